"""Evaluate controllers and policies over the standard 72 trials: tables, intervals, JSON, plots, logs."""

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fishmj import control, engines
from fishmj.base import console, cost, interrupt, ray_cluster
from fishmj.base.errors import ConfigError, FishmjError, MissingExtra
from fishmj.control.own_controller import Own
from fishmj.engines import own_effects, tank_effects
from fishmj.evaluate import protocol, trial_report
from fishmj.evaluate.judge_over_ray import judge_over_ray, with_corrections
from fishmj.evaluate.metrics import Result, summary
from fishmj.evaluate.run_trials import KEPT, FinishedTrials, drawn_otherwise, judge_each_in_solver, run
from fishmj.evaluate.trial_logs import corrections
from fishmj.lbm_oracle.run.domain import EVERY as BOXES
from fishmj.lbm_oracle.run.domain import preset
from fishmj.lbm_oracle.run.solver_water import PLAIN, asked_for, boundary_option, reference_option
from fishmj.mjcf.description import COMMAND_PATHS
from fishmj.mjcf.identity import robot_names
from fishmj.mjcf.reading import load_robot, with_timing
from fishmj.tasks.station_hold import whole_steps
from fishmj.water import choice
from fishmj.water.flow import PRESETS

SOLVER = ("--domain", "--slip", "--device", "--tanks")  # options of --water lbm and hybrid
REFERENCE = ("--reference", "--boundary", "--storage", "--dx")  # options of --water lbm only
EVERY = "--every"  # option of --water hybrid only
FALLBACKS = ("compiled", "planar")
HELD, WORK = 25, 35  # bytes per tick and per (joints + 3) columns: of a finished controller, more of a running one; measured
FRICTIONLESS = (
    "slip 1 (frictionless), the default; a real fish is better judged at 0.99: --slip 0.99 (docs/simulate/your_own_fish.md)"
)
EXAMPLES = f"""examples:
  fishmj evaluate dob                                      the standard 72 trials
  fishmj evaluate station dob --turbulence gust --out runs/gust --plots   two controllers, paired comparison, with plots
  fishmj evaluate pd --speeds 0.2 --los 0,180 --repeats 1  two trials
  fishmj evaluate station adrc-c1 --task figure_eight      follow a path, for which the policy was not trained
  fishmj evaluate station --water hybrid --tanks 12 --device cuda         the water corrected by the solver while it swims
  fishmj evaluate station dob --water lbm --tanks 24 --ray auto --out runs/lbm    over the GPUs of a Ray cluster, resumable

{control.shipped_lines()}
"""


