"""One training run: the loop, its checkpoints, and everything that can go wrong with it.

A run is a folder: settings.json, metrics.jsonl (one line an iteration), checkpoints/, best.safetensors and last.safetensors.
Killed at any point it goes on from the newest complete checkpoint, on the CPU to the same bits.
"""

import json
import signal
import time
from contextlib import contextmanager
from pathlib import Path

import jax
import numpy as np

from fishmj import console, store
from fishmj.errors import ConfigError, SimDiverged
from fishmj.train.assess import Assessment
from fishmj.train.learner import algorithm, environment, pick_engine, policy_of
from fishmj.train.settings import Settings, as_dict

MAX_DIVERGED = 1e-3  # share of dropped episodes above which a run stops


def arrays_of(tree) -> dict[str, np.ndarray]:
    """Every leaf of a pytree under its path; random keys as their bits."""
    out = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        if jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            leaf = jax.random.key_data(leaf)
        out[jax.tree_util.keystr(path)] = np.array(leaf, order="C")  # keeps 0-d arrays 0-d
    return out


def tree_of(arrays: dict[str, np.ndarray], like):
    """The inverse of `arrays_of`. Raises ConfigError when the checkpoint belongs to another set-up."""
    paths, shape = jax.tree_util.tree_flatten_with_path(like)
    leaves = []
    for path, leaf in paths:
        name = jax.tree_util.keystr(path)
        key = jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        expected = jax.random.key_data(leaf).shape if key else leaf.shape
        if name not in arrays or arrays[name].shape != expected:
            got = arrays[name].shape if name in arrays else "nothing"
            raise ConfigError(f"checkpoint: {name} is {got}, this run needs {expected}; it was made with other settings")
        value = jax.numpy.asarray(arrays[name])
        leaves.append(jax.random.wrap_key_data(value) if key else value.astype(leaf.dtype))
    return jax.tree_util.tree_unflatten(shape, leaves)


@contextmanager
def stop_on_signal():
    """A list that fills on Ctrl-C or SIGTERM instead of an exception in the middle of an update."""
    asked: list[int] = []
    old = {}
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            old[number] = signal.signal(number, lambda n, _: asked.append(n))
    except ValueError:  # not the main thread: the caller keeps its own handlers
        pass
    try:
        yield asked
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


