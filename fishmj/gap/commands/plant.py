"""`gap plant EFFECT[=value] --out DATA`: simulates data with a hidden effect and writes the truth to another file.

independent   the second, independently written robot (fishmj.gap.laboratory.virtual_robot) with the effect in its own equations
log           an existing data set (--from) with the effect applied afterwards: only effects of sensors and clocks;
              also the user's own, module:EFFECT or file.py:EFFECT
lbm           the flow solver's fish with the second robot's servos, network and camera
morison, foil, ellipsoid     robots in other forms of water on MuJoCo's bodies and servos (fishmj.gap.laboratory.generators);
              the truth also states the effect's visible size above noise and healthy robots

    fishmj gap plant command_latency=0.04 --seed 7 --out planted
    fishmj gap plant random random --truth truth.json --out planted
    fishmj gap plant --list
"""

from functools import partial
from itertools import count, cycle, islice

import numpy as np

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.effects import EffectStack
from fishmj.effects.randomise import draw
from fishmj.effects.robot_scales import scaled
from fishmj.effects.sites import SensorReadings
from fishmj.engines import own_effects
from fishmj.gap import progress
from fishmj.gap.commands import admission, gap_options
from fishmj.gap.laboratory import generators, random_streams
from fishmj.gap.laboratory.effect_text import check_range, split_text
from fishmj.gap.laboratory.session import trial_name
from fishmj.gap.laboratory.virtual_robot import hidden_dataset, trials
from fishmj.gap.laboratory.virtual_robot.hidden_dataset import bounds, own_reference, placed, write_hidden
from fishmj.gap.laboratory.virtual_robot.trials import page as weighings
from fishmj.gap.null.null_runs import LOUDEST
from fishmj.gap.records import datasets
from fishmj.log import Trial, excitation, numbered
from fishmj.log.dataset import Taken
from fishmj.log.trial import stacked
from fishmj.mjcf.reading import load_robot

RATES = {"joint": "network.period", "pose": "camera.period", "power": "meter.period"}
GENERATORS = ("independent", "log", "lbm", *generators.NAMES)
FASTEST = 1.0  # m/s, of a requested current
SHIFTS = {"pose": ("pose",), "joint": ("joint",), "power": ("power",), "command": ("pose", "joint", "power", "truth", "flow")}


