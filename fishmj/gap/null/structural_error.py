"""Structural error: what another hand's water and servos do to the records, though nothing is missing in the robot.

A calibrated water is right on average. Another form of water asks for other coefficients of the strips in each kind of motion,
and from moment to moment where the wake remembers; every servo has some friction and is some milliseconds late:

    theta_lk(t) = theta_k + sigma_k (w_k e_lk + s_k sum_i a_lki B_i(t))     record l, number k of the strips (strip_water.py)
    phi_j       = v_j e_j                       parameter j of an effect that healthy robots have a little of; all e, a ~ N(0, 1)
    B_i         hat functions every `SPACING`   t between them: straight
    S          += sum over all of these of c c^T, c their tangents, + diag(rho_c^2 R^2)       R rms of the null runs, smoothed

The first are correlated over time, as the error of a force law is, and different from record to record, so that an effect which
is the same in all of them stands out. The second are the same in all. The last is what neither makes up for, by channel c.
w, s, v and rho are measured (`python -m studies.structural_error`): the most likely ones for healthy robots of independent
waters, each calibrated to its own free swims. data/calib/structural_error.toml has them, and those without each family, by which
a benchmark scores it.

Directions of a record that do less than `STRONG` of D^1/2 go onto the diagonal: they are not worth a factor.
"""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import UnknownName
from fishmj.gap.models.strip_water import strips_of
from fishmj.gap.null.variances import Sample, asked
from fishmj.gap.null.whitening import smooth
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.thresholds import Gates
from fishmj.water.choice import STRUCTURED

FILE = "structural_error.toml"
FORMULA = "formula_error.toml"
SCHEMA = "fishmj.structural_error/1"
ALL = "all"
NEVER = ("", "second_robot")  # no robot of theirs took part: the null runs are the second robot's
STEP = 0.02  # of sigma, of the finite differences
SPACING = 1.5  # s: a body length at the speed of a gait (chosen)
OWN_PRIOR = 4.0  # observations of each width that those of other waters count as, against a robot's own (chosen)
OWN_ROUNDS = 10  # of the algorithm, from the widths of other waters
TINY = 1e-12  # variance that stands for none
STRONG = 1.0  # of D^1/2, singular value from which a direction of a record is a factor of its own


class Widths(NamedTuple):
    """numbers, swings: w and s by name of a number of the strips. effects: v, SI, by effect and parameter. channels: rho.

    adequacy: |z|^2 / m that 19 of 20 healthy robots of a family which took no part do not reach. beyond_own: what 19 of 20 robots
    of a family that nobody has seen leave of new experiments at most, over what they leave of the swims that their water was
    calibrated to. gains: |z|^2 a record that, in all of the first, no effect of a stage takes off. formula: by stage, relative
    error of the size that a formula asks for in the water of a family that took no part.
    """

    numbers: dict[str, float]
    swings: dict[str, float]
    effects: dict[str, dict[str, float]]
    channels: dict[str, float]
    adequacy: float = 0.0
    beyond_own: float = 0.0
    gains: dict[str, float] = {}  # noqa: RUF012 (of a tuple, never changed)
    formula: dict[str, float] = {}  # noqa: RUF012


class StructuralError(NamedTuple):
    """shared (J, m), by_record (K_l, m_l) of each record, variance (m,): S += the squares of the first two + diag(variance)."""

    shared: np.ndarray
    by_record: tuple[np.ndarray, ...]
    variance: np.ndarray
    moved: "Tangents | None" = None  # what it was made of

    @property
    def total(self) -> np.ndarray:
        """(m,) variance of each sample."""
        alone = np.concatenate([np.sum(factors**2, 0) for factors in self.by_record]) if self.by_record else 0.0
        return self.variance + np.sum(self.shared**2, 0) + alone


@cache
def widths(without: str = "") -> Widths:
    """Of all families, or as measured without one of them. Raises UnknownName."""
    table = read_toml(calib_folder() / FILE)
    if (key := ALL if without in NEVER else without) not in table:
        raise UnknownName("family of the structural error", without, sorted(set(table) - {ALL, "schema"}))
    formula = read_toml(calib_folder() / FORMULA)
    return Widths(**table[key], formula=formula.get(without, formula[ALL]))


def applies(model) -> bool:
    """Whether the model is a swimming fish whose water was calibrated. One of literature values may be wrong by any amount: its
    null runs, in a water of that kind, stand alone."""
    return hasattr(model, "strips") and model.robot.water.get("model") == STRUCTURED