class Run:
    """Train one policy. `Run(settings, folder).go()` returns the summary dict."""

    def __init__(self, settings: Settings, folder, *, resume: bool = False, quiet: bool = False, learner=None):
        self.settings, self.folder, self.quiet = settings, Path(folder), quiet
        self.env, self.algorithm, self.assess = learner or learner_of(settings)
        self.checkpoints = store.Checkpoints(self.folder / "checkpoints", keep=2)
        self.done, self.seconds, self.best = 0, 0.0, None
        self.training = self.algorithm.init(jax.random.key(settings.seed))
        if resume:
            self._restore()
        elif self.checkpoints.paths():
            raise ConfigError(f"{self.folder} already holds a run; add --resume to go on, or choose another --out")
        store.write_json(self.folder / "settings.json", as_dict(settings))

    def go(self) -> dict:
        """Train to the end, or to Ctrl-C; the summary says which."""
        s, step = self.settings, self.algorithm.steps_per_iteration
        start, saved = time.monotonic() - self.seconds, time.monotonic()
        next_look = (self.done // s.assess_every + 1) * s.assess_every
        board = Board(self.folder)
        with stop_on_signal() as asked, console.Progress(s.steps, "train", "steps") as bar:
            while self.done < s.steps and not asked:
                self.training, figures = self.algorithm.iterate(self.training)
                figures = {k: float(v) for k, v in figures.items()}
                self.done += step
                self.seconds = time.monotonic() - start
                self._check(figures)
                board.write(self.done, {**figures, "seconds": round(self.seconds, 3)})
                if not self.quiet:
                    bar.update(self.done, reward=figures["reward"], distance=figures["late_distance"])
                if self.done >= next_look or self.done >= s.steps:
                    next_look += s.assess_every
                    board.write(self.done, self._look())
                if time.monotonic() - saved > s.checkpoint_every:
                    self._save()
                    saved = time.monotonic()
        self.seconds = time.monotonic() - start
        self._save()
        self._export("last", {})
        return self.summary(stopped=bool(asked))

    def summary(self, stopped: bool = False) -> dict:
        """What the command line prints last."""
        return {
            "folder": str(self.folder),
            "policy": str(self.folder / "best.safetensors"),
            "algorithm": self.settings.algo,
            "engine": pick_engine(self.settings.engine),
            "seed": self.settings.seed,
            "steps": self.done,
            "seconds": round(self.seconds, 2),
            "steps_per_second": round(self.done / max(self.seconds, 1e-9)),
            "stopped": stopped,
            **{f"tune_{k}": v for k, v in (self.best or {}).items()},
        }

    def _look(self) -> dict:
        """Judge the present actor on the tuning flows; keep it if it is the best so far."""
        figures = self.assess(self.training.actor, jax.random.key(20_000))
        figures = {k: round(float(v), 5) for k, v in figures.items()}
        if self.best is None or (figures["stayed"], -figures["rmse_last10"]) >= (min(0.99, self.best["stayed"]), -self.best["rmse_last10"]):
            self.best = figures
            self._export("best", figures)
        return {f"tune_{k}": v for k, v in figures.items()}

    def _export(self, name: str, figures: dict) -> None:
        meta = {"steps": self.done, "seconds": round(self.seconds, 1), "engine": pick_engine(self.settings.engine), "preset": self.settings.preset}
        meta |= {"task": as_dict(self.settings)["task"], **({"tune": figures} if figures else {})}
        policy_of(self.training.actor, self.settings, meta).save(self.folder / f"{name}.safetensors")

    def _check(self, figures: dict) -> None:
        """Stop on non-finite learning or on too many dropped episodes; what was saved stays."""
        bad = [k for k, v in figures.items() if not np.isfinite(v)]
        if bad:
            raise SimDiverged(
                f"training: {', '.join(bad)} became non-finite at step {self.done:,}; the newest checkpoint in "
                f"{self.checkpoints.folder} is intact: --resume with a smaller --learning-rate",
                term="learner",
            )
        if figures.get("diverged", 0) > MAX_DIVERGED:
            raise SimDiverged(
                f"training: {figures['diverged']:.2%} of the steps at {self.done:,} diverged and were dropped, more than {MAX_DIVERGED:.1%}; "
                "the physics step is too long or a parameter is out of range: python -m fishmj.doctor",
                term="physics",
            )

    def _save(self) -> None:
        meta = {"settings": as_dict(self.settings), "done": self.done, "seconds": self.seconds, "best": self.best}
        self.checkpoints.save(self.done, arrays_of(self.training), meta)

    def _restore(self) -> None:
        found = self.checkpoints.latest()
        if found is None:
            raise ConfigError(f"{self.folder}: nothing to resume; start without --resume")
        mine, theirs = as_dict(self.settings), found.meta["settings"]
        differs = [k for k in mine if mine[k] != theirs.get(k) and k not in ("steps", "checkpoint_every")]
        if differs:
            raise ConfigError(f"{self.folder}: the checkpoint was made with other {', '.join(differs)}; resume with the same settings")
        if found.note and not self.quiet:
            console.warn(found.note)
        self.training = tree_of(found.arrays, self.training)
        self.done, self.seconds, self.best = found.meta["done"], found.meta["seconds"], found.meta["best"]


def learner_of(settings: Settings):
    """(environment, algorithm, assessment), to be shared by runs that differ in their seed only."""
    env = environment(settings)
    learner = algorithm(settings, env)
    return env, learner, Assessment(environment(settings, "tune"), learner.act, settings.assess_episodes)


class Board:
    """metrics.jsonl, and TensorBoard events where tensorboardX is installed."""

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / "metrics.jsonl"
        try:
            from tensorboardX import SummaryWriter
        except ImportError:
            self.events = None
        else:
            self.events = SummaryWriter(str(folder / "events"))

    def write(self, step: int, figures: dict) -> None:
        with self.path.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps({"step": step, **figures}) + "\n")
        if self.events is not None:
            for name, value in figures.items():
                self.events.add_scalar(name, value, step)
