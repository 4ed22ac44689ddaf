"""Training of several seeds in one JAX program: one compilation, and on a GPU hardly slower than one run.

Not resumable; for a resumable run, train seed by seed.
"""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from fishmj.base import console
from fishmj.base.errors import SimDiverged
from fishmj.train.build import settled
from fishmj.train.learner import EPISODIC, reported
from fishmj.train.settings import Settings, change
from fishmj.train.training_run import (
    MAX_DIVERGED,
    MetricsLog,
    export,
    is_better,
    learner_of,
    stop_on_signal,
    summary_of,
    write_settings,
)


def train_together(settings: Settings, seeds: list[int], folder: Path, command: str | None = None) -> list[dict]:
    """Trains one policy for each seed in parallel; returns summaries as `TrainingRun.go` does. command: as in `TrainingRun`."""
    settings = settled(settings)
    _, learner, assess = learner_of(settings)
    training = jax.vmap(learner.init)(jnp.stack([jax.random.key(seed) for seed in seeds]))
    iterate = jax.jit(jax.vmap(learner.iterate), donate_argnums=0)
    look = jax.jit(jax.vmap(assess, in_axes=(0, None)))
    lanes = [Lane(change(settings, seed=seed), folder / f"seed-{seed}", learner.policy_layers, command) for seed in seeds]
    start, bar = time.monotonic(), console.Progress(settings.steps, f"train {len(seeds)} seeds", "steps")
    bar.stage("compiling the first iteration")
    done, episodes, dropped = 0, 0.0, 0.0
    next_look = settings.assess_every
    best = f"the best policies so far are in {folder}; --together cannot resume"
    kept = lambda: best if any(lane.best for lane in lanes) else "nothing is saved yet; start again with --force"
    with stop_on_signal(kept) as asked, bar:
        while done < settings.steps and not asked:
            training, figures = iterate(training)
            done += learner.steps_per_iteration
            table = {k: np.asarray(v, float) for k, v in figures.items()}
            if not all(np.isfinite(v).all() for k, v in table.items() if k not in EPISODIC):
                message = f"training: non-finite figures at step {done:,}; train seed by seed to find which"
                raise SimDiverged(message, term="learner")
            episodes, dropped = episodes + table["episodes"].sum(), dropped + table["diverged"].sum()
            if dropped > max(1, MAX_DIVERGED * episodes):
                message = f"training: {dropped:.0f} of {episodes:.0f} episodes diverged up to step {done:,} and were dropped"
                raise SimDiverged(f"{message}, more than {MAX_DIVERGED:.1%}: fishmj doctor", term="physics")
            seconds = round(time.monotonic() - start, 3)
            for i, lane in enumerate(lanes):
                lane.board.write(done, {**reported({k: v[i] for k, v in table.items()}), "seconds": seconds})
            if done >= next_look or done >= settings.steps:
                next_look += settings.assess_every
                judged = {k: np.asarray(v, float) for k, v in look(training.actor, jax.random.key(20_000)).items()}
                for i, lane in enumerate(lanes):
                    figures = {k: round(float(v[i]), 5) for k, v in judged.items()}
                    lane.judge(figures, training.actor, i, done)
            bar.update(done, reward=float(table["reward"].mean()), distance=float(table["late_distance"].mean()))
    for i, lane in enumerate(lanes):
        lane.export("last", training.actor, i, done)
    seconds = time.monotonic() - start
    summaries = [summary_of(lane.settings, lane.folder, done, seconds, lane.best, bool(asked)) for lane in lanes]
    return [{**one, "together": len(seeds)} for one in summaries]


class Lane:
    """One of the seeds: its folder, metrics and best policy."""

    def __init__(self, settings: Settings, folder: Path, policy_layers: Callable, command: str | None):
        self.settings, self.folder, self.policy_layers, self.command = settings, folder, policy_layers, command
        self.best: dict | None = None
        self.board = MetricsLog(folder)
        write_settings(settings, folder)

    def judge(self, figures: dict, actors, i: int, done: int) -> None:
        """Records an assessment; exports actor i of the stacked ones if it is the best so far."""
        self.board.write(done, {f"tune_{k}": v for k, v in figures.items()})
        if is_better(figures, self.best):
            self.best = figures
            self.export("best", actors, i, done)

    def export(self, name: str, actors, i: int, done: int) -> None:
        """Writes the policy `name`."""
        network = self.policy_layers(jax.tree.map(lambda a: a[i], actors))
        meta = {"steps": done, "command": self.command, **({"tune": self.best} if name == "best" else {})}
        export(network, self.settings, meta, self.folder / f"{name}.safetensors")
