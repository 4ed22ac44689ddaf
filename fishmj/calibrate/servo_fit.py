"""Servo and command latency from joint angles: torque = clip(kp (c(t - delay) - q), +-T) - kd q' - F sign(q').

Fitted at once on sine, square and impulse in air and water (paper: "tuned to step and transient responses"), every sample at its
own stamp. What the water and the hull do is known to some per cent only: those constants take part with their tolerance.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from fishmj.calibrate.calibration_logs import MEDIA, SIGNALS, Logs, angles
from fishmj.calibrate.least_squares import Block, FreeParameter, LeastSquaresFit, ParameterEstimate, Tick, fit
from fishmj.errors import LogError
from fishmj.gap.models.swimming_fish import STAND_CONSTANTS, ServoStand
from fishmj.gap.records.records import Record
from fishmj.gap.watch import Bar, Bars, silent

FREE = ("kp", "kd", "friction", "command_latency")
OPEN = 1.0  # width of a 90 % interval, of the number itself (friction: of the stall torque); wider is not told
STRAINED = 3.0  # tolerances that a constant of hull or water may be off before the water is called another


class ServoFit(NamedTuple):
    """The fit on everything, on each medium alone, and what it was fitted to."""

    plant: ServoStand
    records: list[Record]
    row: np.ndarray
    whole: LeastSquaresFit
    alone: dict[str, LeastSquaresFit]

    @property
    def estimates(self) -> dict[str, ParameterEstimate]:
        return {name: self.whole.estimates[name] for name in FREE}

    @property
    def hull(self) -> list[dict]:
        """Constants of hull and water, factors: how many tolerances the trials pushed each of them."""
        values = {c.name: (self.whole.estimates[c.name].value, c.sigma) for c in STAND_CONSTANTS[2:]}
        return [{"constant": k, "factor": v, "tolerance": s, "off by": abs(v - 1.0) / s} for k, (v, s) in values.items()]

    @property
    def words(self) -> str:
        """Which of them were pushed too far; empty when none was."""
        far = [f"{row['constant']} {row['factor']:.2f}" for row in self.hull if row["off by"] > STRAINED]
        return f"the model's water is not that of the trials: {', '.join(far)} of the described values" if far else ""


def calibrate(logs: Logs, plant: ServoStand, *, alone: bool = True, bars: Bars = silent) -> ServoFit:
    """Fit kp, kd, friction and command latency to the bench trials of `logs`.

    Args:
        alone: fit air and water by themselves as well: two media that disagree are a missing effect. bars: of the fits.

    Raises:
        LogError: too few trials with joint angles and moving commands, or they leave a number open.
    """
    records = logs.records(plant.dt, logs.bench())
    media = [m for m in MEDIA if any(r.medium == m for r in records)] if alone else []
    sets = {"": records} | {m: [r for r in records if r.medium == m] for m in media if len(media) > 1}
    fits = {}
    with bars(len(sets), "servo", "fits") as bar:
        for i, (medium, part) in enumerate(sets.items()):
            fits[medium] = fitted(plant, part, partial(_counted, bar, i))
    whole, apart = fits.pop(""), fits
    if left := open_numbers(plant, whole.estimates):
        raise LogError(
            f"{logs.folder}: {len(records)} trials do not tell {'; '.join(left)}. "
            f"Record {', '.join(SIGNALS)} in air and in water, three times each, with amplitudes that move the joints"
        )
    return ServoFit(plant, records, row_of(plant, whole.theta), whole, apart)


def parameters(plant: ServoStand) -> list[FreeParameter]:
    """What is free, and the hull's constants within their tolerance."""
    s, late = plant.robot.servo, plant.latency
    free = [
        FreeParameter("kp", "N m/rad", s.kp, 0.02 * s.kp, 0.1 * s.kp, 10 * s.kp),
        FreeParameter("kd", "N m s/rad", s.kb + s.kv, 0.02 * s.kb, 0.1 * s.kb, 10 * s.kb),
        FreeParameter("friction", "N m", 0.01, 0.002, 0.0, s.torque),
        FreeParameter("command_latency", "s", late, 0.001, 0.0, late + 0.25),
    ]
    return free + [FreeParameter(c.name, "factor", 1.0, 0.02, 0.3, 3.0, c.sigma) for c in STAND_CONSTANTS[2:]]


def open_numbers(plant: ServoStand, estimates: dict[str, ParameterEstimate]) -> list[str]:
    """Of what is free, the numbers that the trials leave open: an interval as wide as the number, or one at its bound."""
    out = []
    for p in (p for p in parameters(plant) if p.name in FREE):
        e = estimates[p.name]
        scale = plant.robot.servo.torque if p.name == "friction" else abs(e.value)
        if e.high - e.low > OPEN * scale or e.value >= p.high or (e.value <= p.low and p.name != "friction"):
            out.append(f"{p.name} ({e.low:.3g} to {e.high:.3g} {e.unit}, sought in {p.low:.3g} to {p.high:.3g})")
    return out


def row_of(plant: ServoStand, theta) -> np.ndarray:
    """The plant's row for fitted parameters (K,)."""
    row = plant.null.copy()
    row[[plant.place("kp"), plant.place("kd")]] = theta[:2]
    row[plant.index("coulomb_friction", "torque")] = theta[2]
    row[plant.index("command_latency", "delay")] = theta[3] - plant.latency
    row[[plant.place(c.name) for c in STAND_CONSTANTS[2:]]] = theta[4:]
    return row


def _counted(bar: Bar, before: int, share: float) -> None:
    """A share of one fit, on the bar of all."""
    bar.update(before + share)


def fitted(plant: ServoStand, records: list[Record], tick: Tick = lambda share: None) -> LeastSquaresFit:
    """The fit on some records. tick: share of it that is done."""
    blocks, size = [], 0
    for record in records:
        for _ in range(angles(record).values.shape[1]):
            where = slice(size, size + len(angles(record).t))
            blocks.append(Block(record.name, f"{record.excitation} {record.medium}", where))
            size = where.stop

    def residual(thetas: np.ndarray) -> np.ndarray:
        predicted = plant.predict(records, np.array([row_of(plant, theta) for theta in thetas]))
        parts = [(angles(r).values - p["joint"]).transpose(0, 2, 1) for r, p in zip(records, predicted, strict=True)]
        return np.concatenate([part.reshape(len(thetas), -1) for part in parts], 1)

    return fit(parameters(plant), residual, blocks, tick)
