"""`gap plant EFFECT[=value] --out DATA`: data in which an effect is hidden; what it was goes to another file.

independent   the second, independently written robot (fishmj.virtual_robot) with the effect in its own equations
log           an existing data set (--from) with the effect put on afterwards: what sensors and clocks do, nothing else can be
"""

from itertools import cycle, islice
from pathlib import Path

import numpy as np

from fishmj import console, effects, excitation
from fishmj.effects import Active
from fishmj.effects.draws import draw
from fishmj.effects.sites import Seen
from fishmj.errors import ConfigError, UnknownName
from fishmj.log import Trial, numbered
from fishmj.log.dataset import read_dataset
from fishmj.log.trial import stacked
from fishmj.virtual_robot import draws
from fishmj.virtual_robot.dataset import write_hidden
from fishmj.virtual_robot.weighing import page as weighings

GENERATORS = ("independent", "log", "lbm")
SHIFTS = {"pose": ("pose",), "joint": ("joint",), "power": ("power",), "command": ("pose", "joint", "power", "truth", "flow")}


def main(argv: list[str]) -> int:
    parser = console.parser("gap plant", __doc__ or "")
    add = parser.add_argument
    add("effect", nargs="+", metavar="EFFECT[=value]", help="SI; NAME:p=1,q=2 sets several parameters; random draws one; none")
    add("--out", type=Path, required=True, metavar="DATA", help="data set folder")
    add("--generator", default="independent", help=", ".join(GENERATORS))
    add("--from", dest="source", type=Path, metavar="DATA", help="data set that --generator log works on")
    add("--logs", type=int, default=12, help="trials to make")
    add("--excitations", default="designed", metavar="LIST", help="designed, casual, dry, all, or ids with commas")
    add("--seed", type=int, default=0)
    add("--noise", type=float, default=1.0, help="factor on every sensor's noise")
    add("--nuisance", type=float, default=0.1, help="relative half width of constants that nobody measured")
    add("--weigh", action="store_true", help="with measurements.toml: what scales, knife edge and pendulum say; not of a log")
    add("--domain", default="laptop", help="--generator lbm: box of water; paper, window, laptop (a preview)")
    add("--device", default="cpu", help="--generator lbm: auto, cpu, cuda")
    add("--tanks", type=int, default=1, help="--generator lbm: trials side by side")
    add("--drop", type=float, default=0.0, help="--generator log: share of sensor rows that are lost")
    add("--truth", type=Path, metavar="FILE", help="what was hidden; default DATA.truth.json, beside the data set")
    add("--overwrite", action="store_true")
    args = parser.parse_args(argv)
    if args.generator not in GENERATORS:
        raise UnknownName("generator", args.generator, GENERATORS)
    if args.weigh and args.generator == "log":
        raise ConfigError("gap plant: --generator log has no robot to --weigh; write measurements.toml into --out by hand")
    if args.noise < 0 or args.logs < 1 or not 0 <= args.drop < 1:
        raise ConfigError(f"gap plant: noise {args.noise}, logs {args.logs}, drop {args.drop}; expected >= 0, >= 1, 0 to 1")
    truth = args.truth or args.out.with_name(f"{args.out.name}.truth.json")
    texts = [text for text in args.effect if text != "none"]
    hidden, trials, facts = {"independent": independent, "log": logged, "lbm": solver}[args.generator](texts, args)
    page = weighings(hidden, args.seed, args.nuisance) if args.weigh else None
    facts = {"generator": args.generator, "seed": args.seed, **facts}
    write_hidden(args.out, truth, trials, hidden, facts, args.overwrite, page)
    console.say(f"{len(trials)} trials in {args.out}; what is hidden in them is in {truth}")
    if args.json:
        console.emit_json({"trials": len(trials), "out": args.out, "truth": truth, "generator": args.generator})
    return console.OK


def independent(texts: list[str], args) -> tuple[dict, list[Trial], dict]:
    """(hidden, trials, facts) of the second robot."""
    from fishmj.virtual_robot import dataset, generate

    hidden, runs = dataset.parse(texts, args.seed), experiments(args)
    facts = {"noise": args.noise, "nuisance": args.nuisance, "excitations": runs}
    return hidden, generate(hidden, runs, args.seed, args.noise, args.nuisance), facts


def logged(texts: list[str], args) -> tuple[dict, list[Trial], dict]:
    """(hidden, trials, facts): an existing data set seen through other sensors and clocks."""
    if args.source is None:
        raise ConfigError("gap plant: --generator log works on a data set; name it with --from DATA")
    hidden = parse(texts, args.seed)
    folder = read_dataset(args.source)
    rng = np.random.default_rng([args.seed, 17])
    trials = [manipulated(name, folder[name], hidden, args.drop, rng) for name in folder.names]
    return hidden, trials, {"from": str(args.source), "drop": args.drop}