def main(argv: list[str]) -> int:
    """The command `gap plant`. Returns the exit code."""
    parser = console.parser("gap plant", __doc__ or "")
    add = parser.add_argument
    one = "SI; NAME:p=1,q=2 sets several parameters; random and random_odd draw one; none"
    add("effect", nargs="*", metavar="EFFECT[=value]", help=one)
    add("--list", action="store_true", help="list the effects of a --model and all experiments, and stop")
    add("--out", type=console.out_folder, metavar="DATA", help="data set folder, new or empty; needed unless --list")
    add("--generator", default="independent", choices=GENERATORS, help=f"{', '.join(GENERATORS)} (default independent)")
    add("--from", dest="source", type=console.path, metavar="DATA", help="data set that --generator log works on (default none)")
    robot = "robot: name or TOML file; not for --generator log and lbm (default fish)"
    add("--model", type=console.text, default="fish", help=robot)
    add("--logs", type=console.whole(1, 1000), default=12, metavar="N", help="trials to make, 1 to 1000 (default 12)")
    shelf = "designed, casual, dry, all, or ids with commas (default designed)"
    add("--excitations", type=console.text, default="designed", metavar="LIST", help=shelf)
    gap_options.of_seed(add, "of the robot and its noise")
    add("--noise", type=console.number(0, LOUDEST), default=1.0, metavar="F", help="factor on every sensor's noise (default 1)")
    nuisance = "relative half width of the unmeasured constants, 0 to 0.5 (default 0.1)"
    add("--nuisance", type=console.number(0, 0.5), default=0.1, metavar="F", help=nuisance)
    add("--weigh", action="store_true", help="also write measurements.toml (scales, knife edge, pendulum); not for a log")
    air = "--generator independent: in water, or hung on a thread in air, without a camera (default water)"
    add("--medium", default=trials.MEDIA[0], choices=trials.MEDIA, help=air)
    ordered = "--generator independent: current, m/s and deg (default 0,0)"
    add("--flow", type=console.flow(FASTEST), default=(0.0, 0.0), metavar="M/S,DEG", help=ordered)
    add("--domain", type=console.text, default="laptop", help="--generator lbm: box of water (default laptop, a preview)")
    add("--device", default="cpu", choices=("auto", "cpu", "cuda"), help="--generator lbm (default cpu)")
    add("--tanks", type=console.whole(1, 64), default=1, metavar="N", help="--generator lbm: trials side by side (default 1)")
    for sensor in RATES:
        rate = f"--generator independent: rows a second of the {sensor} table, 1 to 1000 (default the robot's own)"
        add(f"--{sensor}-rate", type=console.number(1, 1000), metavar="HZ", help=rate)
    drop = "share of sensor rows that are lost, 0 to 0.9; not of lbm (default 0)"
    add("--drop", type=console.number(0, 0.9), default=0.0, metavar="SHARE", help=drop)
    add("--truth", type=console.out_file, metavar="FILE", help="file for the hidden truth (default DATA.truth.json beside DATA)")
    add("--overwrite", action="store_true", help="replace a data set of the same trials")
    args = parser.parse_args(argv)
    if args.list:
        return listed(args.json, effects.RobotScales.of(load_robot(args.model)))
    if args.out is None or not args.effect:
        raise ConfigError("gap plant: name what to hide (EFFECT, or none) and the data set, --out DATA; --list lists the effects")
    gap_options.there(args.source)
    if args.weigh and args.generator == "log":
        raise ConfigError("gap plant: --generator log has no robot to --weigh; write measurements.toml into --out by hand")
    if args.source is not None and args.generator != "log":
        raise ConfigError(f"gap plant: --from is for --generator log, not {args.generator}")
    if args.generator == "log" and args.source is None:
        raise ConfigError("gap plant: --generator log works on a data set; name it with --from DATA")
    if args.drop and args.generator == "lbm" or rates(args) and args.generator != "independent":
        what = "--drop and the rates of sensors" if args.generator == "lbm" else "the rates of sensors"
        raise ConfigError(f"gap plant: {what} are not for --generator {args.generator}")
    if (args.medium, args.flow) != (trials.MEDIA[0], (0.0, 0.0)) and args.generator != "independent":
        raise ConfigError(f"gap plant: --medium and --flow are not for --generator {args.generator}")
    if args.model != "fish" and args.generator in ("log", "lbm"):
        raise ConfigError(f"gap plant: --model is not for --generator {args.generator}, which has a robot of its own")
    if args.generator not in generators.NAMES:
        admission.searchable(load_robot(args.model), args.model)
    given = datasets.readable_trials(args.source) if args.generator == "log" else None
    names = list(given.trials) if given else [trial_name(i, run) for i, run in enumerate(experiments(args))]
    truth = args.truth or args.out.absolute().with_name(f"{args.out.resolve().name}.truth.json")
    out, truth = placed(args.out, truth, names, args.overwrite)
    hidden = on_joints(understood(args), args.effect, joints_of(args, given))
    if args.generator not in ("log", "lbm"):
        hidden = on_robot(hidden, args.effect, effects.RobotScales.of(load_robot(args.model)))
    with progress.terminal_bar(len(names), "trials", "trials") as bar:
        make = {"independent": independent, "log": logged, "lbm": solver}.get(args.generator, other_water)
        made, facts = make(hidden, args, bar.update, given)
    weigh = partial(generators.page, args.generator) if args.generator in generators.NAMES else weighings
    page = weigh(hidden, args.seed, args.nuisance, args.model) if args.weigh else None
    facts = {"generator": args.generator, "seed": args.seed, **facts}
    write_hidden(out, truth, made, hidden, facts, args.overwrite, page)
    console.say(f"{len(made)} trials in {out}; the hidden truth is in {truth}")
    if args.json:
        console.emit_json({"trials": len(made), "out": out, "truth": truth, "generator": args.generator})
    return console.OK


