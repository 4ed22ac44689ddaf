"""`python -m fishmj.train`: learn to hold station."""

import argparse
import shlex
import shutil
from dataclasses import fields, replace
from pathlib import Path

from fishmj.base import console, interrupt, ray_cluster
from fishmj.base.errors import ConfigError
from fishmj.mjcf.reading import load_robot
from fishmj.train.planned_runs import (
    PlannedRun,
    check_distinct,
    grid_points,
    kept_words,
    point_folder,
    resumed,
    sweep_table,
    train_here,
    train_over_ray,
)
from fishmj.water import choice

STEP = 0.2  # s, control step of the presets
HALF = 0.5  # share of fish; a policy with fewer arrivals does not hold station yet
LOOKS = 10  # assessments within an algorithm's own budget of steps
SEED = console.whole(0, 2**32 - 1)  # range of a JAX random key
EXAMPLES = """examples:
  fishmj train                                   a policy for your laptop; three to six minutes on two idle cores
  fishmj train --preset paper --engine planar    the paper's network on a GPU
  fishmj train --preset paper-sac --seeds 0,1,2  the paper's algorithm and budget, three runs
  fishmj train --seeds 0,1,2 --ray auto          on a Ray cluster, one run on each worker; --resume continues
  fishmj train --sweep learning-rate 1e-3 3e-4 --sweep reward.wS 0.002 0.005 --seeds 0,1    a grid of eight runs, and its table
  fishmj train --algo sac                        soft actor-critic, one million steps by default
  fishmj train --gamma 0.98 --epochs 6           other hyperparameters
  fishmj train --flow-speeds 0,0.4 --episode-seconds 60     other streams, longer episodes
  fishmj train --memory 8                        the policy sees its last eight observations
  fishmj train --begin station                   start from a trained policy instead of random weights
  fishmj train --engine lbm --begin station-family --device cuda     fine-tune it in the flow solver itself
  fishmj train --correct --begin station --slip 0.98 --device cuda   alternate training and refitting its water to the solver
  fishmj train --resume --out runs/quick-ppo-0   continue after Ctrl-C
  fishmj train --task ./mine.py:Line             your own task; --algo and --effects also take your own code
  fishmj evaluate runs/quick-ppo-0               evaluate the result, its best.safetensors
"""


