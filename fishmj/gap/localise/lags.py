"""How late every channel is: behind the model, and behind the command.

Cross-correlation of rates with its bootstrap interval (log/timebase.py), over all records in which the channel moves, set one
after the other with pauses between.
"""

from typing import NamedTuple

import numpy as np

from fishmj.errors import LogError
from fishmj.gap.localise.comparison import Comparison
from fishmj.log.timebase import Lag, lag_between

PAUSE = 3.0  # s between records
SAME = 0.006  # s, lags closer than this are not told apart: what a servo within its tolerance makes
REACH = 0.25  # s
MOVES = {"joint": 0.03, "heading": 0.05}  # rad, standard deviation from which a record has something to compare


class Lags(NamedTuple):
    """None where it cannot be told. Positive: measured comes later.

    joint, heading: measured behind the model; *_after: with the effects found. command: joint behind the command; model: the
    model's joint behind it. residual: what is left of the joints, behind the command.
    """

    joint: Lag | None
    heading: Lag | None
    joint_after: Lag | None
    heading_after: Lag | None
    command: Lag | None
    model: Lag | None
    residual: Lag | None


def lags(c: Comparison) -> Lags:
    """All of them."""
    measured, before, after = (chain(c, "joint", which) for which in ("measured", 0, 1))
    command = commands(c)
    yaw, yaw_before, yaw_after = (chain(c, "heading", which) for which in ("measured", 0, 1))
    rest = None if measured is None or before is None else (measured[0], measured[1] - before[1])
    return Lags(
        joint=between("model", before, "joints", measured),
        heading=between("model", yaw_before, "heading", yaw),
        joint_after=between("model", after, "joints", measured),
        heading_after=between("model", yaw_after, "heading", yaw),
        command=between("command", command, "joints", measured),
        model=between("command", command, "model", before),
        residual=between("command", command, "joint residual", rest, either_sign=True),
    )


def between(a: str, earlier, b: str, later, either_sign: bool = False) -> Lag | None:
    """The lag, or None when it is not found: too short, too weak, too wide an interval, or another peak as high."""
    if earlier is None or later is None:
        return None
    try:
        lag = lag_between((a, *earlier), (b, *later), reach=REACH, either_sign=either_sign)
    except LogError:
        return None
    return lag if lag.found and not lag.ambiguous else None


def chain(c: Comparison, channel: str, which) -> tuple[np.ndarray, np.ndarray] | None:
    """Stamps and values of a channel of all records that move, one after the other. which: "measured", or a row's number."""
    times, values, at = [], [], 0.0
    sensor, columns = ("joint", slice(None)) if channel == "joint" else ("pose", slice(2, 3))
    for record, predicted in zip(c.records, c.predictions, strict=True):
        given = getattr(record, sensor)
        if given is None or given.values[:, columns].std(0).max() < MOVES[channel]:
            continue
        shown = given.values if which == "measured" else predicted[sensor][which]
        times.append(at + given.t)
        values.append(shown[:, columns] - shown[:1, columns])
        at += given.t[-1] + PAUSE
    return (np.concatenate(times), np.concatenate(values)) if times else None


def commands(c: Comparison) -> tuple[np.ndarray, np.ndarray] | None:
    """The commands of the records whose joints move, on the same clock as `chain`."""
    times, values, at = [], [], 0.0
    for record in c.records:
        if record.joint is None or record.joint.values.std(0).max() < MOVES["joint"]:
            continue
        stride = max(round(0.02 / record.dt), 1)
        sent = record.commands[::stride]
        times.append(at + np.arange(len(sent)) * stride * record.dt)
        values.append(sent - sent[:1])
        at += record.joint.t[-1] + PAUSE
    return (np.concatenate(times), np.concatenate(values)) if times else None


def significant(lag: Lag | None) -> bool:
    """Whether a lag is there: its interval leaves zero by more than can be told apart."""
    return lag is not None and (lag.low > SAME or lag.high < -SAME)


def compatible(a: Lag | None, b: Lag | None) -> bool:
    """Whether two lags may be one."""
    return a is not None and b is not None and a.low - SAME <= b.high and b.low - SAME <= a.high
