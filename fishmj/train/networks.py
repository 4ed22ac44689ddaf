"""Multilayer perceptrons as lists of (weights, bias), and the fixed scales that bring observations to order one."""

import jax
import jax.numpy as jnp
import numpy as np

from fishmj.tasks.station_hold import GROUPS, spans

ACTIVATIONS = {"relu": jax.nn.relu, "tanh": jnp.tanh}
# target m, the same within reach m, velocity m/s, yaw rate rad/s, joint rad, joint rate rad/s
SCALE = {"target": 1.0, "near": 0.1, "velocity": 0.3, "yaw_rate": 1.5, "joint": 0.7, "joint_rate": 4.0}


def scale(joints: int) -> np.ndarray:
    """Divisors (5 + 2 J,) of one observation."""
    return np.repeat([SCALE[group] for group in GROUPS], [*spans(joints).values()])


def input_scale(joints: int, memory: int) -> np.ndarray:
    """Divisors of the whole policy input: observation, then (action, observation) pairs."""
    # fixed numbers, no running statistics: a policy file holds them, and the robot uses the same divisors as training
    one = scale(joints)
    return np.concatenate([one] + [np.concatenate([np.ones(joints), one])] * (memory - 1))


def privileged_scale(joints: int) -> np.ndarray:
    """Divisors of a privileged critic's additional inputs: true observation, flow, share of time left, target within reach."""
    s = SCALE
    return np.concatenate([scale(joints), [s["velocity"]] * 2, [1.0], [s["near"]] * 2])


def mlp(key, sizes, last: float = 0.01):
    """Orthogonal weights with gain sqrt(2), the last layer with gain `last`; biases zero. Saxe et al. 2014, arXiv 1312.6120."""
    layers = []
    for i, (a, b) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        # sqrt(2) compensates for the half that ReLU cuts off, so that signals keep their size through the layers; an actor's
        # small last gain starts it near rest, where tanh is not saturated, and leaves exploration to sigma
        gain = last if i == len(sizes) - 2 else np.sqrt(2)
        # a key for each layer: one more layer at the end does not change the weights before it
        w = jax.nn.initializers.orthogonal(gain)(jax.random.fold_in(key, i), (a, b), jnp.float32)
        layers.append((w, jnp.zeros(b)))
    return layers


def forward(layers, x, activation: str = "relu"):
    """Output of the layers; no activation after the last."""
    f = ACTIVATIONS[activation]
    for w, b in layers[:-1]:
        x = f(x @ w + b)
    w, b = layers[-1]
    return x @ w + b
