"""Tests if a free force explains more than the found effect, which then only imitates it.

    gain = sum_f loss_f(present model) - loss_f(term)      folds f, each predicted by a coefficient from the others
    lead = gain(best term) - gain(found effect)

A named effect must beat the best single term of the typed library, fitted to the present model and judged in the same way: held
out and with the likelihood linearised at itself. A correct effect leads by hundreds, or a term nearly equals its formula and
neither leads. An effect that imitates a force outside the catalogue is behind the term nearest to that force. Such a term must
also have a smaller form error than the effect; otherwise it is no evidence.

A sensor error may explain the records as well as an effect: a log with every angle 4 % too large instead of a command's gain, an
error of the camera's axes instead of its height, an encoder with slack instead of dry friction. Then the answer is a CLASS with
both.

A term that is an effect's own formula is no evidence against the effect either. Alike are their actions in random states: the
push on a body that swims ahead (surge force, sway force, yaw moment over a body length), the torque on a joint, or
a joint's rest position and its log. -Y |u| w is a sway force ~ surge speed x sway speed, whatever either does
astern; a damping is a joint torque ~ rate; a command's gain a servo reading ~ angle.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from fishmj.effects.effect import Effect
from fishmj.effects.robot_scales import RobotScales
from fishmj.effects.sites import BodyMotion, Gear, SensorReadings, ServoDrive
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.search import likelihood
from fishmj.gap.search.fit import Candidate, on_records
from fishmj.gap.search.likelihood import Likelihood, relinearise
from fishmj.gap.search.stepwise import Selection, cross_validated, informative_records
from fishmj.gap.terms.library import (
    ANGLE,
    BEND,
    LOAD,
    RATE,
    SURGE,
    SWAY,
    TAIL,
    YAW,
    Factor,
    library,
    model_with_terms,
    sensor_terms,
)
from fishmj.gap.terms.select import shortlist, signatures
from fishmj.gap.thresholds import thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import number

RULER = "a known length in the picture, along x and along y, and a held angle read with a protractor: no log has its own scale"


class StrongerTerm(NamedTuple):
    """The best term. name: "sway force ~ yaw rate x tail rate". gain: on held-out records. form: its form error."""

    name: str
    gain: float
    form: float


@np.errstate(over="ignore", invalid="ignore")  # a diverged rollout counts as a huge cost
def challenge(e: Likelihood, found: Selection, verdict: Verdict) -> Verdict:
    """The verdict (of a swimming fish) with the lead of the best free term; UNEXPLAINED if that exceeds chance."""
    if not isinstance(e.model, SwimmingFish):
        return verdict
    limits = thresholds()
    model = model_with_terms(e.model.robot)
    free = strongest_term(model, e, found)
    lead = free.gain - verdict.gates["gain"]
    allowed = max(limits.likelihood.model_error, limits.stronger.form_ratio * found.near.form)
    checks = {"lead": lead, "term": free.name, "believed": free.form <= allowed}
    verdict = replace(verdict, gates=verdict.gates | checks)
    if not is_outdone(verdict.gates):
        return beside_sensor_terms(model, e, found, verdict)
    gains = f"gains {number(lead)} more in twice the log likelihood of records not seen"
    why = f"a free force, {free.name}, {gains}; the best is tentative"
    return replace(verdict, answer="UNEXPLAINED", reason=why)


def is_outdone(checks: dict) -> bool:
    """Returns True if a term explains more than the found effects by the gates of a verdict; False if that was not asked."""
    least = max(thresholds().stronger.lead, thresholds().gates.min_gain_fraction * checks.get("gain", 0.0))
    return checks.get("lead", 0.0) > least and checks["believed"]


def beside_sensor_terms(model: SwimmingFish, e: Likelihood, found: Selection, verdict: Verdict) -> Verdict:
    """CLASS if a sensor's own error makes the records as likely as the one named effect, each linearised at itself."""
    if verdict.answer != "NAMED" or len(found.best.names) > 1:
        return verdict
    (named,), gates, start = found.best.names, thresholds().gates, e.with_model(model)
    best = found.near.loss(found.best.row)
    gain = found.base.cost + found.start_logdet - best
    whole, own = start.subset(), likelihood.costs(on_records(found.near.subset(), found.best).z, e.layout)
    rivals = []
    for c in whole.refine(whole.screen(whole.base(), sensor_terms()), 3):
        if found.base.cost - c.cost < thresholds().stronger.scale_share * gain:
            continue
        near, fitted = relinearise(start, c, 1)
        behind = (near.loss(fitted.row) - best) / gain
        share = likelihood.p_best(np.stack([own, likelihood.costs(fitted.z, e.layout)]))[1]
        if behind < min(gates.margin, gates.rival_margin_abs / gain):
            term = next(x for x in sensor_terms() if x.name == c.names[-1])
            rivals.append({"name": term.formula, "p_best": float(share), "behind": float(behind), "instead_of": named})
    if not rivals:
        return verdict
    why = "these records cannot tell apart what is listed"
    return replace(verdict, answer="CLASS", reason=why, rivals=(*verdict.rivals, *rivals), next_experiment=RULER)


