# make demo         train a fish, judge it, watch it
# make test         style, types, and the tests of every run: all fast ones, and each part of the product once
# make verify       what `make test` leaves out: slow tests, the extras sb3, ray and bench, flow solver, discrepancy, wheel, the site
# make verify-share SHARE=2/15   the second of fifteen parts of it: as much as .ci/run has time for
# make docs         the site of docs/, into build/docs; a broken link fails
# make bench        one JSON line a benchmark
# make lint         style, types and the budget (.ci/budget.toml) only
# make release      dist/: wheel, sdist and their sha256, built, compared and used; uploads nothing
# make manifest     state the sha256 of data/calib after a change there
# VENV=path         another environment than .venv
SHELL := /bin/bash
VENV ?= .venv
PY := $(VENV)/bin/python
JOBS ?= 2
STEP := .ci/step
WORKERS := -n $(JOBS) --dist worksteal
# files in which the mark stands: importing all others takes each process half a minute
marked = $$(grep -lw 'mark\.$(1)' tests/test_*.py)
INSTALLED := $(VENV)/.fishmj-installed
EXTRAS := $(VENV)/.fishmj-extras
SITE := $(VENV)/.fishmj-docs
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# tests start many processes; without bytecode each of them compiles the package
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test verify verify-share slow discrepancy sb3 ray solver docs bench lint install manifest wheel release clean
.DEFAULT_GOAL := test

install: $(INSTALLED)

$(INSTALLED): pyproject.toml studies/pyproject.toml
	@$(STEP) "environment" .ci/environment $(VENV)
	@$(STEP) "install" $(PY) -m pip install --quiet --no-compile --editable ".[dev]" --editable studies
	@touch $@

$(EXTRAS): $(INSTALLED)
	@$(STEP) "install extras" $(PY) -m pip install --quiet --no-compile --editable ".[dev,sb3,ray,bench]"
	@touch $@

$(SITE): $(INSTALLED)
	@$(STEP) "install docs" $(PY) -m pip install --quiet --no-compile --editable ".[docs]"
	@touch $@

demo: $(INSTALLED)
	$(PY) -m fishmj demo

bench: $(INSTALLED)
	$(PY) -m fishmj bench

lint: $(INSTALLED)
	@$(STEP) "style" $(PY) -m ruff check .
	@$(STEP) "format" $(PY) -m ruff format --check .
	@$(STEP) "types" $(PY) -m mypy
	@$(STEP) "budget" $(PY) .ci/shape.py --check

test: lint
	@$(STEP) "tests" $(PY) -m pytest -q $(WORKERS)

verify: $(EXTRAS) $(SITE)
	@$(MAKE) --no-print-directory slow discrepancy
	@$(MAKE) --no-print-directory -j $(JOBS) --output-sync=target wheel sb3 ray solver docs

# the K-th part of N: every N-th file of slow tests, and of the other parts of `make verify` every N-th
SHARE ?= 1/1
OTHERS := discrepancy wheel sb3 ray solver
verify-share: $(INSTALLED)
	@$(MAKE) --no-print-directory slow FISHMJ_SHARE=$(SHARE)
	@some=$$(.ci/share $(SHARE) $(OTHERS)); [ -z "$$some" ] || $(MAKE) --no-print-directory -j $(JOBS) --output-sync=target $$some

slow: $(EXTRAS)
	@$(STEP) "slow tests" $(PY) -m pytest -q $(WORKERS) -m "slow and not gpu and not sb3 and not ray" $(call marked,slow)

discrepancy: $(INSTALLED)
	@$(STEP) "discrepancy" $(PY) -m fishmj.gap bench --small --cases 10 --seed 1 --jobs $(JOBS)

# each of these keeps one core busy: `make verify` runs them side by side
sb3 ray: $(EXTRAS)
	@$(STEP) "$@" $(PY) -m pytest -q -m "$@ and not gpu" $(call marked,$@)

solver: $(INSTALLED)
	@$(STEP) "flow solver" $(PY) -m fishmj.lbm_oracle cases --quick

docs: $(SITE)
	@$(STEP) "docs" $(PY) -m sphinx --fail-on-warning --keep-going --nitpicky --quiet docs build/docs

wheel: $(INSTALLED)
	@$(STEP) "wheel" $(PY) .ci/wheel.py

release: $(INSTALLED)
	@$(STEP) "release" $(PY) .ci/release.py

manifest: $(INSTALLED)
	$(PY) -c "from fishmj.base.store import Manifest; Manifest.of('data/calib').write('data/calib')"

clean:
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
