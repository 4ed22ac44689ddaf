"""How good is a policy in training? Whole episodes without exploration, on flows that training never saw."""

from functools import partial

import jax
import jax.numpy as jnp

from fishmj.calib import constant
from fishmj.tasks.env import StationHold
from fishmj.tasks.station_hold import control_steps


class Assessment:
    """Run `episodes` episodes of 30 s and measure arrival and holding. One jitted function."""

    def __init__(self, env: StationHold, act, episodes: int = 256):
        self.env, self.act, self.episodes = env, act, episodes
        self.radius, self.bound = constant("protocol", "arrival_radius"), constant("task", "bound")
        self.last10 = control_steps(10.0, env.robot)

    @partial(jax.jit, static_argnums=0)
    def __call__(self, actor, key):
        """Figures as scalars: return, arrival, rmse_last10, within (share of episodes with rmse_last10 < 0.1 m)."""
        state = self.env.reset(key, self.episodes, False)

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
