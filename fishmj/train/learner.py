"""Interface of a learning algorithm. To add one: a file beside ppo.py and sac.py, and its line in `settings.ALGORITHMS`.

The file holds two classes: a frozen dataclass of settings, all with defaults, and a `Learner` that is made by
`Class(env, config, steps)`. CONTRIBUTING.md has the recipe, `off_policy.py` the common part of algorithms with a replay buffer.
"""

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from fishmj.base import console
from fishmj.base.calib import constant

METRICS = ("reward", "late_distance", "late_arrived", "left_tank", "episodes", "diverged")  # of `metrics_of`; more may follow
EPISODIC = ("episode_return", "episode_length")  # of `episode_metrics`; left out of a report in which no episode ended
NEEDED = ("reward", "late_distance", "episodes", "diverged")  # for the progress line and the stop on diverged episodes


class PolicyLayers(NamedTuple):
    """Network of a policy file: action = tanh(MLP(observation / scale))."""

    layers: list  # [(weights (in, out), bias (out,)), ..]; the last gives one number a joint
    activation: str  # of the hidden layers, of networks.ACTIVATIONS


class Learner(Protocol):
    """Learner, made by `Class(env, config, steps)`: environment, settings, control steps of the whole run, all fish together.

    A train state is a NamedTuple of arrays and holds `actor`. A checkpoint keeps its leaves, and a resumed run continues from
    them alone: random draws must follow from a key in it, and `self` must hold no learnt state. `--together` maps `init` and
    `iterate` over seeds (jax.vmap). Settings that another algorithm also declares get its options, such as --envs and --gamma.

    The environment (tasks/env.py) restarts by itself: its state has `final_obs` from before the restart, and `obs` from after it.
    `terminated` is the end of an episode, `truncated` its time limit, from which one bootstraps; `diverged` rows are left out.
    """

    name: str
    steps_per_iteration: int  # control steps that one `iterate` takes, all fish together

    def init(self, key) -> Any:
        """Fresh train state."""

    def iterate(self, state) -> tuple[Any, dict]:
        """Does one iteration; returns (train state, metrics as scalars): `METRICS` and others, such as `EPISODIC`.

        May consume `state`.
        """

    def act(self, actor, obs):
        """Deterministic actions (B, J) in [-1, 1] for raw observations (B, n_input), in JAX."""

    def policy_layers(self, actor) -> PolicyLayers:
        """Actor in the form of a policy file; it gives the actions of `act`."""


def warn_of_rounding(learner: Learner, steps: int) -> None:
    """Warns where whole iterations make more than a tenth more of the control steps that were asked."""
    each = learner.steps_per_iteration
    if (whole := each * -(-steps // each)) > 1.1 * steps:
        console.warn(f"train: {whole:,} control steps in place of {steps:,}: an iteration takes {each:,}; fewer --envs take less")


class StepRecord(NamedTuple):
    """One control step of B fish, or a rollout of T, (T, B)."""

    reward: Any
    distance: Any  # m, at the end of the step
    late: Any  # bool, in the second half of the episode's time, where the way in is over
    done: Any  # bool, the episode ends for whatever reason
    terminated: Any  # bool, it left the tank
    diverged: Any  # bool, the episode was dropped


class EpisodeTally(NamedTuple):
    """Return and length so far of the episode of each of B fish."""

    gain: Any  # (B,) undiscounted, unscaled rewards
    length: Any  # (B,) control steps
    whole: Any  # (B,) bool, the episode was counted from its first step

    @classmethod
    def start(cls, xp, n: int) -> "EpisodeTally":
        """Tally of n fish whose clocks start at random times (`reset` with stagger): their first episodes are not counted."""
        return cls(xp.zeros(n), xp.zeros(n), xp.zeros(n, bool))


def episode_metrics(tally: EpisodeTally, r: StepRecord) -> tuple[EpisodeTally, dict]:
    """Mean return and length [control steps] of the episodes that ended in a rollout (T, B), NaN if none did; in JAX.

    Episodes that diverged, and those not counted from their first step, are left out.
    """

    def step(tally, row):
        reward, done, diverged = row
        gain, length = tally.gain + reward, tally.length + 1
        counted = done & tally.whole & ~diverged
        ended = jnp.stack([jnp.where(counted, gain, 0.0).sum(), jnp.where(counted, length, 0.0).sum(), counted.sum()])
        return EpisodeTally(jnp.where(done, 0.0, gain), jnp.where(done, 0.0, length), tally.whole | done), ended

    tally, ended = jax.lax.scan(step, tally, (r.reward, r.done, r.diverged))
    gain, length, count = ended.sum(0)
    return tally, dict(zip(EPISODIC, (gain / count, length / count), strict=True))


def reported(figures) -> dict[str, float]:
    """Metrics as numbers, without those of episodes if none ended."""
    found = {name: float(value) for name, value in figures.items()}
    return {name: value for name, value in found.items() if name not in EPISODIC or value == value}


def record_of(after, limit: int) -> StepRecord:
    """Record of a step from the environment's state after it; `limit` is the length of an episode in control steps."""
    done = after.terminated | after.truncated | after.diverged
    late = (after.count > limit // 2) & ~done
    return StepRecord(after.reward, after.distance, late, done, after.terminated, after.diverged)


def metrics_of(xp, r: StepRecord) -> dict:
    """Scalars: reward a step, distance and share of arrived in the late steps, share of ends outside, episodes ended, dropped."""
    late, ended = xp.maximum(r.late.sum(), 1), xp.maximum(r.done.sum(), 1)
    return {
        "reward": r.reward.mean(),
        "late_distance": xp.sum(xp.where(r.late, r.distance, 0.0)) / late,
        "late_arrived": xp.sum((r.distance < constant("protocol", "arrival_radius")) & r.late) / late,
        "left_tank": r.terminated.sum() / ended,
        "episodes": r.done.sum(),
        "diverged": r.diverged.sum(),
    }
