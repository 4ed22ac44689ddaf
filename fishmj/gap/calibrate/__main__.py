"""Calibrate a fish against its logs: servo, latency, slip, water, mass; a robot in MJCF: model."""

import argparse
from functools import partial
from pathlib import Path

from fishmj.base import console, interrupt
from fishmj.base.console import Command
from fishmj.mjcf.reading import load_robot

CHECKED = Path("runs") / "calibrate" / "check"  # finished robots of `check`
RATIOS = (0.0, 0.9, 0.95, 0.98, 0.99, 0.998, 1.0)


def fit(verb: str, argv: list[str]) -> int:
    """Runs one calibration: servo, latency, slip, water or mass. Returns the exit code: 1 if the result is too poor to use."""
    from fishmj.gap.calibrate.commands import VERBS

    again = interrupt.again("start again")
    with interrupt.keeping(lambda: f"nothing was kept; a run takes seconds to minutes: {again}"):
        made = options(verb)
        args = made.parse_args(argv)
        begun = bool(args.out and args.out.is_file())
        if begun:
            load_robot(args.out)  # refuses an invalid --out before the fit
        args.model = args.model or (str(args.out) if begun else "fish")
        if verb == "slip":
            needs = {"--recompute": (args.recompute, ("ratios", "device", "tanks"))}
            console.refuse_unheeded("calibrate slip", args, made, needs)
            args.ratios = args.ratios or RATIOS
            if args.reference:
                args.grid, args.boundary = reference_grid(args.grid, args.boundary)
            args.boundary = args.boundary or "plain"
        answer = VERBS[verb](args)
    poor = answer.get("poor", "")
    if args.out:
        console.say(f"written: {args.out}" + (f", but {poor}" if poor else ""))
    elif poor:
        console.say(poor)
    if "report" in answer:
        console.say(f"report: {answer['report']}")
    if args.json:
        console.emit_json(answer)
    return console.FAILED_CHECK if poor else console.OK


def reference_grid(grid: str | None, boundary: str | None = None) -> tuple[str, str]:
    """Grid, for a fish that swims away, and boundary of the reference water. Raises ConfigError for others."""
    from fishmj.lbm_oracle.run.solver_water import IN_WINDOW, boundary_name, refuse_beside

    refuse_beside("calibrate slip", IN_WINDOW, grid=grid, boundary=boundary)
    return IN_WINDOW.domain, boundary_name(IN_WINDOW.sharpness)


def options(verb: str) -> console.Parser:
    """The arguments of a calibration."""
    from fishmj.gap.calibrate.calibration_logs import shipped
    from fishmj.gap.calibrate.commands import VERBS, default_report
    from fishmj.gap.commands import gap_options

    made = console.parser(f"calibrate {verb}", VERBS[verb].__doc__ or "")
    add = made.add_argument
    add("--data", type=console.path, default=shipped(), help="data set of trials; for mass, the folder of measurements.toml")
    start = "the fish to start from: shipped name or TOML file (default: the file of --out if it exists, else fish)"
    add("--model", type=console.text, help=start)
    gap_options.of_robot(add)
    out = "fish file (.toml) to write, or to update if it exists (default: write none)"
    add("--out", type=_model_file, help=out)
    report = "folder for report.html and pictures; existing ones are replaced"
    add("--report", type=console.out_folder, default=str(default_report(verb)), help=report)
    if verb == "slip":
        from fishmj.lbm_oracle.run.solver_water import boundary_option

        grid = "grid of the solver's table: paper, window, laptop (default: that of the trials, else window)"
        add("--grid", type=console.text, help=grid)
        boundary_option(add, default=None)
        near = "use grid and boundary of the reference water instead of --grid (default no)"
        add("--reference", action="store_true", help=near)
        add("--recompute", action="store_true", help="run the solver and print a new entry of the table; keeps finished swims")
        ratios = console.Listed(console.number(0, 1), 20)
        which = "with --recompute: slip ratios to run; default 0,0.9,0.95,0.98,0.99,0.998,1"
        add("--ratios", type=ratios, metavar="S,..", help=which)
        place = "with --recompute: auto, cpu, cuda, cuda:N, cuda:all or a list of them; default cpu"
        add("--device", type=console.devices, default="cpu", help=place)
        tanks = "with --recompute: swims side by side on each device; default 1"
        add("--tanks", type=console.whole(1, 64), default=1, help=tanks)
    return made


