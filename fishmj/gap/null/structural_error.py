"""Structural error: effect of other forms of water and other servos on the records of a healthy robot.

A calibrated water is right on average. To match another form of water, the strip coefficients would have to differ between kinds
of motion, and over time if the wake has memory. Every servo has some friction and a few milliseconds of delay:

    theta_lk(t) = theta_k + sigma_k (w_k e_lk + s_k sum_i a_lki B_i(t))     record l, strip parameter k (strip_water.py)
    phi_j       = v_j e_j                       parameter j of an effect that is small in healthy robots; all e, a ~ N(0, 1)
    B_i         hat functions every `SPACING`, linear in between
    S          += sum of c c^T over all of these, c: their tangents, + diag(rho_c^2 R^2)      R: smoothed rms of the null runs

The first line is correlated over time, like the error of a force law, and independent between records, so an effect common to
all records stands out. The second is common to all records. The last is the unexplained rest, by channel c.

w, s, v and rho are measured (`python -m studies.structural_error`): the most likely values for healthy robots in
independent waters, each calibrated to its own free swims. They are in data/calib/structural_error.toml, also without each family:
a benchmark scores a family with values from the others.

Directions of a record smaller than `STRONG` of D^1/2 are added to the diagonal instead of as factors.
"""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import UnknownName
from fishmj.gap.models.strip_water import strips_of
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.variances import Sample, score_variances
from fishmj.gap.null.whitening import smooth
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.thresholds import Gates
from fishmj.water.choice import STRUCTURED

FILE = "structural_error.toml"
FORMULA = "formula_error.toml"
SCHEMA = "fishmj.structural_error/1"
ALL = "all"
NEVER = ("", "second_robot")  # families without a robot in the measurement: the null runs are the second robot's
STEP = 0.02  # finite difference, in units of sigma
SPACING = 1.5  # s: a body length at the speed of a gait (chosen)
OWN_PRIOR = 4.0  # weight of the widths of other waters, as a number of observations of a robot's own (chosen)
OWN_ROUNDS = 10  # iterations, starting from the widths of other waters
TINY = 1e-12  # variance in place of zero
STRONG = 1.0  # singular value, in units of D^1/2, from which a direction of a record is a factor


class StructuralErrorScales(NamedTuple):
    """per_record, within_record: w and s by name of a strip parameter. effects: v, SI, by effect and parameter.

    channels: rho.

    adequacy: 95th percentile of |z|^2 / m over healthy robots of a held-out family. beyond_own: 95th percentile, over robots of a
    held-out family, of |z|^2 / m on new experiments relative to that on their calibration swims. gains: largest fall of |z|^2 per
    record by any effect of a stage on those robots. formula: by stage, relative error of an effect's fitted size in the water of
    a held-out family.
    """

    per_record: dict[str, float]
    within_record: dict[str, float]
    effects: dict[str, dict[str, float]]
    channels: dict[str, float]
    adequacy: float = 0.0
    beyond_own: float = 0.0
    gains: dict[str, float] = {}  # noqa: RUF012 (of a tuple, never changed)
    formula: dict[str, float] = {}  # noqa: RUF012

    @classmethod
    def from_table(cls, numbers: dict, swings: dict, **others) -> "StructuralErrorScales":
        """Scales of a table of structural_error.toml, where per_record is `numbers` and within_record `swings`."""
        return cls(numbers, swings, **others)


class StructuralError(NamedTuple):
    """Terms of S: S += F^T F for the factors shared (J, m) and by_record (K_l, m_l) of each record, + diag(variance (m,))."""

    shared: np.ndarray
    by_record: tuple[np.ndarray, ...]
    variance: np.ndarray
    moved: "Tangents | None" = None  # tangents from which it was made

    @property
    def total(self) -> np.ndarray:
        """(m,) variance of each sample."""
        alone = np.concatenate([np.sum(factors**2, 0) for factors in self.by_record]) if self.by_record else 0.0
        return self.variance + np.sum(self.shared**2, 0) + alone


