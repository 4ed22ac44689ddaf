"""The default run stays short, by a bound on the CPU time of what is not marked slow, and has every part of the product."""

import re
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

HERE = Path(__file__).resolve().parent
PARTS = {"search", "fit", "training", "swim", "page"}  # of the product, each from end to end in every run
BURN = """
import subprocess, sys, time
import pytest

def burn(seconds):
    until = time.process_time() + seconds
    while time.process_time() < until:
        pass
"""
MARKS = "[pytest]\nmarkers =\n  slow: x\n  part: x\n"


@pytest.fixture
def run(pytester, monkeypatch):
    """run(tests) -> outcomes, under our conftest with bounds of 0.1, 0.4 and 0.8 s of CPU, in folders of its own."""
    monkeypatch.setenv("FISHMJ_CACHE", str(pytester.path / "kept"))
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(pytester.path / "kept" / "jax"))
    bounds = "OF_A_TEST, OF_SHARED, OF_A_PART = 0.1, 0.4, 0.8\n"
    text = (HERE / "conftest.py").read_text(encoding="utf-8")
    text = text.replace(', *_WARP.glob("*"), *_SOURCES.rglob("__pycache__")', ",")
    pytester.makeconftest(re.sub(r"^OF_A_TEST, .*\n", bounds, text, flags=re.MULTILINE))
    pytester.makeini(MARKS)

    def outcomes(tests: str) -> dict:
        pytester.makepyfile(BURN + tests)
        return pytester.runpytest_inprocess("-p", "no:cacheprovider").parseoutcomes()

    return outcomes


@pytest.mark.parametrize(
    "test, outcome",
    (
        ("def test(): burn(0.2)", "failed"),
        ("def test(): subprocess.run([sys.executable, '-c', 'sum(range(10**7))'])", "failed"),
        ("def test(): time.sleep(0.3)", "passed"),
        ("@pytest.mark.slow\ndef test(): burn(0.2)", "passed"),
        ("@pytest.mark.part('fit')\ndef test(): burn(0.2)", "passed"),
        ("@pytest.mark.part('fit')\ndef test(): burn(1.0)", "failed"),
        ("@pytest.fixture\ndef made(): burn(0.2)\ndef test(made): pass", "passed"),
        ("@pytest.fixture\ndef made(): burn(0.5)\ndef test(made): pass", "errors"),
    ),
)
def test_cpu_time_is_bounded_where_a_test_is_not_marked_slow(run, test, outcome):
    assert run(test) == {outcome: 1}


@pytest.mark.parametrize("folder, outcome", (("kept", "passed"), ("kept/null", "passed"), ("elsewhere", "failed")))
def test_a_test_that_compiles_what_is_kept_is_judged_by_the_next_run(run, pytester, folder, outcome):
    (pytester.path / folder).mkdir(parents=True)
    assert run(f"def test():\n    burn(0.2)\n    open({str(pytester.path / folder / 'code')!r}, 'w').close()") == {outcome: 1}


def test_every_part_of_the_product_is_in_every_run():
    marks = re.compile(r'pytest\.mark\.part\("(\w+)"\)')
    assert {part for path in HERE.glob("test_*.py") for part in marks.findall(path.read_text(encoding="utf-8"))} == PARTS