def understood(args) -> dict[str, dict[str, float]]:
    """The requested effects with their values, checked before any trial is made.

    Raises ConfigError: `none` beside an effect; UnknownName, ConfigError as of `parse`.
    """
    texts = [text for text in args.effect if text != "none"]
    if texts and len(texts) < len(args.effect):
        raise ConfigError(f"gap plant: none beside {', '.join(texts)[:60]}; expected none alone, or effects")
    if args.generator == "log":
        return parse(texts, args.seed)
    if args.generator in generators.NAMES:
        return generators.parse(texts, args.seed, args.generator)
    return hidden_dataset.parse(texts, args.seed, limits)


def joints_of(args, given: Taken | None) -> int:
    """Number of the robot's joints; of logs, the least that one has, at least 1."""
    if given is not None:
        return max(1, min(map(admission.joints_of, given.trials.values()), default=1))
    return load_robot(args.model).n_joints


def on_joints(hidden: dict, texts: list[str], joints: int) -> dict[str, dict[str, float]]:
    """The values to hide, without those of joints that the robot does not have. Raises ConfigError if such a one is asked for."""
    asked, out = {(part.name, key) for part in map(split_text, texts) for key, _ in part.listed or ()}, {}
    for name, values in hidden.items():
        gone = [p for p in of_catalogue(name).values() if p.joint > joints]
        for p in gone:
            if (name, p.name) in asked:
                raise ConfigError(f"gap plant {name}: {p.name} is of joint {p.joint}, the robot has {joints}; leave it out")
        out[name] = {key: value for key, value in values.items() if key not in {p.name for p in gone}}
    return out


def on_robot(hidden: dict, texts: list[str], robot: effects.RobotScales) -> dict[str, dict[str, float]]:
    """The values to hide in this robot: those drawn for the default fish in proportion to its torque, speed, mass and length.

    Raises ConfigError: a value beyond the bounds of this robot, such as a torque limit above its servo's torque.
    """
    given = {part.name for part in map(split_text, texts) if part.main is not None or part.listed is not None}
    out = {name: dict(values) for name, values in hidden.items()}
    for name, values in out.items():
        for p in (p for p in of_catalogue(name).values() if p.of and p.name in values):
            mine, value = p.on_robot(robot), values[p.name]
            values[p.name] = value = value if name in given else scaled(value, p.of, robot)
            check_range(f"gap plant {name}", p.name, value, mine.low, mine.high, p.unit)
    return out


def independent(hidden: dict, args, tick, _) -> tuple[list[Trial], dict]:
    """(trials, facts) of the second robot."""
    from fishmj.gap.laboratory.virtual_robot import generate

    runs = experiments(args)
    facts = {"noise": args.noise, "nuisance": args.nuisance, "excitations": runs, "model": str(args.model)}
    facts |= {"medium": args.medium, "flow": args.flow}
    numbers = (args.seed, args.noise, args.nuisance, args.model, args.medium)
    whole = generate(hidden, runs, *numbers, flow=args.flow, sensors=rates(args), tick=tick)
    rng = np.random.default_rng([args.seed, 18])
    return [with_lost_rows(trial, args.drop, rng) for trial in whole], facts | {"drop": args.drop, "sensors": rates(args)}


def listed(json: bool, robot: effects.RobotScales) -> int:
    """Prints the effects that the second robot of this size can hide, and the experiments. Returns the exit code."""
    rows: list[dict] = []
    for e in trials.EFFECTS.values():
        shown = {"stage": e.stage, "seen in": ", ".join(e.shows), "shown by": ", ".join(e.runs)}
        for p in e.parameters:
            searched = of_catalogue(e.name).get(p.name)
            of = searched.of if searched else ""
            null, low, high = (scaled(x, of, robot) if of else x for x in (p.null, *p.typical))
            rows.append({"effect": e.name, "parameter": p.name, "unit": p.unit, "null": null, "from": low, "to": high, **shown})
    known = map(excitation.get, excitation.names())
    runs = [{"excitation": run.id, "seconds": round(run.seconds, 1), "about": run.about} for run in known]
    if json:
        console.emit_json({"effects": rows, "excitations": runs})
    else:
        console.say(console.table(rows), "", console.table(runs))
    return console.OK


