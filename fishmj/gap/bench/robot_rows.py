"""Judges data sets of articulated robots: the search as `gap find LOGS --model robot.xml` runs it, and its answer as a row.

A log that the search refuses, and a fault of the search itself, are answers, too (REFUSED, FAULT): they name nothing, and are
counted. A set in which a hidden effect does not show is not searched.
"""

import argparse
import contextlib
import io
import time
import traceback
from pathlib import Path

from fishmj.base.errors import FishmjError
from fishmj.gap.bench.run_case import answered_by, effect_row
from fishmj.gap.commands import find_robot
from fishmj.gap.laboratory.articulated.robot_session import SEEN
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.null.null_runs import RUNS
from fishmj.gap.records.robot_logs import guess_columns, log_files, read_robot_logs, read_sheet

AS_SHIPPED = {
    "null_runs": RUNS,
    "noise": 1.0,
    "seed": 0,
    "most": None,
    "anyway": True,
}  # options of `gap find`; a hidden effect may look like a mistake in the logs


def judge_set(folder: Path, row: dict) -> dict:
    """Row of one data set with the search's answer. folder: of all sets."""
    begin, start = time.process_time(), time.monotonic()
    about = dict(row)
    if "answer" not in row:
        small = row["kind"] in ("single", "pair") and min(row["visible"].values()) <= SEEN
        about |= {"answer": "NOT_SEARCHED"} if small else answer_of(folder / row["id"])
    return about | {"cpu_seconds": time.process_time() - begin, "seconds": time.monotonic() - start}


def answer_of(place: Path) -> dict:
    """Entries of a row on one data set."""
    nothing: dict = {"said": [], "rivals": [], "by_effect": {}}
    try:
        robot = read_robot(place / "robot.xml")
        files = log_files(place / "logs")
        columns = guess_columns(
            list(read_sheet(files[0]).columns), robot.sites("joint"), robot.actuators, False, free=robot.base is not None
        )
        trials, broken = read_robot_logs(files, columns)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            inquiry = find_robot.search(robot, trials, argparse.Namespace(**AS_SHIPPED))
    except FishmjError as error:
        return nothing | {"answer": "REFUSED", "reason": str(error).replace(f"{place.parent}/", "")}  # rows are shared
    except Exception as error:  # noqa: BLE001  one fault of the search must not end a benchmark of hundreds; it is counted
        told = traceback.format_exc().splitlines()[-8:]
        return nothing | {"answer": "FAULT", "reason": f"{type(error).__name__}: {error}", "traceback": told}
    verdict = inquiry.verdict
    out = answered_by(verdict) | {"reason": verdict.reason, "tentative": [effect_row(e) for e in verdict.tentative]}
    out |= {"standing": list(verdict.rivals), "torque_tolerance": inquiry.evidence.model.torque_tolerance}
    return out | {"by_effect": find_robot.by_effect(verdict), "broken": broken}