def options() -> console.Parser:
    """Parser of the verb `evaluate`."""
    parser = console.parser("evaluate", __doc__ or "", examples=EXAMPLES)
    add = parser.add_argument
    brains = f"{', '.join(control.NAMES)}; a shipped policy ({', '.join(control.shipped_policies())}); a policy file, the"
    brains += " folder of a training, gains of fishmj tune as FILE.toml:NAME"
    brains += ", or your own as module:Name or file.py:Name. With several, each is compared with the first"
    add("controllers", type=console.text, nargs="+", action=console.Distinct, metavar="CONTROLLER", help=brains)
    courses = "figure_eight: follow a moving target; angle_of_attack: start on the target, turned from upstream by --los"
    add("--task", choices=protocol.TASKS, default=protocol.HOLD, help=f"{courses}; default station_hold, the 72 trials")
    add("--robot", type=console.text, default="fish", help="shipped name or TOML file")
    solved = "hybrid: fitted, with online correction by segments of the flow solver; lbm: the flow solver itself"
    add("--water", type=console.text, help=f"{choice.HELP}; {solved}, which takes hours without a GPU")
    reference_option(add, "--domain and --slip")
    box = f"box of water of --water lbm, default {PLAIN.domain}, or hybrid, default that of the fitted water"
    add("--domain", choices=BOXES, help=f"{box}; laptop is a preview, _refined has finer cells round the fish")
    cell = "cell size of --water lbm; the box keeps its size, and a refined box round the fish has half of it; default --domain's"
    add("--dx", type=console.number(0.002, 0.1), metavar="M", help=cell)
    slip = (
        "slip ratio of the hull in the flow solver, at the paper's grid: 1 free slip, 0 no slip; default 1, of hybrid the fit's"
    )
    add("--slip", type=console.number(0, 1), help=slip)
    boundary_option(add, default=None)
    bits = "float type of the populations of --water lbm; float16 halves the memory traffic; default float32"
    add("--storage", choices=("float32", "float16"), help=bits)
    place = "device of the flow solver: auto, cpu, cuda, cuda:N; with --water lbm also cuda:all or a list; default auto"
    add("--device", type=console.devices, default="auto", help=place)
    add(EVERY, type=console.number(4, 600), metavar="S", help="period of the 3.5 s segments of --water hybrid; default 50")
    tanks = "number of parallel tanks: trials of --water lbm on each device, or segments of hybrid; 12 fill one GPU; default 1"
    add("--tanks", type=console.whole(1, 256), default=1, help=tanks)
    spread = f"evaluate on the workers of a cluster: {ray_cluster.OPTION}; each takes a controller, with --water lbm some trials"
    add("--ray", type=console.text, metavar="ADDRESS", help=f"{spread}; default: this machine")
    add("--turbulence", choices=tuple(PRESETS), help="kind of turbulence of the current; default: default")
    add("--intensity", type=console.number(0, 0.99), help="turbulence intensity, u_rms / max(speed, 0.1 m/s); default 0.05")
    tank = "flow map of fishmj deploy flow-map: sets TI at each speed, and turbulence by the length scale; default none"
    add("--flow-map", type=console.path, metavar="FILE", help=tank)
    speeds = console.Listed(console.number(0, 1))
    add("--speeds", type=speeds, metavar="M/S,..", help="speeds of the current; default 0.1,0.2,0.3, of angle_of_attack 0.2")
    los = console.Listed(console.number(-360, 360), 360, same=lambda degrees: degrees % 360)
    angle = "directions from fish to target at the start: 0 upstream, 90 to its left; default 0,45,..,315; with"
    angle += " angle_of_attack the initial heading from upstream, default -180,-90,0,90"
    add("--los", type=los, metavar="DEG,..", help=angle)
    add("--repeats", type=console.whole(1, protocol.MOST), metavar="N", help="trials for each speed and direction; default 3")
    add("--heading", choices=protocol.HEADINGS, default="upstream", help="initial heading of the fish; uniform: random")
    add("--engine", choices=engines.NAMES, default="batch", help="physics engine; the standard is batch (MuJoCo in C)")
    add(
        "--duration",
        type=console.number(1, 600),
        metavar="S",
        help="length of a trial; default 60; figure_eight 61, angle_of_attack 30",
    )
    add("--seed", type=console.SEED, default=0, help="seed of all draws")
    add("--seeds", choices=protocol.SETS, default="judge", help="set of turbulence; tune is for choosing gains and checkpoints")
    path = "servo commands between two decisions, as in train; default the robot's. Policies trained on another need --anyway"
    add("--command-path", choices=COMMAND_PATHS, help=path)
    step = "time between two decisions, as in train, a multiple of the bus tick of 0.02 s; default the robot's, 0.2 for fish"
    add("--control-dt", type=console.number(5e-3, 10), metavar="S", help=f"{step}. Policies trained with another are refused")
    control.anyway_option(parser)
    own_effects.option(parser)
    own_effects.drawn_option(parser)
    left = "evaluate without these effects of the robot (default none); --water lbm does not support effects on water forces"
    add("--leave-out", type=console.Listed(console.text), default=(), metavar="NAME,..", help=left)
    add("--no-randomisation", action="store_true", help="nominal fish and latencies")
    add("--no-noise", action="store_true", help="exact observations")
    out = "folder for report.html, results.json, trials.csv; an older report in it is replaced; by default nothing is written"
    add("--out", type=console.out_folder, metavar="DIR", help=out)
    add("--plots", action="store_true", help="with --out: also write plots, and put them into the report")
    add("--log", action="store_true", help="with --out: also write each trial as a trial folder, for replay")
    return parser


