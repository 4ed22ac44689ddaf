"""Chooses the experiment that best separates the remaining explanations: expected distance of every pair, and advice in words.

    z     = S^-1/2 (y_i - y_j)        predictions of both, on planned stamps
    S     = null of that experiment + sum_k s_k^2 t_k t_k^T (parameters k of both, within their uncertainty) + form error
    sigma = |z|

S includes differences that the fish's constants, or other parameter values of either explanation, could compensate. So |z| is the
expected distance in standard deviations (T-optimal design, Atkinson & Fedorov 1975, nuisance integrated out).

A hypothesis is one explanation with its fitted parameter row and the uncertainty of each parameter. `to_plain` and `from_plain`
store it in a report and read it back, so that a later, longer calculation needs no data.
"""

from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from fishmj import effects
from fishmj.effects.ambiguity import together
from fishmj.gap.decide.decide import swap_effect
from fishmj.gap.decide.intervals import estimate
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.whitening import smooth, whitening
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record, ResidualLayout, Sensor
from fishmj.gap.search.fit import Candidate
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.stepwise import Selection
from fishmj.gap.thresholds import thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import title
from fishmj.log import excitation
from fishmj.log.excitation import Excitation

FORM_ERROR = 0.1  # relative error of the change that an explanation makes
HINTS = 6  # experiments that a quick calculation tries
ENOUGH = 5.0  # expected separation, sigma, from which an experiment decides
LEFT = 3  # explanations compared, including the best
WEIGH = "Weigh the robot, balance it on an edge and time it on two threads (measurements.toml beside the trials)"
OPEN = ("CLASS", "UNEXPLAINED")
SENSORS = ("joint", "pose", "power", "placed")


class Hypothesis(NamedTuple):
    """One explanation that is still possible."""

    names: tuple[str, ...]
    row: np.ndarray  # (P,) parameter row
    moves: np.ndarray  # (K, P) rows, each with one parameter changed by its standard deviation
    weight: float  # probability

    @property
    def label(self) -> str:
        """Names of the effects, joined by +."""
        return " + ".join(self.names)


class ExperimentScore(NamedTuple):
    """Expected result of one experiment."""

    excitation: str
    seconds: float
    sigma: float  # separation of the best separated pair that contains the first hypothesis
    pair: tuple[str, str]
    worth: float  # sum over pairs of weights times sigma^2, per second of experiment

    def text(self) -> str:
        """Recommendation as a sentence."""
        a, b = map(in_words, self.pair)
        expected = f"expected separation {self.sigma:.0f} sigma"
        return f"Run `{self.excitation}` ({self.seconds:.0f} s): {expected}; would decide between {a} and {b}."


def in_words(label: str) -> str:
    """Words for an explanation: its effects joined by +, because `and` joins two explanations."""
    return " + ".join(map(title, label.split("+")))


def experiment_scores(
    model, sides: list[Hypothesis], like: Record, runs, null: SimulatedNull, bars: Bars = silent_bar
) -> list[ExperimentScore]:
    """Scores of the experiments `runs` (ids), best first. like: a record of this robot; planned records get its sensors."""
    plans = [planned_record(excitation.get(name, like.commands.shape[1]), like) for name in filter(null.holds, runs)]
    null.prepare(model, plans, bars)
    out = []
    with bars(len(plans), "experiments", "") as bar:
        for plan in plans:
            out.append(experiment_score(model, sides, with_sensors_of_null(model, plan, null), null))
            bar.update(len(out))
    return sorted(out, key=lambda p: -p.worth)