@cache
def widths(without: str = "") -> StructuralErrorScales:
    """Scales measured over all families, or without one of them. Raises UnknownName."""
    table = read_toml(calib_folder() / FILE)
    if (key := ALL if without in NEVER else without) not in table:
        raise UnknownName("family of the structural error", without, sorted(set(table) - {ALL, "schema"}))
    formula = read_toml(calib_folder() / FORMULA)
    return StructuralErrorScales.from_table(**table[key], formula=formula.get(without, formula[ALL]))


def applies(model) -> bool:
    """Returns True for a swimming fish with calibrated water.

    A model with literature values may be wrong by any amount, so it has null runs only, in a water with such values.
    """
    return isinstance(model, SwimmingFish) and model.robot.water.get("model") == STRUCTURED


def of(
    model, records, layout, null: np.ndarray, leftover: np.ndarray, given: StructuralErrorScales, moved: "Tangents | None" = None
) -> StructuralError:
    """Structural error of records; for a model to which it does not apply, only the `record_errors` of the model.

    Args:
        null: (n, m) residuals of null runs. leftover: (m,) D^1/2 without it. moved: tangents of these records, if known.
    """
    if not applies(model):
        alone = model.record_errors(records, layout) if hasattr(model, "record_errors") else ()
        return StructuralError(np.zeros((0, layout.size)), alone, np.zeros(layout.size))
    share = np.array([given.channels.get(str(c), 0.0) for c in layout.channel])
    variance = (share * smooth(np.sqrt(np.mean(null**2, 0)), layout)) ** 2
    moved = moved or tangents(strips_of(model, tuple(given.effects)), records, layout, given.effects)
    by_record, d = [], np.sqrt(leftover**2 + variance)
    for i, part in enumerate(moved.parts):
        mine = layout.record == i
        large, variance_left = strong(part * moved.widths(given, i)[:, None], d[mine])
        by_record.append(large)
        variance[mine] += variance_left
    return StructuralError(moved.shared, tuple(by_record), variance, moved)


