"""`gap check VERSION.xml --data LOGS` for a robot in MJCF: the gap of a version and of its parent, on logs set aside.

The parent is --parent, or the model that verdict.json beside the version names. On the data of that search only the logs set
aside count, or the first fold if there were too few to set some aside; on other data all logs.

gap       mean square of the residual over the parent's floor: its constants within their tolerances, noise, errors of the starts
interval  90 %, of the ratio of both gaps: Bayesian bootstrap (Rubin 1981) over logs, or over segments of fewer than FEW logs
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.cores import one_blas_thread
from fishmj.base.errors import ConfigError, LogError
from fishmj.base.store import sha256
from fishmj.gap import progress
from fishmj.gap.commands import reported
from fishmj.gap.commands.admit_robot import refuse_mistakes
from fishmj.gap.commands.find_robot import columns_of, logs_digest, refuse_fish_options
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import RobotDescription, read_robot
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.null.robot_null import RobotNull
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.robot_logs import log_files, read_robot_logs
from fishmj.gap.records.shooting import assumed, robot_records
from fishmj.gap.search.likelihood import likelihood_of
from fishmj.gap.thresholds import frozen
from fishmj.gap.wording import level, number

FEW = 5  # logs from which the bootstrap is over logs
DRAWS = 4000


class Ratio(NamedTuple):
    """A ratio of two gaps with its 90 % interval. over: logs or segments."""

    value: float
    low: float
    high: float
    over: str

    @property
    def text(self) -> str:
        """The ratio in words."""
        return f"{number(self.value)} ({number(self.low)} to {number(self.high)}, over {self.over})"


@one_blas_thread()
def check_robot(args: Any) -> dict:
    """Answers the command: both gaps, by joint too, and the reason of a failure ("" without one). args: of `gap check`.

    Raises ConfigError: no parent, a parent that changed, or one with other joints; LogError: no judging log is left.
    """
    refuse_fish_options(args, "gap check")
    context = _searched(args.model) if args.parent is None else None
    parent = read_robot(Path(context.model) if context else args.parent)
    version = read_robot(args.model)
    for kind, of in (("joint", lambda r: r.channels), ("actuator", lambda r: r.sites("actuator"))):
        if of(parent) != of(version):
            names = " and ".join(f"{r.path} ({', '.join(of(r))})" for r in (parent, version))
            raise ConfigError(f"gap check: {kind}s differ between {names}; name the description of which it is a version")
    files = log_files(args.data)
    columns = columns_of(args, parent, files)
    same = context is not None and logs_digest(files) == context.data_sha256
    trials, broken = read_robot_logs(files, columns)
    if same and context is not None:
        trials = [trial for trial in trials if trial.name in context.judged]
        if not trials:
            raise LogError(f"{args.data}: has none of the logs that the search set aside: {', '.join(context.judged)}")
    for name, why in broken.items():
        console.warn(f"{name} left out: {why}")
    records = robot_records(trials, parent.dt, parent.channels)
    parent.check_contact(records)
    refuse_mistakes(parent, records, anyway=True)
    found = compare(parent, version, records)
    fields = {"model": str(args.model), "parent": str(parent.path), "logs": [r.name for r in records], "same_data": same}
    return fields | found | {"skipped": broken}


def _searched(version: Path) -> Any:
    """The context of the search beside a version. Raises ConfigError."""
    report = version.parent / "verdict.json"
    found = reported.robot_verdict(report) if report.is_file() else None
    if found is None:
        raise ConfigError(f"gap check: no verdict.json of a robot beside {version}; name its parent with --parent robot.xml")
    context = reported.RobotContext.model_validate(found["context"])
    if not Path(context.model).is_file() or sha256(Path(context.model)) != context.model_sha256:
        raise ConfigError(f"{context.model}: missing or changed since the search; name the version's parent with --parent")
    return context


def compare(parent: RobotDescription, version: RobotDescription, records: list) -> dict:
    """Both gaps on some `RobotRecord`s, their ratio, the RMS error at each joint [rad or m], and the reason of a failure."""
    sizes = sizes_of(parent, records)
    one, other = (RigidRobot(robot, sizes, catalogue=()) for robot in (parent, version))
    scale = likelihood_of(one, records, RobotNull(), progress.terminal_bar).scale
    layout = ResidualLayout(records)
    residuals = [layout.residuals(model.predict(records, model.nothing))[0] for model in (one, other)]
    before, after = (by_segment(layout, (r / scale) ** 2) for r in residuals)
    gaps = [float(g.mean()) for g in (before, after)]
    record = np.repeat(np.arange(len(records)), [len(r.starts) for r in records])
    ratio = ratio_of(before, after, record)
    joints = {name: [float(np.sqrt(np.nanmean(r[layout.channel == name] ** 2))) for r in residuals] for name in parent.channels}
    worse = ""
    if not gaps[1] < gaps[0]:
        worse = f"gap {level(gaps[1])} on {len(records)} logs, no smaller than its parent's {level(gaps[0])}"
    left = ""
    if gaps[1] > frozen().adequacy:
        left = f"gap {level(gaps[1])}: above {level(frozen().adequacy)}, the most that tolerances and noise explain"
    doubt = f"the interval of the ratio contains 1: {len(record)} segments cannot decide" if ratio.low < 1.0 < ratio.high else ""
    result = {
        "gap_parent": gaps[0],
        "gap": gaps[1],
        "ratio": ratio._asdict(),
        "by_joint": joints,
        "worse": worse,
        "left": left,
        "doubt": doubt,
    }
    return result | {"text": f"gap {level(gaps[0])} -> {level(gaps[1])}, ratio {ratio.text}"}


def by_segment(layout: ResidualLayout, squared: np.ndarray) -> np.ndarray:
    """(S,) mean of squares (m,) over each segment of all records; channels have equal weight."""
    out = []
    for i, record in enumerate(layout.records):
        whole, count = np.zeros(len(record.starts)), np.zeros(len(record.starts))
        for b in layout.blocks:
            if b.record == i:
                place = np.searchsorted(record.starts, b.t, side="right") - 1
                np.add.at(whole, place, np.nan_to_num(squared[b.where], nan=1e12))
                np.add.at(count, place, 1)
        out.append(whole / np.maximum(count, 1))
    return np.concatenate(out)


def ratio_of(before: np.ndarray, after: np.ndarray, record: np.ndarray) -> Ratio:
    """Ratio of the means of two gaps by segment (S,). record: (S,) number of each segment's log."""
    logs = int(record.max()) + 1
    unit = record if logs >= FEW else np.arange(len(record))
    sums = np.stack([np.bincount(unit, weights=part) for part in (before, after)])
    draws = np.random.default_rng(0).dirichlet(np.ones(sums.shape[1]), DRAWS) @ sums.T
    low, high = np.quantile(draws[:, 1] / draws[:, 0], [0.05, 0.95])
    return Ratio(float(after.mean() / before.mean()), float(low), float(high), "logs" if logs >= FEW else "segments")


def printed_lines(found: dict) -> list[str]:
    """Lines for a terminal."""
    whose = "logs that the search set aside" if found["same_data"] else "logs"
    rows = [{"joint": n, "RMS of the parent [rad, m]": a, "RMS [rad, m]": b} for n, (a, b) in found["by_joint"].items()]
    notes = [found[key] for key in ("left", "doubt") if found[key]]
    seconds = assumed("segments")["length"]
    over = f"{len(found['logs'])} {whose}, segments of {seconds:g} s; 1: within the description's tolerances"
    return [f"{found['text']}; {over}", console.table(rows), *notes]