def experiment_score(model, sides: list[Hypothesis], record: Record, null: SimulatedNull) -> ExperimentScore:
    """Expected separation by one experiment."""
    layout = ResidualLayout([record])
    e = Likelihood(model, [record], null.residuals(model, [record], layout), FORM_ERROR)
    rows = np.concatenate([model.null[None], *(np.concatenate([s.row[None], s.moves]) for s in sides)])
    seen = -layout.residuals(model.predict([record], rows))  # predictions, up to what was measured
    spots = np.cumsum([1, *(1 + len(s.moves) for s in sides)])
    parts = [seen[a:b] for a, b in zip(spots[:-1], spots[1:], strict=True)]
    worth = 0.0
    best = (0.0, (sides[0].label, sides[1].label))
    for i, j in combinations(range(len(sides)), 2):
        open_ = [p[1:] - p[0] for p in (parts[i], parts[j])]
        wrong = [smooth(FORM_ERROR * (p[0] - seen[0]), layout) for p in (parts[i], parts[j])]
        d = np.sqrt(e.d**2 + np.maximum(*wrong) ** 2)
        z = whitening(np.concatenate([e.factors, *open_]), d, e.by_record, layout.record)(parts[i][0] - parts[j][0])
        sigma = float(np.linalg.norm(z))
        worth += sides[i].weight * sides[j].weight * sigma**2
        if i == 0 and sigma > best[0]:
            best = (sigma, (sides[i].label, sides[j].label))
    return ExperimentScore(record.excitation, record.seconds, *best, worth / record.seconds)


def planned_record(run: Excitation, like: Record) -> Record:
    """Planned record of an experiment, with zeros in place of measurements."""
    steps = round(excitation.PERIOD / like.dt)

    def sensor(old: Sensor | None) -> Sensor | None:
        if old is None:
            return None
        period = float(np.median(np.diff(old.t)))
        t = np.arange(float(old.t[0]) % period, run.seconds, period)
        return Sensor(t, np.zeros((len(t), old.values.shape[1])), old.sigma)

    place = np.array(run.start, float)
    return like._replace(
        name=run.id,
        excitation=run.id,
        replicate_of="",
        commands=np.repeat(run.commands, steps, axis=0),
        joint=sensor(like.joint),
        pose=sensor(like.pose),
        power=sensor(like.power),
        place=place,
        start=place,
        push=np.array(run.push, float),
        joints=run.commands[0].copy(),
        weighed=None,
    )


def with_sensors_of_null(model, plan: Record, null: SimulatedNull) -> Record:
    """The planned record without sensors that the null runs of its experiment lack, such as a start pose after a push."""
    columns = null.experiment(model, plan)
    lacking: dict[str, Any] = {name: None for name in SENSORS if getattr(plan, name) is not None and f"{name}0" not in columns}
    return plan._replace(**lacking)


def hinted_experiments(sides: list[Hypothesis]) -> tuple[str, ...]:
    """A few promising experiments: those that the catalogue lists for these effects, then those of the standard session."""
    found: list[str] = []
    for a, b in combinations(sides, 2):
        for one, other in ((x, y) for p, q in ((a, b), (b, a)) for x in p.names for y in q.names):
            found += [run for c in effects.get(one).confusions if c.other == other for run in c.excitations]
            same = together(one, other)
            found += same.excitations if same else ()
    first = dict.fromkeys(found)
    return tuple(dict.fromkeys([*first, *excitation.DESIGNED]))[: max(HINTS, len(first))]


def normalise_weights(sides: list[Hypothesis]) -> list[Hypothesis]:
    """The hypotheses with weights that sum to 1. Each weight is first raised to at least 0.05: a listed rival is possible."""
    weights = np.maximum([s.weight for s in sides], 0.05)
    return [s._replace(weight=float(w)) for s, w in zip(sides, weights / weights.sum(), strict=True)]


def advise(e: Likelihood, found: Selection, verdict: Verdict, null: SimulatedNull, bars: Bars = silent_bar) -> Verdict:
    """Adds to a CLASS verdict the next experiment from a quick calculation, and the values for a longer one without data."""
    sides = [] if verdict.next_experiment else normalise_weights(hypotheses_of(found, verdict))
    if len(sides) < 2:
        return verdict
    quick = experiment_scores(e.model, sides, e.records[0], hinted_experiments(sides), null, bars=bars)
    listed = {s.names[-1]: to_plain(e.model, s) for s in sides[1:]}
    rivals = [r | {"values": listed[r["name"]]} if r["name"] in listed else r for r in verdict.rivals]
    compared = tuple({"values": to_plain(e.model, s), "weight": s.weight} for s in sides)
    return replace(verdict, rivals=tuple(rivals), explanations=compared, next_experiment=advice(e.model, quick, sides))


