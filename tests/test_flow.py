"""The background flow is what its numbers say, the same for every water, and comes back from its seed."""

import hashlib
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.water.flow import BOXES, GUST_TAU, LENGTH, PRESETS, TICK, Flow, gust_table, sample, solenoidal_box, stack, table_of

EDDYING = ("default", "fine")
MOVING = tuple(p for p in PRESETS if p != "none")


def correlation(u):
    """Autocorrelation (n / 2,) of series u (S, n) of known zero mean, over all series; its first entry is the variance."""
    n = u.shape[1]
    return np.array([np.mean(u[:, : n - k] * u[:, k:]) for k in range(n // 2)])


def integral(r, step):
    """Integral of r / r[0] up to its first zero, trapezoidal, in the unit of `step`."""
    zero = int(np.argmax(r <= 0)) or len(r)
    return step * (np.sum(r[:zero]) / r[0] - 0.5)


# ---- intensity and length ----


@pytest.mark.parametrize("preset", EDDYING)
def test_over_space_intensity_and_integral_length_are_nominal(preset):
    """Lines of 8 L in directions of their own, 800 in each box: TI and the longitudinal length within 20 %.

    A box holds few of its largest eddies: the length of a single one is held to 35 %.
    """
    speed, intensity, step, boxes = 0.3, 0.1, LENGTH[preset] / 16, []
    for box in BOXES.values():
        numbers = dict(speed=speed, turbulence=preset, intensity=intensity, box=box)
        current = stack([Flow(direction=2.4 * seed % 6.28, seed=seed, **numbers) for seed in range(800)])
        along = current.mean / speed
        u, _ = sample(np, current, np.arange(128)[:, None] * step * along[:, None], np.zeros(800, int))
        boxes.append(correlation(np.einsum("bni,bi->bn", u - current.mean[:, None], along)))
    assert [np.sqrt(r[0]) / speed for r in boxes] == pytest.approx([intensity] * 3, rel=0.2)
    assert integral(np.mean(boxes, 0), step) == pytest.approx(LENGTH[preset], rel=0.2)
    assert [integral(r, step) for r in boxes] == pytest.approx([LENGTH[preset]] * 3, rel=0.35)


@pytest.mark.parametrize("speed", [0.1, 0.3])
@pytest.mark.parametrize("preset", EDDYING)
def test_at_a_fixed_point_over_time_they_are_nominal_too(preset, speed):
    """300 fish held at one point while the frozen field passes: L = U times the integral time."""
    flows = [Flow(speed=speed, direction=0.7 * s % 6.28, turbulence=preset, intensity=0.08, seed=s) for s in range(300)]
    current, along = stack(flows), np.array([f.mean[:2] for f in flows]) / speed
    every = max(1, round(LENGTH[preset] / 16 / speed / TICK))
    point = np.tile([0.3, -0.2], (300, 1, 1))
    series = [sample(np, current, point, np.full(300, k * every))[0][:, 0] for k in range(128)]
    u = np.einsum("tbi,bi->bt", np.array(series) - current.mean, along)
    r = correlation(u)
    assert np.sqrt(r[0]) / speed == pytest.approx(0.08, rel=0.2)
    assert integral(r, every * TICK) * speed == pytest.approx(LENGTH[preset], rel=0.2)


@pytest.mark.parametrize(("preset", "share"), [("gust", 1.0), ("vortex_street", 1.0), ("shear", 0.5)])
def test_tables_of_the_other_presets_have_unit_variance_and_no_mean(preset, share):
    """Shear has one component only, which carries its whole intensity."""
    table = table_of(preset)[0].astype(float).reshape(-1, 2)
    assert np.mean(table**2) == pytest.approx(share, rel=1e-5)
    np.testing.assert_allclose(table.mean(0), 0, atol=0.05 if preset == "gust" else 1e-6)


def test_intensity_is_against_a_floor_of_a_tenth():
    assert Flow(speed=0.3, turbulence="default", intensity=0.1).rms == pytest.approx(0.03)
    assert Flow(speed=0.02, turbulence="default", intensity=0.1).rms == pytest.approx(0.01)
    assert Flow(speed=0.3).rms == 0


# ---- the box ----


@pytest.mark.parametrize("preset", EDDYING)
def test_the_box_is_divergence_free_and_isotropic(preset):
    field = solenoidal_box(LENGTH[preset], 0).astype(float)
    n = len(field)
    k = np.fft.fftfreq(n, 1 / n)
    spectrum = np.fft.fftn(field, axes=(0, 1, 2))
    sides = [k[None, :, None], k[None, None, :], k[:, None, None]]  # axes (z, x, y), components (x, y, z)
    inner = (np.abs(sides[0]) < n / 2) & (np.abs(sides[1]) < n / 2) & (np.abs(sides[2]) < n / 2)
    divergence = np.abs(sum(s * spectrum[..., i] for i, s in enumerate(sides)))
    size = np.sqrt(sum(s * s for s in sides)) * np.linalg.norm(spectrum, axis=-1)
    assert (divergence * inner).max() < 1e-5 * size.max()
    np.testing.assert_allclose(field.std((0, 1, 2)), 1.0, atol=0.1)
    np.testing.assert_allclose(field.mean((0, 1, 2)), 0.0, atol=1e-6)


@pytest.mark.parametrize("preset", EDDYING)
def test_the_box_has_von_karmans_spectrum(preset):
    """Energy in shells of wave number against E(k), within 15 % over shells with enough modes."""
    length = LENGTH[preset]
    field = solenoidal_box(length, 1).astype(float)
    n = len(field)
    k = np.fft.fftfreq(n, 1 / n)
    shell = np.rint(np.sqrt(k[:, None, None] ** 2 + k[None, :, None] ** 2 + k[None, None, :] ** 2)).astype(int)
    energy = np.bincount(shell.ravel(), (np.abs(np.fft.fftn(field, axes=(0, 1, 2))) ** 2).sum(-1).ravel())
    count = np.bincount(shell.ravel())
    numbers = np.arange(5, 28)
    x = numbers / (8 * length) * 2 * np.pi / (0.7468 / length)
    expected = x**4 / (1 + x**2) ** (17 / 6) / x**2
    found = energy[numbers] / count[numbers]
    ratio = found / expected
    np.testing.assert_allclose(ratio / np.exp(np.log(ratio).mean()), 1.0, atol=0.15)


@pytest.mark.parametrize("preset", EDDYING)
def test_boxes_are_statistically_independent(preset):
    """No shift makes two boxes alike: the greatest of 262 144 cross-correlations stays that of unrelated fields."""
    fields = [np.fft.rfftn(solenoidal_box(LENGTH[preset], b), axes=(0, 1, 2)) for b in BOXES.values()]
    cells = solenoidal_box(LENGTH[preset], 0)[..., 0].size * 3
    alike = lambda a, b: np.abs(np.fft.irfftn(np.sum(a * b.conj(), -1))).max() / cells
    assert alike(fields[0], fields[0]) == pytest.approx(1.0, rel=1e-5)
    for one, two in ((0, 1), (0, 2), (1, 2)):
        assert alike(fields[one], fields[two]) < 0.35


def test_gust_tables_are_statistically_independent():
    tables = [np.fft.rfft(gust_table(b), axis=1) for b in BOXES.values()]
    size = gust_table(0)[0].size
    alike = lambda a, b: np.abs(np.fft.irfft(np.sum(a[:, None] * b[None].conj(), -1), axis=-1)).max() / size
    assert alike(tables[0], tables[0]) > 0.8
    assert max(alike(tables[0], tables[1]), alike(tables[0], tables[2]), alike(tables[1], tables[2])) < 0.6


# ---- gusts ----


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES)
def test_gusts_are_an_ornstein_uhlenbeck_process(box):
    """Correlation exp(-t / 1.5 s) out to two time constants, integral time within 20 %, both components alike."""
    series = np.moveaxis(gust_table(box), 1, -1).reshape(-1, gust_table(box).shape[1])
    r = correlation(series.astype(float))[:400]
    lag = np.arange(400) * TICK
    early = lag <= 2 * GUST_TAU
    np.testing.assert_allclose(r[early] / r[0], np.exp(-lag[early] / GUST_TAU), atol=0.08)
    assert integral(r, TICK) == pytest.approx(GUST_TAU, rel=0.2)


def test_a_gust_is_uniform_in_space_and_its_slope_is_its_acceleration():
    flow = Flow(speed=0.2, turbulence="gust", intensity=0.1, seed=4)
    points = np.random.default_rng(0).uniform(-2, 2, (1, 5, 2))
    here, slope = sample(np, flow.current(), points, np.array([17]))
    ahead, _ = sample(np, flow.current(), points, np.array([18]))
    assert np.ptp(here, axis=1).max() == 0
    np.testing.assert_allclose((ahead[0, 0] - here[0, 0]) / TICK, slope[0], rtol=1e-4, atol=1e-7)
    middle = flow.at([0.0, 0.0, 0.0], 17.25 * TICK)[:2]
    np.testing.assert_allclose(middle, 0.75 * here[0, 0] + 0.25 * ahead[0, 0], atol=1e-12)


# ---- one flow for every water ----


@pytest.mark.parametrize("seed", [0, 1, 99])
@pytest.mark.parametrize("preset", PRESETS)
def test_at_equals_the_planar_sample_in_the_plane(preset, seed):
    """What the oracle and the single fish see is what the batched engines see: z = 0, at ticks, to rounding of the table."""
    flow = Flow(speed=0.25, direction=(0.3 + seed) % 6.28, turbulence=preset, intensity=0.2, seed=seed, box=seed % 3)
    points = np.random.default_rng(seed).uniform(-3, 3, (40, 3)) * [1, 1, 0]
    for tick in (0, 1, 333, 5000):
        planar, _ = sample(np, flow.current(), points[None, :, :2], np.array([tick]))
        np.testing.assert_allclose(flow.at(points, tick * TICK)[:, :2], planar[0], rtol=0, atol=1e-7)


@pytest.mark.parametrize("preset", PRESETS)
def test_jax_samples_what_numpy_samples(preset):
    flows = [Flow(speed=0.2, direction=s % 6.28, turbulence=preset, intensity=0.1, seed=s) for s in range(16)]
    points = np.random.default_rng(1).uniform(-2, 2, (16, 4, 2))
    ticks = np.arange(16) * 40
    here, slope = sample(np, stack(flows), points, ticks)
    there, other = sample(jnp, type(stack(flows))(*map(jnp.asarray, stack(flows))), jnp.asarray(points), jnp.asarray(ticks))
    np.testing.assert_allclose(there, here, atol=2e-5)
    np.testing.assert_allclose(other, slope, atol=2e-5)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_batch_holds_the_flows_that_were_put_in(preset):
    flows = [Flow(speed=0.1 * s, direction=s, turbulence=preset, intensity=0.05 * s, seed=s) for s in range(4)]
    points = np.random.default_rng(2).uniform(-2, 2, (4, 3, 2))
    together, _ = sample(np, stack(flows), points, np.full(4, 55))
    for i, flow in enumerate(flows):
        alone, _ = sample(np, flow.current(), points[i : i + 1], np.array([55]))
        np.testing.assert_array_equal(together[i], alone[0])


@pytest.mark.parametrize("preset", MOVING)
def test_turning_the_flow_turns_what_is_sampled(preset):
    current = stack([Flow(speed=0.2, direction=0.4, turbulence=preset, intensity=0.2, seed=s) for s in range(5)])
    points, ticks, angle = np.random.default_rng(3).uniform(-2, 2, (5, 6, 2)), np.arange(5) * 70, 1.1
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = current._replace(mean=current.mean @ turn.T, turn=current.turn @ turn.T)
    for one, two in zip(sample(np, current, points, ticks), sample(np, turned, points @ turn.T, ticks), strict=True):
        np.testing.assert_allclose(two, one @ turn.T, atol=1e-5)


@pytest.mark.parametrize("preset", ["vortex_street", "shear"])
def test_streets_and_shear_lie_along_the_stream(preset):
    """Their pattern turns with `direction`; shear varies across the stream only, a street moves with it."""
    angle, points = 0.9, np.random.default_rng(5).uniform(-2, 2, (20, 3))
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    flows = [Flow(speed=0.3, direction=a, turbulence=preset, intensity=0.2, seed=2) for a in (0.0, angle)]
    np.testing.assert_allclose(flows[1].at(points @ turn.T, 1.3), flows[0].at(points, 1.3) @ turn.T, atol=1e-6)
    later = flows[0].at(points + flows[0].mean * 2.0, 3.3)
    np.testing.assert_allclose(later, flows[0].at(points, 1.3), atol=1e-6)
    if preset == "shear":
        np.testing.assert_allclose(flows[0].at(points + [0.37, 0, 0], 1.3), flows[0].at(points, 1.3), atol=1e-6)


def test_direction_is_where_the_water_moves_to():
    np.testing.assert_allclose(Flow(speed=0.2, direction=np.pi / 2).at([1.0, 2.0, 0.3], 5.0), [0, 0.2, 0], atol=1e-15)


def test_without_a_stream_eddies_stand_still_and_gusts_still_blow():
    for preset in EDDYING:
        flow = Flow(turbulence=preset, intensity=0.1, seed=1)
        u = flow.at([[0.1, 0.2, 0.0], [0.9, -0.4, 0.1]], 0.0)
        np.testing.assert_array_equal(flow.at([[0.1, 0.2, 0.0], [0.9, -0.4, 0.1]], 40.0), u)
        assert 1e-4 < np.abs(u).max() < 0.06 and not np.allclose(u[0], u[1])
    gust = Flow(turbulence="gust", intensity=0.1, seed=1)
    assert np.linalg.norm(gust.at([0, 0, 0], 0.0) - gust.at([0, 0, 0], 3.0)) > 1e-3
    assert not Flow().at(np.ones((2, 3)), 7.0).any()


# ---- seeds and errors ----

DIGEST = """
import hashlib, numpy as np
from fishmj.water.flow import Flow
x = np.linspace(-1, 1, 30).reshape(10, 3) * [1, 1, 0.2]
flows = (Flow(speed=0.2, direction=1.0, turbulence=p, intensity=0.1, seed=9, box=2).at(x, 1.3) for p in {presets!r})
print(hashlib.sha256(b"".join(u.tobytes() for u in flows)).hexdigest())
"""


def test_a_seed_gives_the_same_flow_in_another_process():
    x = np.linspace(-1, 1, 30).reshape(10, 3) * [1, 1, 0.2]
    here = [Flow(speed=0.2, direction=1.0, turbulence=p, intensity=0.1, seed=9, box=2).at(x, 1.3) for p in PRESETS]
    there = subprocess.run([sys.executable, "-c", DIGEST.format(presets=PRESETS)], capture_output=True, text=True, check=True)
    assert there.stdout.strip() == hashlib.sha256(b"".join(u.tobytes() for u in here)).hexdigest()


@pytest.mark.parametrize("preset", MOVING)
def test_another_seed_gives_another_flow(preset):
    points = np.random.default_rng(6).uniform(-1, 1, (30, 3))
    one, two = (Flow(speed=0.2, turbulence=preset, intensity=0.1, seed=s).at(points, 1.0) for s in (1, 2))
    assert np.abs(one - two).max() > 1e-3


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        (dict(speed=-0.1), "speed = -0.1"),
        (dict(speed=float("nan")), "speed = nan"),
        (dict(intensity=1.0), "intensity = 1.0"),
        (dict(direction=float("nan")), "direction = nan"),
        (dict(direction=float("inf")), "direction = inf"),
        (dict(seed=-1), "seed = -1"),
        (dict(box=-2), "box = -2"),
    ],
)
def test_a_flow_that_cannot_be_is_one_clear_error(numbers, message):
    with pytest.raises(ConfigError, match=message):
        Flow(**numbers)


def test_unknown_presets_and_mixed_batches_are_refused():
    for make in (lambda: Flow(turbulence="gusts"), lambda: table_of("gusts")):
        with pytest.raises(UnknownName, match="Did you mean 'gust'"):
            make()
    with pytest.raises(ConfigError, match="shares one turbulence preset and box"):
        stack([Flow(turbulence="gust"), Flow(turbulence="gust", box=1)])
