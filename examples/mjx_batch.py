"""A batch of fish in MJX, MuJoCo's physics in JAX: jit-able, so that a training loop runs wholly on the device.

    python examples/mjx_batch.py [FISH]        64 fish on a CPU; a GPU is meant for thousands

The functional environment restarts finished episodes by itself. `engine="planar"` is the same fish in closed form: the same swim,
and far faster on any device.
"""

import sys
import time

import jax
import jax.numpy as jnp

from fishmj.mjcf import load_robot
from fishmj.tasks.env import StationHold

fish = int(sys.argv[1]) if sys.argv[1:] else 64
robot = load_robot("fish")
ends = {}
for engine in ("mjx", "planar"):
    env = StationHold(robot, engine=engine)
    state = env.reset(jax.random.key(0), fish)
    keys = jax.random.split(jax.random.key(1), 10)
    actions = jax.vmap(lambda key: jax.random.uniform(key, (fish, env.n_act), minval=-0.6, maxval=0.6))(keys)  # noqa: B023
    swim = jax.jit(lambda state, actions: jax.lax.scan(lambda s, a: (env.step(s, a), None), state, actions)[0])  # noqa: B023
    swim = swim.lower(state, actions).compile()
    began = time.perf_counter()
    state = jax.block_until_ready(swim(state, actions))
    took = time.perf_counter() - began
    ends[engine] = state.fish.q
    print(f"{engine:<7}{fish * len(actions) / took:10.0f} control steps/s, {fish} fish, {jax.default_backend()}")
apart = float(jnp.abs(ends["mjx"][:, :2] - ends["planar"][:, :2]).max())
print(f"after 2 s the two engines put the fish within {1e3 * apart:.2f} mm of each other")
assert apart < 5e-3