def rates(args) -> dict[str, float]:
    """The requested periods [s] of the second robot's sensors, by field."""
    asked = {field: getattr(args, f"{sensor}_rate") for sensor, field in RATES.items()}
    return {field: 1.0 / rate for field, rate in asked.items() if rate is not None}


def limits(name: str, parameter) -> tuple[float, float]:
    """Range of a planted parameter: within the catalogue's bounds for a search, and the second robot's own rule."""
    low, high = bounds(name, parameter)
    if searched := of_catalogue(name).get(parameter.name):
        low, high = max(parameter.least, searched.low), min(parameter.most, searched.high)
    return low, high


def of_catalogue(name: str) -> dict[str, effects.Parameter]:
    """Parameters of the search's effect of this name; {} without one."""
    own = effects.catalogue().get(name)
    return {p.name: p for p in own.parameters} if own else {}


def logged(hidden: dict, args, tick, given: Taken | None) -> tuple[list[Trial], dict]:
    """(trials, facts) of an existing data set with other sensors and clocks."""
    rng = np.random.default_rng([args.seed, 17])
    late = []
    for name, trial in given.trials.items() if given else ():
        late.append(manipulated(name, trial, hidden, args.drop, rng))
        tick(len(late))
    for name, why in given.broken.items() if given else ():
        console.warn(f"{name} left out: {why}")
    return late, {"from": str(args.source), "drop": args.drop}


def solver(hidden: dict, args, tick, _) -> tuple[list[Trial], dict]:
    """(trials, facts) of the flow solver's fish on the second robot's servos, network and camera."""
    from fishmj.gap.laboratory.hidden_lbm.hidden import generate_lbm

    runs = experiments(args)
    numbers = (args.seed, args.noise, args.nuisance, args.domain, args.device)
    facts = {"noise": args.noise, "nuisance": args.nuisance, "excitations": runs, "domain": args.domain}
    done = count(1)
    return generate_lbm(hidden, runs, *numbers, tanks=args.tanks, say=lambda text: tick(next(done))), facts


def other_water(hidden: dict, args, tick, _) -> tuple[list[Trial], dict]:
    """(trials, facts) of a robot in another form of water; the facts state the effect's visible size."""
    runs, numbers = experiments(args), (args.seed, args.noise, args.nuisance, args.model)
    whole, rng = generators.generate(args.generator, hidden, runs, *numbers, tick=tick), np.random.default_rng([args.seed, 19])
    facts = {"noise": args.noise, "nuisance": args.nuisance, "excitations": runs, "model": str(args.model), "drop": args.drop}
    facts["detectable"] = generators.detectable(args.generator, hidden, runs, *numbers)
    return [with_lost_rows(trial, args.drop, rng) for trial in whole], facts


def experiments(args) -> list[str]:
    """Ids of the trials to make; the list is repeated if it is too short."""
    return list(islice(cycle(excitation.listed(args.excitations)), args.logs))


