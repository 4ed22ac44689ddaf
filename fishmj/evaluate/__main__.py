"""Judge controllers and policies over the decided 72 trials: tables, intervals, JSON, pictures, logs."""

from dataclasses import replace
from pathlib import Path

from fishmj import console, controllers, engines, interrupt
from fishmj.errors import ConfigError, FishmjError, MissingExtra, UnknownName
from fishmj.evaluate import protocol, tables
from fishmj.evaluate.driver import run
from fishmj.evaluate.kept import Kept
from fishmj.evaluate.result import Result
from fishmj.evaluate.statistics import compare, summary
from fishmj.flow import PRESETS
from fishmj.mjcf.description import COMMAND_PATHS, load_robot

WATERS = ("structured", "surrogate", "lbm")
FALLBACKS = ("compiled", "planar")


def options(argv: list[str]):
    """Parsed arguments."""
    parser = console.parser("evaluate", __doc__)
    add = parser.add_argument
    add("controllers", nargs="+", metavar="CONTROLLER", help=f"{', '.join(controllers.NAMES)}, a shipped policy or a policy file")
    add("--robot", default="fish", help="shipped name or TOML file")
    add("--water", default="structured", help=f"{', '.join(WATERS)}, or the TOML of a fitted water")
    add("--domain", default="paper", help="box of water of --water lbm: paper, flow_tank, window, laptop (a preview)")
    add("--slip", type=float, default=1.0, help="slip ratio of --water lbm at the paper's grid")
    add("--device", default="auto", help="of --water lbm: auto, cpu, cuda")
    add("--tanks", type=int, default=1, help="trials of --water lbm that run side by side; 12 or more keep one GPU busy")
    add("--turbulence", default="default", help=", ".join(PRESETS))
    add("--intensity", type=float, default=None, help="TI = u_rms / max(U, 0.1 m/s); default 0.05")
    add("--speeds", type=numbers, default=None, metavar="M/S,..", help="default 0.1,0.2,0.3")
    add("--los", type=numbers, default=None, metavar="DEG,..", help="default 0,45,..,315; 0 = target straight upstream")
    add("--repeats", type=int, default=None, help="default 3")
    add("--heading", default="upstream", help=", ".join(protocol.HEADINGS))
    add("--engine", default="batch", help=f"{', '.join(engines.NAMES)}; the judge is batch (MuJoCo C)")
    add("--duration", type=float, default=None, help="s, default 60")
    add("--seed", type=int, default=0)
    add("--seeds", default="judge", help="judge, or tune for choosing gains and checkpoints")
    add("--command-path", default=None, help=", ".join(COMMAND_PATHS))
    add("--no-randomisation", action="store_true", help="the nominal fish, nominal latencies")
    add("--no-noise", action="store_true", help="exact observations")
    add("--out", type=Path, default=None, metavar="DIR", help="report.html, results.json, trials.csv")
    add("--plots", action="store_true", help="with --out: pictures too, also in the report")
    add("--log", action="store_true", help="with --out: every trial as a trial folder, for replay")
    return parser.parse_args(argv)


def numbers(text: str) -> list[float]:
    """`0.1,0.2` -> [0.1, 0.2]."""
    return [float(part) for part in text.split(",") if part]


def main(argv: list[str]) -> int:
    args = options(argv)
    if args.water not in WATERS and not args.water.endswith(".toml"):
        raise UnknownName("water", args.water, WATERS)
    if (args.plots or args.log) and args.out is None:
        raise ConfigError("evaluate: --plots and --log write files; say where with --out DIR")
    robot = load_robot(args.robot) if args.water == "lbm" else engines.in_water(load_robot(args.robot), args.water)
    if args.command_path is not None:
        if args.command_path not in COMMAND_PATHS:
            raise UnknownName("command path", args.command_path, COMMAND_PATHS)
        robot = replace(robot, timing=replace(robot.timing, command_path=args.command_path))
    trials = protocol.trials(
        speeds=args.speeds, los_deg=args.los, repeats=args.repeats, seed=args.seed, box=args.seeds, turbulence=args.turbulence,
        intensity=args.intensity, heading=args.heading, randomisation=0.0 if args.no_randomisation else 1.0,
        noise=0.0 if args.no_noise else 1.0, duration=args.duration,
    )  # fmt: skip
    brains = [controllers.make(name, robot) for name in args.controllers]  # a wrong name fails before anything runs
    if args.water == "lbm":
        with interrupt.keeping(lambda: tanks_words(args.out)):
            return report([judge_in_tanks(brain, robot, trials, args) for brain in brains], args)
    kept = Kept(args.out, robot, trials, args.engine, [brain.name for brain in brains])
    with interrupt.keeping(kept.words):
        try:
            results = judged(brains, robot, trials, args, kept)
        except FishmjError:
            if kept.done:
                console.warn(kept.words())
            raise
        code = report(results, args)
    kept.end()
    return code


