"""`gap find` from a data set to a verdict.

read -> null runs -> forward selection -> gates -> free forces -> repeatability -> gap on records set aside
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.cores import one_blas_thread
from fishmj.base.errors import LogError
from fishmj.gap.decide.decide import decide
from fishmj.gap.decide.implausible import advice
from fishmj.gap.decide.intervals import missed_sizes
from fishmj.gap.localise.swimming_speed import speed_errors, steady_speeds
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.robot_null import RobotNull
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record
from fishmj.gap.search.fit import needs_fine_value
from fishmj.gap.search.healthy_swims import HealthySwims
from fishmj.gap.search.likelihood import Likelihood, draws, likelihood_of
from fishmj.gap.search.stepwise import Selection, forward_select, split
from fishmj.gap.thresholds import Gates, frozen, thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import level, percent
from fishmj.log import Trial
from fishmj.log.replicates import RATIO, groups


@dataclass(frozen=True)
class Inquiry:
    """State of one search, for the vetoes and for the report.

    verdict: that of the gates, then as changed by each veto. unseen: (L,) bool over `records`: those held out of every decision;
    the others are those of `evidence`. further, speed_error, seed, say, bars, notes: as for `investigate`.
    """

    verdict: Verdict
    evidence: Likelihood
    found: Selection
    gates: Gates
    trials: list[Trial]
    records: list[Record]
    unseen: np.ndarray
    null: Any  # SimulatedNull, or RobotNull of a robot in MJCF
    swims: Likelihood | None
    further: bool
    speed_error: float | None
    seed: int
    say: Callable[[str], None]
    bars: Bars
    notes: tuple[str, ...]

    @property
    def held(self) -> np.ndarray:
        """(L,) bool over the records of `evidence`: the first fold, for the report's pictures."""
        return self.found.folds[0]

    @property
    def judged(self) -> list[str]:
        """Names of the records held out of every decision; if there are none, of those held out of the first fit."""
        seen = [r.name for r, u in zip(self.records, self.unseen, strict=True) if not u]
        apart = [r.name for r, u in zip(self.records, self.unseen, strict=True) if u]
        return apart or [name for name, held in zip(seen, self.held, strict=True) if held]

    @property
    def synthetic(self) -> bool:
        """True where a trial says that it was simulated."""
        return any(t.value("origin") == "synthetic" for t in self.trials)


@one_blas_thread()
@np.errstate(over="ignore", invalid="ignore")  # a diverged rollout counts as a huge cost
def investigate(
    model,
    trials: list[Trial],
    *,
    gates: Gates | None = None,
    null: SimulatedNull | RobotNull | None = None,
    page: dict | None = None,
    mass_known: bool = True,
    healthy: HealthySwims | None = None,
    speed_error: float | None = None,
    seed: int = 0,
    further: bool = False,
    say: Callable[[str], None] = lambda text: None,
    bars: Bars = silent_bar,
    admit: Callable[[Likelihood], None] = lambda e: None,
    answered: Callable[[Inquiry], None] = lambda inquiry: None,
    notes: tuple[str, ...] = (),
) -> Inquiry:
    """Finds the missing effects of `model` in `trials`.

    Args:
        null: settings of the null runs. page: of weighings, log/measurements.py.
        mass_known: the description's mass counts as weighed if the page has no scales.
        healthy: result of the calibration swims (search/healthy_swims.py): the usual gap of this robot and its remaining
            uncertainty; None: not measured.
        speed_error: mean relative speed error of the water's calibration on swims outside its fit; None: not calibrated.
        further: after CLASS, also search for the deciding experiment; after UNEXPLAINED, for terms that describe the gap.
        bars: progress bars. admit: is called with the likelihood before the search and may raise. answered: is called with the
            answer, before any advice is computed. notes: for the report.

    Raises LogError: fewer than two trials, or a trial that cannot be compared; ConfigError: a page with an invalid number.
    """
    gates = gates or frozen()
    null = null or SimulatedNull()
    records = model.records(trials)
    if len(records) < 2:
        raise LogError(f"gap find: got {len(records)} trial; at least two are needed: one to fit, one to validate")
    say(f"{len(records)} records, {sum(r.seconds for r in records):.0f} s; {len(model.active.effects)} effects in question")
    compile_kernel(model, say)
    say(f"null: {null.text}")
    unseen = set_aside(records, seed)
    seen = [r for r, u in zip(records, unseen, strict=True) if not u]
    weighed = mass_properties.sensor(page or {}, model, mass_known)
    if mass_known and "scales" not in (page or {}):
        say(mass_properties.described(float(mass_properties.predicted(model, model.null)[0, 0])))
    swims = healthy.swims if healthy else None
    e = likelihood_of(model, mass_properties.with_page(seen, weighed), null, bars, swims)
    admit(e)
    gates = e.allowed(gates, healthy.calibration_residual if healthy else 0.0)
    if healthy:
        left, usual = level(healthy.calibration_residual), level(gates.adequacy)
        say(f"baseline misfit on the calibration swims: {left}; gaps up to {usual} are usual for this robot")
    found = forward_select(e, gates, split(seen, seed), say, bars)
    verdict = decide(e, found, gates)
    inquiry = Inquiry(
        verdict, e, found, gates, trials, records, unseen, null, swims, further, speed_error, seed, say, bars, notes
    )
    for veto in VETOES:
        inquiry = replace(inquiry, verdict=veto(inquiry.verdict, inquiry))
    answered(inquiry)
    for what, step in ADVICE.items():
        advised = console.after_answer(what, partial(step, inquiry.verdict, inquiry), inquiry.verdict)
        inquiry = replace(inquiry, verdict=advised)
    return inquiry


