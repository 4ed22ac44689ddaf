"""Lists of training runs, one for each point of a sweep and each seed: run here in sequence, or by the workers of a Ray cluster.

Every run has its own folder, with Ray on a disk that all machines share. An interrupted run resumes from its newest checkpoint.
"""

import argparse
import json
import re
import shlex
from collections import deque
from collections.abc import Iterator, Sequence
from copy import copy
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.base.ray_cluster import RayCluster, RayTask
from fishmj.base.store import Checkpoints
from fishmj.control.policy import Policy
from fishmj.train.settings import ALGORITHMS, REWARD, Settings, change, hyperparameters, referred

SWEPT = ("algo", "command_path", "control_dt", "hide", "memory", "steps")  # besides hyperparameters and weights


class PlannedRun(NamedTuple):
    """One run of a list. begin: policy that it starts from. point: swept options, `gamma=0.98,epochs=6`; "" without a sweep."""

    settings: Settings
    folder: Path
    begin: Policy | None = None
    point: str = ""

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"{self.point} seed {self.settings.seed}".lstrip()

    @property
    def has_checkpoint(self) -> bool:
        """True if the run has a checkpoint."""
        return bool(Checkpoints(self.folder / "checkpoints").paths())


def grid_points(parser: console.Parser, args: argparse.Namespace) -> list[tuple[str, argparse.Namespace]]:
    """Points of `--sweep NAME VALUE ...`, as text and as parsed arguments; without a sweep the one point "".

    Raises ConfigError: an option that cannot be swept, is given twice, or has fewer than two values.
    """
    axes, own = [], f"reward.{'|reward.'.join(REWARD)}".split("|")
    options = {name.replace("_", "-"): name for name in SWEPT} | {h.option[2:]: name for name, h in hyperparameters().items()}
    for name, *values in args.sweep:
        if name not in (known := sorted([*options, *own])):
            why = "cannot be swept, because points share task, robot and water"
            raise ConfigError(f"--sweep {name}: {why}; expected one of {', '.join(known)}, without dashes")
        if len(values) < 2 or len(set(values)) < len(values):
            raise ConfigError(f"--sweep {name}: got {' '.join(values) or 'nothing'}; expected two or more different values")
        weight = name.partition(".")[2]
        dest, words = (
            ("reward", [f"--reward={weight}={v}" for v in values])
            if weight
            else (options[name], [f"--{name}={v}" for v in values])
        )
        given = weight in dict(args.reward) if weight else getattr(args, dest) is not None
        if given or name in (axis[0] for axis in axes):
            raise ConfigError(f"--sweep {name}: {name} is given twice; leave one of them out")
        axes.append((name, dest, [(v, getattr(parser.parse_args([word]), dest)) for v, word in zip(values, words, strict=True)]))
    found = []
    for values in product(*(axis[2] for axis in axes)):
        one, texts = copy(args), []
        for (name, dest, _), (text, value) in zip(axes, values, strict=True):
            texts.append(f"{name}={text}")
            setattr(one, dest, [*one.reward, *value] if dest == "reward" else value)
        found.append((",".join(texts), one))
    return found


def point_folder(point: str) -> str:
    """Folder name of a point of a sweep."""
    return re.sub(r"[^\w.=,+-]", "_", point)


def check_distinct(runs: Sequence[PlannedRun]) -> None:
    """Raises ConfigError if two points of a sweep are the same."""
    seen: dict[Any, str] = {}
    for run in runs:
        for key in (repr(run.settings), str(run.folder)):
            if seen.setdefault(key, run.point) != run.point:
                raise ConfigError(f"--sweep: {seen[key]} and {run.point} are the same; leave one of them out")


def train_run(run: PlannedRun, command: str, learner: Any = None, *, devices: int = 1, resume: bool = False, quiet: bool = False):
    """Trains one run, from its checkpoint if there is one; returns the summary of `TrainingRun.go`.

    Args:
        learner: from `learner_of`; made here by default. resume: refuse a run without a checkpoint.
    """
    resume = resume or run.has_checkpoint
    if train := run.settings.algo in ALGORITHMS and ALGORITHMS[run.settings.algo].train:
        return referred(train)(run.settings, run.folder, resume=resume, command=command, quiet=quiet)
    from fishmj.train.training_run import TrainingRun, learner_of

    learner, begin = learner or learner_of(run.settings, devices), None if resume else run.begin
    return TrainingRun(run.settings, run.folder, resume=resume, learner=learner, command=command, begin=begin, quiet=quiet).go()


def _outcome(run: PlannedRun, *args: Any, **options: Any) -> dict:
    """Summary of one of several runs; if it diverged, the reason, so that the others continue."""
    try:
        return train_run(run, *args, **options)
    except SimDiverged as error:
        return failed(run, str(error))


def failed(run: PlannedRun, why: str) -> dict:
    """Summary of a run that failed."""
    return {"folder": str(run.folder), "algorithm": run.settings.algo, "seed": run.settings.seed, "stopped": False, "failed": why}


