"""Resumable training loop of one run, with its checkpoints and the handling of failures.

A run is a folder: settings.json, metrics.jsonl (one line an iteration), checkpoints/, best.safetensors and last.safetensors.
After a kill it resumes from the newest complete checkpoint, bit-identically on the CPU. A full disk pauses it.
"""

import errno
import json
import os
import shlex
import time
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from hashlib import sha256
from pathlib import Path
from threading import Lock

import jax
import jax.numpy as jnp
import numpy as np

from fishmj.base import console, interrupt, store
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.base.source import made_by
from fishmj.control.policy import Policy
from fishmj.control.policy_meta import one_line, structure_sha256
from fishmj.mjcf.identity import constants_sha256, structure_of
from fishmj.tasks.env import StationHold
from fishmj.tasks.station_hold import control_steps
from fishmj.train import training_cost
from fishmj.train.begin import start_from_policy
from fishmj.train.build import algorithm, environment, pick_engine, policy_of, robot_for, settled
from fishmj.train.learner import PolicyLayers, reported, warn_of_rounding
from fishmj.train.settings import ALGORITHMS, FILE, MADE_BY, Settings, as_dict, from_dict, own_code, same
from fishmj.water.choice import LBM
from fishmj.water.water_identity import water_identity

PROGRESS = ("done", "assessed", "seconds", "best", "episodes", "dropped", "command")  # stored in a checkpoint with the arrays
SLOW = 0.5  # s; longer iterations keep a copy of their initial state, so that an interrupt need not wait for their end
MAX_DIVERGED = 1e-3  # share of the run's episodes that may be dropped; a single dropped episode never stops a run
MAX_FAILED = 0.02  # the same in the flow solver, which can become unstable around a fish that moves violently
PACKAGES = ("jax", "optax", "numpy", "mujoco", "numba")  # their versions are recorded in every run
FULL = (errno.ENOSPC, errno.EDQUOT)
PAUSE = 5.0  # s between two tries on a full disk


def arrays_of(tree) -> dict[str, np.ndarray]:
    """Leaves of a pytree as {path: array}; random keys as raw bits."""
    out = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        if jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            leaf = jax.random.key_data(leaf)
        out[jax.tree_util.keystr(path)] = np.array(leaf, order="C")  # keeps 0-d arrays 0-d
    return out


def tree_of(arrays: dict[str, np.ndarray], like):
    """Inverse of `arrays_of`. Raises ConfigError if shapes or types differ from `like`: the run has another set-up."""
    paths, shape = jax.tree_util.tree_flatten_with_path(like)
    leaves = []
    for path, leaf in paths:
        name = jax.tree_util.keystr(path)
        key = jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)  # stored as raw bits
        expected = jax.random.key_data(leaf).shape if key else leaf.shape
        if name not in arrays or arrays[name].shape != expected:
            got = arrays[name].shape if name in arrays else "nothing"
            changed = "the settings are the same, so fishmj, the robot or the water has changed since the checkpoint"
            remedy = "resume with the old ones, or start a new run from its policy: fishmj train --begin RUN --out NEW"
            raise ConfigError(f"checkpoint: {name} is {got}, this run needs {expected}; {changed}; {remedy}")
        value = jax.numpy.asarray(arrays[name])
        leaves.append(jax.random.wrap_key_data(value) if key else value.astype(leaf.dtype))
    return jax.tree_util.tree_unflatten(shape, leaves)


class Assessment:
    """Evaluation in complete episodes without exploration, on flows not used in training. One jitted function."""

    def __init__(self, env: StationHold, act, episodes: int = 256):
        self.env, self.act, self.episodes = env, act, episodes
        self.radius, self.bound = constant("protocol", "arrival_radius"), constant("task", "bound")
        self.last10 = control_steps(10.0, env.robot)

    @partial(jax.jit, static_argnums=0)
    def __call__(self, actor, key):
        """Figures as scalars: return, arrival, rmse_last10, within (share of episodes with rmse_last10 < 0.1 m)."""
        state = self.env.reset(key, self.episodes, False)
        state = state._replace(count=jnp.zeros_like(state.count))  # every episode has full length

        def one(carry, _):
            state, alive = carry
            after = self.env.step(state, self.act(actor, state.obs))
            distance = jnp.where(alive, after.distance, jnp.nan)
            alive = alive & ~after.terminated & ~after.diverged
            return (after, alive), (distance, after.reward * alive)

        steps = self.env.limit
        (_, alive), (distance, reward) = jax.lax.scan(one, (state, jnp.ones(self.episodes, bool)), None, steps)
        far = jnp.nan_to_num(distance, nan=self.bound)  # outside the tank
        late = jnp.sqrt(jnp.mean(jnp.square(far[-self.last10 :]), 0))
        return {
            "return": reward.sum(0).mean(),
            "arrival": jnp.mean(jnp.any(far < self.radius, 0)),
            "stayed": alive.mean(),
            "rmse_last10": late.mean(),
            "rmse_last10_median": jnp.median(late),
            "within": jnp.mean(late < self.radius),
        }


