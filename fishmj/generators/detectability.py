"""How much of what is hidden can be seen at all: computed by the generator, from robots of its own, never by a search.

    s   what the effect does to a sample: the same seed with and without it, without noise
    n   the sensors' noise there; d  what healthy robots of the family differ by there: their deviation from the first of them
    mean over records and channels of  mean s^2 / (n^2 + d^2)

Detectable is a mean square above 5 (`BOUND`). Beside it stands the measure without d, which the second robot's benchmark uses.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from fishmj.excitation import Excitation
from fishmj.generators.sensors import sigmas
from fishmj.generators.trials import Effects, generate, robot_of
from fishmj.log import Trial
from fishmj.mjcf.description import Robot

BOUND = 5.0
HEALTHY = 8  # robots of the family, beside the one in question
FIRST = 700_000_000  # their seeds: beyond those that a benchmark draws


class Seen(NamedTuple):
    """Channels of one record at its stamps: (K, C) values, (C,) noise."""

    t: np.ndarray
    values: np.ndarray
    sigma: np.ndarray


def detectable(
    family: str, effects: Effects, excitations: Iterable[str | Excitation], seed: int, noise: float = 1.0, nuisance: float = 0.1,
    robot: "str | Robot" = "fish", healthy: int = HEALTHY,
) -> dict:  # fmt: skip
    """Mean squares of all that is hidden together and of each effect alone.

    Returns:
        {"all": .., "each": {name: ..}, "noise_only": .., "each_noise_only": {..}, "bound": 5, "healthy": how many robots}
    Raises:
        as `trials.generate`.
    """
    runs = list(excitations)
    if not effects:
        return {"all": 0.0, "each": {}, "noise_only": 0.0, "each_noise_only": {}, "bound": BOUND, "healthy": 0}

    sigma = sigmas(robot_of(family, {}, seed, nuisance=nuisance, robot=robot), noise)

    def seen(hidden: Effects, of: int) -> list[Seen]:
        return [s for trial in generate(family, hidden, runs, of, 0.0, nuisance, robot) for s in channels(trial, sigma)]

    plain, others = seen({}, seed), [seen({}, FIRST + k) for k in range(healthy)]
    spread = [spreads([o[i] for o in others], plain[i]) for i in range(len(plain))]
    alone = {name: {name: values} for name, values in effects.items()}
    both = {name: shares(seen(h, seed), plain, spread) for name, h in {"": effects, **_several(alone)}.items()}
    each = {name: both.get(name, both[""]) for name in effects}
    return {
        "all": both[""][0],
        "each": {name: one[0] for name, one in each.items()},
        "noise_only": both[""][1],
        "each_noise_only": {name: one[1] for name, one in each.items()},
        "bound": BOUND,
        "healthy": healthy,
    }


def _several(alone: Mapping[str, Effects]) -> Mapping[str, Effects]:
    """Of one effect alone, the whole says it already."""
    return alone if len(alone) > 1 else {}


def channels(trial: Trial, sigma: Mapping[str, float]) -> list[Seen]:
    """Joints, pose and power of a trial; sigma: noise of each column."""
    out = []
    for table, names in (("joint", [n for n in trial.table("joint") if n != "t"]), ("pose", ["x", "y", "yaw"])):
        rows = trial.table(table)
        out.append(Seen(rows["t"], np.stack([rows[n] for n in names], 1), np.array([sigma[n] for n in names])))
    rows = trial.table("power")
    watts, error = rows["V"] * rows["I"], np.hypot(sigma["V"] * np.mean(rows["I"]), sigma["I"] * np.mean(rows["V"]))
    return [*out, Seen(rows["t"], watts[:, None], np.array([error]))]


def at(seen: Seen, t: np.ndarray) -> np.ndarray:
    """(K, C) values at other stamps, straight between."""
    return np.stack([np.interp(t, seen.t, column) for column in seen.values.T], 1)


def spreads(others: list[Seen], plain: Seen) -> np.ndarray:
    """(K, C) variance of healthy robots at the stamps of `plain`."""
    return np.var([at(other, plain.t) for other in others], axis=0, ddof=1)


def shares(hidden: list[Seen], plain: list[Seen], spread: list[np.ndarray]) -> tuple[float, float]:
    """(mean square over noise and healthy robots, over noise alone), every record and channel alike."""
    both, alone = [], []
    for h, p, d in zip(hidden, plain, spread, strict=True):
        square, floor = (at(h, p.t) - p.values) ** 2, np.broadcast_to(p.sigma**2, p.values.shape)
        both += list((square / np.maximum(floor + d, 1e-30)).mean(0))
        alone += list((square / np.maximum(floor, 1e-30)).mean(0))
    return float(np.mean(both)), float(np.mean(alone))
