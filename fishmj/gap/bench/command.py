"""`gap bench`: how often the search is right, wrong or silent on data whose answer it does not know."""

import json
from collections.abc import Callable
from pathlib import Path

from fishmj import console
from fishmj.gap.bench import cases, solver
from fishmj.gap.bench.rows import kept
from fishmj.gap.bench.run import run
from fishmj.gap.bench.score import score
from fishmj.gap.null_runs import Null
from fishmj.gap.search import frozen
from fishmj.store import write_text

GENERATORS = ("second", "lbm")
ALLOWED = 1  # wrong names, and false alarms, that a quick run may have


def main(argv: list[str]) -> int:
    parser = console.parser("gap bench", __doc__)
    add = parser.add_argument
    add("--cases", type=int, default=400, help="how many")
    add("--seed", type=int, default=0, help="draws everything anew: effects, sizes, fish, noise")
    add("--kinds", default="", metavar="KIND,..", help=f"only {', '.join(cases.KINDS)}; default all, in their shares")
    add(
        "--generator", choices=GENERATORS, default="second", help="second: the second robot; lbm: shipped sets of the flow solver"
    )
    add("--small", action="store_true", help="half a session, usual noise: a case takes seconds")
    add("--shard", default="0/1", metavar="I/N", help="every N-th case from the I-th: for several machines")
    add("--out", type=Path, help="folder for rows.jsonl and score.json; the same command continues where it stopped")
    add("--baselines", action="store_true", help="four usual methods on the same cases, in one table")
    args = parser.parse_args(argv)
    index, shards = map(int, args.shard.split("/"))
    if args.generator == "lbm":
        given = [one for one in solver.draw() if one.case.kind in (args.kinds or ",".join(cases.KINDS)).split(",")]
        rows = judged(given[index : args.cases : shards], args.out, solver.plant)
    else:
        kinds = {k: cases.KINDS[k] for k in args.kinds.split(",")} if args.kinds else None
        todo = cases.draw(args.cases, args.seed, kinds, small=args.small)[index::shards]
        rows = judged([solver.Given(case, None, Null(noise=case.noise)) for case in todo], args.out)
    result = score(list(rows))
    if args.out:
        write_text(args.out / "score.json", json.dumps(console.plain(result), indent=1))
    console.say(*told(result))
    if args.baselines and args.generator == "second":
        from fishmj.gap.baselines import beside, compared

        console.say(compared(rows, beside(todo, rows, args.out)))
    if args.json:
        flat = {k: v["value"] if isinstance(v, dict) else v for k, v in result.items()}
        console.emit_json(flat | {"detail": result})
    wrong = result["precision"]["n"] - result["precision"]["hits"]
    fails = wrong > ALLOWED or result["false_alarm_rate"]["hits"] > ALLOWED
    return console.FAILED_CHECK if args.small and fails else console.OK


def judged(todo: list[solver.Given], out: Path | None, make: Callable | None = None) -> list[dict]:
    """Rows of all cases, those that `out` holds already read from there; `make` makes the plant, by default the shipped fish."""
    from fishmj.gap.plants.fish import Fish

    plant, gates, rows = (make or Fish)(), frozen(), {}
    if out:
        out.mkdir(parents=True, exist_ok=True)
        rows = {r["id"]: r for r in kept(out / "rows.jsonl")}
    with console.Progress(len(todo), "bench", unit="cases") as bar:
        for i, (case, trials, null) in enumerate(todo):
            if case.id not in rows:
                rows[case.id] = console.plain(run(plant, case, gates, null, trials))
                if out:
                    with (out / "rows.jsonl").open("a", encoding="utf-8") as file:
                        file.write(json.dumps(rows[case.id]) + "\n")
            bar.update(i + 1)
    return [rows[one.case.id] for one in todo]


def told(result: dict) -> list[str]:
    """The score in lines."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            of, within = f"{value['hits']} of {value['n']}", f"95 %: {value['low']:.1%} to {value['high']:.1%}"
            lines.append(f"{key:26s} {value['value']:6.1%}  ({of}; {within})")
        else:
            lines.append(f"{key:26s} {value if value is None or isinstance(value, int) else round(value, 3)}")
    return lines
