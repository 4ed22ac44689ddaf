"""What the tests of training share: a task so small that its answer is known, and the settings of a tiny run."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from fishmj.tasks.env import Options
from fishmj.train.settings import change, preset

EDGE = 1.1  # where the point leaves its line
TINY = {"hidden": (16, 16), "envs": 32, "horizon": 16, "minibatches": 2, "epochs": 2}


def tiny(**changes):
    """A run of PPO on the fish that takes seconds: 512 steps an iteration."""
    base = change(preset("quick"), engine="compiled", algorithm=TINY, steps=2048, assess_every=1024, assess_episodes=4)
    return change(base, **changes)


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
