"""`gap find DATA`: which effect is missing in the model, how large it is, what else it could be, and how far the gap closes."""

from dataclasses import replace
from pathlib import Path

from fishmj import console
from fishmj.gap.null_runs import RUNS, Null
from fishmj.gap.search import frozen
from fishmj.gap.workflow import Inquiry, investigate
from fishmj.log import Trial
from fishmj.log.dataset import read_dataset
from fishmj.store import write_json, write_text


def main(argv: list[str]) -> int:
    parser = console.parser("gap find", __doc__)
    add = parser.add_argument
    add("data", type=Path, help="data set: a folder of trial folders with manifest.json (python -m fishmj.log import makes one)")
    add("--model", default="fish", help="the model to question: shipped name or TOML file, with the effects it already has")
    add("--out", type=Path, help="folder for report.html, verdict.json and model.patched.toml")
    add("--noise", type=float, default=1.0, help="factor on the sensors' usual noise, when the logs do not state their own")
    add("--null-runs", type=int, default=RUNS, help="runs of every record in the independent simulator")
    add("--most", type=int, default=None, help="effects to add at most")
    add("--seed", type=int, default=0, help="of the split and of the null runs")
    args = parser.parse_args(argv)
    inquiry = search(args)
    console.say(inquiry.verdict.text())
    if args.out:
        written = write(inquiry, args.out)
        console.say(f"written: {', '.join(written)}")
    if args.json:
        console.emit_json(inquiry.verdict.plain())
    return console.OK


def search(args) -> Inquiry:
    """Read the data set and search."""
    from fishmj.gap.plants.fish import Fish

    trials = [named(name, trial) for name, trial in zip(*_trials(args.data), strict=True)]
    gates = frozen() if args.most is None else replace(frozen(), most=args.most)
    null = Null(runs=args.null_runs, noise=args.noise, seed=args.seed)
    return investigate(Fish(args.model), trials, gates=gates, null=null, seed=args.seed, further=True, say=console.say)


def _trials(folder: Path) -> tuple[list[str], list[Trial]]:
    data = read_dataset(folder)
    return list(data.names), list(data)


def named(name: str, trial: Trial) -> Trial:
    """The trial under its folder's name."""
    return Trial(trial.meta, trial.tables, name=name, notes=trial.notes)


def write(inquiry: Inquiry, folder: Path) -> list[str]:
    """verdict.json and report.html."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "verdict.json", inquiry.verdict.plain())
    from fishmj.gap.report import page

    write_text(folder / "report.html", page(inquiry))
    return ["verdict.json", "report.html"]
