"""The velocity filter is the straight-line fit that it says, late by half its window, on the frames that have arrived."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fishmj.tasks.sensing import delayed, estimate, slope_weights

DT = 0.02
WINDOWS = st.integers(2, 12)
SEEDS = st.integers(0, 2**32 - 1)


def times(window):
    """(W,) s, the newest at 0."""
    return (np.arange(window) - window + 1) * DT


@given(WINDOWS, SEEDS)
def test_a_straight_line_is_exact(window, seed):
    rng = np.random.default_rng(seed)
    start, rate = rng.normal(size=(2, 5, 3))
    poses = start[:, None] + rate[:, None] * times(window)[:, None]
    pose, velocity = estimate(np, poses, DT)
    np.testing.assert_allclose(velocity, rate, atol=1e-12)
    np.testing.assert_array_equal(pose, poses[:, -1])


@given(WINDOWS, SEEDS)
def test_the_estimate_is_half_a_window_late(window, seed):
    """On a parabola the slope of the line is the true velocity (W - 1) dt / 2 ago, for every W."""
    rate, curve = np.random.default_rng(seed).normal(size=(2, 3))
    t = times(window)[:, None]
    _, velocity = estimate(np, rate * t + curve * t * t, DT)
    np.testing.assert_allclose(velocity, rate - 2 * curve * (window - 1) * DT / 2, atol=1e-12)


@given(WINDOWS, SEEDS)
def test_it_is_the_least_squares_line(window, seed):
    poses = np.random.default_rng(seed).normal(size=(window, 3))
    expected = np.polyfit(times(window), poses, 1)[0]
    np.testing.assert_allclose(estimate(np, poses, DT)[1], expected, rtol=1e-9, atol=1e-9)


def test_weights_ignore_where_the_fish_is():
    for window in (2, 6, 11):
        weights = slope_weights(window, DT)
        assert abs(weights.sum()) < 1e-10 and weights @ times(window) == pytest.approx(1.0)


def test_position_noise_becomes_velocity_noise_by_the_textbook_factor():
    """sigma_v = sigma_p / dt sqrt(12 / (W (W^2 - 1))): 12 cm/s a centimetre of white noise at W = 6 and 50 Hz."""
    factor = np.sqrt(12 / (6 * 35)) / DT
    assert factor == pytest.approx(11.95, abs=0.01)
    noise = np.random.default_rng(0).normal(0, 0.01, (40000, 6, 3))
    assert estimate(np, noise, DT)[1].std() == pytest.approx(0.01 * factor, rel=0.02)


@given(st.integers(2, 8), st.integers(0, 6), SEEDS)
def test_delayed_frames_are_the_newest_that_have_arrived(window, longest, seed):
    """Brute force: of the H frames, forget the `late` newest, keep the last W."""
    rng = np.random.default_rng(seed)
    history = rng.normal(size=(7, window + longest, 3))
    late = rng.integers(0, longest + 1, 7)
    expected = [h[: len(h) - n][-window:] for h, n in zip(history, late, strict=True)]
    np.testing.assert_array_equal(delayed(np, history, late, window), expected)


def test_jax_gives_what_numpy_gives():
    history = np.random.default_rng(1).normal(size=(9, 11, 3)).astype(np.float32)
    late = np.arange(9) % 6
    here = estimate(np, delayed(np, history, late, 6), DT)
    there = estimate(jnp, delayed(jnp, jnp.asarray(history), jnp.asarray(late), 6), DT)
    np.testing.assert_array_equal(there[0], here[0])
    np.testing.assert_allclose(there[1], here[1], rtol=2e-5, atol=2e-4)
