"""`gap next REPORT|DATA`: which experiment would tell apart the explanations that are left.

REPORT is what `gap find --out` wrote; DATA a data set, which is searched first. Every experiment of the library is simulated with
each explanation at its fitted values; the best separation for the time it takes comes first.
"""

from pathlib import Path

from fishmj import console, excitation
from fishmj.engines import own_effects
from fishmj.errors import LogError, UnknownName
from fishmj.gap.advice import LEFT, OPEN, advice, read, sides_of
from fishmj.gap.null_runs import RUNS, Null
from fishmj.gap.records import Record, record_of
from fishmj.gap.separation import Side, evenly, hinted, prospects
from fishmj.store import read_json


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
    own_effects.option(parser)
    args = parser.parse_args(argv)
    own_effects.join(args.effects)
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
    advised = advice(plant, found, sides)
    console.say(advised)
    if args.json:
        console.emit_json({"answer": answer, "advice": advised, "experiments": [p._asdict() for p in found]})
    return console.OK


def _opened(args, null: Null):
    """(answer, plant, sides, a record) of a report or a data set."""
    from fishmj.gap.plants.fish import Fish

    report = args.source / "verdict.json" if args.source.is_dir() else args.source
    plant = Fish(args.model)
    if report.is_file():
        verdict = read_json(report)
        return verdict["answer"], plant, evenly(_reported(plant, verdict)), _usual(plant)
    from fishmj.gap.data import page_in, trials_in
    from fishmj.gap.workflow import investigate

    trials, page = trials_in(args.source), page_in(args.source)
    inquiry = investigate(plant, trials, null=null, page=page, seed=args.seed, say=console.say)
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
