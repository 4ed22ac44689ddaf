"""Visible size of hidden effects: computed by the generator, from robots of its own, never by a search.

    s   the effect's change of a sample: the same seed with and without it, without noise
    n   the sensors' noise there;  d  standard deviation of healthy robots of the family there
    mean over records and channels of  mean s^2 / (n^2 + d^2)

An effect is detectable at a mean square above 5 (`BOUND`). The measure without d, which the second robot's benchmark uses, is
given too. numba is loaded at first use only, so that the benchmark's tables can be read without it.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.base.compile_cache import cache_folder
from fishmj.base.errors import StoreError
from fishmj.base.store import read_npz, write_npz
from fishmj.gap.laboratory.session import Effects
from fishmj.log import Trial, excitation
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

BOUND = 5.0
HEALTHY = 8  # robots of the family
FIRST = 700_000_000  # their first seed, above all seeds of a benchmark
TABLES = ("joint", "pose", "power")
NOTHING = {"all": 0.0, "each": {}, "noise_only": 0.0, "each_noise_only": {}, "bound": BOUND, "healthy": 0}  # no effect


class SensedChannels(NamedTuple):
    """Channels of one record at its stamps: (K, C) values, (C,) noise."""

    t: np.ndarray
    values: np.ndarray
    sigma: np.ndarray


def detectable(
    family: str, effects: Effects, excitations: Iterable[str | Excitation], seed: int, noise: float = 1.0, nuisance: float = 0.1,
    robot: "str | Robot" = "fish", healthy: int = HEALTHY,
) -> dict:  # fmt: skip
    """Mean squares of all hidden effects together and of each alone.

    Returns:
        {"all": .., "each": {name: ..}, "noise_only": .., "each_noise_only": {..}, "bound": 5, "healthy": number of robots}

    Raises:
        as `generator_trials.generate`.
    """
    from fishmj.gap.laboratory.generators.generator_trials import generate, robot_of
    from fishmj.gap.laboratory.generators.lab_sensors import sigmas

    if not effects:
        return dict(NOTHING)
    runs = [excitation.get(item) if isinstance(item, str) else item for item in excitations]
    described, fish = load_robot(robot), robot_of(family, {}, seed, nuisance=nuisance, robot=robot)
    sigma = sigmas(fish, noise)

    def seen(hidden: Effects) -> list[SensedChannels]:
        return [s for trial in generate(family, hidden, runs, seed, 0.0, nuisance, robot) for s in channels(trial, sigma)]

    spread = [d for what in runs for d in tolerance(family, what, described, nuisance, healthy)]
    return mean_squares(seen, spread, effects, healthy)


def mean_squares(
    seen: Callable[[Effects], list[SensedChannels]], spread: list[np.ndarray], effects: Effects, healthy: int
) -> dict:
    """Result of `detectable` for any robots. seen: hidden effects -> channels of every record; spread: their variance."""
    plain = seen({})
    parts = {name: {name: values} for name, values in effects.items()} if len(effects) > 1 else {}
    both = {name: shares(seen(h), plain, spread) for name, h in {"": effects, **parts}.items()}
    each = {name: both.get(name, both[""]) for name in effects}
    return {
        "all": both[""][0],
        "each": {name: one[0] for name, one in each.items()},
        "noise_only": both[""][1],
        "each_noise_only": {name: one[1] for name, one in each.items()},
        "bound": BOUND,
        "healthy": healthy,
    }


def tolerance(family: str, what: Excitation, robot: Robot, nuisance: float, healthy: int = HEALTHY) -> list[np.ndarray]:
    """Variance of healthy robots of a family in one experiment, (K, C) of joints, pose and power; cached on disk."""
    identity = (family, robot, nuisance, healthy, FIRST, what.id, what.start, what.push, mujoco.__version__)
    key = hashlib.sha256(repr(identity).encode() + np.ascontiguousarray(what.commands).tobytes() + _sources()).hexdigest()[:32]
    path = cache_folder() / "generators" / f"{key}.npz"
    try:
        stored = read_npz(path)
        return [stored[name] for name in TABLES]
    except StoreError:
        pass
    from fishmj.gap.laboratory.generators.generator_trials import generate

    trials = [generate(family, {}, [what], FIRST + k, 0.0, nuisance, robot)[0] for k in range(healthy)]
    seen = [channels(trial, trial.meta["sigma"]) for trial in trials]
    made = {name: spreads([one[i] for one in seen], seen[0][i]) for i, name in enumerate(TABLES)}
    write_npz(path, made)
    return [made[name] for name in TABLES]


@cache
def _sources() -> bytes:
    """Hash of the code that simulates a healthy robot."""
    here = Path(__file__).resolve().parent
    folders = (here, here.parent, here.parents[2] / "mjcf")
    files = [path for folder in folders for path in sorted(folder.glob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).digest()


def channels(trial: Trial, sigma: Mapping[str, float]) -> list[SensedChannels]:
    """Joints, pose and power of a trial; sigma: noise of each column."""
    out = []
    for table, names in (("joint", [n for n in trial.table("joint") if n != "t"]), ("pose", ["x", "y", "yaw"])):
        rows = trial.table(table)
        out.append(SensedChannels(rows["t"], np.stack([rows[n] for n in names], 1), np.array([sigma[n] for n in names])))
    rows = trial.table("power")
    watts, error = rows["V"] * rows["I"], np.hypot(sigma["V"] * np.mean(rows["I"]), sigma["I"] * np.mean(rows["V"]))
    return [*out, SensedChannels(rows["t"], watts[:, None], np.array([error]))]


def at(seen: SensedChannels, t: np.ndarray) -> np.ndarray:
    """Values (K, C) at other stamps, linear in between."""
    return np.stack([np.interp(t, seen.t, column) for column in seen.values.T], 1)


def spreads(others: list[SensedChannels], plain: SensedChannels) -> np.ndarray:
    """(K, C) variance of healthy robots at the stamps of `plain`."""
    return np.var([at(other, plain.t) for other in others], axis=0, ddof=1)


def shares(hidden: list[SensedChannels], plain: list[SensedChannels], spread: list[np.ndarray]) -> tuple[float, float]:
    """(mean square over noise and healthy robots, over noise alone), averaged over records and channels."""
    both, alone = [], []
    for h, p, d in zip(hidden, plain, spread, strict=True):
        square, floor = (at(h, p.t) - p.values) ** 2, np.broadcast_to(p.sigma**2, p.values.shape)
        both += list((square / np.maximum(floor + d, 1e-30)).mean(0))
        alone += list((square / np.maximum(floor, 1e-30)).mean(0))
    return float(np.mean(both)), float(np.mean(alone))
