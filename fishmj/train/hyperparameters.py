"""Hyperparameters of the learning algorithms, each declared once with its default, range and meaning.

The options of `fishmj train`, the checks, the run folder, the policy header and the table of docs/train/training.md follow from
these dataclasses. A new algorithm derives from `Hyperparameters` and declares its fields by `setting`.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

from fishmj.base.errors import ConfigError
from fishmj.base.options import Listed, OneOf, declared, number, setting, whole

FLOAT = 4  # bytes
STATE = 300  # numbers of a fish besides its observations: poses, commands, draws of the episode
ADAM = 4  # copies of a network: weights, its gradient, two moments
ACTIVATIONS = ("relu", "tanh")  # of networks.ACTIVATIONS, which needs JAX


@dataclass(frozen=True)
class Switch(OneOf):
    """Kind of a boolean option with named values: `known` is (name of False, name of True)."""

    def __call__(self, text: str) -> Any:
        return super().__call__(text) == self.known[1]

    def holds(self, value: Any) -> bool:
        """Returns True for a bool."""
        return isinstance(value, bool)


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """Base of the settings of every algorithm. Raises ConfigError for a value out of its range."""

    algo: ClassVar[str] = "algorithm"  # in messages

    envs: int = setting(512, whole(1, 2**20), "fish that swim at once")
    learning_rate: float = setting(1e-3, number(0, 1, above=True), "step size of Adam")
    gamma: float = setting(0.99, number(0, 1), "discount of the reward for each control step")
    hidden: tuple[int, ...] = setting((64, 64), Listed(whole(1, 8192), 10, distinct=False), "widths of the hidden layers")
    activation: str = setting("tanh", OneOf(ACTIVATIONS), "activation of the hidden layers")
    reward_scale: float = setting(1.0, number(0, 1e6, above=True), "factor on the reward in learning, not in reports")

    def __post_init__(self):
        for name, one in declared(type(self)).items():
            value, kind = getattr(self, name), one.metadata["kind"]
            if not kind.holds(value):
                raise ConfigError(f"{self.algo}: {name} = {value!r}; expected {kind.expected}")


@dataclass(frozen=True, kw_only=True)
class PlainPPOConfig(Hyperparameters):
    """Hyperparameters of PPO whose critic sees what the policy sees."""

    algo: ClassVar[str] = "sb3-ppo"

    horizon: int = setting(32, whole(1, 100_000), "control steps of each fish between two updates")
    epochs: int = setting(4, whole(1, 1000), "passes over each rollout")
    minibatches: int = setting(8, whole(1, 2**20), "parts of a rollout, one gradient step each; must divide envs x horizon")
    final_rate: float = setting(0.1, number(0, 10, above=True), "final share of the learning rate, which decays geometrically")
    lam: float = setting(0.95, number(0, 1), "lambda of the advantage estimate (GAE)", "--lambda")
    clip: float = setting(0.2, number(0, 10, above=True), "bound on |probability ratio - 1|")
    value_weight: float = setting(0.5, number(0, 1e6), "weight of the critic's loss")
    entropy: float = setting(0.002, number(0, 1e3), "weight of the entropy bonus")
    max_grad_norm: float = setting(0.5, number(0, 1e6, above=True), "clip the gradient to this norm")
    adam_eps: float = setting(1e-5, number(0, 1, above=True), "epsilon of Adam")
    sigma: float = setting(0.5, number(0, 10, above=True), "initial standard deviation of the action before tanh")
    reward_scale: float = setting(0.1, number(0, 1e6, above=True), "factor of the reward in learning, not in reports")

    def __post_init__(self):
        super().__post_init__()
        if self.envs * self.horizon % self.minibatches:
            raise ConfigError(
                f"{self.algo}: envs x horizon = {self.envs * self.horizon} does not split into {self.minibatches} minibatches"
            )

    def operations(self, width) -> float:
        """Number of operations of the networks for one control step; `width` as from training_cost.widths."""
        actor, critic = self._networks(width)
        return 2 * (actor + 2 * critic) + 6 * self.epochs * (actor + critic)

    def bytes(self, width, steps: float) -> float:
        """Size of the arrays of one iteration, bytes."""
        seen, inputs, joints = width
        batch = self.envs * self.horizon
        rollout = batch * (inputs + seen + 5 + joints + 4)
        minibatch = batch / self.minibatches * (inputs + 2 * 3 * sum(self.hidden))
        return FLOAT * (rollout + minibatch + self.envs * (2 * inputs + STATE) + ADAM * sum(self._networks(width)))

    def _networks(self, width) -> tuple[int, int]:
        seen, inputs, joints = width
        told = (seen + 5) * getattr(self, "privileged", False)
        return weights(inputs, *self.hidden, joints), weights(inputs + told, *self.hidden, 1)


@dataclass(frozen=True, kw_only=True)
class PPOConfig(PlainPPOConfig):
    """Hyperparameters of PPO."""

    algo: ClassVar[str] = "ppo"

    privileged: bool = setting(
        True,
        Switch(("plain", "privileged")),
        "privileged: the critic sees the flow, the actor never does; plain: neither",
        "--critic",
    )
    mirror: float = setting(0.0, number(0, 1e3), "weight of the symmetry loss: the mirrored fish should act as the mirror image")


@dataclass(frozen=True, kw_only=True)
class OffPolicyConfig(Hyperparameters):
    """Hyperparameters of off-policy learning with two critics and target networks; the paper's where it states them."""

    algo: ClassVar[str] = "off-policy"

    envs: int = setting(64, whole(1, 2**20), "fish that swim at once")
    learning_rate: float = setting(3e-4, number(0, 1, above=True), "step size of Adam")
    hidden: tuple[int, ...] = setting((256, 256), Listed(whole(1, 8192), 10, distinct=False), "widths of the hidden layers")
    activation: str = setting("relu", OneOf(ACTIVATIONS), "activation of the hidden layers")
    utd: float = setting(1.0, number(0, 1e3, above=True), "gradient steps for each control step of one fish")
    block: int = setting(16, whole(1, 100_000), "control steps of each fish between two reports")
    batch: int = setting(256, whole(1, 2**20), "transitions in a minibatch")
    buffer: int = setting(1_000_000, whole(1, 10**9), "capacity of the replay buffer, transitions")
    warmup: int = setting(5_000, whole(0, 10**9), "control steps of random actions before learning")
    tau: float = setting(0.005, number(0, 1, above=True), "Polyak averaging factor of the target critics")

    def operations(self, width) -> float:
        """Number of operations of `utd` gradient steps: both critics and their targets, the actor twice, all gradients."""
        actor, critic = self._networks(width)
        return self.utd * self.batch * (8 * actor + 2 * (2 + 6 + 6) * critic)

    def bytes(self, width, steps: float) -> float:
        """Size of buffer, environment and networks, bytes; `width` as from training_cost.widths."""
        _, inputs, joints = width
        replay = max(self.envs, min(self.buffer, steps)) * (2 * inputs + joints + 2)
        actor, critic = self._networks(width)
        return FLOAT * (replay + self.envs * (2 * inputs + STATE) + ADAM * actor + (2 * ADAM + 2) * critic)

    def _networks(self, width) -> tuple[int, int]:
        _, inputs, joints = width
        return weights(inputs, *self.hidden, 2 * joints), weights(inputs + joints, *self.hidden, 1)


@dataclass(frozen=True, kw_only=True)
class SACConfig(OffPolicyConfig):
    """Hyperparameters of SAC: from the paper where it states them, else from Haarnoja et al."""

    algo: ClassVar[str] = "sac"

    initial_alpha: float = setting(0.2, number(0, 1e3, above=True), "initial entropy temperature")
    target_entropy: float = setting(-1.0, number(-100, 100), "target entropy, nat per joint")


def weights(*layers: int) -> int:
    """Number of weights of a network with layers of these widths."""
    return sum(a * b for a, b in zip(layers, layers[1:], strict=False))
