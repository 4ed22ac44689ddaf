"""A run lists its slowest tests and fails none of them for it; every part of the product is in the default run."""

import re
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

HERE = Path(__file__).resolve().parent
PARTS = {"search", "fit", "training", "swim", "page"}  # of the product, each from end to end in every run
TESTS = """
import subprocess, sys, time
import pytest

def burn(seconds):
    until = time.process_time() + seconds
    while time.process_time() < until:
        pass

def test_quick(): pass
def test_busy(): burn(0.3)
def test_child(): subprocess.run([sys.executable, '-c', 'sum(range(10**7))'])
@pytest.mark.slow
def test_marked(): burn(0.2)
"""


@pytest.mark.parametrize("workers", ([], ["-n", "1"]))
def test_slow_tests_are_listed_and_pass(pytester, workers):
    text = (HERE / "conftest.py").read_text(encoding="utf-8")
    pytester.makeconftest(re.sub(r"^QUICK, LISTED = .*\n", "QUICK, LISTED = 0.05, 3\n", text, flags=re.MULTILINE))
    pytester.makeini("[pytest]\nmarkers =\n  slow: x\n")
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", *workers)
    assert result.parseoutcomes() == {"passed": 4}
    shown = re.findall(r"^ *[\d.]+  \S+::(\w+)(.*)$", result.stdout.str(), flags=re.MULTILINE)
    hints = {name: bool(hint) for name, hint in shown}
    assert len(shown) == 3 and hints["test_busy"] and hints["test_child"] and not hints.get("test_marked", False)


def test_default_run_holds_every_part():
    marks = re.compile(r'pytest\.mark\.part\("(\w+)"\)')
    assert {part for path in HERE.glob("test_*.py") for part in marks.findall(path.read_text(encoding="utf-8"))} == PARTS


def test_no_test_bounds_elapsed_time():
    clock = re.compile(r"assert .*(process_time|perf_counter|monotonic)\(\).* < |assert .*\b(took|elapsed)\b *<")
    found = [
        f"{path.name}:{number}: {line.strip()}"
        for path in sorted(HERE.glob("*.py"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if clock.search(line) and "clock = re" not in line
    ]
    assert not found, "\n".join(["no test may fail because of time", *found])
