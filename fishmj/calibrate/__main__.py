"""Calibrate a fish against its logs: servo, latency, slip, mass.

fishmj calibrate servo   --out fish.calibrated.toml      sine, square and impulse, in air and water
fishmj calibrate latency --out fish.calibrated.toml      the same trials: commands, camera
fishmj calibrate slip    --out fish.calibrated.toml      swims at two beats and a coast-down; prints the profile over s
fishmj calibrate mass    --out fish.calibrated.toml      a page of weighings
fishmj calibrate score   --model fish.calibrated.toml    synthetic trials only: fitted against the sealed values
fishmj calibrate check   --robots 16                     how far off it is, on robots drawn anew
"""

import argparse
from pathlib import Path

from fishmj import console
from fishmj.errors import UnknownName

OTHERS = ("score", "check")


def main(argv: list[str]) -> int:
    from fishmj.calibrate.logs import shipped
    from fishmj.calibrate.verbs import VERBS, default_report

    if not argv or argv[0] in ("-h", "--help"):
        console.say(__doc__ or "")
        return console.OK if argv else console.BAD_INPUT
    verb, *rest = argv
    if verb == "score":
        from fishmj.campaign import hidden_score

        return hidden_score.main(rest)
    if verb == "check":
        return drawn(rest)
    if verb not in VERBS:
        raise UnknownName("calibration", verb, [*VERBS, *OTHERS])
    parser = console.parser(f"calibrate {verb}", VERBS[verb].__doc__ or "")
    add = parser.add_argument
    data = "data set of trials; for mass, the folder of measurements.toml (default: the shipped ones)"
    add("--data", type=Path, default=shipped(), help=data)
    add("--model", default="fish", help="the fish to start from: shipped name or TOML file (default fish)")
    add("--same-robot", action="store_true", help="the logs are the model's, although they name another robot")
    add("--out", type=_model_file, help="fish file (.toml) to write, or to go on with when it is there; default none")
    report = f"folder for report.html and pictures (default {default_report(verb)})"
    add("--report", type=console.out_folder, default=default_report(verb), help=report)
    if verb == "slip":
        add("--grid", help="grid of the solver's table: paper, window, laptop; default: the trials', else window")
        add("--recompute", action="store_true", help="run the solver and print a new entry of the table")
        ratios = "slip ratios to run, each 0 to 1 (default 0,0.9,0.95,0.98,0.99,0.998,1)"
        add("--ratios", type=_ratios, default=_ratios("0,0.9,0.95,0.98,0.99,0.998,1"), help=ratios)
        add("--device", default="cpu", choices=("auto", "cpu", "cuda"), help="of --recompute (default cpu)")
        add("--tanks", type=console.whole(1, 64), default=1, metavar="N", help="side by side, of --recompute (default 1)")
    args = parser.parse_args(rest)
    answer = VERBS[verb](args)
    if args.out:
        console.say(f"written: {args.out}")
    if "report" in answer:
        console.say(f"report: {answer['report']}")
    if args.json:
        console.emit_json(answer)
    return console.OK


def drawn(argv: list[str]) -> int:
    """`check`: the second simulator makes robots, the calibration does not know of whom."""
    from fishmj.calibrate.check import check
    from fishmj.calibrate.logs import Logs
    from fishmj.campaign.hidden_trials import hidden, trials, truth
    from fishmj.gap.watch import shown

    parser = console.parser("calibrate check", "Calibrate robots drawn anew, whose numbers are known: errors and coverage.")
    add = parser.add_argument
    add("--robots", type=console.whole(1, 1000), default=8, metavar="N", help="how many, 1 to 1000 (default 8)")
    add("--seed", type=console.whole(0, 2**31 - 1), default=100, metavar="N", help="of the first (default 100)")
    args = parser.parse_args(argv)
    seeds = range(args.seed, args.seed + args.robots)
    with shown(args.robots, "robots", "robots") as bar:
        rows = check(_counted(((truth(hidden(seed)), Logs(Path("drawn anew"), trials(seed))) for seed in seeds), bar))
    console.say(console.table(rows))
    if args.json:
        console.emit_json({"check": rows})
    return console.OK


def _counted(cases, bar):
    """The same, each counted as done when the next is asked for."""
    for done, case in enumerate(cases):
        bar.update(done)
        yield case
        bar.update(done + 1)


def _model_file(text: str) -> Path:
    """The `type=` of --out."""
    path = console.out_file(text)
    if path.suffix != ".toml":
        raise argparse.ArgumentTypeError(f"{path}: a fish file is a .toml")
    return path


def _ratios(text: str) -> list[float]:
    """The `type=` of --ratios."""
    one = console.number(0, 1)
    return [one(part.strip()) for part in text.split(",")]


if __name__ == "__main__":
    raise SystemExit(console.run(main))