@contextmanager
def stop_on_signal(words: interrupt.Words = str):
    """Yields the list of `interrupt.stop_requests`, so that an interrupt waits for the end of an update.

    words: function that returns the text for `interrupt.finishing`, if the update takes too long.
    """
    with interrupt.stop_requests() as asked, interrupt.finishing(words):
        yield asked


def when_there_is_room(write: Callable[[], object], asked: list) -> bool:
    """Calls `write()`; on a full disk prints the space needed, waits and tries again.

    Returns:
        True when written; False if a stop was requested while the disk was full. Other failures are raised.
    """
    waiting = False
    while True:
        try:
            write()
        except OSError as error:  # a StoreError is one, and keeps the errno
            if error.errno not in FULL:
                raise
            if asked:
                console.warn(f"not saved: {error}")
                return False
            if not waiting:
                console.warn(f"paused: {error}; trying again every {PAUSE:g} s; Ctrl-C stops without saving this")
            waiting = True
        else:
            if waiting:
                console.warn("the disk has room again: saved, training continues")
            return True
        until = time.monotonic() + PAUSE
        while time.monotonic() < until and not asked:
            time.sleep(min(0.1, PAUSE))


class MetricsLog:
    """Writes metrics.jsonl, one complete line per iteration; also TensorBoard events if tensorboardX is installed.

    A run that resumes from step `after` removes the later lines, and writes them again.

    assessed: step of the last assessment before the resumed step; lines of later assessments are also removed.
    """

    def __init__(self, folder: Path, after: int = 0, assessed: int = 0):
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / "metrics.jsonl"
        if self.path.exists():
            store.write_text(self.path, "".join(_until(after, assessed, self.path.read_text(encoding="utf-8"))))
        try:
            from tensorboardX import SummaryWriter
        except ImportError:
            self.events = None
        else:
            self.events = SummaryWriter(str(folder / "events"))

    def write(self, step: int, figures: dict) -> None:
        """Appends one line. Raises OSError, and leaves the file unchanged, if the disk is full."""
        line = (json.dumps({"step": step, **figures}) + "\n").encode()
        with open(self.path, "ab", buffering=0) as lines:
            size = os.fstat(lines.fileno()).st_size
            try:
                if lines.write(line) < len(line):
                    raise OSError(errno.ENOSPC, f"disk full: needs {len(line)} bytes", str(self.path))
            except OSError:
                lines.truncate(size)
                raise
        if self.events is not None:
            for name, value in figures.items():
                self.events.add_scalar(name, value, step)


def _until(step: int, assessed: int, text: str) -> list[str]:
    """Lines up to `step`, and of assessments up to `assessed`; drops an incomplete last line."""
    whole = [line + "\n" for line in text.split("\n")[:-1]]
    rows = [json.loads(line) for line in whole]
    last = [assessed if any(key.startswith("tune_") for key in row) else step for row in rows]
    return [line for line, row, end in zip(whole, rows, last, strict=True) if row["step"] <= end]


