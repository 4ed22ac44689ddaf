"""Plan of the solver's swims: robots of several models, each with free swims for a calibration, a session, and cases.

    planned(PlanSettings(models={"fish": "fish"}, robots=14, seed=1)) -> FamilyPlan  drawn from the seed, kept as plan.json

A robot carries one case with nothing hidden, singles, and every other one a fault outside the catalogue, all in one session of
designed experiments. Every four robots of a model share two sessions without a common experiment, so that each experiment
is swum by half of the healthy robots; their scatter decides if an effect is detectable (solver_detectability.py).

The solver is slow, so invisible effects are not swum: a single is drawn again until its mean square in the second
robot's water is `LIKELY` at least. That is a forecast; the figure that counts is the solver's own, found afterwards.
"""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.base.store import write_json, write_text
from fishmj.gap.bench import calibrated, families
from fishmj.gap.bench.cases import STRENGTH, BenchCase, draw_card
from fishmj.gap.bench.drawn_robots import FIRST
from fishmj.gap.bench.solver_plan import PLAN, SCHEMA, SOLVER, FamilyPlan, PlannedRobot, PlanSettings
from fishmj.gap.laboratory.generators.detectability import BOUND
from fishmj.log import excitation
from fishmj.log.excitation import PERIOD, Excitation
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

MODELS = "models"  # folder of descriptions
LOGS = 6  # of a session: half of the designed experiments
SHARING = 4  # robots of a model that share two sessions
LIKELY = BOUND / 2
DRAWS = 12  # of a single, at most


def swims(robot: Robot, seconds: float) -> list[Excitation]:
    """Free swims for the calibration of a robot's water, each cut to `seconds`."""
    return [cut(what, seconds) for what in families.runs_of(calibrated.SWIMS, robot)]


def session(one: PlannedRobot, robot: Robot, seconds: float) -> list[Excitation]:
    """Experiments of a robot, each cut to `seconds`."""
    return [cut(what, seconds) for what in families.runs_of(one.experiments, robot)]


def cut(what: Excitation, seconds: float) -> Excitation:
    """The first `seconds` of an experiment."""
    return replace(what, commands=what.commands[: max(round(seconds / PERIOD), 1)])


def planned(asked: PlanSettings, tick=lambda done: None) -> FamilyPlan:
    """Draws the whole plan. tick: receives the number of finished robots. Raises ConfigError, UnknownName: no such model."""
    descriptions = {name: load_robot(source) for name, source in asked.models.items()}
    found: dict[tuple[int, int], PlannedRobot] = {}
    for number, name in enumerate(asked.models):
        decks: dict[str, list[str]] = {"single": [], "off": []}
        sessions = [_session(asked.seed, number, turn) for turn in range(asked.robots)]
        # robots of one session follow each other: the healthy robots of a forecast are made once a session
        for turn in sorted(range(asked.robots), key=lambda turn: (sessions[turn], turn)):
            found[turn, number] = _robot(asked, name, number, turn, sessions[turn], descriptions[name], decks)
            tick(len(found))
    return FamilyPlan(asked, tuple(found[key] for key in sorted(found)), descriptions)


def _session(seed: int, number: int, turn: int) -> tuple[str, ...]:
    """One half or the other of the designed experiments."""
    order = np.random.default_rng([seed, 22, number, turn // SHARING]).permutation(len(excitation.DESIGNED))
    half = order[:LOGS] if turn % 2 == 0 else order[-LOGS:]
    return tuple(excitation.DESIGNED[k] for k in sorted(half.tolist()))


def _robot(
    asked: PlanSettings, name: str, number: int, turn: int, runs: tuple[str, ...], robot: Robot, decks: dict
) -> PlannedRobot:
    rng = np.random.default_rng([asked.seed, 23, number, turn])
    seed = FIRST + 1_000_000 * (asked.seed % 500) + 10_000 * len(families.NAMES) + 1000 * number + turn
    kinds = ["none", *["single"] * asked.singles, *(["off"] if turn % 2 else [])]
    label = f"{SOLVER}-{asked.seed}-{name}-{turn:02d}"
    able, cases, forecasts = families.pool(families.SECOND), [], []
    for i, kind in enumerate(kinds):
        effects: dict = {}
        forecast = None
        for _ in range(DRAWS if kind == "single" else 1 if kind == "off" else 0):
            source = able.off if kind == "off" else able.catalogued
            chosen = draw_card(decks[kind], list(source), rng)
            effects = {chosen: source[chosen].draw(rng, float(np.exp(rng.uniform(*np.log(STRENGTH)))))}
            if kind == "off":
                break
            try:
                forecast = families.detectable(families.SECOND, effects, runs, seed, robot)["all"]
            except (ConfigError, SimDiverged):
                forecast = 0.0
            if forecast >= LIKELY:
                break
        cases.append(BenchCase(f"{label}-{i}", kind, effects, 1.0, runs, seed))
        forecasts.append(forecast)
    return PlannedRobot(label, name, seed, runs, tuple(cases), tuple(forecasts))


# ------------------------------------------------------------------------------------------------------------------------ on disk
def write(plan: FamilyPlan, folder: Path) -> None:
    """Writes plan.json, and beside it the descriptions that are files."""
    models = {}
    for name, source in plan.asked.models.items():
        models[name] = source
        if Path(source).is_file():
            models[name] = f"{MODELS}/{name}.toml"
            write_text(folder / models[name], Path(source).read_text(encoding="utf-8"))
    robots = []
    for one in plan.robots:
        cases = [
            {"id": case.id, "kind": case.kind, "effects": case.effects, "forecast": forecast}
            for case, forecast in zip(one.cases, one.forecasts, strict=True)
        ]
        robots.append({"id": one.id, "model": one.model, "seed": one.seed, "experiments": list(one.experiments), "cases": cases})
    body = {"schema": SCHEMA, "origin": "synthetic", "asked": asdict(plan.asked) | {"models": models}, "robots": robots}
    write_json(folder / PLAN, console.plain(body))