def main(argv: list[str]) -> int:
    """Runs the verb `evaluate`; returns the exit code."""
    args = options().parse_args(argv)
    args.argv = argv
    args.again = shlex.join(["fishmj", "evaluate", *argv, *([] if args.log else ["--log"])])
    given = [o for o in (*SOLVER, *REFERENCE, EVERY) if any(word == o or word.startswith(f"{o}=") for word in argv)]
    of = ((SOLVER, (choice.LBM, choice.HYBRID)), (REFERENCE, (choice.LBM,)), ((EVERY,), (choice.HYBRID,)))
    for some, waters in of:
        if args.water not in waters and (unused := [o for o in given if o in some]):
            words = " or ".join(f"--water {name}" for name in waters)
            raise ConfigError(f"evaluate: {', '.join(unused)}: needs {words}; add it, or leave the option out")
    if args.water == choice.LBM and args.engine != "batch":
        raise ConfigError(f"evaluate: --engine {args.engine} with --water lbm, which replaces the engine; leave one of them out")
    joined, drawn = own_effects.join(args.effects), tuple(args.randomise_effects or ())
    if drawn and (args.no_randomisation or args.water == choice.LBM):
        other = "--no-randomisation" if args.no_randomisation else "--water lbm"
        raise ConfigError(f"evaluate: --randomise-effects with {other}; leave one of them out")
    if (args.plots or args.log) and args.out is None:
        raise ConfigError("evaluate: --plots and --log write files; add --out DIR")
    water = choice.chosen(load_robot(args.robot), args.water).within((*choice.SELF_MADE, choice.LBM, choice.HYBRID), "evaluate")
    robot = engines.with_effects(water.robot, drawn)
    for effect in joined:
        if effect.name not in {fitted.name for fitted in robot.effects}:
            console.warn(
                f"{effect.name} was added to the catalogue, but robot {robot.name} does not have it: add to its description"
                f' [[effect]] name = "{effect.name}"'
            )
    robot = tank_effects.without(robot, args.leave_out)
    if water.kind == choice.LBM:
        tank_effects.check_effects(robot)
    robot = with_timing(robot, args.control_dt, args.command_path, "evaluate --control-dt")
    if args.duration is not None:
        whole_steps("evaluate: --duration", args.duration, robot)
    trials = protocol.trials(
        speeds=args.speeds, los_deg=args.los, repeats=args.repeats, seed=args.seed, box=args.seeds,
        turbulence=args.turbulence or "default", intensity=args.intensity, heading=args.heading,
        randomisation=0.0 if args.no_randomisation else 1.0, noise=0.0 if args.no_noise else 1.0, duration=args.duration,
        task=args.task, effects=drawn,
    )  # fmt: skip
    if args.flow_map is not None:
        trials = in_a_tank(trials, args)
    affordable(robot, trials, len(args.controllers))
    brains = control.several(args.controllers, robot, anyway=args.anyway)  # a wrong name fails before anything runs
    if args.ray:
        ray_cluster.refuse_own_code([*(b.name for b in brains if isinstance(b, Own)), *(["--effects"] if args.effects else [])])
    if water.kind == choice.LBM:
        from fishmj.lbm_oracle.run import solver_cost

        less = "--domain laptop --repeats 1 --speeds 0.2 --los 0 --duration 10 is a preview"
        edge = {"boundary": args.boundary, "storage": args.storage, "dx": args.dx}
        args.solver = asked_for("evaluate", args.reference, args.domain, args.slip, **edge)
        work = [(args.solver.box, trials.duration * len(trials) * len(brains))]
        if not args.ray:
            solver_cost.agree("evaluate", args.device, work, instead=less, tanks=min(args.tanks, len(trials)))
        begin(water, brains, drawn, f": {args.solver.said}")
        if args.slip is None and args.reference is None and args.boundary != "wall_stress" and args.robot != "fish":
            console.warn(FRICTIONLESS)
        with interrupt.keeping(lambda: tanks_words(args.out)):
            results: list[Result] = []
            for found in judge_in_tanks(brains, robot, trials, args):
                results.append(found._replace(left_out=tuple(args.leave_out)))
                if args.out is not None and len(results) < len(brains):
                    trial_report.save(args.out, results, findings(results, args))
            return report(results, args)
    args.hybrid = hybrid_options(args, robot, trials, len(brains)) if water.kind == choice.HYBRID else None
    family = choice.family_in(robot) if args.no_randomisation else None
    begin(water, brains, drawn, f"; --no-randomisation: the first fit alone, {family.members[0].name}" if family else "")
    moved_by = args.engine if args.hybrid is None else args.hybrid.label(robot)
    kept = FinishedTrials(args.out, robot, trials, moved_by, [brain.name for brain in brains])
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


