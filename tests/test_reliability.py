"""The page of faults names every fault test, and only tests that exist."""

import re
from pathlib import Path

HERE = Path(__file__).resolve().parent


def test_the_page_of_faults_is_complete():
    there = {
        f"{path.name}::{name}"
        for path in HERE.glob("test_*.py")
        for name in re.findall(r"^def (test_fault_\w+)", path.read_text(encoding="utf-8"), re.M)
    }
    named = re.findall(r"`(test_\w+\.py::test_fault_\w+)`", (HERE / "FAULTS.md").read_text(encoding="utf-8"))
    assert sorted(there) == sorted(named)
