"""How far an experiment that nobody has done yet would set two explanations apart.

    z     = S^-1/2 (y_i - y_j)        predictions of both, on planned stamps
    S     = null of that experiment + sum_k s_k^2 t_k t_k^T (parameters k of both, as far as data leave them open) + form error
    sigma = |z|

What the constants of the fish or another value of either explanation could make up for does not count, so |z| is the expected
distance in standard deviations (T-optimal design, Atkinson & Fedorov 1975, nuisance integrated out).
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from fishmj import excitation
from fishmj.effects.ambiguity import together
from fishmj.excitation import Excitation
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.whitening import smooth, whitening
from fishmj.gap.records.records import Record, ResidualLayout, Sensor
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.watch import Bars, silent
from fishmj.gap.wording import title

HINTS = 6  # experiments that a quick look tries


class Hypothesis(NamedTuple):
    """One explanation that is still possible."""

    names: tuple[str, ...]
    row: np.ndarray  # (P,) parameter row
    moves: np.ndarray  # (K, P) rows, each one standard deviation of one parameter away
    weight: float  # how probable it is

    @property
    def label(self) -> str:
        return " + ".join(self.names)


class ExperimentScore(NamedTuple):
    """What one experiment promises."""

    excitation: str
    seconds: float
    sigma: float  # between the two sides that it sets apart best, of those that the first takes part in
    pair: tuple[str, str]
    worth: float  # sum over pairs of weights times sigma^2, a second

    def text(self) -> str:
        """As a recommendation."""
        a, b = (title(side) for side in self.pair)
        return (
            f"Run `{self.excitation}` ({self.seconds:.0f} s): expected separation {self.sigma:.0f} sigma;"
            f" would decide between {a} and {b}."
        )


def experiment_scores(
    model, sides: list[Hypothesis], like: Record, runs, null: SimulatedNull, form: float = 0.1, bars: Bars = silent
) -> list[ExperimentScore]:
    """Every experiment of `runs` (ids), best first. like: a record of this robot, whose sensors the planned ones have."""
    plans = [planned_record(excitation.get(name), like) for name in filter(null.holds, runs)]
    null.prepare(model, plans, bars)
    out = []
    with bars(len(plans), "experiments", "") as bar:
        for plan in plans:
            out.append(experiment_score(model, sides, plan, null, form))
            bar.update(len(out))
    return sorted(out, key=lambda p: -p.worth)


def experiment_score(model, sides: list[Hypothesis], record: Record, null: SimulatedNull, form: float) -> ExperimentScore:
    """One experiment."""
    layout = ResidualLayout([record])
    e = Likelihood(model, [record], null.residuals(model, [record], layout), form)
    rows = np.concatenate([model.null[None], *(np.concatenate([s.row[None], s.moves]) for s in sides)])
    seen = -layout.residuals(model.predict([record], rows))  # predictions, up to what was measured
    spots = np.cumsum([1, *(1 + len(s.moves) for s in sides)])
    parts = [seen[a:b] for a, b in zip(spots[:-1], spots[1:], strict=True)]
    worth = 0.0
    best = (0.0, (sides[0].label, sides[1].label))
    for i, j in combinations(range(len(sides)), 2):
        open_ = [p[1:] - p[0] for p in (parts[i], parts[j])]
        wrong = [smooth(form * (p[0] - seen[0]), layout) for p in (parts[i], parts[j])]
        d = np.sqrt(e.d**2 + np.maximum(*wrong) ** 2)
        z = whitening(np.concatenate([e.factors, *open_]), d)(parts[i][0] - parts[j][0])
        sigma = float(np.linalg.norm(z))
        worth += sides[i].weight * sides[j].weight * sigma**2
        if i == 0 and sigma > best[0]:
            best = (sigma, (sides[i].label, sides[j].label))
    return ExperimentScore(record.excitation, record.seconds, *best, worth / record.seconds)


def planned_record(run: Excitation, like: Record) -> Record:
    """The record that an experiment will give, all zeros where there will be measurements."""
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


def hinted_experiments(sides: list[Hypothesis], most: int = HINTS) -> tuple[str, ...]:
    """A handful of experiments worth a look: what the catalogue says separates the sides, then those of the standard session."""
    from fishmj import effects

    found: list[str] = []
    for a, b in combinations(sides, 2):
        for one, other in ((x, y) for p, q in ((a, b), (b, a)) for x in p.names for y in q.names):
            found += [run for c in effects.get(one).confusions if c.other == other for run in c.excitations]
            same = together(one, other)
            found += same.excitations if same else ()
    first = dict.fromkeys(found)
    return tuple(dict.fromkeys([*first, *excitation.DESIGNED]))[: max(most, len(first))]


def normalise_weights(sides: list[Hypothesis]) -> list[Hypothesis]:
    """The same with weights that add up to 1, none below a twentieth before: a rival that is listed is possible."""
    weights = np.maximum([s.weight for s in sides], 0.05)
    return [s._replace(weight=float(w)) for s, w in zip(sides, weights / weights.sum(), strict=True)]