def strongest_term(model: SwimmingFish, e: Likelihood, found: Selection) -> StrongerTerm:
    """The term that explains most of the records of `e`, except for those with the formula of a found effect."""
    start = e.with_model(model)
    folds = found.folds
    named = [x for x in e.model.active.effects if x.name in found.best.names]
    terms = {x.name: x for x in model.active.effects if x in library() and not any(is_own_formula(n, x) for n in named)}
    tried = (relinearise(start, c, 1) for c in best_in_sample(start, list(terms.values())))
    near, c = min(tried, key=lambda t: t[0].loss(t[1].row))
    fitted = cross_validated(near, c, folds)
    before = sum(e.subset(f).loss(found.base.row) for f in folds)
    return StrongerTerm(terms[c.names[0]].formula, before - fitted.loss(folds), near.form)


def best_in_sample(start: Likelihood, terms: list) -> list[Candidate]:
    """The best terms by |z|^2: found on the few records with the largest excess, fitted to all."""
    limits = thresholds().stronger
    whole = start.subset()
    base = whole.base()
    few = start.subset(informative_records(base, start.layout))
    here = on_records(few, base)
    g, probed = signatures(few, terms)
    first_order = (g @ here.z) ** 2 / (np.sum(g * g, 1) + 1e-12)
    screened = few.screen(here, [terms[k] for k in shortlist(first_order, probed)])[: limits.screened]
    fitted = sorted((on_records(whole, c) for c in screened), key=lambda c: c.cost)[: limits.fitted]
    return whole.refine(fitted, 3)[: limits.tried]


LIMITS = thresholds().equivalence


def is_own_formula(effect: Effect, term: Effect) -> bool:
    """Returns True if a term is the effect's own formula.

    Only for effects without memory that push the body, turn a joint or shift its rest position.
    """
    if effect.memory or term.memory:
        return False
    pairs = [(does(effect), does(term)) for does in (pushes, torques, rests)]
    return any(bool(abs(a @ b) > LIMITS.cosine * np.linalg.norm(a) * np.linalg.norm(b) > 0.0) for a, b in pairs)


def pushes(effect: Effect) -> np.ndarray:
    """(3 n,) push over n random states of an effect at its usual size; zero for one that does not push."""
    if effect.body is None:
        return np.zeros(3 * LIMITS.states)
    u, w, r, swing, bend = drawn(SURGE, SWAY, YAW, TAIL, BEND)
    still = dict.fromkeys(BodyMotion._fields, 0.0) | {"sway_mass": 1.0, "drag": 1.0, "wet": 1.0, "added": 1.0}
    state = BodyMotion(**still | {"u": np.abs(u), "w": w, "r": r, "swing": swing, "bend": bend})
    pushed, _ = effect.body(np, usual(effect), state, effect.memory, LIMITS.step)
    return np.concatenate([np.broadcast_to(x, LIMITS.states) for x in (pushed.fx, pushed.fy, pushed.n / LIMITS.length)])


def torques(effect: Effect) -> np.ndarray:
    """(n,) torque of an effect at its usual size on a joint; zero for one without a gear site."""
    if effect.gear is None:
        return np.zeros(LIMITS.states)
    angle, rate, drive = drawn(ANGLE, RATE, LOAD)
    state = Gear(drive, angle, rate, torque=0.0, resist=0.0, wet=1.0, kb=0.1, limit=1.6)
    turned, _ = effect.gear(np, usual(effect), state, effect.memory, LIMITS.step)
    return np.broadcast_to(turned.torque - turned.resist * rate + turned.drive - drive, LIMITS.states)


def rests(effect: Effect) -> np.ndarray:
    """(2 n,) offset of a joint's rest position from its command with an effect at its usual size, and the log's from both."""
    (asked,) = drawn(ANGLE)
    values = usual(effect)
    shift = np.zeros(LIMITS.states)
    reading = asked
    if effect.command is not None:
        shift = effect.command(np, values, asked, effect.memory, LIMITS.step)[0] - asked
    if effect.servo is not None:
        state = ServoDrive(shift, asked, rate=0.0, kp=1.0, kv=0.0, kb=0.1, limit=1.6, current=0.0, time=0.0)
        shift = effect.servo(np, values, state, effect.memory, LIMITS.step)[0].error
    if effect.measure is not None:
        still = dict.fromkeys(SensorReadings._fields, np.zeros(LIMITS.states))
        reading = effect.measure(np, values, SensorReadings(**still | {"joint": asked[:, None]})).joint[:, 0]
    return np.concatenate([np.broadcast_to(x, LIMITS.states) for x in (shift, shift + reading - asked)])


def drawn(*factors: Factor) -> np.ndarray:
    """(len(factors), n) values of their usual size."""
    return np.random.default_rng(0).standard_normal((len(factors), LIMITS.states)) * np.array([[f.size] for f in factors])


def usual(effect: Effect) -> SimpleNamespace:
    """The parameters at their usual size."""
    return SimpleNamespace(**{p.name: p.null if p.shape else p.probe for p in effect.parameters}, joint=0, robot=RobotScales())
