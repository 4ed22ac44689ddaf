"""What a learning algorithm is to a run. To add one: a file beside ppo.py and sac.py, and its line in `settings.ALGORITHMS`.

The file holds two classes: a frozen dataclass of settings, all with defaults, and a `Learner` that is made by
`Class(env, config, steps)`. docs/guide/training.md has the recipe, `off_policy.py` what algorithms with a replay buffer share.
"""

from typing import Any, NamedTuple, Protocol

METRICS = ("reward", "late_distance", "late_arrived", "left_tank", "episodes", "diverged")  # of rollout.py; more may follow
NEEDED = ("reward", "late_distance", "episodes", "diverged")  # for the progress line and the stop on diverged episodes


class PolicyLayers(NamedTuple):
    """The network of a policy file: action = tanh(MLP(observation / scale))."""

    layers: list  # [(weights (in, out), bias (out,)), ..]; the last gives one number a joint
    activation: str  # of the hidden layers, of networks.ACTIVATIONS


class Learner(Protocol):
    """Made by `Class(env, config, steps)`: the environment, its settings, control steps of the whole run, all fish together.

    A train state is a NamedTuple of arrays and holds `actor`. A checkpoint keeps its leaves, a resumed run goes on from them
    alone: what is drawn must follow from a key in it, and nothing that learns may live in `self`. `--together` maps `init` and
    `iterate` over seeds (jax.vmap). Settings named envs, learning_rate, hidden or privileged get the options of these names.

    The environment (tasks/env.py) starts anew by itself: its state has `final_obs`, before the restart, beside `obs` after it;
    `terminated` is the end of an episode, `truncated` its time limit, from which one bootstraps; `diverged` rows are left out.
    """

    name: str
    steps_per_iteration: int  # control steps that one `iterate` takes, all fish together

    def init(self, key) -> Any:
        """A fresh train state."""

    def iterate(self, state) -> tuple[Any, dict]:
        """(train state, metrics as scalars): `METRICS` and what the algorithm adds. May use up the state it is given."""

    def act(self, actor, obs):
        """Deterministic actions (B, J) in [-1, 1] for raw observations (B, n_input), in JAX."""

    def policy_layers(self, actor) -> PolicyLayers:
        """The actor as a policy file holds it; gives the actions of `act`."""
