"""`gap next REPORT|DATA`: which experiment would tell apart the explanations that are left.

REPORT is what `gap find --out` wrote; DATA a data set, which is searched first. Every experiment of the library is simulated with
each explanation at its fitted values; the best separation for the time it takes comes first.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj import console, excitation
from fishmj.errors import LogError, UnknownName
from fishmj.gap.candidates import Candidate
from fishmj.gap.contest import replaced
from fishmj.gap.intervals import HALF, estimate
from fishmj.gap.null_runs import RUNS, Null
from fishmj.gap.records import Record, record_of
from fishmj.gap.search import Evidence, Found
from fishmj.gap.separation import Prospect, Side, evenly, hinted, prospects
from fishmj.gap.verdict import Verdict
from fishmj.store import read_json

ENOUGH = 5.0  # sigma from which an experiment is said to decide
LEFT = 3  # explanations compared, the best among them
OPEN = ("CLASS", "UNEXPLAINED")


def main(argv: list[str]) -> int:
    parser = console.parser("gap next", __doc__)
    add = parser.add_argument
    add("source", type=Path, metavar="REPORT|DATA", help="folder or verdict.json of `gap find --out`, or a data set")
    add("--model", default="fish", help="the model that was questioned")
    add("--runs", default="all", metavar="ID,..", help="experiments to consider: ids, all, or hinted (a quick look)")
    add("--top", type=int, default=5, help="how many to list")
    add("--noise", type=float, default=1.0, help="factor on the sensors' usual noise")
    add("--null-runs", type=int, default=RUNS, help="runs of every experiment in the independent simulator")
    add("--seed", type=int, default=0, help="of the split and of the null runs")
    args = parser.parse_args(argv)
    null = Null(runs=args.null_runs, noise=args.noise, seed=args.seed)
    answer, plant, sides, like = _opened(args, null)
    if len(sides) < 2:
        console.say(f"{answer}: fewer than two explanations are left; no experiment has to decide between any")
        if args.json:
            console.emit_json({"answer": answer, "experiments": []})
        return console.OK
    with console.Progress(len(_runs(args.runs, sides)), "experiments") as bar:
        tick = iter(range(1, 1000))
        found = prospects(plant, sides, like, _runs(args.runs, sides), null, say=lambda name: bar.update(next(tick)))
    console.say(console.table([{"experiment": p.excitation, "s": p.seconds, "sigma": p.sigma} for p in found[: args.top]]))
    console.say(advice(found, sides))
    if args.json:
        console.emit_json({"answer": answer, "advice": advice(found, sides), "experiments": [p._asdict() for p in found]})
    return console.OK


def advised(e: Evidence, found: Found, verdict: Verdict, null: Null) -> Verdict:
    """A CLASS verdict with the next experiment of a quick look, and its rivals' values, so that a longer look needs no data."""
    sides = evenly(sides_of(e, found, verdict))
    if verdict.answer not in OPEN or len(sides) < 2:
        return verdict
    quick = prospects(e.plant, sides, e.records[0], hinted(sides), null)
    known = {s.names: written(e.plant, s) for s in sides[1:]}
    listed = {names[-1]: values for names, values in known.items()}
    rivals = [r | {"values": listed[r["name"]]} if r["name"] in listed else r for r in verdict.rivals]
    return replace(verdict, rivals=tuple(rivals), next_experiment=advice(quick, sides))


def advice(found: list[Prospect], sides: list[Side]) -> str:
    """The best experiment in words, or what to do where none of the library decides."""
    from fishmj.effects.classes import together

    best = next((p for p in found if p.sigma >= ENOUGH), None)
    if best:
        return best.text()
    most = max(found, key=lambda p: p.sigma)
    a, b = most.pair
    text = f"No experiment tried separates {a} from {b} by more than {most.sigma:.1f} sigma (`{most.excitation}`)"
    same = next((c for x in sides[0].names for y in sides[1].names if (c := together(x, y))), None)
    return f"{text}: {same.splits}." if same else f"{text}; repeat it, or measure what tells them apart directly."