def options() -> console.Parser:
    """Parser of the verb `train`."""
    from fishmj.engines import NAMES, own_effects
    from fishmj.lbm_oracle.run.domain import EVERY as BOXES
    from fishmj.lbm_oracle.run.solver_water import PLAIN
    from fishmj.mjcf.description import COMMAND_PATHS
    from fishmj.tasks.reference import COURSES
    from fishmj.tasks.station_hold import GROUPS
    from fishmj.train.settings import ALGORITHMS, PRESETS
    from fishmj.water.flow import PRESETS as FLOWS

    about = "Learn to hold station in a current that the fish cannot sense; writes the policy file best.safetensors to --out."
    about += " docs/decisions/paper_errata.md names the paper."
    p = console.parser("train", about, examples=EXAMPLES)
    add = p.add_argument
    of = lambda value: ", ".join(f"{name} {value(s)}" for name, s in PRESETS.items())
    preset = "set of defaults. quick: PPO for a CPU; paper: PPO, the paper's network, for a GPU; paper-sac: the paper's algorithm"
    preset += " and budget; lbm: a short PPO in the flow solver (default: quick on a CPU, else paper; lbm with --engine lbm)"
    add("--preset", choices=tuple(PRESETS), help=preset)
    algo = f"learning algorithm: {', '.join(ALGORITHMS)}, or your own as module:Name (default: the preset's)"
    add("--algo", type=console.text, metavar="NAME", help=algo)
    task = f"{', '.join(COURSES)}, or your own as module:Name, docs/simulate/your_own_code.md (default station_hold)"
    add("--task", type=console.text, metavar="NAME", help=task)
    engine = "physics engine. auto: mjx on a GPU, compiled or planar on a CPU; batch: sb3 only; lbm: the flow solver,"
    engine += " one tank for each fish (--envs), needs a GPU, best with --begin (default: auto)"
    add("--engine", choices=("auto", *NAMES, choice.LBM), help=engine)
    box = f"box of water of --engine lbm (default: {PLAIN.domain}) and --correct (default: the water's); laptop is a preview"
    add("--domain", choices=BOXES, help=box)
    slip = "slip ratio of the hull in the solver, at the paper's grid: 1 free slip, 0 no slip"
    slip += f" (default: {PLAIN.slip:g}; --correct: the water's)"
    add("--slip", type=console.number(0, 1), help=slip)
    correct = "train in the fitted water, compare the policy's returns there and in the flow solver, refit the water to both;"
    correct += " repeat until the returns agree. After an interrupt, the same command continues"
    p.add_argument("--correct", action="store_true", help=correct)
    add("--rounds", type=console.whole(1, 100), metavar="N", help="largest number of rounds of --correct (default: 4)")
    place = (
        "device of the solver: auto, cpu, cuda, cuda:N, cuda:all or a list; --engine lbm trains its networks on the CPU"
        " (default: auto)"
    )
    add("--device", type=console.devices, help=place)
    own = ", ".join(f"{name} {entry.budget:,}" for name, entry in ALGORITHMS.items() if entry.budget)
    steps = f"control steps of the whole run, all fish together (default: {of(lambda s: f'{s.steps:,}')}; by --algo {own})"
    add("--steps", type=console.number(1, 1e11), metavar="N", help=steps)
    add("--seed", type=SEED, help="seed of all random draws of the run (default: 0)")
    seeds = "train one run for each seed, in sequence, for example 0,1,2 (default: --seed)"
    add("--seeds", type=console.Listed(SEED), metavar="N,..", help=seeds)
    devices = "number of devices that share the fish of a run, PPO only; results depend on it (default: 1)"
    add("--devices", type=console.whole(1, 1024), default=1, metavar="N", help=devices)
    sweep = "train with each value of this option and compare; write its name without dashes. Several --sweep make a grid;"
    sweep += " reward weights are reward.wG, .. (default: none)"
    add("--sweep", nargs="+", action="append", type=console.text, default=[], metavar=("NAME", "VALUE"), help=sweep)
    spread = f"train the runs on the workers of a cluster: {ray_cluster.OPTION}; --out on a disk that all share (default: here)"
    add("--ray", type=console.text, metavar="ADDRESS", help=spread)
    add("--together", action="store_true", help="train all --seeds side by side in one program (fast on a GPU; not resumable)")
    memory = "number of newest observations in the policy's input (default: 1, no memory, as in the paper)"
    add("--memory", type=console.whole(1, 1000), metavar="N", help=memory)
    add("--turbulence", choices=tuple(FLOWS), help="turbulence to train in (default: gust)")
    intensity = "largest turbulence intensity, u_rms / max(speed, 0.1 m/s); each episode draws from 0 to it"
    intensity += f" (default: {of(lambda s: s.task['intensity'][1])})"
    add("--intensity", type=console.number(0, 0.99), help=intensity)
    speeds = f"stream speed: each episode draws it from LOW to HIGH; one number fixes it (default: the task's, {task_speeds()})"
    bounds = console.Listed(console.number(0, 5), 2, distinct=False, rising=True)
    add("--flow-speeds", type=bounds, metavar="LOW,HIGH", help=f"m/s, {speeds}")
    exponent = "exponent E of that draw, LOW + (HIGH - LOW) u^E with u uniform: 2 draws slow streams more often (default: 1)"
    add("--flow-exponent", type=console.number(0.1, 10), metavar="E", help=exponent)
    share = "share of episodes that start at the target and last 8 s; half of these head downstream, within 45 deg"
    add("--at-target", type=console.number(0, 1), metavar="SHARE", help=f"{share} (default: 0, start anywhere, as in the paper)")
    seconds = "length of an episode (default: the task's, 30 for station_hold)"
    add("--episode-seconds", type=console.number(0.02, 1e6), metavar="S", help=seconds)
    step = "time between two decisions, a multiple of the bus tick of 0.02 s; evaluate and the robot must use the same. --gamma"
    step += (
        " and --reward apply per decision: half the step halves gamma's horizon in seconds, and doubles the reward of a second"
    )
    add("--control-dt", type=console.number(5e-3, 10), metavar="S", help=f"{step} (default: the robot's, 0.2 for fish)")
    path = "servo commands between two decisions. linear: interpolated to the new angles; hold: the new angles at once;"
    path += " move_time: linear, and the servo interpolates between bus ticks (default: the robot's, linear for fish)"
    add("--command-path", choices=COMMAND_PATHS, help=path)
    add("--robot", type=console.text, help="fish, tendon_fish, or a TOML file (default: fish)")
    add("--water", type=console.text, help=choice.HELP)
    hide = f"observation groups set to zero, for ablations: {', '.join(GROUPS)} (default: none)"
    add("--hide", type=console.Listed(console.OneOf(GROUPS)), metavar="NAME,..", help=hide)
    own_effects.drawn_option(p)
    begin = "policy that PPO starts from, with its widths, memory and command path: shipped name, policy file or folder of a"
    add("--begin", type=console.text, metavar="POLICY", help=f"{begin} training (default: random weights)")
    own_effects.option(p)
    reward = "weights of the reward: wG, wD, wS (default: the paper's)"
    add("--reward", type=weight, nargs="*", default=[], metavar="KEY=VALUE", help=reward)
    out = "folder of the run; refused if it holds a run already; several seeds have subfolders seed-N"
    out += " (default: runs/<preset>-<algo>-<seed>)"
    add("--out", type=console.out_folder, help=out)
    p.add_argument("--yes", action="store_true", help="start even if the run takes more than a week or more memory than there is")
    resume = "continue the run in --out with its own settings; only --steps may differ, and counts from the run's start"
    p.add_argument("--resume", action="store_true", help=resume)
    p.add_argument("--force", action="store_true", help="remove an existing run in --out and start again")
    hyperparameter_options(p)
    return p