def of(
    model, records, layout, null: np.ndarray, leftover: np.ndarray, given: Widths, moved: "Tangents | None" = None
) -> StructuralError:
    """Nothing where it does not apply.

    Args:
        null: (n, m) residuals of null runs. leftover: (m,) D^1/2 without it. moved: tangents of these records, where known.
    """
    if not applies(model):
        return StructuralError(np.zeros((0, layout.size)), (), np.zeros(layout.size))
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


def own_widths(given: Widths, layout, null: np.ndarray, leftover: np.ndarray, moved: "Tangents", residual: np.ndarray) -> Widths:
    """The same for one robot, as its own healthy swims ask for it: the most likely numbers, swings and channels.

        u <- u ((seen + nu u_0 / u^2) / (expected + nu / u))^1/2        variances u, those of other waters u_0 (variances.py)

    Those of other waters count as `OWN_PRIOR` observations, a scaled inverse chi-squared: what the swims do not tell stays.

    Args:
        layout, null (n, m), leftover (m,), moved, residual (m,): of the swims.
    """
    names, channels = moved.names, list(given.channels)
    numbers, swings = ([table.get(name, 0.0) for name in names] for table in (given.numbers, given.swings))
    start = np.array([*numbers, *swings, *(given.channels[c] for c in channels), 0.0]) ** 2
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
        told = asked(swum, found[:count], found[count:])
        found = found * np.sqrt((told.seen + OWN_PRIOR * known / found**2) / (told.expected + OWN_PRIOR / found))
    width = np.where(start > 0.0, np.sqrt(found), 0.0).tolist()
    tables = (dict(zip(names, width[i : i + len(names)], strict=True)) for i in (0, len(names)))
    return given._replace(
        numbers=given.numbers | next(tables),
        swings=given.swings | next(tables),
        channels=dict(zip(channels, width[count:-1], strict=True)),
    )


def allowed(gates: Gates, given: Widths, own: float = 0.0) -> Gates:
    """The gates with what healthy robots of an unknown water leave, before a search and after it, and what they gain.

    own: |z|^2 / m that the model leaves of healthy swims of this robot (search/healthy_swims.py); 0: there are none.
    """
    usual = max(given.adequacy, given.beyond_own * own)
    adequacy, residual = (max(usual, gate) for gate in (gates.adequacy, gates.residual))
    return replace(gates, adequacy=adequacy, residual=residual, gain=gates.calibrated_gain)


class Tangents(NamedTuple):
    """parts: of each record (K (1 + windows), m_l), what sigma of each number does throughout, then in each window. names: of the
    numbers (K,). shared: (J, m) what each effect does at its size."""

    parts: list[np.ndarray]
    names: list[str]
    shared: np.ndarray

    def widths(self, given: Widths, record: int) -> np.ndarray:
        """(K (1 + windows),) of the parts of a record."""
        throughout, swings = ([table.get(name, 0.0) for name in self.names] for table in (given.numbers, given.swings))
        windows = len(self.parts[record]) // len(self.names) - 1
        return np.concatenate([throughout, np.tile(swings, windows)])


def tangents(strips, records, layout, sizes: dict[str, dict[str, float]]) -> Tangents:
    """Of every record. strips: `GatedWater`. sizes: v of the effects that `strips` has, SI."""
    sigma = np.array([r.sigma for r in strips.ranges()])
    count = len(sigma)
    throughout, swings = (np.tile(strips.null, (1 + count, 1)) for _ in range(2))
    throughout[1:, :count] += STEP * np.diag(sigma)
    swings[1:, count : 2 * count] += STEP * np.diag(sigma)
    places = [strips.index(effect, name) for effect, values in sizes.items() for name in values]
    effects = np.tile(strips.null, (len(places), 1))
    for row, place, size in zip(effects, places, [v for values in sizes.values() for v in values.values()], strict=True):
        row[place] += size  # as large as it is: dry friction has no slope at none

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
    """(factors (K, m), variance (m,) of what is left) of the tangents (k, m) of one record, over D^1/2 (m,).

    The singular vectors have the same scatter as the tangents, and most of them do next to nothing.
    """
    _, size, shape = np.linalg.svd(moved / d, full_matrices=False)
    directions, large = size[:, None] * shape * d, size >= STRONG
    return directions[large], np.sum(directions[~large] ** 2, 0)