def advice(model, found: list[ExperimentScore], sides: list[Hypothesis]) -> str:
    """Sentence on the best experiment; if none of the library decides, on a weighing that does, or other advice."""
    best = next((p for p in found if p.sigma >= ENOUGH), None)
    if best:
        return best.text()
    rows = [np.concatenate([s.row[None], s.moves]) for s in sides]
    sigma, other = max((mass_properties.separation(model, rows[0], r), s.label) for r, s in zip(rows[1:], sides[1:], strict=True))
    if sigma >= ENOUGH:
        ours = in_words(sides[0].label)
        return f"{WEIGH}: expected separation {sigma:.0f} sigma; would decide between {ours} and {in_words(other)}."
    most = max(found, key=lambda p: p.sigma)
    a, b = map(in_words, most.pair)
    text = f"No experiment tried separates {a} from {b} by more than {most.sigma:.1f} sigma (`{most.excitation}`)"
    same = next((c for x in sides[0].names for y in sides[1].names if (c := together(x, y))), None)
    return f"{text}: {same.splits}." if same else f"{text}; repeat it, or measure what tells them apart directly."


def hypotheses_of(found: Selection, verdict: Verdict) -> list[Hypothesis]:
    """Remaining explanations: the best one, then it with each listed rival in place; without rivals, the last round's next."""
    if not found.steps:
        return []
    near = found.near
    whole = near.subset()
    accepted = [s for s in found.steps if s.accepted]
    sets: list[Candidate] = [found.best] if accepted else [found.steps[0].ranked[0]]
    for rival in verdict.rivals[: LEFT - 1]:
        rounds = [s for s in accepted if rival["instead_of"] in s.ranked[0].newest] or accepted
        like = next((c for s in rounds for c in s.ranked if rival["name"] in c.newest), None)
        other = swap_effect(whole, found.best, rival["instead_of"], rival["name"], like) if like else None
        sets += [other] if other else []
    if len(sets) < 2:
        sets += [c for c in (accepted or found.steps)[-1].ranked if set(c.names) != set(sets[0].names)][: LEFT - 1]
    fitted = {c.names: c for c in whole.refine(sets, 3)}
    weights = [min([1.0, *(n.p_best for n in verdict.effects)])] + [float(r["p_best"]) for r in verdict.rivals] + [0.0] * LEFT
    return [hypothesis(near, fitted[c.names], w) for c, w in zip(sets, weights, strict=False)]


def hypothesis(e: Likelihood, c: Candidate, weight: float) -> Hypothesis:
    """A candidate with the uncertainty of its parameters."""
    moves = np.repeat(c.row[None], len(c.places), 0)
    for k, (place, spread) in enumerate(zip(c.places, estimate(e, c)[1], strict=True)):
        moves[k, place] += spread
    return Hypothesis(c.names, c.row, moves, weight)


def to_plain(model, s: Hypothesis) -> dict:
    """{effect: {parameter: [value, low, high]}} of a hypothesis, 90 % intervals."""
    out: dict = {}
    quantile = thresholds().intervals.quantile
    entries = [(x, p) for x in model.active.effects if x.name in s.names for p in x.parameters]
    for k, (x, p) in enumerate(sorted(entries, key=lambda xp: s.names.index(xp[0].name))):
        place = model.index(x.name, p.name)
        value = s.row[place]
        half = quantile * abs(s.moves[k, place] - value)
        out.setdefault(x.name, {})[p.name] = [float(value), float(value - half), float(value + half)]
    return out


def from_plain(model, values: dict, weight: float) -> Hypothesis:
    """Hypothesis from the dictionary that `to_plain` wrote."""
    row = model.null.copy()
    moves = []
    quantile = thresholds().intervals.quantile
    for name, entries in values.items():
        for parameter, (value, low, high) in entries.items():
            row[model.index(name, parameter)] = value
            moves.append((model.index(name, parameter), (high - low) / 2 / quantile))
    rows = np.repeat(row[None], len(moves), 0)
    for k, (place, spread) in enumerate(moves):
        rows[k, place] += spread
    return Hypothesis(tuple(values), row, rows, weight)
