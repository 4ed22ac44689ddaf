"""Trainings inside an experiment: the settings and the loop of `fishmj train`, resumed where they were interrupted."""

import json
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.calib import constant
from fishmj.base.store import Checkpoints
from fishmj.evaluate.experiments.experiment_rows import identity_of
from fishmj.evaluate.experiments.paper_experiment import ExperimentSetup
from fishmj.evaluate.metrics import Result
from fishmj.tasks import station_hold as task
from fishmj.train.settings import Settings, as_dict, change, of_run, preset
from fishmj.water import choice

FASTER = 6.0  # simulated seconds of training that cost as much as one second of a trial; measured on two cores
QUICK: dict[str, Any] = {"steps": 1_500_000, "algorithm": {"envs": 256}}  # of --quick


def settings_of(setup: ExperimentSetup, **changes: Any) -> Settings:
    """Settings of a training: those of the policy's run if it is a folder, else of the preset quick; in this fitted water."""
    run = of_run(Path(setup.policy)) if Path(setup.policy).is_dir() else None
    water = choice.label(setup.robot) if setup.solver is None else "auto"
    made = change(run or preset("quick"), robot=setup.described, water=water, **setup.of({}, QUICK))
    return change(made, assess_every=made.steps, **changes)


def sim_seconds(settings: Settings) -> float:
    """Simulated time of trials that cost as much as a training, s."""
    return settings.steps * (settings.control_dt or constant("task", "control_dt")) / FASTER


def train_stages(setup: ExperimentSetup, name: str, settings: Settings, stages: tuple[int, ...]) -> tuple[Path, list[Path]]:
    """Trains one policy and saves it at given numbers of control steps, and at the end.

    Returns:
        folder of the run, policy files of the stages.

    Raises SystemExit: the training was interrupted; the same command continues it.
    """
    from fishmj.train.training_run import TrainingRun, learner_of

    mark = sha256(json.dumps([identity_of(setup), as_dict(settings), stages], default=str).encode()).hexdigest()[:8]
    folder = setup.out / "training" / f"{name}-{mark}"
    files = [folder / f"stage-{k + 1}.safetensors" for k in range(len(stages))]
    learner = None
    for steps, file in zip(stages, files, strict=True):
        if file.is_file():
            continue
        learner = learner or learner_of(settings)
        there = bool(Checkpoints(folder / "checkpoints").paths())
        summary = TrainingRun(change(settings, steps=steps), folder, resume=there, learner=learner).go()
        if summary["stopped"]:
            console.warn(f"interrupted; {folder} holds the run up to step {summary['steps']:,}; {interrupt.again()}")
            raise SystemExit(console.INTERRUPTED)
        shutil.copyfile(folder / "last.safetensors", file)
    return folder, files


def learning_curve(folder: Path, points: int = 100) -> dict[str, list[float]]:
    """Mean reward of a control step over the control steps of a run, averaged into `points`."""
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    rows = [row for row in rows if "reward" in row]
    each = np.array_split(np.array([[row["step"], row["reward"]] for row in rows]), min(points, len(rows)))
    means = np.array([some.mean(0) for some in each])
    return {"step": means[:, 0].round().tolist(), "reward": means[:, 1].round(5).tolist()}


def returns(result: Result) -> np.ndarray:
    """Return of each episode (n,), by the paper's reward; a trial gets no reward after leaving the domain."""
    ticks = round(result.robot.timing.control_dt / result.robot.timing.bus_dt)
    steps = min(task.control_steps(30.0, result.robot), (len(result.t) - 1) // ticks)
    total = np.zeros(len(result.trials))
    for k in range(steps):
        rates = result.rate[:, k * ticks + 1 : (k + 1) * ticks + 1]
        end = (k + 1) * ticks
        total += np.where(end < result.left, task.reward(np, result.distance[:, end], rates), 0.0)
    return total


def in_other_water(setup: ExperimentSetup, water: str | None) -> ExperimentSetup:
    """Same setting in another water, without the flow solver; None: the robot's default."""
    return replace(setup, robot=choice.in_water(setup.robot, water), solver=None)