def compile_kernel(model, say: Callable[[str], None]) -> None:
    """Compiles the model's step to machine code and reports how long that took: no progress bar covers it."""
    if hasattr(type(model), "kernel") and "kernel" not in vars(model):
        say("compiling the model's kernel: some 12 s on one core the first time, then cached")
        begin = time.monotonic()
        _ = model.kernel
        say(f"compiled in {time.monotonic() - begin:.1f} s")


def set_aside(records: Sequence, seed: int) -> np.ndarray:
    """(L,) bool: records held out of every decision, a quarter if there are many, none if there are few."""
    aside = np.zeros(len(records), bool)
    if len(records) >= thresholds().workflow.set_aside_from:
        aside[np.random.default_rng(seed + 1).permutation(len(records))[: len(records) // 4]] = True
    return aside


# ------------------------------------------------------------------------------------------------------------------------- vetoes
def challenge_by_free_forces(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Veto G10: UNEXPLAINED if a free force explains more; CLASS if a sensor error explains as much."""
    if verdict.answer not in ("NAMED", "CLASS"):
        return verdict
    from fishmj.gap.terms.stronger import challenge

    return challenge(inquiry.evidence, inquiry.found, verdict)


def require_repeatability(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Veto: NOT_REPEATABLE if replicates differ. It replaces any answer but AGREES."""
    shakes = unrepeatable(inquiry.trials, inquiry.evidence) if verdict.answer != "AGREES" else ""
    return replace(verdict, answer="NOT_REPEATABLE", reason=shakes, effects=(), rivals=()) if shakes else verdict


def ask_unseen_records(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Veto: UNEXPLAINED if the residual does not shrink on records set aside. Adds the gap on them to the verdict."""
    if not inquiry.unseen.any():
        return verdict
    model, found = inquiry.evidence.model, inquiry.found
    aside = [r for r, u in zip(inquiry.records, inquiry.unseen, strict=True) if u]
    apart = likelihood_of(model, aside, inquiry.null, inquiry.bars, inquiry.swims)
    near = apart.linearised_at(found.best.row, found.near.form) if found.best.names else apart
    gaps = apart.gap(model.null)[0], near.gap(found.best.row)[0]
    before, after = apart.over_floor(model.null)[0], apart.over_floor(found.best.row)[0]
    floors = verdict.over_floor | {"unseen": (before, after)}
    verdict = replace(verdict, gap_unseen_before=gaps[0], gap_after_unseen=gaps[1], over_floor=floors)
    grown = after > before + thresholds().workflow.chance_growth and near.loss(found.best.row) > apart.loss(model.null)
    if not grown or verdict.answer not in ("NAMED", "CLASS"):
        return verdict
    why = f"the residual on the records set aside grows from {level(before)} to {level(after)} times the floor"
    return replace(verdict, answer="UNEXPLAINED", reason=f"{why}; the best is tentative")


def require_calibrated_speed(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Veto: UNEXPLAINED in place of AGREES if most steady swims are off by more than the water's calibration explains.

    The scatter of healthy robots in other waters is wider than the error of a robot whose own water was calibrated.
    """
    if verdict.answer != "AGREES" or not inquiry.speed_error:
        return verdict
    model, records = inquiry.evidence.model, inquiry.records
    errors = speed_errors(steady_speeds(records, model.predict(records, inquiry.found.base.row)))
    allowed = thresholds().workflow.speed_error * inquiry.speed_error
    beyond = int(max(np.sum(errors > allowed), np.sum(errors < -allowed)))
    if 2 * beyond <= len(errors):
        return verdict
    middle = float(np.median(errors))
    verdict = replace(verdict, gates=verdict.gates | {"speed": middle, "speed_allowed": allowed})
    swims = f"swims {percent(abs(middle))} {'faster' if middle > 0 else 'slower'} than the calibrated model"
    many = f"in {beyond} of {len(errors)} steady swims by more than {percent(allowed)}"
    why = f"the calibration is off by {percent(inquiry.speed_error)} on average, and no effect of the catalogue explains the rest"
    return replace(verdict, answer="UNEXPLAINED", reason=f"{swims}, {many}; {why}")


def require_smaller_torques(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Veto for a robot in MJCF: an effect is named only if the unexplained torque shrinks where it acts."""
    model = inquiry.evidence.model
    if not isinstance(model, RigidRobot):
        return verdict
    from fishmj.gap.search import unexplained_torque

    return unexplained_torque.require_smaller_torques(verdict, inquiry.evidence, inquiry.found.best.row, model.robot.channels)


def require_residual_at_floor(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Veto for a robot in MJCF: UNEXPLAINED if the cross-validated residual stays above the floor.

    It does not apply if the model with the effects agrees within the description's tolerances (gate G1): where one constant makes
    most of the floor, a correct robot two standard deviations off leaves four times the floor. Effects of the wrong form remove
    most of a gap but stay above both limits. Nor does it apply to random effects or quantised commands: no model predicts the
    draws, or the moment of each jump.
    """
    model, found, most = inquiry.evidence.model, inquiry.found, thresholds().torques.floors
    if verdict.answer not in ("NAMED", "CLASS") or not isinstance(model, RigidRobot):
        return verdict
    names = found.best.names
    stepped = any(needs_fine_value(x) for x in model.active.effects if x.name in names)
    if stepped or draws(model, names):
        return verdict
    left = found.fitted.over_floor(found.folds)
    stated = inquiry.evidence.with_record_errors(model.with_errors(model.torque_tolerance, found.best.row))
    near = stated.linearised_at(found.best.row, 0.0)
    unseen = zip(found.folds, found.fitted.fits, strict=True)
    gap = sum(near.subset(fold).at(fit.row).cost for fold, fit in unseen) / near.layout.size
    verdict = replace(verdict, gates=verdict.gates | {"floors": left, "stated": gap})
    if left <= most or gap <= inquiry.gates.adequacy:
        return verdict
    what = "they are" if len(names) > 1 else "it is"
    why = f"the residual of held-out records is still {level(left)} times the floor, above {level(most)}; {what} tentative"
    return replace(verdict, answer="UNEXPLAINED", reason=why)


# The vetoes in the order of rows 20 to 23 of docs/search/gap.md; two are for robots in MJCF
VETOES = (
    *(challenge_by_free_forces, require_repeatability, require_residual_at_floor, require_smaller_torques, ask_unseen_records),
    require_calibrated_speed,
)


# ------------------------------------------------------------------------------------------------------------------------- advice
def propose_experiment(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Adds to CLASS the experiment that separates its effects; of an implausible value, the numbers to check."""
    if not inquiry.further or verdict.answer != "CLASS":
        return verdict
    if verdict.implausible:
        stack = inquiry.evidence.model.active
        return replace(verdict, next_experiment=advice(stack.effect(e.name) for e in verdict.effects))
    from fishmj.gap.experiment import advise

    inquiry.say("searching for the experiment that separates these effects")
    return advise(inquiry.evidence, inquiry.found, verdict, inquiry.null, inquiry.bars)


def describe_by_terms(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Adds to UNEXPLAINED the terms that describe the remaining gap."""
    if not inquiry.further or verdict.answer != "UNEXPLAINED":
        return verdict
    from fishmj.gap.terms.select import describe

    inquiry.say("searching for forces that describe the gap")
    return replace(verdict, terms=describe(inquiry.evidence, inquiry.null, inquiry.seed))


def with_missed_sizes(verdict: Verdict, inquiry: Inquiry) -> Verdict:
    """Adds to AGREES the sizes of effects that could have been missed, at the cost of a few evaluations.

    Detection needs `gain`; after a round that found no more than chance it needs `certain_gain`.
    """
    if verdict.answer != "AGREES":
        return verdict
    e, found, gates = inquiry.evidence, inquiry.found, inquiry.gates
    asked = max(gates.certain_gain, gates.gain) if found.best.names else gates.gain
    return replace(verdict, missed=missed_sizes(e.subset(), found.base.row, asked))


ADVICE = {  # steps that only add to an answer which has been given
    "the choice of the next experiment": propose_experiment,
    "the description of the gap by forces": describe_by_terms,
    "the sizes of effects that could have been missed": with_missed_sizes,
}


def unrepeatable(trials: list[Trial], e: Likelihood) -> str:
    """Reason for NOT_REPEATABLE if replicates differ from each other as much as from the model; else "".

    The test is the mean square of the residual over its variance between replicates: the median over the channels with a gap,
    since a slow random drift may by chance shift all replicates of one channel the same way.
    """
    residual = e.layout.residuals(e.model.predict(e.records, e.model.null))[0] / e.scale
    ratios = []
    for members in groups(trials).values():
        names = {t.name for t in members}
        rows = [i for i, r in enumerate(e.records) if r.name in names]
        if len(rows) < 2:
            continue
        seen = [{(b.sensor, b.column): b for b in e.layout.blocks if b.record == i} for i in rows]
        for same in ([blocks[key] for blocks in seen] for key in seen[0] if all(key in blocks for blocks in seen)):
            n = min(len(b.t) for b in same)
            values = np.stack([residual[b.where][:n] for b in same])
            gap = float(np.mean(values**2))
            between = float(np.mean(np.var(values, 0, ddof=1)))
            if gap > thresholds().workflow.replicate_gap:
                ratios.append(gap / max(between, 1e-12))
    if ratios and np.median(ratios) <= RATIO:
        return f"records of the same experiment differ from each other as much as from the model (ratio {np.median(ratios):.2f})"
    return ""