class TrainingRun:
    """Trains one policy. `TrainingRun(settings, folder).go()` returns the summary dict.

    learner: from `learner_of`, also on several devices; a run may resume on another number of devices, not bit-identically.
    command: command line for the header of the policy. A run resumed with other steps has its first one and, after "&&", that of
        the resume. None: called from Python.
    begin: policy that a fresh run starts from, with `settings` from `begin.begin_with`.
    stop_when: predicate on the figures of an `Assessment`; the run ends at the first new best that satisfies it.
    """

    def __init__(
        self,
        settings: Settings,
        folder,
        *,
        resume: bool = False,
        quiet: bool = False,
        learner=None,
        command: str | None = None,
        begin: Policy | None = None,
        stop_when: Callable[[dict], bool] = lambda figures: False,
    ):
        self.settings, self.folder, self.quiet, self.command = settled(settings), Path(folder), quiet, command
        self.env, self.algorithm, self.assess = learner or learner_of(settings)
        self.devices = getattr(self.algorithm, "devices", 1)
        self.stop_when = stop_when
        self.checkpoints = store.Checkpoints(self.folder / "checkpoints", keep=2)
        self.done, self.seconds = 0, 0.0
        self.assessed = 0  # the step of the newest assessment
        self.best: dict | None = None
        self.episodes, self.dropped = 0, 0
        self.trained_on = trained_on(self.settings)
        self._saving, self._under_way = Lock(), False
        self._copy_before: tuple[dict, dict] | None = None
        self._iteration_seconds = 0.0  # s of the last iteration
        self._assessment_compiled = False
        self.bar = console.Progress(settings.steps, f"train on {self.devices} devices" if self.devices > 1 else "train", "steps")
        if not quiet:
            if settings.engine == "auto" and pick_engine(settings) == "planar":
                console.warn('numba is not installed: training on the slower engine planar; pip install "fishmj[fast]"')
            self.bar.stage("compiling the fish and the networks")
        self.training = self.algorithm.init(jax.random.key(settings.seed))
        if resume:
            self._restore()
        elif self.checkpoints.paths():
            raise ConfigError(f"{self.folder} already holds a run; add --resume to go on, or choose another --out")
        elif begin is not None:
            self.training = start_from_policy(self.training, begin, settings, self.env)
            self.assessed = -1  # the starting policy is assessed too, and may remain the best
        if self.devices > 1:
            self.training = self.algorithm.place(self.training)
        self.bar.done_before = self.done
        write_settings(self.settings, self.folder)

    def go(self) -> dict:
        """Trains to the last step, until `stop_when` holds, or until Ctrl-C, which the summary reports."""
        s = self.settings
        start, saved = time.monotonic() - self.seconds, time.monotonic()
        self.bar.restart()  # its final time equals the summary's
        if self.done >= s.steps:
            console.warn(f"{self.folder} has {self.done:,} control steps of {s.steps:,} already: nothing to train; raise --steps")
        board = MetricsLog(self.folder, after=self.done, assessed=self.assessed)
        if not self.quiet:
            self.bar.stage("compiling the first iteration")
        with stop_on_signal(self._save_on_interrupt) as asked, self.bar as bar:
            write = lambda what, *to: when_there_is_room(lambda: what(*to), asked)
            if self._assessment_is_due():
                self._judge(board, write)
            while self.done < s.steps and not asked and not self._is_good():
                figures = self._iterate()
                self.done += self.algorithm.steps_per_iteration
                self.seconds = time.monotonic() - start
                self._check(figures)
                self._under_way = False
                write(board.write, self.done, {**figures, "seconds": round(self.seconds, 3)})
                if self._assessment_is_due():
                    self._judge(board, write)
                if not self.quiet:
                    bar.update(self.done, reward=figures["reward"], distance=figures["late_distance"])
                if time.monotonic() - saved > s.checkpoint_every:
                    write(self._save)
                    saved = time.monotonic()
            self.seconds = time.monotonic() - start
            write(self._save) and write(self._export, "last", {})
        return summary_of(s, self.folder, self.done, self.seconds, self.best, bool(asked), self.devices)

    def _is_good(self) -> bool:
        return self.best is not None and self.stop_when(self.best)

    def _assessment_is_due(self) -> bool:
        """Returns True after the first iteration past a multiple of `assess_every`, and at the end of the run."""
        every = self.settings.assess_every
        return self.done > self.assessed and (self.done // every > self.assessed // every or self.done >= self.settings.steps)

    def _judge(self, board: MetricsLog, write: Callable) -> None:
        """Assesses, records, and exports a new best policy; the assessment counts as done only after all of this."""
        began = time.monotonic()
        with self.bar.aside("" if self.quiet or self._assessment_compiled else "compiling the assessment"):
            figures, better = self._assess_actor()
        every = self.settings.assess_every
        self.bar.ahead = (self.settings.steps // every - self.done // every) * (time.monotonic() - began)
        write(board.write, self.done, figures)
        if better:
            write(self._export, "best", self.best)
        self.assessed = self.done

    def _iterate(self) -> dict[str, float]:
        """Does one iteration. It consumes the state, so a copy is kept first if iterations are slow."""
        began = time.monotonic()
        if self._iteration_seconds > SLOW:
            self._copy_before = self._state()
        self._under_way = True
        self.training, figures = self.algorithm.iterate(self.training)
        figures = reported(figures)  # waits for the device
        self._raise_failure(self.env)
        self._iteration_seconds, self._copy_before = time.monotonic() - began, None
        return figures

    def _save_on_interrupt(self) -> str:
        """Saves a checkpoint from before the running iteration, on an interrupt; called in another thread."""
        with self._saving:
            held = self._copy_before or (None if self._under_way else self._state())
            newest = next((int(path.stem[5:]) for path in self.checkpoints.paths()), 0)
            if held and held[1]["done"] > newest:
                newest = held[1]["done"]
                self.checkpoints.save(newest, *held)
        if not newest:
            return f"nothing is saved yet; {interrupt.again('start again')}"
        return go_on(self.folder, newest, self.settings, self.devices)

    def _assess_actor(self) -> tuple[dict, bool]:
        """Assesses the present actor on the tuning flows; returns figures for the log, and True if it is the best so far."""
        self._assessment_compiled = True
        actor = jax.device_get(self.training.actor)  # the assessment runs on one device
        figures = self.assess(actor, jax.random.key(20_000))
        figures = {k: round(float(v), 5) for k, v in figures.items()}
        self._raise_failure(getattr(self.assess, "env", None))
        better = is_better(figures, self.best)
        self.best = figures if better else self.best
        return {f"tune_{k}": v for k, v in figures.items()}, better

    def _export(self, name: str, figures: dict) -> None:
        meta = {"steps": self.done, "seconds": round(self.seconds, 1), **({"tune": figures} if figures else {})}
        meta |= {"command": self.command, **({"devices": self.devices} if self.devices > 1 else {})}
        export(self.algorithm.policy_layers(self.training.actor), self.settings, meta, self.folder / f"{name}.safetensors")

    def _check(self, figures: dict) -> None:
        """Raises an error if a figure is not finite or too many episodes diverged; saved files stay."""
        self._finite(figures)
        self.episodes += int(figures["episodes"])
        self.dropped += int(figures["diverged"])
        most = MAX_FAILED if self.settings.engine == LBM else MAX_DIVERGED
        if self.dropped > max(1, most * self.episodes):
            raise SimDiverged(
                f"training: {self.dropped} of {self.episodes} episodes at step {self.done:,} diverged and were dropped, "
                f"more than {most:.1%}; the physics step is too long or a parameter out of range: see fishmj doctor",
                term="physics",
            )

    def _raise_failure(self, env) -> None:
        """Raises an error that the engine has stored because it could not raise it inside a compiled loop."""
        if error := getattr(getattr(env, "engine", None), "failed", None):
            raise error

    def _finite(self, table: dict) -> None:
        """Raises an error if one of the named figures or arrays is not finite."""
        if bad := [k for k, v in table.items() if not np.isfinite(v).all()]:
            raise SimDiverged(
                f"training: {', '.join(bad[:3])} became non-finite at step {self.done:,}; the newest checkpoint in "
                f"{self.checkpoints.folder} is intact; start again with a smaller --learning-rate",
                term="learner",
            )

    def _state(self) -> tuple[dict, dict]:
        """Arrays and metadata of a checkpoint."""
        arrays = arrays_of(self.training)
        self._finite(arrays)  # the last update can spoil the weights after the figures were computed
        return arrays, {"settings": as_dict(self.settings), **{k: getattr(self, k) for k in (*PROGRESS, "trained_on")}}

    def _save(self) -> None:
        with self._saving:
            self.checkpoints.save(self.done, *self._state())

    def _restore(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # reported below, in one line
            found = self.checkpoints.latest()
        if found is None:
            raise ConfigError(f"{self.folder}: nothing to resume; start without --resume")
        # use the checkpoint's settings: a resumed run may already have rewritten settings.json
        same(self.folder, self.settings, as_dict(settled(from_dict(found.meta["settings"]))))
        there = found.meta.get("trained_on", self.trained_on)
        if changed := [name for name, digest in self.trained_on.items() if there.get(name) != digest]:
            what = f"the {' and the '.join(changed)} of {self.settings.robot} changed since the checkpoint"
            begin = f"start another run from its policy: --begin {shlex.quote(str(self.folder))}"
            raise ConfigError(f"{self.folder}: {what}; restore it, or {begin}")
        # the fresh state defines leaves, shapes and dtypes; its restored key makes all later draws the same
        self.training = tree_of(found.arrays, self.training)
        # counts of the run, not of the learner: without them a resumed run would assess and stop at other steps
        again = self.command
        for name in PROGRESS:
            setattr(self, name, found.meta.get(name, getattr(self, name)))
        if self.command and again and self.settings.steps != found.meta["settings"]["steps"]:
            self.command = one_line(f"{self.command} && {again}")
        if (steps := self.settings.steps) <= self.done and steps != found.meta["settings"]["steps"]:
            got = f"got --steps {steps:,}, but {self.done:,} are trained already; expected a larger total"
            raise ConfigError(f"{self.folder}: {got}; for {steps:,} more give --steps {self.done + steps}")
        self.assessed = found.meta.get("assessed", self.done)  # older versions did not store it
        if self.settings.engine == LBM:
            fresh = self.algorithm.init(jax.random.fold_in(jax.random.key(self.settings.seed), self.done))
            self.training = self.training._replace(env_state=fresh.env_state, tally=fresh.tally)
            console.warn("checkpoints do not hold the solver's water: every fish begins a new episode")
        if found.note:
            console.warn(found.note)
            # newer than the one that was read, but damaged: set aside for inspection
            for path in self.checkpoints.paths():
                if path.name > found.path.name:
                    path.rename(path.with_suffix(".damaged"))


def trained_on(settings: Settings) -> dict[str, str]:
    """Digests of the robot and the water of a run, which must not change when it resumes."""
    robot = robot_for(settings)
    body = f"{structure_sha256(structure_of(robot))} {constants_sha256(robot)}"
    return {"description": sha256(body.encode()).hexdigest(), "water": water_identity(robot).get("sha256", "")}


def export(network: PolicyLayers, settings: Settings, meta: dict, path: Path) -> None:
    """Writes a policy file with a header about its training."""
    said = as_dict(settings)
    made = {"engine": pick_engine(settings), "preset": settings.preset, "task": said["task"], "reward": said["reward"]}
    made |= {"solver": said["solver"]} if settings.engine == LBM else {}
    made |= {"hyperparameters": said["algorithm"], MADE_BY: programs(settings), "machine": training_cost.machine()}
    policy_of(network, settings, {**made, **meta}).save(path)


def programs(settings: Settings) -> dict:
    """Versions of the packages of a run, and the commit."""
    own = ALGORITHMS[settings.algo].packages if settings.algo in ALGORITHMS else ()
    return made_by(*PACKAGES, *own, *(["warp-lang"] if settings.engine == LBM else []))


def write_settings(settings: Settings, folder: Path) -> None:
    """Writes the run's file of settings: all of them, the seed, and the versions."""
    store.write_json(folder / FILE, as_dict(settings) | {MADE_BY: programs(settings)})


def summary_of(
    settings: Settings, folder: Path, done: int, seconds: float, best: dict | None, stopped: bool, devices: int = 1
) -> dict:  # fmt: skip
    """Summary at the end of a run, or of one of several seeds."""
    policies = [folder / f"{name}.safetensors" for name in ("best", "last")]
    return {
        "folder": str(folder),
        "policy": str(policies[0] if policies[0].exists() else policies[1]),
        "algorithm": settings.algo,
        "engine": pick_engine(settings),
        "seed": settings.seed,
        "steps": done,
        "seconds": round(seconds, 2),
        "steps_per_second": round(done / max(seconds, 1e-9)),
        "stopped": stopped,
        "devices": devices,
        **{f"tune_{k}": v for k, v in (best or {}).items()},
    }


def go_on(folder: Path, done: int, settings: Settings, devices: int = 1) -> str:
    """Text for an interrupted run: its state and the command that resumes it."""
    own = [word for pair in own_code(settings).items() for word in pair]  # only a command line may name these
    own += ["--devices", str(devices)] if devices > 1 else []
    command = shlex.join(["fishmj", "train", "--resume", "--out", str(folder), *own])
    return f"{folder} holds the run up to step {done:,}; go on with: {command}"


def is_better(figures: dict, best: dict | None) -> bool:
    """Returns True if an assessment's mean return is at least that of the best so far.

    The share of fish that stay in the tank is too noisy: with 1,024 fish its standard error is 0.4 %, more than half a training
    changes.
    """
    return best is None or figures["return"] >= best["return"]


def learner_of(settings: Settings, devices: int = 1):
    """Environment, algorithm (on this number of devices) and assessment, shared by runs that differ only in their seed."""
    env = environment(settings)
    learner = algorithm(settings, env, devices)
    warn_of_rounding(learner, settings.steps)
    return env, learner, Assessment(environment(settings, "tune"), learner.act, settings.assess_episodes)