def hyperparameter_options(parser: console.Parser) -> None:
    """Adds an option for every hyperparameter that an algorithm declares."""
    from fishmj.train.settings import hyperparameters, option_text

    about = "of the algorithm; options of other algorithms are refused. Default: the preset's value, else the algorithm's"
    group = parser.add_argument_group("hyperparameters", about)
    for name, one in hyperparameters().items():
        algos: dict[str, list[str]] = {}
        for algo, value in one.defaults.items():
            algos.setdefault(option_text(value, one.kind), []).append(algo)
        default = "; ".join(f"{', '.join(names)} {value}" for value, names in algos.items())
        own = "".join(f"; preset {preset} {option_text(value, one.kind)}" for preset, value in one.presets.items())
        shape = "N,.." if isinstance(one.kind, console.Listed) else "N" if isinstance(one.kind, console.Number) else "NAME"
        group.add_argument(one.option, dest=name, type=one.kind, metavar=shape, help=f"{one.about} (default: {default}{own})")


def task_speeds() -> str:
    """Stream speeds of the tasks as text, `0.1,0.3`."""
    from fishmj.base.calib import constant

    return ",".join(map(str, constant("task", "flow_speed")))


def weight(text: str) -> tuple[str, float]:
    """Parses a weight: `wG=0.5` -> ("wG", 0.5).

    Raises ArgumentTypeError for an unknown weight, or a number that is negative or not finite.
    """
    from fishmj.train.settings import REWARD

    key, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"{text[:40]!r}: expected {'=, '.join(REWARD)}= and a number")
    return console.OneOf(REWARD)(key), console.number(0, 1e6)(value)