def judged(brains, robot, trials, args, kept: Kept) -> list[Result]:
    """All controllers; those that an interrupted judgement had finished are taken from --out."""
    results, engine = [], None
    for brain in brains:
        found = kept.find(brain)
        if found is None:
            if engine is None:
                with console.Progress(1, "judge") as bar:
                    bar.stage(f"compiling the engine {args.engine}")
                    engine = choose_engine(args.engine, robot)
            found = judge(brain, robot, trials, engine)
        results.append(kept.keep(brain, found))
    return results


def tanks_words(folder: Path | None) -> str:
    """What an interrupted judgement in the flow solver says."""
    if folder is None:
        return "nothing was kept: with --out DIR every finished trial is"
    return f"{folder / 'lbm'} holds {len(list((folder / 'lbm').glob('*.npz')))} trials; go on with the same command"


def choose_engine(name: str, robot):
    """The engine asked for; without batched MuJoCo the next one that is installed, with a note."""
    if name not in engines.NAMES:
        raise UnknownName("engine", name, engines.NAMES)
    for option in (name, *FALLBACKS) if name == "batch" else (name,):
        try:
            made = engines.make(option, robot)
        except (MissingExtra, ModuleNotFoundError) as error:
            reason = error
            continue
        if option != name:
            console.warn(f"engine {name} is not available ({reason}); judged on {option} instead")
        return made
    raise ConfigError(f"engine {name}: not available in this build: {reason}")


def judge(brain, robot, trials, engine) -> Result:
    """One controller over all trials, with a progress line in simulated seconds."""
    with console.Progress(trials.duration * len(trials), f"judge {brain.name}", unit="sim s") as bar:
        done = robot.timing.control_dt * len(trials)
        return run(brain, robot, trials, engine, progress=lambda step: bar.update(step * done))


def judge_in_tanks(brain, robot, trials, args) -> Result:
    """One controller over all trials in the flow solver; finished trials are kept in --out and not run again."""
    from fishmj.evaluate import tank

    if args.tanks < 1:
        raise ConfigError(f"evaluate: --tanks {args.tanks}; expected 1 or more")
    total = trials.duration * len(trials)
    with console.Progress(total, f"judge {brain.name} in the solver", unit="sim s") as bar:
        options = {"domain": args.domain, "slip": args.slip, "device": args.device, "tanks": args.tanks}
        seen = lambda k: bar.update(k * robot.timing.control_dt)  # noqa: E731
        return tank.judge(brain, robot, trials, args.out, progress=seen, **options)


def report(results: list[Result], args) -> int:
    """Tables to the terminal, files where asked."""
    summaries = [summary(r) for r in results]
    console.say("", tables.condition(results[0]), "value (95 % bootstrap interval over trials)", "")
    console.say(tables.overall(summaries), "", tables.overall(summaries, ("arrival", *tables.REST)))
    for s in summaries:
        console.say("", f"{s['controller']} by flow speed", tables.by_condition(s, "by_speed"))
        console.say("", f"{s['controller']} by direction (0 = target straight upstream)", tables.by_condition(s, "by_los"))
    pairs = [(results[0], other) for other in results[1:]]
    for a, b in pairs:
        console.say("", f"paired over the same trials: {b.controller} minus {a.controller}; * = the interval excludes 0")
        console.say(tables.paired(a, b))
    found = {
        "condition": tables.condition(results[0]),
        "results": summaries,
        "paired": [{"a": a.controller, "b": b.controller, **d._asdict()} for a, b in pairs for d in compare(a, b)],
    }
    if args.out is not None:
        from fishmj.evaluate.report import write

        console.say("", f"wrote {write(args.out, results, found, plots=args.plots, logs=args.log)}")
    if args.json:
        console.emit_json(found)
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
