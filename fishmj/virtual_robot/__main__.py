"""`python -m fishmj.virtual_robot`: make trials of a robot in which effects are hidden.

python -m fishmj.virtual_robot --plant command_latency=0.038 --logs 12 --seed 7 --out data --truth truth.json
python -m fishmj.virtual_robot --plant random --plant random --seed 8 --out data2 --truth truth2.json
python -m fishmj.virtual_robot --list
"""

import time
from itertools import cycle, islice
from pathlib import Path

from fishmj import console, excitation
from fishmj.errors import ConfigError


def main(argv: list[str]) -> int:
    parser = console.parser("virtual_robot", "Synthetic trials of a second, independent robot in which effects are hidden.")
    parser.add_argument(
        "--plant", action="append", default=[], metavar="EFFECT[=value]", help="SI; may be repeated; random, random_odd"
    )
    parser.add_argument(
        "--excitations", default="designed", metavar="LIST", help="designed, casual, dry, all, or ids with commas"
    )
    parser.add_argument("--logs", type=int, help="number of trials; beyond the list they are replicates. Default: the list once")
    parser.add_argument("--seed", type=int, default=0, help="robot and noise")
    parser.add_argument("--noise", type=float, default=1.0, help="factor on every sensor's noise")
    parser.add_argument("--nuisance", type=float, default=0.1, help="relative half width of unmeasured constants")
    parser.add_argument("--medium", default="water", choices=("water", "air"))
    parser.add_argument("--flow", default="0,0", metavar="SPEED,DIRECTION", help="ordered stream, m/s and rad")
    parser.add_argument("--weigh", action="store_true", help="with measurements.toml: scales, knife edge, pendulum")
    parser.add_argument("--out", type=Path, help="data set folder")
    parser.add_argument("--truth", type=Path, help="file for what was planted, outside the data set")
    parser.add_argument("--overwrite", action="store_true")
    parser.add_argument("--list", action="store_true", help="name effects and excitations and stop")
    args = parser.parse_args(argv)
    if args.list:
        return _list(args.json)
    if args.out is None or args.truth is None:
        raise ConfigError("virtual_robot: say where: --out FOLDER for the trials and --truth FILE for what is hidden in them")
    from fishmj.virtual_robot.dataset import parse, write_hidden
    from fishmj.virtual_robot.trials import generate
    from fishmj.virtual_robot.weighing import page

    effects, runs, flow = parse(args.plant, args.seed), _runs(args.excitations, args.logs), _flow(args.flow)
    if args.noise < 0:
        raise ConfigError(f"--noise {args.noise}: a factor, 0 or more")
    begin = time.perf_counter()
    trials = generate(effects, runs, args.seed, args.noise, args.nuisance, medium=args.medium, flow=flow)
    facts = {"seed": args.seed, "noise": args.noise, "nuisance": args.nuisance, "medium": args.medium, "excitations": runs}
    weighings = page(effects, args.seed, args.nuisance) if args.weigh else None
    write_hidden(args.out, args.truth, trials, effects, facts, args.overwrite, weighings)
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
    if logs is not None and logs < 1:
        raise ConfigError(f"--logs {logs}: at least one trial")
    return list(islice(cycle(listed), len(listed) if logs is None else logs))


def _flow(text: str) -> tuple[float, float]:
    try:
        speed, direction = map(float, text.split(","))
    except ValueError as error:
        raise ConfigError(f"--flow {text}: expected SPEED,DIRECTION such as 0.2,3.14 (m/s, rad)") from error
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
