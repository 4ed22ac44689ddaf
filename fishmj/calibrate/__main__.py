"""Calibrate a fish against its logs: servo, latency, slip, mass.

fishmj calibrate servo   --out fish.calibrated.toml      sine, square and impulse, in air and water
fishmj calibrate latency --out fish.calibrated.toml      the same trials: commands, camera
fishmj calibrate slip    --out fish.calibrated.toml      swims at two beats and a coast-down; prints the profile over s
fishmj calibrate mass    --out fish.calibrated.toml      a page of weighings
fishmj calibrate score   --model fish.calibrated.toml    synthetic trials only: fitted against the sealed values
fishmj calibrate check   --robots 16                     how far off it is, on robots drawn anew
"""

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
    add("--data", type=Path, default=shipped(), help="data set of trials; for mass, the folder of measurements.toml")
    add("--model", default="fish", help="the fish to start from: shipped name or TOML file")
    add("--out", type=Path, help="fish file to write, or to go on with when it is there")
    add("--report", type=Path, default=default_report(verb), help="folder for report.html and pictures")
    if verb == "slip":
        add("--grid", help="grid of the solver's table: paper, window, laptop; default: the trials', else window")
        add("--recompute", action="store_true", help="run the solver and print a new entry of the table")
        add("--ratios", default="0,0.9,0.95,0.98,0.99,0.998,1", help="slip ratios to run")
        add("--device", default="cpu")
        add("--tanks", type=int, default=1)
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

    parser = console.parser("calibrate check", "Calibrate robots drawn anew, whose numbers are known: errors and coverage.")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--seed", type=int, default=100, help="of the first")
    args = parser.parse_args(argv)
    seeds = range(args.seed, args.seed + args.robots)
    rows = check((truth(hidden(seed)), Logs(Path("drawn anew"), trials(seed))) for seed in seeds)
    console.say(console.table(rows))
    if args.json:
        console.emit_json({"check": rows})
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