def in_a_tank(trials: protocol.Trials, args) -> protocol.MeasuredTrials:
    """Trials in turbulence measured in a tank; prints how the simulated flow differs.

    Raises ConfigError: the map lacks a speed, or an option contradicts the map.
    """
    from fishmj.water.flow_map.flow_map import FlowMap, preset_for

    if args.turbulence is not None or args.intensity is not None:
        raise ConfigError("evaluate: --flow-map sets the turbulence; leave --turbulence and --intensity out")
    found = FlowMap.read(args.flow_map)
    waters = {float(speed): found.for_speed(float(speed)) for speed in sorted(set(trials.speed.tolist()))}
    kind, said = preset_for([water.length for water in waters.values()])
    console.say(f"flow map {args.flow_map}: {said}")
    return protocol.measured(trials, {speed: water.intensity for speed, water in waters.items()}, kind)


def begin(water: choice.WaterChoice, brains, drawn: tuple[str, ...], more: str = "") -> None:
    """Prints the water of the evaluation, and the differences from the policies' training."""
    console.say(f"water: {water.said}{more}")
    for note in (note for brain in brains for note in getattr(brain, "notes", ())):
        console.warn(note)
    for brain in brains:
        if said := drawn_otherwise(brain, drawn):
            console.warn(f"policy {brain.name}: not as trained: {said}")


def judged(brains, robot, trials, args, kept: FinishedTrials) -> list[Result]:
    """Results of all controllers; those that an interrupted evaluation had finished are read from --out."""
    found = {brain.name: kept.keep(brain, there) for brain in brains if (there := kept.find(brain)) is not None}
    ours = lambda: [found[b.name]._replace(left_out=tuple(args.leave_out)) for b in brains if b.name in found]
    waiting = [brain for brain in brains if brain.name not in found]
    for brain, result in judge_each(waiting, robot, trials, args) if waiting else ():
        found[brain.name] = kept.keep(brain, result)
        if args.out is not None and kept.unfinished:  # save finished results, in case a later controller fails
            trial_report.save(args.out, ours(), findings(ours(), args) | {"unfinished": kept.unfinished})
    return ours()


def judge_each(brains, robot, trials, args) -> Iterator[tuple[Any, Result]]:
    """Yields controllers and results as they finish, here or on a Ray cluster."""
    with console.Progress(1, "judge") as bar:
        bar.stage(f"compiling the engine {args.engine}")
        engine = choose_engine(args.engine, robot)
    if args.ray:
        with console.Progress(trials.duration * len(trials) * len(brains), f"judge {len(brains)} over Ray", unit="sim s") as bar:
            bar.stage("starting the workers")
            seen = lambda done: bar.update(done) if done else None
            yield from judge_over_ray(args.ray, brains, robot, trials, engines.name_of(engine), args.hybrid, seen)
        return
    engine = with_corrections(engine, robot, trials, args.hybrid)
    for brain in brains:
        yield brain, judge(brain, robot, trials, engine)


