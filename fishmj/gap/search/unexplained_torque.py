"""Torque at each joint of a robot in MJCF that no effect of the catalogue explains, from its own logs.

    fit of all effects at once -> most likely deviations of the torques (null/variances.py) -> fit again .. while likelier
    starts: no effect, and the best single effect at each of the best few sites; the most likely fit counts
    if torques remain: also from the best random effect, its scatter in S, and from the best that needs an exact value

The remaining torque is the noise of the search, as Mallows' C_p takes the noise of a regression from its largest model. Without
it, torque ripple and motor dynamics of a real arm would be so many times the encoder's noise that any effect would gain.

Each joint has a gate on the ratio of the unexplained torque after and before the found effects: an effect that only seems to
explain the logs lowers no torque.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fishmj.effects import Effect, site_of
from fishmj.gap.models.robot_description import RobotDescription
from fishmj.gap.null.variances import Sample, score_variances
from fishmj.gap.null.whitening import separate_blocks
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.search.drawn_effects import drawn_candidates
from fishmj.gap.search.fit import EffectFitter, needs_fine_value
from fishmj.gap.search.likelihood import Likelihood, draws
from fishmj.gap.search.stepwise import informative_records
from fishmj.gap.thresholds import thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import percent, quantity, title


class UnexplainedTorque(NamedTuple):
    """(J,) N m: deviations with the present model, and with all effects fitted."""

    before: np.ndarray
    least: np.ndarray


class TorqueFit(NamedTuple):
    """Fit of all effects. loss: twice the negative log likelihood in `near`, with torques and tangents at the row."""

    loss: float
    near: Likelihood
    row: np.ndarray
    drawn: bool = False  # True if S includes the scatter of random effects


def with_measured_errors(model, records: Sequence, null, bars: Bars = silent_bar):
    """(model with the measured errors of torques, the torques). model: `RigidRobot`; null: `RobotNull`."""
    records, limits = list(records), thresholds().torques
    runs = null.residuals(model, records, ResidualLayout(records), bars)
    e = Likelihood(model.with_errors(limits.start * model.torque_tolerance, model.null), records, runs)
    before = torques(e, model.null)
    few = informative_records(e.subset().base(), e.layout, model.screened_records)
    most = (1 + limits.starts) * limits.first_fits + (2 * limits.kept + 1) * limits.fits
    with bars(most, "unexplained torques", "rounds of fits", at_most=True) as bar:
        done = 0

        def all_fitted(starts: Sequence[TorqueFit], fits: int, chord: bool = True) -> list[TorqueFit]:
            nonlocal done
            found = []
            for fit in starts:
                found.append(descend(fit, fits, limits.steps, chord))
                done += fits
                bar.update(done)
            return sorted(found, key=lambda fit: fit.loss)

        # The fit of all effects has several minima; the best one sets the noise of the search.
        rows = [model.null, *_best_single(e.subset(few), model.null, model.active.effects)]
        found = all_fitted([TorqueFit(np.inf, e, row) for row in rows], limits.first_fits)[: limits.kept]
        (best,) = all_fitted(all_fitted(found, limits.fits)[:1], limits.fits, chord=False)
        least = torques(best.near, best.row)
        if np.any(least > limits.left * model.torque_tolerance):
            best = min([best, *all_fitted(_unusual(e, few, best), limits.fits)], key=lambda fit: fit.loss)
            least = torques(best.near, best.row)
    return best.near.model, UnexplainedTorque(before, least)


def _unusual(e: Likelihood, few: np.ndarray, best: TorqueFit) -> list[TorqueFit]:
    """Starts with the best random effect and with the best that needs an exact value, which no descent finds.

    Each alone and together with all others. Torques are as stated: those of a fit without the effect would hide its scatter.
    """
    model, chosen = e.model, best.row.copy()
    for x in draws(model):
        chosen[[model.index(x.name, p.name) for p in x.parameters]] = x.null
    out = []
    for row in (model.null, chosen):
        stated = e.with_record_errors(model.with_errors(model.torque_tolerance, row))
        fit = stated.subset(few)
        exact = [x for x in model.active.effects if needs_fine_value(x)]
        tried = fit.screen(fit.at(row), exact, fit.grid_search(fit.at(row), exact))[:1] if exact else []
        drawn = (c for x in draws(model) for c in drawn_candidates(stated, few, fit.at(row), x))
        tried += sorted(drawn, key=lambda c: c.cost)[:1]
        out += [_measured_at(stated, c.row, bool(draws(model, c.names[-1:]))) for c in tried]
    return sorted(out, key=lambda fit: fit.loss)[: thresholds().torques.kept]


def _best_single(fit: EffectFitter, row: np.ndarray, effects: Sequence[Effect]) -> list[np.ndarray]:
    """Rows with the best effect at each of the best few sites, at a finite size.

    Play, a limit or a period has no slope at its null. Effects at one site lead to the same minimum, so one is enough.
    """
    base = fit.at(row)
    waves = [x for x in effects if any(p.fine and p.shape for p in x.parameters)]
    found = fit.screen(base, effects, fit.grid_search(base, waves)) if effects else []
    best: dict[str, np.ndarray] = {}
    for c in (c for c in found if c.cost < base.cost):
        best.setdefault(site_of(c.names[-1]), c.row)
    return list(best.values())[: thresholds().torques.starts]


def descend(fit: TorqueFit, fits: int, steps: int, chord: bool = True) -> TorqueFit:
    """Fits all effects in at most `fits` rounds: values, then torques and tangents at these values.

    A round that ends less likely by its own torques is shortened, and finally rejected, since values and torques can oscillate.
    steps, chord: for Gauss-Newton in each round.
    """
    limits = thresholds().torques
    model = fit.near.model
    names, places = tuple(x.name for x in model.active.effects), tuple(range(len(model.constants), len(model.null)))
    for _ in range(fits):
        search = fit.near.subset()
        end = search.refine([search.at(fit.row, names, places)], steps, chord)[0].row
        for share in limits.shares if np.isfinite(fit.loss) else (1.0,):
            new = _measured_at(fit.near, fit.row + share * (end - fit.row), fit.drawn)
            if new.loss < fit.loss:
                break
        else:
            return fit
        gained, fit = fit.loss - new.loss, new
        if gained < limits.settled:
            break
    return fit


def _measured_at(near: Likelihood, row: np.ndarray, drawn: bool = False) -> TorqueFit:
    """The likelihood with torques and tangents at a row. drawn: also with the scatter of its effects."""
    model = near.model
    near = near.with_scatter(row if drawn else model.null)
    there = near.with_record_errors(model.with_errors(np.maximum(torques(near, row), model.torque_tolerance), row))
    there.scatter = near.scatter
    return TorqueFit(there.subset().loss(row), there, row, drawn)


def torques(e: Likelihood, row: np.ndarray) -> np.ndarray:
    """(J,) N m: most likely deviations of the torques at the joints, for a parameter row."""
    model, joints = e.model, e.model.joints
    residual = e.layout.residuals(model.predict(e.records, row))[0]
    null, parts, groups, block = [e.factors], [], [], np.full(e.layout.size, -1)
    for i, record in enumerate(e.records):
        mine, own = np.flatnonzero(e.layout.record == i), model.error_groups(record)
        errors = e.by_record[i][: len(own)]
        for rows, samples in separate_blocks(errors):  # the errors of one segment are a block
            block[mine[samples]] = len(parts)
            parts.append(errors[np.ix_(rows, samples)])
            groups.append(own[rows])
        if e.scatter:  # as it is
            null.append(np.zeros((len(e.scatter[i]), e.layout.size)))
            null[-1][:, mine] = e.scatter[i]
    sample = Sample(
        null=np.concatenate(null),
        shared=np.zeros((0, e.layout.size)),
        group=np.zeros(0, int),
        parts=parts,
        groups=groups,
        record=block,
        variance=e.d**2,
        spread=np.zeros(e.layout.size),
        channel=np.zeros(e.layout.size, int),
        residual=np.nan_to_num(residual),
    )
    u, tiny = np.ones(joints + 1), np.finfo(float).tiny ** 0.5
    for _ in range(thresholds().torques.updates):
        told = score_variances(sample, u, np.zeros(1))
        ratio = np.sqrt(np.maximum(told.seen[:joints], tiny) / np.maximum(told.expected[:joints], tiny))
        # A joint may stick where the model slides. No finite torque explains that: both sums are rounding errors and u overflows.
        u[:joints] = np.clip(u[:joints] * np.where(told.expected[:joints] > 0, ratio, 1.0), tiny, 1e6)
    return np.sqrt(u[:joints]) * model.torque_error


def torque_limits(robot: RobotDescription) -> np.ndarray:
    """(J,) N m: largest torque of the actuator at each channel; inf without one, or without a limit of its force."""
    m, out = robot.model, np.full(len(robot.channels), np.inf)
    for j in robot.joints:
        if j.actuator >= 0 and m.actuator_forcelimited[j.actuator]:
            gear = abs(float(m.actuator_gear[j.actuator, 0])) or 1.0
            out[robot.channels.index(j.name)] = gear * float(np.abs(m.actuator_forcerange[j.actuator]).max())
    return out


def require_smaller_torques(verdict: Verdict, e: Likelihood, row: np.ndarray, names: tuple[str, ...]) -> Verdict:
    """Veto: an effect at a joint must halve the mean square of the unexplained torque there, other effects that of all joints.

    Otherwise it is fitted but not named; if no effect is left, the answer is UNEXPLAINED. A torque within the allowance counts as
    zero. A torque that remains beside a named effect is a warning. Nothing is named if the torque that remains at any joint is
    more than its actuator can give, or most of the joint's usual torque: an obstacle loads all joints of an arm.

    names: of the joints.
    """
    model = e.model
    limits = thresholds().torques
    # Torques are those of the description: where the found friction holds a joint, estimated torques are too large.
    plain = e.with_record_errors(model.with_errors(model.torque_error, model.null))
    before, after = torques(plain, model.null), torques(plain.with_scatter(row), row)
    told = verdict.gates | {"torques": {n: (float(a), float(b)) for n, a, b in zip(names, before, after, strict=True)}}
    verdict = replace(verdict, gates=told)
    allowed = limits.allowed * model.torque_tolerance
    left = {n: x for n, x, most in zip(names, after, allowed, strict=True) if x > most}
    if not left or verdict.answer not in ("AGREES", "NAMED", "CLASS"):
        return verdict
    words = " and ".join(f"{quantity(x, model.robot.force_unit(n))} at {title(n)}" for n, x in left.items())
    if verdict.answer == "AGREES":
        return replace(verdict, answer="UNEXPLAINED", reason=f"torques of {words} are explained by no effect of the catalogue")
    most = np.minimum(torque_limits(model.robot), limits.usual * model.sizes.torque)
    if outside := [n for n, x, beyond in zip(names, after, most, strict=True) if n in left and x > beyond]:
        where = " and ".join(map(title, outside))
        why = f"something outside the catalogue acts at {where}: torques of {words} remain; what is listed is tentative"
        return replace(verdict, answer="UNEXPLAINED", reason=why)
    shares = {n: (b / a) ** 2 if n in left else 0.0 for n, a, b in zip(names, before, after, strict=True)}
    everywhere = float(np.sum((after / allowed) ** 2) / np.sum((before / allowed) ** 2))
    share = {found.name: shares.get(site_of(found.name), everywhere) for found in verdict.effects}
    kept = tuple(found for found in verdict.effects if share[found.name] <= limits.share)
    rest = f"torques of {words} remain unexplained"
    if not kept:
        least = percent(min(share.values()))
        why = f"{least} of the mean square of the unexplained torques remains, {words}; the best effect is tentative"
        return replace(verdict, answer="UNEXPLAINED", reason=why)
    others = tuple(found for found in verdict.effects if found not in kept)
    return replace(verdict, effects=kept, tentative=(*verdict.tentative, *others), warnings=(*verdict.warnings, rest))
