# make demo         train a fish, judge it, watch it
# make test         style, types, import order, tests, and the wheel in a fresh environment
# make test-extras  what needs the extras sb3, ray and bench
# make bench        one JSON line a benchmark
# make lint         style and types only
# make manifest     state the sha256 of data/calib after a change there
# VENV=path         another environment than .venv
SHELL := /bin/bash
VENV ?= .venv
PY := $(VENV)/bin/python
JOBS ?= 2
STEP := .ci/step
INSTALLED := $(VENV)/.fishmj-installed
EXTRAS := $(VENV)/.fishmj-extras
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test test-extras bench lint install manifest wheel clean
.DEFAULT_GOAL := test

install: $(INSTALLED)

$(INSTALLED): pyproject.toml
	@$(STEP) "environment" .ci/environment $(VENV)
	@$(STEP) "install" $(PY) -m pip install --quiet --editable ".[fast,dev]"
	@touch $@

$(EXTRAS): $(INSTALLED)
	@$(STEP) "install extras" $(PY) -m pip install --quiet --editable ".[fast,dev,sb3,ray,bench]"
	@touch $@

demo: $(INSTALLED)
	$(PY) -m fishmj.demo

bench: $(INSTALLED)
	$(PY) -m fishmj.bench

lint: $(INSTALLED)
	@$(STEP) "style" $(PY) -m ruff check .
	@$(STEP) "format" $(PY) -m ruff format --check .
	@$(STEP) "types" $(PY) -m mypy

test: lint
	@$(STEP) "import order" $(PY) -m pytest -q tests/test_architecture.py
	@$(STEP) "tests" $(PY) -m pytest -q -n $(JOBS) --dist loadfile --durations 15 --ignore tests/test_architecture.py
	@$(STEP) "flow solver" $(PY) -m fishmj.lbm_oracle cases --quick
	@$(STEP) "discrepancy" $(PY) -m fishmj.gap bench --small --cases 20 --seed 1 --jobs $(JOBS)
	@$(MAKE) --no-print-directory wheel

wheel: $(INSTALLED)
	@$(STEP) "wheel" $(PY) .ci/wheel.py

test-extras: $(EXTRAS)
	@$(STEP) "sb3" $(PY) -m pytest -q -m sb3 --durations 5
	@$(STEP) "ray" $(PY) -m pytest -q -m ray --durations 5
	@$(STEP) "baselines" $(PY) -m pytest -q tests/test_gap_baselines.py

manifest: $(INSTALLED)
	$(PY) -c "from fishmj.store import Manifest; Manifest.of('data/calib').write('data/calib')"

clean:
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
