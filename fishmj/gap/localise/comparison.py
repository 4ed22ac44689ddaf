"""Input of a localisation, and the shares of the gap by channel and by regime of the robot.

    share(channel, regime) = max(0, sum (z^2 - 1)) / sum of all cells        z whitened residual, as in the gap: |z|^2 / m

Every half second counts once, with the most specific of its labels (log/regimes.py).
"""

from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import LogError
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record, ResidualLayout
from fishmj.log import Trial, numbered
from fishmj.log.regimes import label


class Comparison(NamedTuple):
    """Records and their predictions by two parameter rows: present model (0), model with the found effects (1; if none, as 0).

    layout: of the logs, without weighings. scale: (m,) floor, standard deviation of the null runs' residual. rows: (2, P).
    predictions: `model.predict` of both rows. residuals: (2, m) measured minus predicted; whitened: (2, m) z of them.
    """

    model: Any
    records: list[Record]
    layout: ResidualLayout
    scale: np.ndarray
    rows: np.ndarray
    predictions: list[dict]
    residuals: np.ndarray
    whitened: np.ndarray

    @property
    def changed(self) -> bool:
        """Returns True if any effect was found."""
        return not np.array_equal(self.rows[0], self.rows[1])

    @property
    def ratio(self) -> np.ndarray:
        """(2, m) z^2, whose mean is the gap: healthy robots leave about 1."""
        return self.whitened**2

    @property
    def over_floor(self) -> np.ndarray:
        """(2, m) squared residuals over the floor, for patterns in time: whitening mixes z over time."""
        return (self.residuals / self.scale) ** 2


def compared(e, near, before, after) -> Comparison:
    """Simulates both rows over the records of a likelihood `e` (search/likelihood.py); weighings are left out.

    near: the same likelihood, linearised at `after`.
    """
    logs, kept = [r._replace(weighed=None) for r in e.records], e.layout.channel != mass_properties.CHANNEL
    rows = np.stack([np.asarray(before, float), np.asarray(after, float)])
    predictions = e.model.predict(e.records, rows)
    residuals = e.layout.residuals(predictions)
    whitened = np.stack([at.subset().whiten(np.nan_to_num(r)) for at, r in zip((e, near), residuals, strict=True)])
    layout = ResidualLayout(logs)
    return Comparison(e.model, logs, layout, e.scale[kept], rows, predictions, residuals[:, kept], whitened[:, kept])


PRIORITY = (  # label, words; the most specific first
    ("joint_step", "joint steps"),
    ("torque_limited", "holding far from the command"),
    ("turn", "turns"),
    ("ramp", "growing and fading beats"),
    ("steady_swim", "steady swimming"),
    ("coast", "coasting"),
    ("creep", "slow joint motion"),
    ("rest", "rest"),
)
KINDS = (*(words for _, words in PRIORITY), "other motion")
OTHER = len(PRIORITY)


def trial_of(record: Record) -> Trial:
    """The record as a trial again, for the labels."""
    stride = max(round(0.02 / record.dt), 1)
    commands = record.commands[::stride]
    tables = {"cmd": {"t": np.arange(len(commands)) * stride * record.dt, **numbered("c#", commands)}}
    if record.joint is not None:
        tables["joint"] = {"t": record.joint.t, **numbered("j#", record.joint.values)}
    if record.pose is not None:
        x, y, yaw = record.pose.values.T
        tables["pose"] = {"t": record.pose.t, "x": x, "y": y, "yaw": yaw}
    flow = {"speed": float(np.hypot(*record.flow)), "direction": float(np.arctan2(record.flow[1], record.flow[0]))}
    return Trial({"flow": flow}, tables, name=record.name)


def beat_of(record: Record) -> float:
    """Period of the command's beat, s: median time between every second zero crossing; 1 s without a beat."""
    c = record.commands - record.commands.mean(0)
    c = c[:, int(np.argmax(c.std(0)))]
    turns = np.flatnonzero(np.diff(np.sign(c[np.abs(c) > 1e-6])) != 0)
    return float(2 * np.median(np.diff(turns)) * record.dt) if len(turns) > 4 else 1.0


def kinds_of(record: Record, t: np.ndarray) -> np.ndarray:
    """(n,) index into KINDS of the robot's regime at times t."""
    try:
        found = label(trial_of(record), beat=float(np.clip(beat_of(record), 0.2, 4.0)))
    except LogError:  # shorter than one window
        return np.full(len(t), OTHER)
    kind = np.full(len(found), OTHER)
    for i, (name, _) in reversed(list(enumerate(PRIORITY))):
        kind[found.is_[name]] = i
    window = np.clip(np.searchsorted(found.start, t, side="right") - 1, 0, len(found) - 1)
    return kind[window]


def kinds(c: Comparison) -> np.ndarray:
    """(m,) index into KINDS for every entry of the comparison."""
    out = np.empty(c.layout.size, int)
    for b in c.layout.blocks:
        out[b.where] = kinds_of(c.records[b.record], b.t)
    return out


def shares(c: Comparison, kind: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    """(channels, share of the gap above 1, mean of z^2 (NaN without data), share of the channel's time), (C, K) each.

    The start, a single moment, has no share of the time.
    """
    names = tuple(dict.fromkeys(b.channel for b in c.layout.blocks))
    excess, time = np.zeros((2, len(names), len(KINDS)))
    level = np.full((len(names), len(KINDS)), np.nan)
    ratio = c.ratio[0]
    for i, name in enumerate(names):
        for k in range(len(KINDS)):
            some = (c.layout.channel == name) & (kind == k)
            time[i, k] = some.sum() / (c.layout.channel == name).sum() if name != "start" else 0.0
            if some.any():
                excess[i, k] = max(0.0, float(np.sum((ratio - 1)[some])))
                level[i, k] = float(np.mean(ratio[some]))
    total = excess.sum()
    return names, excess / total if total > 0 else excess, level, time
