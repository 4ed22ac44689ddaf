"""Alternating training of a policy and refitting of its water: `fishmj train --correct`.

    train in the water -> swim the same episodes there and in the flow solver -> stop if the returns agree, else refit and repeat

A policy exploits the errors of its water, in states to which the water was not fitted. Each round trains the policy of the
previous round in the present water; `hydro_fit.campaign.dagger` compares, collects data and refits. The rounds end when the mean
returns differ by less than 5 % of the solver's. Episodes use the training flows, never those of the evaluation.

A run is a folder: round-N/train (a training), round-N.json (the comparison), solver (segments of all rounds), round-N/water.toml
(the water after round N; round-0 has the first). After an interrupt, the same command continues.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from fishmj.base import console, interrupt
from fishmj.base.calib import OWN
from fishmj.base.errors import ConfigError
from fishmj.base.store import read_json, write_json
from fishmj.base.store.atomic import same_as_begun
from fishmj.base.store.manifest import shipped
from fishmj.hydro_fit.campaign.dagger import dagger
from fishmj.hydro_fit.campaign.data.collect import Local, Pool, tanks_on
from fishmj.hydro_fit.campaign.data.run_segments import Setup
from fishmj.hydro_fit.prior_model import unfitted
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.solver_water import water_of_fit
from fishmj.mjcf.reading import load_robot
from fishmj.train.begin import begin_with
from fishmj.train.build import settled, timed, water_for
from fishmj.train.settings import Settings, as_dict, change
from fishmj.train.training_run import TrainingRun
from fishmj.water.choice import STRUCTURED, family_in, model_of
from fishmj.water.hydro_model import HydroModel

EPISODES, SECONDS = 12, 20.0  # of a round's comparison; each also gives a short segment, started from the surrogate half-way
AGAIN = 2_000_000  # control steps of a round that starts from a policy


def first_water(settings: Settings, slip: float | None) -> HydroModel:
    """Water of the first round, with the slip ratio of the solver. Raises ConfigError for a family of waters."""
    robot = water_for(settings).robot
    if family_in(robot) is not None:
        raise ConfigError(f"--correct --water {settings.water}: a family has several waters; name one fit, such as {robot.name}")
    model = model_of(robot) or replace(unfitted(load_robot(settings.robot)), notes=STRUCTURED)
    return replace(model, name="water", slip=model.slip if slip is None else slip)


def train_and_correct(
    settings: Settings, folder: Path, *, begin: str | None = None, asked: Mapping[str, Any] | None = None,
    slip: float | None = None, domain: str | None = None, device: str = "auto", rounds: int = 4, steps: int | None = None,
    pool: Pool | None = None, episodes: int = EPISODES, seconds: float = SECONDS, command: str | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Alternates training and refitting. Returns rounds (rows of `dagger.compare_returns`), agreed, policy and water (paths).

    Args:
        begin, asked: starting policy of the first round and options, as in `begin_with`; None: random weights.
        slip, domain, device: of the flow solver, by default those of the water's own segments.
        steps: control steps of each round; by default `AGAIN`, and from random weights the settings' own.

    Raises ConfigError: the folder holds another run, or the water cannot be refitted; KeyboardInterrupt: a training was stopped.
    """
    robot = timed(load_robot(settings.robot), settings)
    model = first_water(settings, slip)
    tank = water_of_fit(model.dataset, model.slip, domain)
    about = {"settings": as_dict(settings), "begin": begin, "slip": model.slip, "domain": tank.box.name, "steps": steps}
    same_as_begun(folder / dagger.BEGUN, about)
    data = open_dataset(shipped(OWN / "hydro" / robot.name))
    dagger.warn_of_two_waters([data], tank)
    devices = devices_of(device)
    setup = Setup(robot=robot, domain=tank.box, device=devices[0], sharpness=tank.sharpness)
    pool = pool or Local(tanks_on(devices[0]), devices)
    made: list[Path] = []

    def train(number: int, model: HydroModel) -> str:
        before = str(made[-1]) if made else begin
        water = model.save(folder / f"round-{number - 1}")
        made.append(trained(settings, water, folder / f"round-{number}" / "train", before, asked or {}, steps, command))
        return str(made[-1])

    refit = lambda model, solver: dagger.refitted(robot, model, [data], solver, folder)
    with interrupt.keeping(partial(dagger.kept_words, folder)):
        found = dagger.correct(
            train, robot, model, folder, setup, refit=refit, rounds=rounds, episodes=episodes, seconds=seconds, pool=pool
        )
    return {**found, "model": None, "water": str(folder / f"round-{len(made) - 1}" / "water.toml"), "policy": str(made[-1])}


def trained(settings: Settings, water: Path, folder: Path, begin: str | None, asked, steps: int | None, command) -> Path:
    """Policy of one round; a finished training is not repeated, an interrupted one resumes."""
    policy, done = None, folder / "summary.json"
    one = change(settings, water=str(water))
    if begin is not None:
        policy, one = begin_with(begin, one, asked)
        one = change(one, steps=AGAIN, assess_every=AGAIN // 4)
    if steps is not None:
        one = change(one, steps=steps, assess_every=max(1, steps // 4))
    one = settled(one)
    if not done.is_file():
        resume = any((folder / "checkpoints").glob("*"))
        summary = TrainingRun(one, folder, resume=resume, command=command, begin=None if resume else policy).go()
        if summary["stopped"]:
            raise KeyboardInterrupt
        write_json(done, summary)
    return Path(read_json(done)["policy"])


def affordable(settings: Settings, args) -> None:
    """Checks that this machine can do the solver's part. Raises TooMuch with the estimate."""
    model = first_water(settings, args.slip)
    water = args.rounds * EPISODES * (SECONDS + dagger.SHORT)
    less = "take fewer --rounds; --domain laptop is a preview"
    work = [(water_of_fit(model.dataset, model.slip, args.domain).box, water)]
    solver_cost.agree("train --correct", args.device or "auto", work, instead=less, flag="--yes", asked=args.yes)


def table(rows: list[dict]) -> str:
    """Table of the rounds: mean reward per control step, difference with its interval, RMS distances in the second half [m]."""
    named = lambda row: {
        "round": row["round"],
        "return in the water": row["surrogate"],
        "in the solver": row["solver"],
        "difference (95 %)": f"{row['surrogate'] - row['solver']:+.3f} ({row['low']:+.3f} {row['high']:+.3f})",
        "rmse in the water": row["rmse_surrogate"],
        "rmse in the solver": row["rmse_solver"],
    }
    return console.table([named(row) for row in rows])