def parse(texts: list[str], seed: int) -> dict[str, dict[str, float]]:
    """Parses `NAME`, `NAME=value`, `NAME:p=1,q=2` or `random`, for effects that can be applied to a log afterwards.

    An effect of the user's own, `module:NAME` or `file.py:NAME` in place of NAME, is loaded and joins the catalogue.

    Raises:
        UnknownName, ConfigError: no such effect, one that acts before the sensors, no number, a value outside the bounds.
        OwnCodeError: the user's own code breaks a rule.
    """
    texts = [_joined(text) for text in texts]
    able = {e.name: e for e in effects.catalogue().values() if afterwards(e)}
    out: dict[str, dict[str, float]] = {}
    for position, text in enumerate(texts):
        rng = random_streams.stream(seed, "log", position)
        name, main, listed = split_text(text)
        left = sorted(set(able) - set(out))
        if name == "random" and not left or name in out:
            raise ConfigError(f"gap plant {text[:60]}: give each effect once; left are {', '.join(left) or 'none'}")
        name = str(rng.choice(left)) if name == "random" else name
        if effects.get(name) and name not in able:
            raise ConfigError(
                f"effect {name!r} acts before the sensors, so it cannot be added to a log afterwards; possible: {', '.join(able)}"
            )
        effect = able[name]
        active = EffectStack([effect], excitation.JOINTS)
        row = np.array(active.null) if main or listed is not None else draw(active, 1, rng)[0]
        for key, value in [(effect.parameters[0].name, main)] if main else listed or ():
            row[active.index(name, effect.parameter(key).name)] = _number(text, value, effect.parameter(key))
        out[name] = {p.name: float(v) for p, v in zip(effect.parameters, row, strict=True)}
    return out


def _joined(text: str) -> str:
    """The text with the effect's name in place of a reference to the user's own code, which is loaded."""
    own = own_reference(text)
    return own_effects.join([own])[0].name + text[len(own) :] if own else text


def afterwards(effect) -> bool:
    """Returns True for an effect that acts only on sensor readings and their stamps."""
    clocks = set(effect.delays) | set(effect.drifts)
    return not set(effect.sites) - {"measure"} and bool(effect.measure or clocks & set(SHIFTS)) and not effect.stochastic


def manipulated(name: str, trial: Trial, hidden: dict, drop: float, rng) -> Trial:
    """One trial with the effects applied: values through `measure`, stamps of a late clock shifted by its delay."""
    active = EffectStack([effects.get(key) for key in hidden], admission.joints_of(trial))
    row = active.flat(hidden)
    tables = {key: dict(table) for key, table in trial.tables.items()}
    for sensor in ("pose", "joint", "power"):
        if sensor in tables and not (sensor == "power" and "I" not in tables[sensor]):
            tables[sensor] = measured(active, row, sensor, tables[sensor])
    for clock, late in SHIFTS.items():
        for sensor in late:
            if sensor in tables:
                t = np.asarray(tables[sensor]["t"], float)
                tables[sensor]["t"] = t + active.delay(np, row, clock, t)
    return with_lost_rows(Trial(trial.meta, tables, name=name, notes=trial.notes), drop, rng)


def with_lost_rows(trial: Trial, drop: float, rng: np.random.Generator) -> Trial:
    """The trial without a share of its sensors' rows."""
    if not drop:
        return trial
    tables = dict(trial.tables)
    for sensor in (name for name in RATES if name in tables):
        kept = rng.random(len(tables[sensor]["t"])) >= drop
        tables[sensor] = {key: np.asarray(column)[kept] for key, column in tables[sensor].items()}
    return Trial(trial.meta, tables, name=trial.name, notes=trial.notes)


def measured(active: EffectStack, row, sensor: str, table: dict) -> dict:
    """A table with the effects' sensor errors."""
    t = np.asarray(table["t"], float)
    zero = np.zeros_like(t)
    x, y, yaw = (np.asarray(table[k], float) for k in ("x", "y", "yaw")) if sensor == "pose" else (zero, zero, zero)
    joint = stacked(table, "j#") if sensor == "joint" else np.zeros((len(t), active.joints))
    power = np.asarray(table["V"] * table["I"], float) if sensor == "power" else zero
    seen = active.measure(np, row, SensorReadings(t, x, y, yaw, joint, power))
    if sensor == "pose":
        return table | {"x": seen.x + zero, "y": seen.y + zero, "yaw": seen.yaw + zero}
    if sensor == "joint":
        return table | numbered("j#", seen.joint)
    return table | {"I": seen.power / np.asarray(table["V"], float)}


def _number(text: str, value: str, parameter) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not parameter.low <= number <= parameter.high:
        raise ConfigError(
            f"gap plant {text}: {parameter.name} = {value!r}; expected {parameter.low:g} to {parameter.high:g} {parameter.unit}"
        )
    return number
