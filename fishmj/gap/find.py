"""`gap find DATA`: which effect is missing in the model, how large it is, what else it could be, and how far the gap closes."""

from dataclasses import asdict, replace
from pathlib import Path

from fishmj import console, interrupt
from fishmj.engines import in_water
from fishmj.engines.native import cache_folder
from fishmj.gap import data, judge, version
from fishmj.gap.apply import settle
from fishmj.gap.gates import frozen
from fishmj.gap.null_runs import RUNS
from fishmj.gap.quiet import Shortage, everything, shortage
from fishmj.gap.records import record_of
from fishmj.gap.workflow import Inquiry, investigate
from fishmj.mjcf.description import load_robot
from fishmj.store import write_json


def main(argv: list[str]) -> int:
    parser = console.parser("gap find", __doc__)
    add = parser.add_argument
    given = "a folder of trial folders with manifest.json (fishmj.log import), or a bundle (.npz)"
    add("data", type=Path, help=f"data set: {given}; measurements.toml in the folder (docs/logs.md) is what was weighed")
    add("--model", default="fish", help="the model to question: shipped name or TOML file, with the effects it already has")
    add(
        "--water",
        default="structured",
        help="a fitted water in place of the model's own: surrogate, or a name such as swift-base",
    )
    add("--null", type=Path, help="folder of null sets (data/gap/lbm/nulls: of the flow solver); default, runs made anew")
    add("--out", type=Path, help="folder for report.html, verdict.json and model.patched.toml (or model.rejected-*.toml)")
    add("--noise", type=float, default=1.0, help="factor on the sensors' usual noise, when the logs do not state their own")
    add(
        "--null-runs",
        type=int,
        default=RUNS,
        help="runs of every record in the independent simulator; with fewer than 64 a healthy fish may show a gap",
    )
    add("--most", type=int, default=None, help="effects to add at most")
    add("--seed", type=int, default=0, help="of the split and of the null runs")
    args = parser.parse_args(argv)
    lacking = missing(args)
    if lacking is not None:
        console.say(lacking.text())
        if args.json:
            console.emit_json(asdict(lacking))
        return console.CANNOT_TELL
    with interrupt.keeping(words):
        inquiry = search(args)
        console.say(inquiry.verdict.text())
        if args.out:
            console.say(f"written: {', '.join(write(inquiry, args.out, context_of(inquiry, args)))}")
    if args.json:
        console.emit_json(inquiry.verdict.plain())
    return console.OK


def words() -> str:
    """What an interrupted search says."""
    return f"{cache_folder() / 'null'} holds the null runs that were finished; the same command begins with those"


def search(args) -> Inquiry:
    """Read the data set and search."""
    from fishmj.gap.plants.fish import Fish

    trials = data.trials_in(args.data)
    gates = frozen() if args.most is None else replace(frozen(), most=args.most)
    plant = Fish(in_water(load_robot(args.model), args.water))
    null = data.null_of(null_of(args))
    page = data.page_in(args.data)
    return investigate(plant, trials, gates=gates, null=null, page=page, seed=args.seed, further=True, say=console.say)


def null_of(args) -> dict:
    """How null runs are drawn: of the second robot, or those of a folder."""
    made = {"runs": args.null_runs, "noise": args.noise, "seed": args.seed}
    return made | {"folder": str(args.null.resolve())} if args.null else made


def missing(args) -> "Shortage | None":
    """Whether the data set is too short or too quiet to tell effects apart; None when it is not."""
    dt = load_robot(args.model).timing.physics_dt
    return shortage([record_of(t, dt) for t in data.trials_in(args.data)], everything())


def context_of(inquiry: Inquiry, args) -> dict:
    """What was searched, by hash, and the records that no decision saw (or none was fitted to): what gap apply needs."""
    apart = [r.name for r, u in zip(inquiry.records, inquiry.unseen, strict=True) if u]
    seen = [r.name for r, u in zip(inquiry.records, inquiry.unseen, strict=True) if not u]
    held = [name for name, h in zip(seen, inquiry.held, strict=True) if h]
    drawn = {"null": null_of(args), "water": args.water}
    hashes = {"model_sha256": version.digest(args.model), "data_sha256": data.digest(args.data)}
    model = str(Path(args.model).resolve()) if str(args.model).endswith(".toml") else str(args.model)
    return {"model": model, "data": str(args.data.resolve()), **hashes, "judged": apart or held, **drawn}


def write(inquiry: Inquiry, folder: Path, context: "dict | None" = None) -> list[str]:
    """verdict.json, report.html and report.json; with the context of the search also the patched (or the rejected) model."""
    folder.mkdir(parents=True, exist_ok=True)
    verdict = inquiry.verdict.plain()
    if context is None:
        write_json(folder / "verdict.json", verdict)
    else:
        some = [r for r in inquiry.records if r.name in context["judged"]]
        plant = inquiry.evidence.plant
        measure = lambda versions: judge.gaps_of(versions, some, data.null_of(context["null"]), plant)  # noqa: E731
        done = settle(verdict, context, measure, folder / "model.patched.toml", folder)
        patched = done.path.name if done.path and done.accepted else ""
        write_json(folder / "verdict.json", verdict | {"context": context, "patched_model": patched})
    from fishmj.gap import report

    return ["verdict.json", *report.write(inquiry, folder), *([done.path.name] if context is not None and done.path else [])]
