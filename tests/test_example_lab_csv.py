"""The example of a lab's own CSV files, with fewer null runs."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

import lab_csv


@pytest.mark.slow
def test_three_csv_files_of_a_labs_own_naming_become_a_report(tmp_path, capsys):
    lab_csv.main(["--out", str(tmp_path / "lab"), "--null-runs", "24"])
    shown = capsys.readouterr().out
    assert "servo1_goal_deg" in shown and "NAMED" in shown
    page = (tmp_path / "lab" / "report" / "report.html").read_text(encoding="utf-8")
    assert "coulomb friction" in page.lower()
