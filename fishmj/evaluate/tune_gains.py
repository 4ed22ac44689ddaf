"""Tune the gains of classical controllers in a water or a family of waters by CMA-ES, with the same budget for each.

    score = mean over trials of rmse_after_arrival + rmse_last20 + 0.2 rmse_total + 0.2 (1 - arrival) + 0.01 power / W

Each candidate swims 24 tuning trials with sensor noise and randomised fish. Every generation has new draws, alternately with
default turbulence and gusts of 10 %. The search runs over the logarithms of the gains whose source says `tuned`. The mean of the
last generation is used if it scores better than the first gains on 144 held-out trials, 72 with each turbulence.
"""

import re
import shlex
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj import control, engines
from fishmj.base import console, interrupt, store
from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.base.source import package_sha256
from fishmj.control import gains_of, shipped_gains, tuned_names
from fishmj.evaluate import metrics, protocol
from fishmj.evaluate.run_trials import run
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import robot_sha256
from fishmj.mjcf.reading import load_robot
from fishmj.water import choice
from fishmj.water.water_identity import water_identity

WEIGHTS = {"rmse_after_arrival": 1.0, "rmse_last20": 1.0, "rmse_total": 0.2, "arrival": -0.2, "power": 0.01}
GENERATION, SPREAD, REACH = 16, 0.35, 6.0  # candidates; first standard deviation of a logarithm; largest factor on a gain
LOST = 10.0  # score of gains that fail
KEPT = "; no candidate was better, the gains before are kept"  # added to the source of such gains
HELD_OUT = 999_983  # added to the command's seed for the held-out trials
EXAMPLES = """examples:
  fishmj tune dob --water family --out gains.toml          then: fishmj evaluate gains.toml:dob dob --water family
  fishmj tune all --budget 640 --seed 1 --out gains.toml   all classical controllers, the same budget for each
  fishmj tune pi --robot pike.toml --out pike_gains.toml   for a fish of your own
"""


class GainSearch(NamedTuple):
    """Gains of one controller that are searched."""

    name: str
    first: dict[str, Any]  # gain -> value or list of values

    @classmethod
    def of(cls, name: str, file: Path | None) -> "GainSearch":
        """Searched gains of a controller, from a file of gains where it has them, else the shipped ones.

        Raises ConfigError: none of them may be changed.
        """
        entries = shipped_gains()[name]
        values = gains_of(name, file=file)
        free = [key for key, entry in entries.items() if entry["source"].startswith("tuned")]
        first = {key: values[key] for key in free if np.all(values[key])}
        if not first:
            raise ConfigError(f"tune {name}: none of its gains has a source `tuned`; expected one in controllers.toml [{name}]")
        return cls(name, first)

    def point(self) -> np.ndarray:
        """Logarithms of the first gains."""
        return np.log(np.concatenate([np.ravel(value) for value in self.first.values()]))

    def reach(self) -> np.ndarray:
        """(G, 2) bounds of the logarithms: a factor of `REACH` either way, below the largest gain of its unit."""
        units = {key: entry["unit"] for key, entry in shipped_gains()[self.name].items()}
        most = [np.full(np.size(value), control.largest_gain(units[key])) for key, value in self.first.items()]
        point = self.point()
        return np.stack([point - np.log(REACH), np.minimum(point + np.log(REACH), np.log(np.concatenate(most)))], 1)

    def gains(self, point) -> dict[str, Any]:
        """Gains at a point, rounded to four digits."""
        given, values = {}, iter(np.exp(point))
        for key, value in self.first.items():
            some = [float(f"{next(values):.4g}") for _ in np.ravel(value)]
            given[key] = some if np.ndim(value) else some[0]
        return given


def tuning_trials(seed: int, gust: bool, repeats: int = 1) -> protocol.Trials:
    """Tuning trials of a seed: 24 a repeat, with the default turbulence or in gusts of 10 %."""
    how: dict[str, Any] = {"turbulence": "gust", "intensity": 0.1} if gust else {}
    return protocol.trials(seed=seed, repeats=repeats, box="tune", **how)


def score(search: GainSearch, point, robot: Robot, engine, *sets: protocol.Trials) -> float:
    """Score of the gains at a point on sets of trials; `LOST` if no controller can be made of them or the physics diverges."""
    try:
        brain = control.make(search.name, robot, **search.gains(point))
        found = [metrics.figures(run(brain, robot, some, engine)) for some in sets]
    except (ConfigError, SimDiverged):
        return LOST
    values = {key: np.concatenate([figures[key] for figures in found]) for key in WEIGHTS}
    return float(0.2 + sum(weight * np.mean(values[key]) for key, weight in WEIGHTS.items()))


class Tuning(NamedTuple):
    """Result of a search."""

    controller: str
    gains: dict[str, Any]
    first_score: float  # of the gains before, on the trials that decide
    score: float  # of these gains, there
    candidates: int


