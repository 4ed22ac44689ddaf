"""A reward of your own on the shipped task: pay for being near, charge for every watt.

    python examples/own_reward.py
    fishmj train --task examples/own_reward.py:Frugal --out runs/frugal

A task is a small class: where an episode starts, where the target goes, what a step is worth. Here only the last is new. `xp` is
NumPy or jax.numpy, so the same lines run in dm_control, in Gymnasium and in training: arithmetic, and no `if` on values.
"""

from dataclasses import dataclass

import numpy as np

from fishmj import suite
from fishmj.policy import Policy
from fishmj.tasks.reference import StationHoldReference


@dataclass(frozen=True, kw_only=True)
class Frugal(StationHoldReference):
    """Station holding with the servos' power in the reward."""

    price: float = 0.2  # 1/W

    def reward(self, xp, step):
        """(B,) from `step`: trace (pose, joint, rate, velocity, power), target, distance, action, time."""
        return 1.0 / (1.0 + 10.0 * step.distance) - self.price * step.trace.power.mean(-1)


def returned(price: float, policy: Policy) -> float:
    """Return of one episode."""
    task = {"random": 4, "seconds": 10.0, "flow_speed": 0.2, "price": price}
    env = suite.load("fish", Frugal, task_kwargs=task, environment_kwargs={"flat_observation": True})
    step, total = env.reset(), 0.0
    while not step.last():
        step = env.step(policy(step.observation["observations"][None])[0])
        total += step.reward
    return total


if __name__ == "__main__":
    policy = Policy.load("station")
    free, paid = returned(0.0, policy), returned(0.2, policy)
    watts = (free - paid) / 0.2 / 50
    print(f"return of the policy 'station' over 50 steps: {free:.1f} for place alone, {paid:.1f} with 0.2 a watt charged")
    print(f"its servos take {watts:.2f} W")
    assert np.isfinite([free, paid]).all() and 0.2 < watts < 5
