"""Effects of a robot in MJCF that no log of it can tell apart, found by simulation.

    d(A, B) = min_b |z(A) - z(B; b)| / |z(A) - z(0)|     A at its found values, B at any values b instead
    z       whitened readings, with the errors of the starts and unexplained torques integrated out, as in the search

B is the same as A on this robot if d is below [same] share of data/calib/gap.toml, in random motions over the whole range of the
robot (`drawn_motions`), not only in those of the logs. On a pendulum, air drag and quadratic friction of the joint are the same
equation; on an arm of two links they are not. Such effects are structurally indistinguishable (Walter, Lecourtier, Happel, 1984,
IEEE Trans. Autom. Control 29).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.null.whitening import whitening
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.shooting import RobotRecord, thinned
from fishmj.gap.search.fit import bounds
from fishmj.gap.search.likelihood import draws
from fishmj.gap.thresholds import Gates, thresholds
from fishmj.gap.verdict import NamedEffect, PointValue, Verdict
from fishmj.gap.wording import title

LOGS, SEGMENTS = 3, 48  # numbers of logs and segments whose stamps and commands are used
LOOKS = 30  # largest number of evaluations of a fit


def with_indistinguishable(verdict: Verdict, model: RigidRobot, records: Sequence[Any], gates: Gates, seed: int) -> Verdict:
    """The verdict of `decide` with equivalent rivals listed as `same`; NAMED if no other rival remains.

    Verdicts with an implausible value stay unchanged. A warning about unexplained torques does not count as a doubt.
    records: RobotRecords of the search.
    """
    doubted = any(w.startswith(f"{title(e.name)}: ") for e in verdict.effects for w in verdict.warnings)
    if verdict.answer != "CLASS" or doubted or not verdict.rivals:
        return verdict
    whitened = _Readings(model, drawn_motions(model, records, np.random.default_rng([seed, 11])))
    row = model.nothing
    for effect in verdict.effects:
        for name, value in effect.parameters.items():
            row[model.index(effect.name, name)] = value.value
    effects, rivals = [], []
    for effect in verdict.effects:
        same, p_best = {}, effect.p_best
        for rival in verdict.rivals:
            if rival["instead_of"] != effect.name:
                continue
            found = _instead(model, whitened, row, effect, rival["name"])
            if found is None:
                rivals.append(rival)
            else:
                same[rival["name"]] = found
                p_best += rival["p_best"]
        effects.append(replace(effect, same=same, p_best=min(p_best, 1.0)))
    told = replace(verdict, effects=tuple(effects), rivals=tuple(rivals))
    if rivals or any(e.p_best < gates.p_best for e in effects):
        return told
    return replace(
        told, answer="NAMED", reason="explains records that it was not fitted to, and no effect that differs on this robot does"
    )


def drawn_motions(model: RigidRobot, records: Sequence[Any], rng: np.random.Generator) -> list[RobotRecord]:
    """Segments with the logs' stamps, random starts within the joints' ranges, high rates and larger commands."""
    robot, out = model.robot, []
    m, base = robot.model, len(robot.channels) - len(robot.joints)
    low, high = (
        np.array([m.jnt_range[j.joint] if m.jnt_limited[j.joint] else (-np.pi, np.pi) for j in robot.joints]).reshape(-1, 2).T
    )
    least, most = np.where(m.actuator_ctrllimited.astype(bool), m.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
    further = thresholds().same.further
    for record in thinned(list(records[:LOGS]), SEGMENTS):
        mean = record.commands.mean(0)
        angles = record.angles.copy()
        angles[:, base:] = rng.uniform(low, high, (len(angles), len(low)))
        turns = rng.standard_normal(record.start_turns.shape)
        turned = turns / np.linalg.norm(turns, axis=1, keepdims=True)
        rates = further * model.sizes.rate * rng.uniform(-1.0, 1.0, record.rates.shape)
        commands = np.clip(mean + further * (record.commands - mean), least, most)
        out.append(record._replace(angles=angles, rates=rates, accelerations=0.0 * rates, commands=commands, start_turns=turned))
    return out


class _Readings:
    """Whitened readings (R, m) of parameter rows (R, P) on some records."""

    def __init__(self, model: RigidRobot, records: list[RobotRecord]):
        self.model, self.records = model, records
        self.layout = ResidualLayout(records)
        errors = model.record_errors(records, self.layout)
        none = np.zeros((0, self.layout.size))
        self.whiten = whitening(none, self.layout.noise(), errors, self.layout.record)

    def __call__(self, rows: Any) -> np.ndarray:
        return self.whiten(np.nan_to_num(self.layout.residuals(self.model.predict(self.records, rows))))


def _instead(
    model: RigidRobot, readings: _Readings, row: np.ndarray, effect: NamedEffect, rival: str
) -> dict[str, PointValue] | None:
    """Values of a rival at which it is equivalent to an effect of the row; None if there are none.

    Parameters that change no reading of this robot, such as a centre's offset along its hinge axis, are left out.
    """
    known = {e.name: e for e in model.active.effects}
    if rival not in known or draws(model, (effect.name, rival)):  # a force of terms/; a random effect is more than its mean
        return None
    low, high, size = bounds(model)
    without, mine = row.copy(), [model.index(effect.name, p) for p in effect.parameters]
    without[mine] = model.nothing[mine]
    target, nothing = readings(np.stack([row, without]))
    change = float(np.linalg.norm(target - nothing))
    if change == 0.0:  # the drawn motions do not show the effect
        return None
    begin, nearest, free = without, change, {}
    for p in known[rival].parameters:
        place = model.index(rival, p.name)
        tried = np.array([*p.typical, *(2.0 * p.null - t for t in p.typical if p.signed)])
        rows = np.tile(without, (len(tried), 1))
        rows[:, place] = np.clip(tried, low[place], high[place])
        z = readings(rows)
        if np.abs(z - nothing).max() > 1e-9 * change:  # more than rounding
            free[place] = p
        apart = np.linalg.norm(z - target, axis=1)
        if apart.min() < nearest:
            begin, nearest = rows[apart.argmin()], float(apart.min())
    places = list(free)
    if not places:
        return None

    def left(values: np.ndarray) -> np.ndarray:
        rows = np.tile(without, (len(np.atleast_2d(values)), 1))
        rows[:, places] = values
        return (readings(rows) - target) / change

    def slopes(values: np.ndarray) -> np.ndarray:
        step = thresholds().fit.difference_step * size[places]
        step = np.where(values + step > high[places], -step, step)
        return ((left(values + np.diag(step)) - left(values)) / step[:, None]).T

    within = (low[places], high[places])
    inside = np.clip(begin[places], low[places] + 1e-6 * size[places], high[places] - 1e-6 * size[places])
    fit = least_squares(lambda values: left(values)[0], inside, slopes, within, x_scale=size[places], max_nfev=LOOKS)
    if np.linalg.norm(fit.fun) > thresholds().same.share:
        return None
    return {p.name: PointValue(x, p.unit) for p, x in zip(free.values(), fit.x.tolist(), strict=True)}