def solver(texts: list[str], args) -> tuple[dict, list[Trial], dict]:
    """(hidden, trials, facts) of the flow solver's fish on the second robot's servos, network and camera."""
    from fishmj.campaign.hidden import generate_lbm
    from fishmj.virtual_robot import dataset

    hidden, runs = dataset.parse(texts, args.seed), experiments(args)
    numbers = (args.seed, args.noise, args.nuisance, args.domain, args.device)
    facts = {"noise": args.noise, "nuisance": args.nuisance, "excitations": runs, "domain": args.domain}
    return hidden, generate_lbm(hidden, runs, *numbers, tanks=args.tanks, say=console.say), facts


def experiments(args) -> list[str]:
    """Ids of the trials to make, the list again where it is too short."""
    shelf = {"designed": excitation.DESIGNED, "casual": excitation.CASUAL, "dry": excitation.DRY, "all": excitation.names()}
    listed = shelf.get(args.excitations, args.excitations.split(","))
    return [excitation.get(n).id for n in islice(cycle(listed), args.logs)]


def parse(texts: list[str], seed: int) -> dict[str, dict[str, float]]:
    """`NAME`, `NAME=value`, `NAME:p=1,q=2` or `random`, of the effects that can be put on a log afterwards.

    Raises:
        UnknownName, ConfigError: no such effect, one that acts before the sensors, no number, a value outside the bounds.
    """
    able = {e.name: e for e in effects.catalogue().values() if afterwards(e)}
    out: dict[str, dict[str, float]] = {}
    for position, text in enumerate(texts):
        rng = draws.stream(seed, "log", position)
        name, colon, listed = text.partition(":")
        main = "" if colon else name.partition("=")[2]
        name = name.partition("=")[0]
        name = str(rng.choice(sorted(set(able) - set(out)))) if name == "random" else name
        if effects.get(name) and name not in able:
            raise ConfigError(
                f"effect {name!r} acts before the sensors: a log cannot show it afterwards; able: {', '.join(able)}"
            )
        effect = able[name]
        active = Active([effect], 3)
        row = draw(active, 1, rng)[0] if not (colon or main) else np.array(active.null)
        pairs = [(effect.parameters[0].name, main)] if main else [tuple(p.split("=", 1)) for p in listed.split(",") if colon]
        for key, value in pairs:
            row[active.index(name, effect.parameter(key).name)] = _number(text, value, effect.parameter(key))
        out[name] = {p.name: float(v) for p, v in zip(effect.parameters, row, strict=True)}
    return out


def afterwards(effect) -> bool:
    """Whether it acts on what sensors report and when, and nowhere else."""
    clocks = set(effect.delays) | set(effect.drifts)
    return not set(effect.sites) - {"measure"} and bool(effect.measure or clocks & set(SHIFTS)) and not effect.stochastic


def manipulated(name: str, trial: Trial, hidden: dict, drop: float, rng) -> Trial:
    """One trial with the effects on it: values through `measure`, stamps of a late clock moved by its delay."""
    active = Active([effects.get(key) for key in hidden], 3)
    row = active.flat(hidden)
    tables = {key: dict(table) for key, table in trial.tables.items()}
    for sensor in ("pose", "joint", "power"):
        if sensor in tables:
            tables[sensor] = measured(active, row, sensor, tables[sensor])
    for clock, late in SHIFTS.items():
        for sensor in late:
            if sensor in tables:
                t = np.asarray(tables[sensor]["t"], float)
                tables[sensor]["t"] = t + active.delay(np, row, clock, t)
    if drop:
        for sensor in {"pose", "joint", "power"} & set(tables):
            kept = rng.random(len(tables[sensor]["t"])) >= drop
            tables[sensor] = {key: np.asarray(column)[kept] for key, column in tables[sensor].items()}
    return Trial(trial.meta, tables, name=name, notes=trial.notes)


def measured(active: Active, row, sensor: str, table: dict) -> dict:
    """A table as the effects' sensors report it."""
    t = np.asarray(table["t"], float)
    zero = np.zeros_like(t)
    x, y, yaw = (np.asarray(table[k], float) for k in ("x", "y", "yaw")) if sensor == "pose" else (zero, zero, zero)
    joint = stacked(table, "j#") if sensor == "joint" else np.zeros((len(t), active.joints))
    power = np.asarray(table["V"] * table["I"], float) if sensor == "power" else zero
    seen = active.measure(np, row, Seen(t, x, y, yaw, joint, power))
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
