"""Fit of PPO's critic to its returns in preset `quick`, and worth of the policy at half of its steps.

    python -m studies.training.critic privileged 0        critic of Preset quick, seed 0; also: plain, timeless
    python -m studies.training.critic timeless 1 --steps 1e6

`timeless` is the privileged critic whose input of the time left is zero. Prints the explained variance 1 - var(R - V) / var(R)
of a rollout every half a million steps, and the mean return, the share that stays and the RMSE of the last 10 s of 256 tuning
episodes at the end. The learning rate falls as for 8 M steps.
"""

import argparse

import jax
import jax.numpy as jnp

from fishmj.base import console
from fishmj.tasks.env import StationHold
from fishmj.tasks.station_hold import privileged_spans
from fishmj.train.build import settled
from fishmj.train.settings import change, preset
from fishmj.train.training_run import learner_of

EVERY = 30  # iterations, of 16,384 control steps


class TimelessStationHold(StationHold):
    """The task whose privileged input does not tell the time left."""

    def _privileged(self, state, obs_now):
        widths = privileged_spans(self.n_act)
        place = sum(list(widths.values())[: list(widths).index("time_left")])
        return super()._privileged(state, obs_now).at[:, place].set(0.0)


def main() -> None:
    """Trains, and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("critic", choices=("privileged", "plain", "timeless"))
    parser.add_argument("seed", type=int)
    parser.add_argument("--steps", type=float, default=4e6)
    args = parser.parse_args()
    settings = settled(change(preset("quick"), seed=args.seed, algorithm={"privileged": args.critic != "plain"}))
    env, learner, assess = learner_of(settings)
    if args.critic == "timeless":
        env.__class__ = TimelessStationHold
    state = learner.init(jax.random.key(args.seed))

    @jax.jit
    def explained(state):
        batch = learner.collect(state)[1]
        return 1 - jnp.var(batch.returns - batch.value) / jnp.var(batch.returns), batch.value.mean()

    for done in range(1, int(args.steps) // learner.steps_per_iteration + 1):
        state, _ = learner.iterate(state)
        if done % EVERY == 0:
            share, value = map(float, explained(state))
            console.say(f"{done * learner.steps_per_iteration:,} steps: explained {share:.3f}, mean value {value:.2f}")
    found = assess(state.actor, jax.random.key(123))
    console.say(", ".join(f"{name} {float(found[name]):.4g}" for name in ("return", "stayed", "rmse_last10")))


if __name__ == "__main__":
    main()
