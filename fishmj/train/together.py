"""Several seeds in one program: one compilation, one set of kernels, and on a GPU hardly slower than one run.

Not resumable; for a run that must survive, train seed by seed.
"""

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from fishmj import console, store
from fishmj.errors import SimDiverged
from fishmj.train.learner import pick_engine, policy_of
from fishmj.train.run import Board, learner_of, stop_on_signal
from fishmj.train.settings import Settings, as_dict, change


def train_together(settings: Settings, seeds: list[int], folder: Path) -> list[dict]:
    """Train one policy a seed side by side; returns the summaries that `Run.go` would give."""
    _, learner, assess = learner_of(settings)
    start = time.monotonic()
    keys = jnp.stack([jax.random.key(seed) for seed in seeds])
    training = jax.vmap(learner.init)(keys)
    iterate = jax.jit(jax.vmap(learner.iterate), donate_argnums=0)
    look = jax.jit(jax.vmap(assess, in_axes=(0, None)))
    boards = [Board(folder / f"seed-{seed}") for seed in seeds]
    done, next_look, best = 0, settings.assess_every, [None] * len(seeds)
    with stop_on_signal() as asked, console.Progress(settings.steps, f"train {len(seeds)} seeds", "steps") as bar:
        while done < settings.steps and not asked:
            training, figures = iterate(training)
            done += learner.steps_per_iteration
            table = {k: np.asarray(v, float) for k, v in figures.items()}
            if not all(np.isfinite(v).all() for v in table.values()):
                raise SimDiverged(f"training: non-finite figures at step {done:,}; train seed by seed to find which", term="learner")
            for i, board in enumerate(boards):
                board.write(done, {**{k: float(v[i]) for k, v in table.items()}, "seconds": round(time.monotonic() - start, 3)})
            bar.update(done, reward=float(table["reward"].mean()), distance=float(table["late_distance"].mean()))
            if done >= next_look or done >= settings.steps:
                next_look += settings.assess_every
                judged = {k: np.asarray(v, float) for k, v in look(training.actor, jax.random.key(20_000)).items()}
                for i, seed in enumerate(seeds):
                    one = {k: round(float(v[i]), 5) for k, v in judged.items()}
                    boards[i].write(done, {f"tune_{k}": v for k, v in one.items()})
                    if best[i] is None or one["rmse_last10"] <= best[i]["rmse_last10"]:
                        best[i] = one
                        actor = jax.tree.map(lambda a, i=i: a[i], training.actor)
                        meta = {"steps": done, "engine": pick_engine(settings.engine), "preset": settings.preset, "tune": one}
                        meta["task"] = as_dict(settings)["task"]
                        policy_of(actor, change(settings, seed=seed), meta).save(folder / f"seed-{seed}" / "best.safetensors")
    seconds = round(time.monotonic() - start, 2)
    for seed in seeds:
        store.write_json(folder / f"seed-{seed}" / "settings.json", as_dict(change(settings, seed=seed)))
    return [
        {
            "folder": str(folder / f"seed-{seed}"), "policy": str(folder / f"seed-{seed}" / "best.safetensors"), "algorithm": settings.algo,
            "engine": pick_engine(settings.engine), "seed": seed, "steps": done, "seconds": seconds, "stopped": bool(asked),
            "together": len(seeds), **{f"tune_{k}": v for k, v in (best[i] or {}).items()},
        }
        for i, seed in enumerate(seeds)
    ]  # fmt: skip