def hybrid_options(args, robot, trials, brains: int):
    """Schedule and solver options of the hybrid water.

    Raises TooMuch: the solver would take too long on a CPU; ConfigError: several devices.
    """
    from fishmj.engines.hybrid import HybridOptions
    from fishmj.lbm_oracle.fluid.device import several
    from fishmj.lbm_oracle.run import solver_cost
    from fishmj.lbm_oracle.run.spread import ray_device

    if several(args.device):
        raise ConfigError(f"evaluate --water hybrid: --device {args.device}: its tanks share one; take auto, cpu or cuda:N")
    device = ray_device(args.device) if args.ray else args.device
    asked: dict = {"domain": args.domain, "slip": args.slip, "device": device, "side_by_side": args.tanks, "wait": True}
    made = HybridOptions(**asked | ({} if args.every is None else {"every": args.every}))
    segments = max(0, 1 + (trials.duration - made.first - made.lead - made.span) // made.every) * len(trials) * brains
    less = "--domain laptop is a preview; --repeats 1 --speeds 0.2 --los 0 is one trial"
    work = [(preset(made.solver(robot).domain), segments * (made.lead + made.span))]
    if not args.ray:
        solver_cost.agree("evaluate", args.device, work, instead=less, tanks=min(args.tanks, len(trials)))
    return made


def tanks_words(folder: Path | None) -> str:
    """Text for an interrupted evaluation in the flow solver."""
    if folder is None:
        return "nothing was saved; with --out DIR every finished trial is saved"
    return f"{folder / KEPT} holds {len(list((folder / KEPT).glob('*.npz')))} trials; {interrupt.again()}"


def affordable(robot, trials, brains: int) -> None:
    """Checks that this machine has enough memory for the evaluation. Raises TooMuch with the estimate."""
    ticks = trials.duration / robot.timing.bus_dt * len(trials)
    need = ticks * (brains * HELD + WORK) * (robot.n_joints + 3)
    what, less = f"{len(trials)} trials of {trials.duration:g} s by {brains} controllers", "take fewer --repeats, or a part by"
    cost.memory("evaluate", need, what, instead=f"{less} --speeds and --los")


def choose_engine(name: str, robot):
    """Engine by name; if batched MuJoCo is not installed, the next available one, with a warning."""
    for option in (name, *FALLBACKS) if name == "batch" else (name,):
        try:
            made = engines.make(option, robot)
        except (MissingExtra, ModuleNotFoundError) as error:
            reason = error
            continue
        if option != name:
            console.warn(f"engine {name} is not available ({reason}); using {option} instead")
        return made
    raise ConfigError(f"engine {name}: not available in this build: {reason}")


def judge(brain, robot, trials, engine) -> Result:
    """Evaluates one controller over all trials, with a progress line in simulated seconds."""
    with console.Progress(trials.duration * len(trials), f"judge {brain.name}", unit="sim s") as bar:
        done = robot.timing.control_dt * len(trials)
        bar.stage("first step; engines compile in it")
        return run(brain, robot, trials, engine, progress=lambda step: bar.update(step * done))


def judge_in_tanks(brains, robot, trials, args) -> Iterator[Result]:
    """Yields the result of each controller in the flow solver; finished trials are saved in --out and not run again."""
    what = brains[0].name if len(brains) == 1 else f"{len(brains)} controllers"
    with console.Progress(trials.duration * len(trials) * len(brains), f"judge {what} in the solver", unit="sim s") as bar:
        if args.ray:
            bar.stage("starting the workers")
        seen = lambda k: bar.update(k * robot.timing.control_dt) if k else None
        options = {"device": args.device, "tanks": args.tanks, "ray": args.ray, "progress": seen}
        yield from judge_each_in_solver(brains, robot, trials, args.out, water=args.solver, **options)


def findings(results: list[Result], args) -> dict:
    """Content of results.json."""
    a, corrected = results[0], {r.controller: corrections(r) for r in results if r.corrections is not None}
    return {
        "condition": trial_report.condition(a),
        "robot": robot_names(a.robot),
        **({"left_out": list(a.left_out)} if a.left_out else {}),
        "command": shlex.join(["fishmj", "evaluate", *args.argv]),
        "results": [summary(r) | trial_report.provenance(r, args.argv, args.controllers, k) for k, r in enumerate(results)],
        **({"hybrid": corrected} if corrected else {}),
        "paired": trial_report.paired_entries(results),
    }


def report(results: list[Result], args) -> int:
    """Writes the requested files and prints the tables, even if a part of the report could not be written."""
    from fishmj.view.replay import write_html

    found = findings(results, args)
    parts = {"plots": args.plots, "logs": args.log, "replay": write_html if args.log else None, "again": args.again}
    try:
        written = args.out and trial_report.write(args.out, results, found, **parts)
    finally:
        summaries = found["results"]
        head = [found["condition"], *trial_report.not_as_trained(summaries), *trial_report.failures(results)]
        trial_report.say_tables(results, summaries, head, summaries)
    if written:
        console.say("", f"wrote {written}")
    if args.json:
        console.emit_json(found)
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