def drawn(argv: list[str]) -> int:
    """`check`: the second simulator makes robots, and the calibration does not know their numbers."""
    from fishmj.gap.calibrate.calibration_logs import Logs, PartialResults
    from fishmj.gap.calibrate.commands import check_one, check_rows
    from fishmj.gap.laboratory.hidden_lbm.calibration_trials import hidden, trials, truth
    from fishmj.gap.models.swimming_fish import ServoStand
    from fishmj.gap.progress import terminal_bar

    about = (
        f"Calibrates random robots with known parameters and reports errors and coverage. Finished robots are kept in {CHECKED}"
    )
    parser = console.parser("calibrate check", f"{about} and not repeated.")
    parser.add_argument("--robots", type=console.whole(1, 1000), default=8, help="number of robots; each takes minutes")
    parser.add_argument("--seed", type=console.SEED, default=100, help="of the first")
    args = parser.parse_args(argv)
    names = {f"robot-{seed}": seed for seed in range(args.seed, args.seed + args.robots)}
    kept, plant, robots = PartialResults(CHECKED, {}), ServoStand(), []
    with interrupt.keeping(lambda: kept.words(list(names), "robots")), terminal_bar(args.robots, "robots", "robots") as bar:
        for done, (name, seed) in enumerate(names.items(), 1):
            off = kept.find(name)
            if off is None:
                off = kept.keep(name, check_one(truth(hidden(seed)), Logs(Path("drawn anew"), trials(seed)), plant))
            robots.append(off)
            bar.update(done)
    rows = check_rows(robots)
    console.say(console.table(rows))
    if args.json:
        console.emit_json({"check": rows})
    return console.OK


def _model_file(text: str) -> Path:
    """The `type=` of --out."""
    path = console.out_file(text)
    if path.suffix != ".toml":
        raise argparse.ArgumentTypeError(f"{path}: a fish file is a .toml")
    return path


main = console.CommandGroup(
    "calibrate",
    __doc__ or "",
    {
        "servo": Command(
            partial(fit, "servo"),
            "sine, square and impulse, in air and water",
            "fishmj calibrate servo --out fish.calibrated.toml",
        ),
        "latency": Command(
            partial(fit, "latency"), "the same trials: commands, camera", "fishmj calibrate latency --out fish.calibrated.toml"
        ),
        "slip": Command(
            partial(fit, "slip"),
            "swims at two beat frequencies and a coast-down; prints the profile over s",
            "fishmj calibrate slip --out fish.calibrated.toml",
        ),
        "water": Command(
            partial(fit, "water"),
            "free swims: gaits, turns, coasting; thrust, drag, added mass",
            "fishmj calibrate water --data my_swims --out fish.calibrated.toml",
        ),
        "mass": Command(
            partial(fit, "mass"), "weighings (measurements.toml)", "fishmj calibrate mass --out fish.calibrated.toml"
        ),
        "model": Command(
            "fishmj.gap.calibrate.robot_command",
            "a robot in MJCF: friction, damping, armature, gains, delay, bodies, from its logs",
            "fishmj calibrate model LOGS --model robot.xml --out robot.calibrated.xml",
        ),
        "score": Command(
            "fishmj.gap.laboratory.hidden_lbm.sealed_score",
            "synthetic trials only: compare the fit with the sealed truth",
            "fishmj calibrate score --model fish.calibrated.toml",
        ),
        "families": Command(
            "fishmj.gap.bench.water_families",
            "error of the water calibration, on robots of every generator",
            "fishmj calibrate families --robots 3 --jobs 2",
        ),
        "check": Command(drawn, "error of the calibrations, on random robots", "fishmj calibrate check --robots 16"),
    },
)


if __name__ == "__main__":
    raise SystemExit(console.run(main))
