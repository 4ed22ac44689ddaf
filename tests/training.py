"""What the tests of training share: a task so small that its answer is known, and the settings of a tiny run."""

import json
import signal
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from fishmj.tasks import station_hold
from fishmj.tasks.env import Options
from fishmj.train.settings import change, preset
from fishmj.train.training_run import TrainingRun

EDGE = 1.1  # where the point leaves its line
CALM = {"turbulence": "none", "intensity": (0.0, 0.0), "noise": 0.0, "randomisation": 0.0}
SMALL = {"hidden": (32, 32), "envs": 256, "horizon": 32, "minibatches": 4, "epochs": 4, "learning_rate": 2e-3}
SAC = {"hidden": (16, 16), "envs": 16, "block": 8, "batch": 32, "warmup": 256, "utd": 0.25}


def calm_run(**changes):
    """PPO in still turbulence and with the nominal fish: 8,192 control steps an iteration, 120 iterations."""
    base = change(preset("quick"), engine="compiled", task=CALM, algorithm=SMALL)
    return change(base, **{"steps": 120 * 8192, "assess_every": 60 * 8192, "assess_episodes": 64, **changes})


def sac_run(**changes):
    """SAC on the fish, too short to learn much: 128 control steps an iteration."""
    base = replace(preset("paper-sac"), engine="compiled", algorithm=SAC, assess_episodes=4)
    return change(base, **{"steps": 1024, "assess_every": 512, **changes})


class StopAt(TrainingRun):
    """A run that gets a SIGINT once it has taken so many steps."""

    def __init__(self, settings, folder, steps: int, **options):
        super().__init__(settings, folder, quiet=True, **options)
        self.stop_at = steps

    def _check(self, figures):
        super()._check(figures)
        if self.done >= self.stop_at:
            signal.raise_signal(signal.SIGINT)


def figures_of(run) -> list[dict]:
    """The lines of metrics.jsonl without their clock."""
    lines = (run.folder / "metrics.jsonl").read_text().splitlines()
    return [{k: v for k, v in json.loads(line).items() if k != "seconds"} for line in lines]


class PointState(NamedTuple):
    """What the learners read of an environment's state; arrays (B, ...)."""

    x: Any
    count: Any
    key: Any
    obs: Any
    final_obs: Any
    privileged: Any
    final_privileged: Any
    reward: Any
    terminated: Any
    truncated: Any
    distance: Any
    diverged: Any


class Point:
    """A point on a line goes to 0: x' = x + 0.3 a, reward -|x'|; |x'| > 1.1 leaves, 10 steps are the time limit.

    Args:
        poisoned: number of a point whose every step diverges, with the reward 777 that no learner may see.
    """

    n_obs, n_act, n_input, n_privileged = 7, 1, 7, 12
    input_scale, privileged_scale = station_hold.input_scale(1), station_hold.privileged_scale(1)
    options = Options()
    limit = 10

    def __init__(self, poisoned: int | None = None):
        self.poisoned = poisoned

    def reset(self, key, n: int, stagger: bool = False) -> PointState:
        """n points, anywhere; with `stagger` their clocks anywhere as well."""
        key, k_x, k_count = jax.random.split(key, 3)
        x = jax.random.uniform(k_x, (n,), minval=-1.0)
        count = jax.random.randint(k_count, (n,), 0, self.limit) if stagger else jnp.zeros(n, jnp.int32)
        no, see = jnp.zeros(n, bool), self.see(x)
        return PointState(x, count, key, see, see, self._all(x), self._all(x), 0 * x, no, no, abs(x), no)

    def step(self, s: PointState, action) -> PointState:
        """One step; ended points start again."""
        x, count = s.x + 0.3 * action[:, 0], s.count + 1
        bad = jnp.arange(len(x)) == (-1 if self.poisoned is None else self.poisoned)
        left = (abs(x) > EDGE) & ~bad
        late = (count >= self.limit) & ~left & ~bad
        fresh, done = self.reset(s.key, len(x)), left | late | bad
        now = jnp.where(done, fresh.x, x)
        return PointState(
            now, jnp.where(done, 0, count), fresh.key, self.see(now), self.see(x), self._all(now), self._all(x),
            jnp.where(bad, 777.0, -abs(x)), left, late, abs(x), bad,
        )  # fmt: skip

    def see(self, x):
        return jnp.zeros((len(x), self.n_obs)).at[:, 0].set(x)

    def _all(self, x):
        return jnp.zeros((len(x), self.n_privileged)).at[:, 0].set(x)