def sides_of(e: Evidence, found: Found, verdict: Verdict) -> list[Side]:
    """What is left: the best, then each listed rival in its place; where none is listed, the next of the last round."""
    if not found.steps:
        return []
    whole = e.part(np.ones(len(e.records), bool))
    accepted = [s for s in found.steps if s.accepted]
    sets: list[Candidate] = [found.best] if accepted else [found.steps[0].ranked[0]]
    for rival in verdict.rivals[: LEFT - 1]:
        rounds = [s for s in accepted if s.ranked[0].names[-1] == rival["instead_of"]] or accepted
        near = next((c for s in rounds for c in s.ranked if c.names[-1] == rival["name"]), None)
        other = replaced(whole, found.best, rival["instead_of"], near) if near else None
        sets += [other] if other else []
    if len(sets) < 2:
        sets += [c for c in (accepted or found.steps)[-1].ranked if set(c.names) != set(sets[0].names)][: LEFT - 1]
    fitted = {c.names: c for c in whole.refine(sets, 3)}
    weights = [min([1.0, *(n.p_best for n in verdict.effects)])] + [float(r["p_best"]) for r in verdict.rivals] + [0.0] * LEFT
    return [side(e, fitted[c.names], w) for c, w in zip(sets, weights, strict=False)]


def side(e: Evidence, c: Candidate, weight: float) -> Side:
    """A candidate with how far its parameters may be off."""
    moves = np.repeat(c.row[None], len(c.places), 0)
    for k, (place, spread) in enumerate(zip(c.places, estimate(e, c)[1], strict=True)):
        moves[k, place] += spread
    return Side(c.names, c.row, moves, weight)


def written(plant, s: Side) -> dict:
    """{effect: {parameter: [value, low, high]}} of a side, 90 %."""
    out: dict = {}
    entries = [(x, p) for x in plant.active.effects if x.name in s.names for p in x.parameters]
    for k, (x, p) in enumerate(sorted(entries, key=lambda xp: s.names.index(xp[0].name))):
        place = plant.index(x.name, p.name)
        value, half = s.row[place], HALF * abs(s.moves[k, place] - s.row[place])
        out.setdefault(x.name, {})[p.name] = [float(value), float(value - half), float(value + half)]
    return out


def read(plant, values: dict, weight: float) -> Side:
    """The side that `written` wrote."""
    row, moves = plant.null.copy(), []
    for name, entries in values.items():
        for parameter, (value, low, high) in entries.items():
            row[plant.index(name, parameter)] = value
            moves.append((plant.index(name, parameter), (high - low) / 2 / HALF))
    rows = np.repeat(row[None], len(moves), 0)
    for k, (place, spread) in enumerate(moves):
        rows[k, place] += spread
    return Side(tuple(values), row, rows, weight)


def _opened(args, null: Null):
    """(answer, plant, sides, a record) of a report or a data set."""
    from fishmj.gap.plants.fish import Fish

    report = args.source / "verdict.json" if args.source.is_dir() else args.source
    plant = Fish(args.model)
    if report.is_file():
        verdict = read_json(report)
        return verdict["answer"], plant, evenly(_reported(plant, verdict)), _usual(plant)
    from fishmj.gap.workflow import investigate
    from fishmj.log.dataset import read_dataset

    trials = list(read_dataset(args.source))
    inquiry = investigate(plant, trials, null=null, seed=args.seed, say=console.say)
    verdict = inquiry.verdict
    if verdict.answer not in OPEN:
        return verdict.answer, plant, [], inquiry.records[0]
    return verdict.answer, plant, evenly(sides_of(inquiry.evidence, inquiry.found, verdict)), inquiry.records[0]


def _reported(plant, verdict: dict) -> list[Side]:
    """Sides of a verdict.json."""
    if verdict["answer"] not in OPEN:
        return []
    ours = {e["name"]: {k: [v["value"], v["low"], v["high"]] for k, v in e["parameters"].items()} for e in verdict["effects"]}
    rivals = [r for r in verdict["rivals"] if "values" in r]
    if not rivals:
        raise LogError("gap next: the report lists no rival with values; give the data set itself: gap next DATA")
    best = min([1.0, *(e["p_best"] for e in verdict["effects"])])
    return [read(plant, ours, best), *(read(plant, r["values"], r["p_best"]) for r in rivals[: LEFT - 1])]


def _usual(plant) -> Record:
    """A record with the usual sensors of this robot."""
    from fishmj.virtual_robot import generate

    return record_of(generate({}, ["idle"], 0)[0], plant.dt)


def _runs(text: str, sides: list[Side]) -> tuple[str, ...]:
    """Ids of the experiments to consider."""
    if text == "hinted":
        return hinted(sides)
    listed = excitation.names() if text == "all" else tuple(name.strip() for name in text.split(","))
    for name in listed:
        if name not in excitation.names():
            raise UnknownName("excitation", name, excitation.names())
    return listed
