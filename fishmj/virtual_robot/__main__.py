"""`python -m fishmj.virtual_robot`: make trials of a robot in which effects are hidden.

python -m fishmj.virtual_robot --plant command_latency=0.038 --logs 12 --seed 7 --out data --truth truth.json
python -m fishmj.virtual_robot --plant random --plant random --seed 8 --out data2 --truth truth2.json
python -m fishmj.virtual_robot --list
"""

import argparse
import math
import time
from itertools import cycle, islice

from fishmj import console, excitation
from fishmj.errors import ConfigError

MOST_LOGS, LAST_SEED, FASTEST = 1000, 2**31 - 1, 1.0  # trials, seed, m/s


def main(argv: list[str]) -> int:
    parser = console.parser("virtual_robot", "Synthetic trials of a second, independent robot in which effects are hidden.")
    parser.add_argument(
        "--plant", action="append", default=[], metavar="EFFECT[=value]", help="SI; may be repeated; random, random_odd"
    )
    parser.add_argument(
        "--excitations", default="designed", metavar="LIST", help="designed, casual, dry, all, or ids with commas"
    )
    add = parser.add_argument
    add(
        "--logs", type=console.whole(1, MOST_LOGS), metavar="N", help="trials; beyond the list replicates. Default: the list once"
    )
    add("--seed", type=console.whole(0, LAST_SEED), default=0, metavar="N", help="robot and noise, from 0 (default 0)")
    add("--noise", type=console.number(0, 100), default=1.0, metavar="F", help="factor on every sensor's noise (default 1)")
    nuisance = "relative half width of unmeasured constants, 0 to 0.5 (default 0.1)"
    add("--nuisance", type=console.number(0, 0.5), default=0.1, metavar="F", help=nuisance)
    add("--medium", default="water", choices=("water", "air"), help="water, or air: hung on a thread (default water)")
    add("--flow", type=_flow, default=(0.0, 0.0), metavar="SPEED,DIRECTION", help="ordered stream, m/s and rad (default 0,0)")
    add("--weigh", action="store_true", help="with measurements.toml: scales, knife edge, pendulum")
    add("--out", type=console.out_folder, help="data set folder")
    add("--truth", type=console.out_file, help="file for what was planted, outside the data set")
    add("--overwrite", action="store_true", help="replace a data set of the same trials")
    parser.add_argument("--list", action="store_true", help="name effects and excitations and stop")
    args = parser.parse_args(argv)
    if args.list:
        return _list(args.json)
    if args.out is None or args.truth is None:
        raise ConfigError("virtual_robot: say where: --out FOLDER for the trials and --truth FILE for what is hidden in them")
    from fishmj.virtual_robot.dataset import parse, placed, write_hidden
    from fishmj.virtual_robot.trials import generate, trial_name
    from fishmj.virtual_robot.weighing import page

    effects, runs = parse(args.plant, args.seed), _runs(args.excitations, args.logs)
    names = [trial_name(i, run) for i, run in enumerate(runs)]
    out, truth = placed(args.out, args.truth, names, args.overwrite)
    begin = time.perf_counter()
    with console.Progress(len(runs), "trials", "trials") as bar:
        bar.update(0)
        numbers = (args.seed, args.noise, args.nuisance)
        trials = generate(effects, runs, *numbers, medium=args.medium, flow=args.flow, tick=bar.update)
    facts = {"seed": args.seed, "noise": args.noise, "nuisance": args.nuisance, "medium": args.medium, "excitations": runs}
    weighings = page(effects, args.seed, args.nuisance) if args.weigh else None
    write_hidden(out, truth, trials, effects, facts, args.overwrite, weighings)
    seconds = sum(trial.span[1] for trial in trials)
    took = time.perf_counter() - begin
    console.say(
        f"{len(trials)} trials, {seconds:.0f} s of synthetic logs in {args.out} ({took:.1f} s); the truth is in {args.truth}"
    )
    if args.json:
        console.emit_json(
            {"trials": len(trials), "seconds": seconds, "out": args.out, "truth": args.truth, "hidden": len(effects)}
        )
    return console.OK


def _runs(text: str, logs: int | None) -> list[str]:
    """Excitation ids of the session."""
    shelf = {"designed": excitation.DESIGNED, "casual": excitation.CASUAL, "dry": excitation.DRY, "all": excitation.names()}
    listed = list(shelf.get(text, [name.strip() for name in text.split(",")]))
    for name in listed:
        excitation.get(name)
    return list(islice(cycle(listed), len(listed) if logs is None else logs))


def _flow(text: str) -> tuple[float, float]:
    """The `type=` of --flow."""
    try:
        speed, direction = map(float, text.split(","))
    except ValueError:
        speed, direction = math.nan, math.nan
    if not (0 <= speed <= FASTEST and abs(direction) <= 2 * math.pi):
        expected = f"SPEED,DIRECTION such as 0.2,3.14: 0 to {FASTEST:g} m/s, -6.28 to 6.28 rad"
        raise argparse.ArgumentTypeError(f"got {text[:40]!r}, expected {expected}")
    return speed, direction


def _list(json: bool) -> int:
    from fishmj.virtual_robot.trials import EFFECTS

    rows = [
        {
            "effect": e.name,
            "parameter": p.name,
            "unit": p.unit,
            "null": p.null,
            "from": p.typical[0],
            "to": p.typical[1],
            "stage": e.stage,
        }
        for e in EFFECTS.values()
        for p in e.parameters
    ]
    runs = [
        {"excitation": n, "seconds": round(excitation.get(n).seconds, 1), "about": excitation.get(n).about}
        for n in excitation.names()
    ]
    if json:
        console.emit_json({"effects": rows, "excitations": runs})
    else:
        console.say(console.table(rows), "", console.table(runs))
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