def settings_from(args, run=None):
    """Preset, or settings of a run to resume, with all options of the command line.

    Raises ConfigError, UnknownName: invalid options, or own code of the run that the command line does not name again.
    """
    from fishmj.base import plugins
    from fishmj.engines import own_effects
    from fishmj.tasks.reference import named
    from fishmj.train.build import pick_engine
    from fishmj.train.settings import ALGORITHMS, ON_MJX, change, hyperparameters, own_code, preset, referred

    own_effects.join(args.effects)
    s = run or preset(args.preset or (choice.LBM if args.engine == choice.LBM else _default_preset()))
    for option, name in own_code(run).items() if run else ():
        if getattr(args, option[2:]) is None:
            raise ConfigError(f"the run uses your own code {name!r}, which only the command line may name: add {option} {name}")
    kept = lambda values: {name: tuple(v) if isinstance(v, list) else v for name, v in values.items() if v is not None}
    given = lambda *names: kept({name: getattr(args, name) for name in names})
    top = given("preset", "engine", "robot", "water", "seed", "command_path", "control_dt")
    algorithm, task, reward = given(*hyperparameters()), given("memory", "turbulence"), dict(args.reward)
    solver = {} if args.correct else given("domain", "slip", "device")
    if args.algo and args.algo not in ALGORITHMS:
        plugins.load("algorithm", args.algo, ALGORITHMS)
        s = s if args.algo == s.algo else replace(s, algo=args.algo, algorithm={})
    elif args.algo and args.algo != s.algo:  # hyperparameters do not carry over from one algorithm to another
        has = {one.name for one in fields(referred(ALGORITHMS[args.algo].config))}
        s = replace(s, algo=args.algo, algorithm={k: v for k, v in s.algorithm.items() if k == "hidden" and k in has})
        if budget := ALGORITHMS[args.algo].budget:  # nor does how long it takes to learn
            s = replace(s, steps=budget, assess_every=budget // LOOKS)
    if len(reward) < len(args.reward):
        raise ConfigError("--reward: one weight is given twice; give each once")
    if args.steps is not None:
        top |= {"steps": int(args.steps), "assess_every": min(preset(s.preset).assess_every, max(1, int(args.steps) // 4))}
    if args.task:
        named(args.task)  # loaded here, from the command line; below it is a name
    speeds, intensity = args.flow_speeds and (args.flow_speeds[0], args.flow_speeds[-1]), args.intensity
    task |= kept({"flow_speed": speeds, "flow_exponent": args.flow_exponent, "at_target": args.at_target})
    task |= kept({"seconds": args.episode_seconds})
    task |= kept({"intensity": None if intensity is None else (0.0, intensity), "course": args.task})
    task |= kept({"hide": args.hide, "effects": args.randomise_effects})
    if args.together and (s.algo not in ALGORITHMS or ALGORITHMS[s.algo].train):
        raise ConfigError(f"--together trains fishmj's own algorithms only, not {s.algo}; train the seeds one after another")
    made = change(s, algorithm=algorithm, task=task, reward=reward, solver=solver, **top)
    if args.intensity and made.task.get("turbulence") == "none":
        raise ConfigError(f"--intensity {args.intensity:g} with --turbulence none, which has no eddies; leave one of them out")
    if made.engine == choice.LBM:
        _in_solver(made, args)
    elif solver:
        raise ConfigError(f"--{next(iter(solver))}: needs --engine lbm or --correct; add one of them, or leave it out")
    if run is None and args.envs is None and made.algo == "ppo" and pick_engine(made) == "mjx":
        made = change(made, algorithm=ON_MJX.get(made.preset, {}))
    return made


def _in_solver(settings, args) -> None:
    """Raises ConfigError for options that training in the flow solver does not support."""
    from fishmj.train.settings import ALGORITHMS

    if settings.preset != choice.LBM:
        raise ConfigError(f"--preset {settings.preset} with --engine lbm: needs too many tanks, one a fish; leave --preset out")
    apart = settings.algo in ALGORITHMS and ALGORITHMS[settings.algo].train  # brings an environment of its own
    given = {f"--algo {settings.algo}": apart, "--together": args.together, "--ray": args.ray}
    if wrong := [option for option, value in given.items() if value]:
        raise ConfigError(f"{wrong[0]}: not supported in the flow solver; leave it out")


def _policy_options(args) -> dict:
    """Options given by the user that the policy of --begin also fixes."""
    given = {"--hidden": args.hidden and tuple(args.hidden), "--memory": args.memory, "--command-path": args.command_path}
    given |= {"--control-dt": args.control_dt, "--activation": args.activation, "--sigma": args.sigma}
    given["--learning-rate"] = args.learning_rate
    return {option: value for option, value in given.items() if value}


def corrected(args, command: str) -> int:
    """Alternates training and refitting; exit code 1 if the returns do not agree after the last round."""
    from fishmj.hydro_fit.campaign.dagger import dagger
    from fishmj.hydro_fit.fit.training_loop import use_cores_as_devices
    from fishmj.train import correct_water

    given = {"--resume": args.resume, "--force": args.force, "--together": args.together, "--seeds": args.seeds}
    given |= {"--engine lbm": args.engine == choice.LBM, "--algo": args.algo not in (None, "ppo")}
    given |= {"--ray": args.ray, "--devices": args.devices > 1, "--sweep": args.sweep}
    if wrong := [option for option, value in given.items() if value]:
        raise ConfigError(
            f"--correct with {wrong[0]}: not supported: --correct trains one seed by PPO in the fitted water and resumes by"
            f" itself; leave {wrong[0].split()[0]} out"
        )
    use_cores_as_devices()
    settings, args.rounds = settings_from(args), args.rounds or 4
    correct_water.affordable(settings, args)
    out = args.out or Path("runs") / f"correct-{settings.preset}-{settings.seed}"
    where = {"slip": args.slip, "domain": args.domain, "device": args.device or "auto", "rounds": args.rounds}
    steps = None if args.steps is None else int(args.steps)
    options = {"begin": args.begin, "asked": _policy_options(args), "steps": steps, "command": command}
    try:
        found = correct_water.train_and_correct(settings, out, **where, **options)
    except KeyboardInterrupt:
        console.warn(f"interrupted; {dagger.kept_words(out)}")
        return console.INTERRUPTED
    console.say("", correct_water.table(found["rounds"]), f"water: {found['water']}", f"policy: {found['policy']}")
    if args.json:
        console.emit_json(found)
    return console.OK if found["agreed"] else console.FAILED_CHECK


def _trained_on_lbm(out: Path) -> bool:
    from fishmj.train.settings import of_run

    return any((run := of_run(folder)) is not None and run.engine == choice.LBM for folder in (out, *out.glob("seed-*")))


def _default_preset() -> str:
    import jax

    return "quick" if jax.default_backend() == "cpu" else "paper"


def folders_of(args, settings, seeds: list[int]) -> dict[int, Path]:
    """Folder of each seed's run; with --together one folder for all."""
    from fishmj.base import plugins

    algo = plugins.name_of(settings.algo)
    if args.together:
        return dict.fromkeys(seeds, args.out or Path("runs") / f"{settings.preset}-{algo}")
    alone = lambda seed: args.out or Path("runs") / f"{settings.preset}-{algo}-{seed}"
    apart = bool(args.out) and len(seeds) > 1
    return {seed: alone(seed) / f"seed-{seed}" if apart else alone(seed) for seed in seeds}


def check_folders(args, folders: list[Path]) -> None:
    """Checks the folders of all runs before the first one starts.

    Raises:
        ConfigError: a folder holds a run, without --resume or --force; or --force would remove something else.
        ArgumentTypeError: a folder cannot be written.
    """
    from fishmj.base.store import Checkpoints
    from fishmj.control.policy import OF_A_RUN

    if args.resume and args.force:
        raise ConfigError("--resume continues a run and --force removes it; leave one of them out")
    if args.together and args.resume:
        raise ConfigError("--together cannot resume; train the seeds one after another")
    if args.together and folders[0].exists() and not args.force:
        raise ConfigError(f"{folders[0]} is there already; add --force to overwrite it, or choose another --out")
    for folder in dict.fromkeys(folders):
        console.out_folder(str(folder))
        began = any((folder / name).exists() for name in ("settings.json", "checkpoints"))
        if Checkpoints(folder / "checkpoints").paths() and not (args.resume or args.force):
            raise ConfigError(f"{folder} already holds a run; add --resume to go on, --force to remove it, or take another --out")
        if began and any((folder / name).exists() for name in OF_A_RUN) and not (args.resume or args.force):  # of --together
            raise ConfigError(f"{folder} already holds a run that cannot resume; add --force to remove it, or take another --out")
        several = args.together and any(folder.glob("seed-*/settings.json"))
        if args.force and not (began or several) and folder.exists() and any(folder.iterdir()):
            raise ConfigError(f"{folder} holds no training run, so --force does not remove it; choose another --out")
    if args.resume and not any((folder / "checkpoints").is_dir() for folder in folders):
        message = "start without --resume"
        if inside := sorted(path.parent.name for path in (args.out or Path()).glob("seed-*/checkpoints")):
            listed = ",".join(name.removeprefix("seed-") for name in inside)
            message = f"it has the runs {', '.join(inside)}: add --seeds {listed}"
        raise ConfigError(f"{', '.join(map(str, folders))}: nothing to resume; {message}")


def main(argv: list[str]) -> int:
    """Runs the verb `train`; returns the exit code."""
    under_way: list[PlannedRun] = []
    with interrupt.keeping(lambda: kept_words(under_way, argv)):
        return _train(argv, under_way)


def _train(argv: list[str], under_way: list[PlannedRun]) -> int:
    """Checks the command and trains; `under_way` receives the runs before the first one compiles."""
    parser = options()
    args = parser.parse_args(argv)
    from fishmj.control.policy_meta import one_line
    from fishmj.train import training_cost
    from fishmj.train.build import check_devices, water_for
    from fishmj.train.settings import own_code

    if choice.LBM in (args.engine, args.preset) or (args.resume and args.out and _trained_on_lbm(args.out)):
        import jax

        jax.config.update("jax_platforms", "cpu")  # small networks; the GPU is the solver's
    if args.correct:
        return corrected(args, one_line(shlex.join(["fishmj", "train", *argv])))
    console.refuse_unheeded("train", args, parser, {"--correct": (False, ("rounds",))})
    if args.begin and (args.resume and not (args.seeds or args.sweep) or args.together):
        other = "--resume" if args.resume else "--together"
        raise ConfigError(f"--begin with {other}: not supported, --begin starts one fresh run; leave one of them out")
    if args.together and args.devices > 1:
        raise ConfigError(f"--together with --devices {args.devices}: it trains on one device; leave one of them out")
    if args.together and (args.ray or args.sweep):
        other = "--ray" if args.ray else "--sweep"
        raise ConfigError(f"--together with {other}: it trains only seeds in one program; leave one of them out")
    if args.seeds and args.seed is not None:
        raise ConfigError(f"--seed {args.seed} with --seeds: both name the runs; leave one of them out")
    runs = [run for point, one in grid_points(parser, args) for run in planned(one, point)]
    check_folders(args, [run.folder for run in runs])
    check_distinct(runs)
    if args.ray:
        ray_cluster.refuse_own_code(
            [*(name for run in runs for name in own_code(run.settings)), *(["--effects"] * bool(args.effects))]
        )
    else:  # with --ray, the worker's devices count
        for run in runs:
            check_devices(run.settings, args.devices)
    training_cost.agree([run.settings for run in runs], together=args.together, yes=args.yes, devices=args.devices)
    console.say(*dict.fromkeys(f"water: {water_for(run.settings).said}" for run in runs))
    if args.force and not args.resume:
        for folder in dict.fromkeys(run.folder for run in runs):
            shutil.rmtree(folder, ignore_errors=True)
    under_way += runs
    typed, first = one_line(shlex.join(["fishmj", "train", *argv])), runs[0]
    if args.together:
        from fishmj.train.multi_seed import train_together

        results = train_together(first.settings, [run.settings.seed for run in runs], first.folder, typed)
    elif args.ray:
        results = train_over_ray(args.ray, runs, typed, args.devices)
    else:
        results = train_here(runs, typed, args.devices, args.resume)
    return report(args, argv, runs, results)


def planned(args, point: str) -> list[PlannedRun]:
    """Runs of one point of a sweep, or of a command without a sweep: one run for each seed."""
    from fishmj.train.begin import begin_with
    from fishmj.train.build import settled
    from fishmj.train.settings import as_dict, change, of_run, same

    settings = settings_from(args)
    seeds = args.seeds or [settings.seed]
    if point:
        from fishmj.base import plugins

        algo = plugins.name_of(settings.algo)
        args.out = (args.out or Path("runs") / f"{settings.preset}-{algo}-sweep") / point_folder(point)
    folders = folders_of(args, settings, seeds)
    if there := {folder: run for folder in folders.values() if args.resume and (run := of_run(folder))}:
        settings = settings_from(args, next(iter(there.values())))
        folders = folders if args.seeds else {settings.seed: folders[seeds[0]]}
        for seed, folder in folders.items():
            if folder in there:
                same(folder, change(settings, seed=seed), as_dict(there[folder]))
    begin = None
    if args.begin:
        begin, settings = begin_with(args.begin, settings, _policy_options(args))
    settings = settled(settings)
    return [PlannedRun(change(settings, seed=seed), folder, begin, point) for seed, folder in folders.items()]


def judging(settings, folder: str) -> str:
    """Command that evaluates a policy as its `Settings`: robot, water (not the flow solver), control step, command path."""
    from fishmj.mjcf.reading import load_robot

    own = load_robot(settings.robot).timing
    words = ["fishmj", "evaluate", folder, *(["--robot", settings.robot] if settings.robot != "fish" else [])]
    if settings.water not in ("auto", choice.FITTED, choice.LBM):
        words += ["--water", settings.water]
    if settings.control_dt not in (0.0, own.control_dt):
        words += ["--control-dt", f"{settings.control_dt:g}"]
    if settings.command_path not in ("", own.command_path):
        words += ["--command-path", settings.command_path]
    return shlex.join(words)


def report(args, argv: list[str], runs: list[PlannedRun], results: list[dict]) -> int:
    """Prints the results; of a sweep also its table, which is written to sweep.json. Returns the exit code."""
    from fishmj.base.store import write_json
    from fishmj.train.training_run import go_on

    if stopped := bool(results and results[-1]["stopped"]):
        last, settings = results[-1], runs[len(results) - 1].settings
        more = go_on(last["folder"], last["steps"], settings, args.devices)
        if args.together:
            more = f"the policies so far are in {Path(last['folder']).parent}; --together cannot resume"
        elif len(runs) > 1:
            more = f"{last['folder']} holds the run up to step {last['steps']:,}; go on with all: {resumed(argv)}"
        console.warn(f"interrupted; {more}")
    for run, r in zip(runs, results, strict=False):
        if "failed" in r:
            console.warn(f"{run.name}: {r['failed']}")
            continue
        took, judged = console.duration(r["seconds"]), "not yet evaluated on the tuning flows"
        took += f" {'in all ' if args.resume else ''}(compiling iterations included)"
        if "tune_arrival" in r:
            held = f"RMSE of the last 10 s {r['tune_rmse_last10']:.3f} m"
            judged = f"tuning flows: arrival {r['tune_arrival']:.1%}, {held}"
        done = f"{'stopped after ' if r['stopped'] else ''}{r['steps']:,} control steps"
        console.say(
            f"{r['algorithm']} {run.name}: {done} in {took} on {r['engine']}; {judged}",
            f"policy: {r['policy']}",
            f"evaluate it with: {judging(run.settings, r['folder'])}",
        )
        if r.get("tune_arrival", 1.0) < HALF and not r["stopped"]:
            more = shlex.join(["fishmj", "train", "--resume", "--out", r["folder"]])
            step = run.settings.control_dt or load_robot(run.settings.robot).timing.control_dt
            jerks = f"; steps of {step:g} s explore faster joint motion than {STEP:g} s: try --reward wS=0.001, a higher --gamma"
            longer = f"to train longer: {more} --steps N{jerks if step < STEP else ''}"
            console.warn(f"{run.name}: fewer than half of the fish arrive; {longer}")
    result: dict = {"runs": results}
    if args.sweep:
        table = sweep_table(runs, results)
        result["sweep"] = table
        write_json(runs[0].folder.parents[1 if args.seeds and len(args.seeds) > 1 else 0] / "sweep.json", result)
        shown = lambda rows: console.table(rows, list(dict.fromkeys(key for row in rows for key in row)))
        console.say("", shown(table["rows"]), "", "means over the seeds, on the tuning flows", shown(table["points"]))
        if best := table["best"]:
            names = [r["policy"] for run, r in zip(runs, results, strict=False) if run.point == best["point"]]
            again = "evaluate it on other draws with: fishmj evaluate"
            console.say("", f"best on the tuning flows: {best['point']}; {again} {shlex.join(names)}")
    if args.json:
        console.emit_json(result)
    return console.INTERRUPTED if stopped else console.FAILED_CHECK if any("failed" in r for r in results) else console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
