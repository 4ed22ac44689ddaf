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
    """Learner, made by `Class(env, config, steps)`; steps: control steps of the whole run, all fish together.

    A train state is a NamedTuple of arrays and holds `actor`. A checkpoint stores only its leaves, and a resumed run continues
    from them: random draws must come from a key in the state, and `self` must hold no learnt state. `--together` maps `init` and
    `iterate` over seeds (jax.vmap). Settings that another algorithm also declares share its options, such as --envs and --gamma.

    The environment (tasks/env.py) resets itself: `final_obs` is the observation before a reset, `obs` the one after it. Do not
    bootstrap where `terminated`; bootstrap from `final_obs` where `truncated` (time limit); leave rows with `diverged` out.
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
    """Warns if rounding up to whole iterations adds more than a tenth to the requested control steps."""
    each = learner.steps_per_iteration
    if (whole := each * -(-steps // each)) > 1.1 * steps:
        console.warn(
            f"train: {whole:,} control steps instead of {steps:,}: an iteration has {each:,}; take fewer --envs for fewer"
        )


class StepRecord(NamedTuple):
    """One control step of B fish, or a rollout of T, (T, B)."""

    reward: Any
    distance: Any  # m, at the end of the step
    late: Any  # bool, in the second half of the episode, after the approach
    done: Any  # bool, the episode ends, for any reason
    terminated: Any  # bool, the fish left the tank
    diverged: Any  # bool, the episode was dropped


class EpisodeTally(NamedTuple):
    """Running return and length of the current episode of each of B fish."""

    gain: Any  # (B,) undiscounted, unscaled rewards
    length: Any  # (B,) control steps
    whole: Any  # (B,) bool, the episode was counted from its first step

    @classmethod
    def start(cls, xp, n: int) -> "EpisodeTally":
        """Tally of n fish whose clocks start at random times (`reset` with stagger); their first episodes do not count."""
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
    """Metrics as floats, without the episodic ones if no episode ended."""
    found = {name: float(value) for name, value in figures.items()}
    return {name: value for name, value in found.items() if name not in EPISODIC or value == value}


def record_of(after, limit: int) -> StepRecord:
    """Record of a step from the environment's state after it; `limit` is the length of an episode in control steps."""
    done = after.terminated | after.truncated | after.diverged
    late = (after.count > limit // 2) & ~done
    return StepRecord(after.reward, after.distance, late, done, after.terminated, after.diverged)


def metrics_of(xp, r: StepRecord) -> dict:
    """Scalars `METRICS`: mean reward, distance and arrived share of late steps, share of ends outside, episodes, dropped ones."""
    late, ended = xp.maximum(r.late.sum(), 1), xp.maximum(r.done.sum(), 1)
    return {
        "reward": r.reward.mean(),
        "late_distance": xp.sum(xp.where(r.late, r.distance, 0.0)) / late,
        "late_arrived": xp.sum((r.distance < constant("protocol", "arrival_radius")) & r.late) / late,
        "left_tank": r.terminated.sum() / ended,
        "episodes": r.done.sum(),
        "diverged": r.diverged.sum(),
    }
