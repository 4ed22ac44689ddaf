"""Seeds of a training over the workers of a Ray cluster: a run each, in a folder on a disk that all machines share.

A run that was under way when its worker or the command ended goes on from its newest checkpoint.
"""

import json
from collections import deque
from pathlib import Path

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError
from fishmj.base.ray_cluster import RayCluster, RayTask
from fishmj.base.store import Checkpoints
from fishmj.control.policy import Policy
from fishmj.train.settings import ALGORITHMS, Settings, change, own_code, referred


def check_own_code(settings: Settings, effects: list) -> None:
    """Raises ConfigError for code of the user's own, which a worker on another machine has not loaded."""
    if found := [*own_code(settings), *(["--effects"] if effects else [])]:
        raise ConfigError(f"--ray: a worker has no code of your own ({', '.join(found)}); train the seeds one after another")


def train_over_ray(
    address: str, settings: Settings, folders: dict[int, Path], command: str, begin: Policy | None, devices: int
) -> list[dict]:
    """Summaries of `TrainingRun.go`, by seed.

    Args:
        folders: of the runs by seed; one with a checkpoint goes on from it.

    Raises:
        ConfigError: no such cluster, an error of a run, a run that no worker ended, or a folder that is not shared.
    """
    waiting = deque(RayTask(f"seed {seed}", (change(settings, seed=seed), folder.resolve())) for seed, folder in folders.items())
    cluster, made = RayCluster(address), {}
    more = f"the runs keep checkpoints; {interrupt.again()}, with --resume"
    bar = console.Progress(settings.steps * len(folders), f"train {len(folders)} seeds over Ray", "steps")

    def show_progress(_: float) -> bool:
        if steps := sum(map(steps_of, folders.values())):
            bar.update(min(steps, settings.steps * len(folders)))
        return True

    with interrupt.keeping(lambda: more), bar:
        bar.stage("starting the workers")
        work = f"{__name__}:run_seeds"
        for task, summary in cluster.spread(work, waiting, command, begin, devices, gpus=devices, go_on=show_progress):
            made[task.given[0].seed] = summary
    if lost := [seed for seed in folders if seed not in made]:
        raise ConfigError(f"--ray: no worker ended seed {', '.join(map(str, lost))}; {more}")
    if away := [summary["policy"] for summary in made.values() if not Path(summary["policy"]).is_file()]:
        raise ConfigError(f"--ray: {away[0]} is on the worker's machine only; take an --out on a disk that all machines share")
    return [made[seed] for seed in folders]


def run_seeds(tasks: list[RayTask], command: str, begin: Policy | None, devices: int) -> list[dict]:
    """Summaries of runs, one after the other, in a worker."""
    return [_run(settings, folder, command, begin, devices) for _, (settings, folder) in tasks]


def _run(settings: Settings, folder: Path, command: str, begin: Policy | None, devices: int) -> dict:
    resume = bool(Checkpoints(folder / "checkpoints").paths())
    if train := ALGORITHMS[settings.algo].train:
        return referred(train)(settings, folder, resume=resume, command=command, quiet=True)
    from fishmj.train.training_run import TrainingRun, learner_of

    learner = learner_of(settings, devices)
    return TrainingRun(
        settings, folder, resume=resume, learner=learner, command=command, begin=None if resume else begin, quiet=True
    ).go()


def steps_of(folder: Path) -> int:
    """Control steps of a run so far, from its metrics.jsonl; 0 before its first line."""
    path = folder / "metrics.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    for line in reversed(lines):
        try:
            return int(json.loads(line)["step"])
        except ValueError:  # a line that is being written
            continue
    return 0