def train_here(runs: Sequence[PlannedRun], command: str, devices: int, resume: bool) -> list[dict]:
    """Trains the runs in sequence in this process; returns the summaries up to the run that Ctrl-C stopped."""
    from fishmj.train.training_run import learner_of

    if len(runs) == 1:
        return [train_run(runs[0], command, devices=devices, resume=resume)]
    results: list[dict] = []
    shared: tuple[Settings, Any] | None = None
    for number, run in enumerate(runs, 1):
        alike = change(run.settings, seed=0)
        if shared is None or shared[0] != alike:
            apart = alike.algo in ALGORITHMS and ALGORITHMS[alike.algo].train
            shared = alike, None if apart else learner_of(run.settings, devices)
        seconds, steps = (sum(r.get(key, 0) for r in results) for key in ("seconds", "steps"))
        left = sum(r.settings.steps for r in runs[number - 1 :]) * seconds / steps if steps else 0.0
        console.say(
            f"run {number} of {len(runs)}: {run.name}" + (f"; about {console.duration(left)} for the rest" if left else "")
        )
        results.append(_outcome(run, command, shared[1]))
        if results[-1]["stopped"]:
            break
    return results


def train_over_ray(address: str, runs: Sequence[PlannedRun], command: str, devices: int) -> list[dict]:
    """Trains each run on a worker of a Ray cluster; returns the summaries. Errors as `RayCluster.spread`.

    Raises ConfigError: a folder that is not shared.
    """
    waiting = deque(RayTask(run.name, run._replace(folder=run.folder.resolve())) for run in runs)
    cluster, made = RayCluster(address), {}
    more = f"the runs have checkpoints; {interrupt.again()}, with --resume"
    total = sum(run.settings.steps for run in runs)
    bar = console.Progress(total, f"train {len(runs)} runs over Ray", "steps")

    def show_progress(_: float) -> bool:
        if steps := sum(steps_of(run.folder) for run in runs):
            bar.update(min(steps, total))
        return True

    with interrupt.keeping(lambda: more), bar:
        bar.stage("starting the workers")
        work = partial(_in_worker, command=command, devices=devices)
        for task, summary in cluster.spread(work, waiting, gpus=devices, go_on=show_progress):
            made[task.id] = summary
    if away := [policy for summary in made.values() if not Path(policy := summary.get("policy", ".")).exists()]:
        raise ConfigError(f"--ray: {away[0]} is on the worker's machine only; give an --out on a disk that all machines share")
    return [made.get(run.name) or failed(run, "no worker ended it") for run in runs]


def _in_worker(tasks: list[RayTask], command: str, devices: int) -> Iterator[tuple[str, dict]]:
    for name, run in tasks:
        yield name, _outcome(run, command, devices=devices, quiet=True)


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


def resumed(argv: Sequence[str]) -> str:
    """Command that resumes the runs of `fishmj train *argv`."""
    words = [word for word in argv if word not in ("--force", "--resume")]
    return shlex.join(["fishmj", "train", *words, "--resume"])


def kept_words(runs: Sequence[PlannedRun], argv: Sequence[str]) -> str:
    """Text of an interrupt outside training, such as during compilation: what is saved, and how to continue."""
    if kept := [run.folder for run in runs if run.has_checkpoint]:
        return f"{', '.join(map(str, kept))} hold{'' if kept[1:] else 's'} checkpoints; go on with: {resumed(argv)}"
    return f"nothing is saved yet; {interrupt.again('go on' if '--resume' in argv else 'start again')}"


def sweep_table(runs: Sequence[PlannedRun], results: Sequence[dict]) -> dict:
    """Table of a sweep: {"rows": one for each run, "points": means over the seeds, "best": the best complete point}.

    All figures are from the tuning flows (`tune_...` of the summaries), on which runs also choose their best policy: they rank
    points, but are no unbiased evaluation. "best" is None as long as no point is complete.
    """
    told = lambda r: {k.removeprefix("tune_"): v for k, v in r.items() if k.startswith("tune_")}
    rows: list[dict] = []
    points: dict[str, list[dict]] = {}
    for run, result in zip(runs, results, strict=False):
        state = "failed" if "failed" in result else "stopped" if result["stopped"] else ""
        rows.append({"point": run.point, "seed": run.settings.seed, **told(result), **({"state": state} if state else {})})
        points.setdefault(run.point, []).append({} if state else told(result))
    means: list[dict[str, Any]] = []
    for point, found in points.items():
        complete = all(found) and len(found) == sum(run.point == point for run in runs)
        figures = {key: round(float(np.mean([f[key] for f in found])), 5) for key in found[0]} if complete else {}
        means.append({"point": point, "seeds": len(found), **figures})
    ranked = [mean for mean in means if len(mean) > 2]
    # points with other reward weights have incomparable returns; a task's own reward has no weights
    weighted = bool(runs[0].settings.reward)
    rank = lambda mean: (min(0.99, mean["stayed"]), -mean["rmse_last10"]) if weighted else mean["return"]
    best = max(ranked, key=rank) if ranked else None
    return {"rows": rows, "points": means, "best": best}