def own_widths(
    given: StructuralErrorScales, layout, null: np.ndarray, leftover: np.ndarray, moved: "Tangents", residual: np.ndarray
) -> StructuralErrorScales:
    """Scales of one robot from its own healthy swims: the most likely per_record, within_record and channels.

        u <- u ((seen + nu u_0 / u^2) / (expected + nu / u))^1/2        variances u, those of other waters u_0 (variances.py)

    The prior, a scaled inverse chi-squared, counts other waters as `OWN_PRIOR` observations; undetermined values stay.

    Args:
        layout, null (n, m), leftover (m,), moved, residual (m,): of the swims.
    """
    names, channels = moved.names, list(given.channels)
    scales = [table.get(name, 0.0) for table in (given.per_record, given.within_record) for name in names]
    start = np.array([*scales, *(given.channels[c] for c in channels), 0.0]) ** 2
    count, known = 2 * len(names), np.maximum(start, TINY)
    order = np.arange(len(names))
    groups = [np.concatenate([order, np.tile(order, len(part) // len(names) - 1) + len(names)]) for part in moved.parts]
    channel = np.array([channels.index(c) if c in channels else len(channels) for c in layout.channel.tolist()])
    spread = np.where(channel < len(channels), smooth(np.sqrt(np.mean(null**2, 0)), layout) ** 2, 0.0)
    swum = Sample(
        null=np.concatenate([null / np.sqrt(len(null)), moved.shared]),
        shared=np.zeros((0, layout.size)),
        group=np.zeros(0, int),
        parts=moved.parts,
        groups=groups,
        record=layout.record,
        variance=leftover**2,
        spread=spread,
        channel=channel,
        residual=residual,
    )
    found = known
    for _ in range(OWN_ROUNDS):
        told = score_variances(swum, found[:count], found[count:])
        found = found * np.sqrt((told.seen + OWN_PRIOR * known / found**2) / (told.expected + OWN_PRIOR / found))
    width = np.where(start > 0.0, np.sqrt(found), 0.0).tolist()
    tables = (dict(zip(names, width[i : i + len(names)], strict=True)) for i in (0, len(names)))
    return given._replace(
        per_record=given.per_record | next(tables),
        within_record=given.within_record | next(tables),
        channels=dict(zip(channels, width[count:-1], strict=True)),
    )


def allowed(gates: Gates, given: StructuralErrorScales, calibration_residual: float = 0.0) -> Gates:
    """The gates, widened by the residuals of healthy robots in an unknown water before and after a search, and by their gains.

    calibration_residual: baseline misfit, |z|^2 / m on healthy swims of this robot (search/healthy_swims.py); 0 if not measured.
    """
    usual = max(given.adequacy, given.beyond_own * calibration_residual)
    adequacy, residual = (max(usual, gate) for gate in (gates.adequacy, gates.residual))
    return replace(gates, adequacy=adequacy, residual=residual, gain=gates.calibrated_gain)


class Tangents(NamedTuple):
    """Tangents of the structural error.

    parts: of each record (K (1 + windows), m_l), response to sigma of each strip parameter throughout, then in each window.
    names: (K,) of the parameters. shared: (J, m) response to each effect of healthy robots at its size.
    """

    parts: list[np.ndarray]
    names: list[str]
    shared: np.ndarray

    def widths(self, given: StructuralErrorScales, record: int) -> np.ndarray:
        """(K (1 + windows),) scales of the parts of a record."""
        throughout, within = ([table.get(n, 0.0) for n in self.names] for table in (given.per_record, given.within_record))
        windows = len(self.parts[record]) // len(self.names) - 1
        return np.concatenate([throughout, np.tile(within, windows)])


def tangents(strips, records, layout, sizes: dict[str, dict[str, float]]) -> Tangents:
    """Tangents of every record. strips: `GatedWater`. sizes: v of the effects that `strips` has, SI."""
    sigma = np.array([r.sigma for r in strips.ranges()])
    count = len(sigma)
    throughout, swings = (np.tile(strips.null, (1 + count, 1)) for _ in range(2))
    throughout[1:, :count] += STEP * np.diag(sigma)
    swings[1:, count : 2 * count] += STEP * np.diag(sigma)
    places = [strips.index(effect, name) for effect, values in sizes.items() for name in values]
    effects = np.tile(strips.null, (len(places), 1))
    for row, place, size in zip(effects, places, [v for values in sizes.values() for v in values.values()], strict=True):
        row[place] += size  # at its full size: dry friction has no slope at zero

    parts, shared = [], np.zeros((len(places), layout.size))
    for i, record in enumerate(records):
        alone = ResidualLayout([record])
        t = np.arange(len(record.commands)) * record.dt
        gates = [np.maximum(0.0, 1.0 - np.abs(t - at) / SPACING) for at in np.arange(0.0, t[-1] + SPACING, SPACING)]
        still = strips.predict([strips.gated(record, 0.0 * t)], np.concatenate([throughout, effects]))
        seen = np.nan_to_num(alone.residuals(still))
        moved = [(seen[1 : 1 + count] - seen[0]) / STEP]
        shared[:, layout.record == i] = seen[1 + count :] - seen[0]
        for one in strips.predict([strips.gated(record, gate) for gate in gates], swings):
            seen = np.nan_to_num(alone.residuals([one]))
            moved.append((seen[1:] - seen[0]) / STEP)
        parts.append(np.concatenate(moved))
    return Tangents(parts, [constant.name for constant in strips.numbers], shared)


def strong(moved: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(factors (K, m), variance (m,) of the rest) of the tangents (k, m) of one record, over D^1/2 (m,).

    Singular vectors give the same covariance as the tangents, and most are negligible.
    """
    _, size, shape = np.linalg.svd(moved / d, full_matrices=False)
    directions, large = size[:, None] * shape * d, size >= STRONG
    return directions[large], np.sum(directions[~large] ** 2, 0)