def tune(search: GainSearch, robot: Robot, budget: int, seed: int, kept: Path | None, bar: console.Progress) -> Tuning:
    """Searches by CMA-ES. kept: file of finished generations, from which the same search continues. Raises MissingExtra."""
    from cmaes import CMA

    start = search.point()
    generations = max(1, budget // GENERATION)
    mark = {
        "controller": search.name, "first": search.first, "robot": sha256(repr((robot, robot.effects)).encode()).hexdigest(),
        "water": water_identity(robot), "budget": budget, "seed": seed, "code": package_sha256(),
    }  # fmt: skip
    done: list[list[float]] = []
    if kept is not None and kept.is_file() and (old := store.read_json(kept)).get("mark") == mark:
        done = old["scores"]
    optimiser = CMA(start, SPREAD, bounds=search.reach(), seed=seed, population_size=GENERATION)
    engine = engines.make(engines.fastest(), robot)
    for g in range(generations):
        points = [optimiser.ask() for _ in range(GENERATION)]
        if g == len(done):
            scores, drawn = [], tuning_trials(1000 * (seed + 1) + g, gust=g % 2 == 1)
            for i, point in enumerate(points):
                scores.append(score(search, point, robot, engine, drawn))
                bar.update(g * GENERATION + i + 1, best=min(scores))
            done.append(scores)
            if kept is not None:
                store.write_json(kept, {"mark": mark, "scores": done})
        optimiser.tell(list(zip(points, done[g], strict=True)))
    held_out = [tuning_trials(HELD_OUT + seed, gust, 3) for gust in (False, True)]
    before, after = (score(search, point, robot, engine, *held_out) for point in (start, optimiser.mean))
    better = after < before
    gains = search.gains(optimiser.mean) if better else search.first
    return Tuning(search.name, gains, before, after if better else before, generations * GENERATION)


def with_gains(text: str, name: str, gains: dict, source: str) -> str:
    """Text of a file of gains with the section of a controller replaced or added; values that were not searched stay."""
    entries = {key: dict(entry) for key, entry in shipped_gains()[name].items()}
    entries |= {key: {**entries[key], "value": value, "source": source} for key, value in gains.items()}
    wide = max(map(len, entries))
    quoted = lambda entry: f'{{ value = {entry["value"]}, unit = "{entry["unit"]}", source = "{entry["source"]}" }}'
    block = f"[{name}]\n" + "".join(f"{key:<{wide}} = {quoted(entry)}\n" for key, entry in entries.items())
    own = re.compile(rf"^\[{re.escape(name)}\]\n.*?(?=^\[|\Z)", re.MULTILINE | re.DOTALL)
    if own.search(text):
        return own.sub(lambda _: f"{block}\n", text).rstrip() + "\n"
    return f"{text.rstrip()}\n\n{block}"


def options() -> console.Parser:
    """Parser of the verb `tune`."""
    parser = console.parser("tune", __doc__ or "", examples=EXAMPLES)
    add = parser.add_argument
    names = f"{', '.join(tuned_names())}; all: every one; for a controller of your own, see docs/train/evaluation.md"
    add("controllers", nargs="+", action=console.Distinct, choices=(*tuned_names(), "all"), metavar="CONTROLLER", help=names)
    add("--robot", type=console.text, default="fish", help="shipped name or TOML file")
    add("--water", type=console.text, help=choice.HELP)
    add(
        "--budget",
        type=console.whole(GENERATION, 10**6),
        default=240,
        metavar="N",
        help=f"number of candidates for each controller, at least {GENERATION}",
    )
    add("--seed", type=console.SEED, default=0, help="seed of the search and its trials")
    out = "file of gains; the search starts from its gains, and replaces the sections of these controllers"
    add("--out", type=console.path, default=Path("gains.toml"), metavar="FILE", help=out)
    return parser


def main(argv: list[str]) -> int:
    """Runs the verb `tune`; returns the exit code."""
    args = options().parse_args(argv)
    if args.out.suffix != ".toml":
        raise ConfigError(f"tune --out {args.out}: expected a file .toml")
    water = choice.chosen(load_robot(args.robot), args.water).within(choice.SELF_MADE, "tune")
    robot, names = water.robot, tuned_names() if "all" in args.controllers else tuple(args.controllers)
    console.say(f"water: {water.said}", f"{len(names)} controllers, {args.budget} candidates of 24 trials each")
    text = args.out.read_text(encoding="utf-8") if args.out.is_file() else 'schema = "fishmj.controllers/1"\n'
    there = read_toml(args.out) if args.out.is_file() else {}
    source = f"tuned: fishmj tune {{}} --water {choice.label(robot)} --budget {args.budget} --seed {args.seed}"
    if args.robot != "fish":
        source += f", of robot {robot.name} ({robot_sha256(robot)[:12]})"
    rows: list[Tuning] = []
    for name in names:
        sources = [entry.get("source") for entry in there.get(name, {}).values() if isinstance(entry, dict)]
        if {source.format(name), source.format(name) + KEPT}.intersection(sources):
            console.warn(f"{name}: was tuned by this command before, see {args.out}; take another --seed to continue from there")
            continue
        kept = args.out.with_suffix(f".{name}.json")
        search = GainSearch.of(name, args.out if name in there else None)
        with console.warnings_behind(), console.Progress(args.budget, f"tune {name}", unit="candidates") as bar:
            bar.stage("first candidate; engines compile in it")
            words = lambda kept=kept: f"{kept} holds the finished generations; {interrupt.again()}"
            with interrupt.keeping(words):
                found = tune(search, robot, args.budget, args.seed, kept, bar)
        remark = "" if found.score < found.first_score else KEPT
        text = with_gains(text, name, found.gains, source.format(name) + remark)
        store.write_text(args.out, text)
        kept.unlink(missing_ok=True)
        rows.append(found)
        scores = f"score {found.first_score:.3f} before, {found.score:.3f} now"
        console.say(f"{name}: {scores}, on 144 tuning trials of no candidate{remark}")
    same = ["--robot", args.robot, *(["--water", args.water] if args.water else [])]
    console.say(f"judge it with: {shlex.join(['fishmj', 'evaluate', f'{args.out}:{names[0]}', *same])}")
    if rows and args.out.resolve().parent == calib_folder().resolve():
        console.warn("shipped gains changed: make manifest")
    if args.json:
        console.emit_json({"file": str(args.out), "water": choice.label(robot), "tuned": [row._asdict() for row in rows]})
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
