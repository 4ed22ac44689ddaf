"""A raft for tests of the environment: an engine without physics that goes where the action says."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from fishmj import engines, mjcf
from fishmj.engines import Trace
from fishmj.tasks.env import Options, StationHold

ROBOT = mjcf.load_robot("fish")
KEY = jax.random.PRNGKey(7)


class Raft:
    """An engine without physics: x' and y' are 30 m/s a rad of the first two commands, a full third command breaks it."""

    jittable = True

    def __init__(self):
        self.traced = 0

    def advance(self, state, commands, params, current, tick):
        """As every engine's."""
        self.traced += 1
        velocity = 30.0 * commands.at[:, :, 2].set(0.1 * commands[:, :, 2])
        path = state.q[:, None, :3] + jnp.cumsum(velocity * 0.02, 1)
        broken = (commands[:, -1, 2] > 1.0)[:, None]
        q = jnp.concatenate([jnp.where(broken, jnp.nan, path[:, -1]), commands[:, -1]], -1)
        v = jnp.concatenate([velocity[:, -1], 0.5 * commands[:, -1]], -1)
        buffer = jnp.concatenate([state.buffer, commands], 1)[:, -engines.BUFFER :]
        pose = jnp.where(broken[:, None], jnp.nan, path)
        return state._replace(q=q, v=v, buffer=buffer), Trace(pose, commands, 0.5 * commands, velocity, velocity[:, :, 0])


@cache
def environment(**options):
    """The environment over a raft with these options, compiled once for all tests."""
    return StationHold(ROBOT, Raft(), Options(**options))


def raft(n=6, **options):
    """(environment, first state); without options: clean sensors, no turbulence."""
    env = environment(**(options or dict(noise=0.0, turbulence="none")))
    return env, env.reset(KEY, n)


def push(n=6, **rows):
    """Actions (n, 3): zero, but for fish `f0=(ax, ay, aturn)`."""
    action = np.zeros((n, 3), np.float32)
    for name, value in rows.items():
        action[int(name[1:])] = value
    return jnp.asarray(action)


def rows_equal(one, two, rows):
    """All per-fish leaves of two states are equal in `rows`."""
    n = len(one.count)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        if np.ndim(a) and np.shape(a)[0] == n:
            np.testing.assert_array_equal(np.asarray(a)[rows], np.asarray(b)[rows])
