"""Multilayer perceptrons as lists of (weights (in, out), bias)."""

import jax
import jax.numpy as jnp
import numpy as np

ACTIVATIONS = {"relu": jax.nn.relu, "tanh": jnp.tanh}


def mlp(key, sizes, last: float = 0.01):
    """Orthogonal weights with gain sqrt(2), the last layer with gain `last`; biases zero. Saxe et al. 2014, arXiv 1312.6120."""
    layers = []
    for i, (a, b) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        # sqrt(2) compensates for the half that ReLU cuts off, so signals keep their size through the layers. A small last gain
        # starts the actor near zero, where tanh is not saturated, and leaves exploration to sigma
        gain = last if i == len(sizes) - 2 else np.sqrt(2)
        # a key for each layer: an additional last layer does not change the weights before it
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
