"""`python -m fishmj virtual_robot`: make trials of a robot in which effects are hidden."""

import time
from argparse import ArgumentTypeError
from itertools import cycle, islice
from math import pi

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.log import excitation

EXAMPLES = """examples:
  fishmj virtual_robot --plant command_latency=0.038 --logs 12 --seed 7 --out data --truth truth.json
  fishmj virtual_robot --plant random --plant random --seed 8 --out data2 --truth truth2.json
  fishmj virtual_robot --list"""
MOST_LOGS, FASTEST = 1000, 1.0  # trials, m/s


def options() -> console.Parser:
    """The arguments of `virtual_robot`."""
    summary = "Synthetic trials of a second, independent robot in which effects are hidden."
    parser = console.parser("virtual_robot", summary, examples=EXAMPLES)
    add = parser.add_argument
    plant = "what is hidden, SI; may be repeated; random, random_odd; by default nothing"
    add("--plant", type=console.text, action="append", default=[], metavar="EFFECT[=value]", help=plant)
    runs = "designed, casual, dry, all, or ids with commas"
    add("--excitations", type=console.text, default="designed", metavar="LIST", help=runs)
    logs = "number of trials; beyond the list they are replicates. Default: the list once"
    add("--logs", type=console.whole(1, MOST_LOGS), metavar="N", help=logs)
    add("--seed", type=console.SEED, default=0, help="robot and noise")
    add("--noise", type=console.number(0, 100), default=1.0, help="factor on every sensor's noise")
    add("--nuisance", type=console.number(0, 0.5), default=0.1, help="relative half width of unmeasured constants")
    add("--model", type=console.text, default="fish", help="the robot: name or TOML file, a chain of 2 to 8 links (default fish)")
    add("--medium", default="water", choices=("water", "air"), help="air: hung on a thread, no camera")
    add("--flow", type=stream, default="0,0", metavar="SPEED,DIRECTION", help="ordered stream, m/s and rad")
    add("--weigh", action="store_true", help="with measurements.toml: scales, knife edge, pendulum")
    add("--out", type=console.out_folder, help="data set folder; refused when it is there; needed unless --list")
    add("--truth", type=console.out_file, help="file for what was planted, outside the data set; needed unless --list")
    add("--overwrite", action="store_true", help="replace the data set and the truth that are there")
    add("--list", action="store_true", help="name effects and excitations and stop")
    return parser


def main(argv: list[str]) -> int:
    """The verb `virtual_robot`. Returns the exit code."""
    args = options().parse_args(argv)
    if args.list:
        return _list(args.json)
    if args.out is None or args.truth is None:
        raise ConfigError("virtual_robot: say where: --out FOLDER for the trials and --truth FILE for what is hidden in them")
    from fishmj.gap.laboratory.session import trial_name
    from fishmj.gap.laboratory.virtual_robot.hidden_dataset import parse, placed, write_hidden
    from fishmj.gap.laboratory.virtual_robot.robot_constants import buildable
    from fishmj.gap.laboratory.virtual_robot.trials import generate
    from fishmj.gap.laboratory.virtual_robot.weighing import page
    from fishmj.mjcf.reading import load_robot

    buildable(load_robot(args.model), args.model)
    effects, runs = parse(args.plant, args.seed), _runs(args.excitations, args.logs)
    names = [trial_name(i, run) for i, run in enumerate(runs)]
    out, truth = placed(args.out, args.truth, names, args.overwrite)
    begin = time.perf_counter()
    with console.Progress(len(runs), "trials", "trials") as bar:
        bar.update(0)
        numbers = (args.seed, args.noise, args.nuisance)
        trials = generate(effects, runs, *numbers, args.model, medium=args.medium, flow=args.flow, tick=bar.update)
    facts = {"seed": args.seed, "noise": args.noise, "nuisance": args.nuisance, "medium": args.medium, "excitations": runs}
    facts["model"] = args.model
    weighings = page(effects, args.seed, args.nuisance, args.model) if args.weigh else None
    write_hidden(out, truth, trials, effects, facts, args.overwrite, weighings)
    seconds = sum(trial.span[1] for trial in trials)
    took = time.perf_counter() - begin
    made = f"{len(trials)} trials, {seconds:.0f} s of synthetic logs in {args.out} ({took:.1f} s)"
    console.say(f"{made}; the truth is in {args.truth}")
    if args.json:
        result = {"trials": len(trials), "seconds": seconds, "out": args.out, "truth": args.truth, "hidden": len(effects)}
        console.emit_json(result)
    return console.OK


def _runs(text: str, logs: int | None) -> list[str]:
    """Excitation ids of the session."""
    shelf = {"designed": excitation.DESIGNED, "casual": excitation.CASUAL, "dry": excitation.DRY, "all": excitation.names()}
    listed = list(shelf.get(text, [name.strip() for name in text.split(",")]))
    for name in listed:
        excitation.get(name)
    return list(islice(cycle(listed), len(listed) if logs is None else logs))


def stream(text: str) -> tuple[float, float]:
    """Parses `0.2,3.14`: speed [m/s] and direction [rad]. Raises ArgumentTypeError: no two numbers in their ranges."""
    parts = text.split(",")
    if len(parts) != 2:
        raise ArgumentTypeError(f"got {text[:40]!r}, expected SPEED,DIRECTION such as 0.2,3.14 (m/s, rad)")
    return console.number(0, FASTEST)(parts[0]), console.number(-2 * pi, 2 * pi)(parts[1])


def _list(json: bool) -> int:
    from fishmj.gap.laboratory.virtual_robot.trials import EFFECTS

    rows: list[dict] = []
    for e in EFFECTS.values():
        shown = {"stage": e.stage, "seen in": ", ".join(e.shows), "shown by": ", ".join(e.runs)}
        for p in e.parameters:
            row = {"effect": e.name, "parameter": p.name, "unit": p.unit}
            rows.append({**row, "null": p.null, "from": p.typical[0], "to": p.typical[1], **shown})
    known = map(excitation.get, excitation.names())
    runs = [{"excitation": run.id, "seconds": round(run.seconds, 1), "about": run.about} for run in known]
    if json:
        console.emit_json({"effects": rows, "excitations": runs})
    else:
        console.say(console.table(rows), "", console.table(runs))
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
