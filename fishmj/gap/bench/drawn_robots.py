"""Robots of a benchmark over families, and the cases that each of them carries: all from the seed.

    robots(200, 3, ("foil", "ellipsoid"))      [BenchRobot] with 200 cases in sum

Calibration and null runs belong to a robot, so a robot carries about six cases: one with nothing hidden, three singles, a
pair, in seven of ten a fault outside the catalogue. Many singles are too small to be seen among healthy robots. Of those, and of
pairs with such an effect, one in `SPARSE` is searched (`is_searched`), drawn before the search. Of two robots of a family one is
the shipped fish, the other a drawn chain: 2 to 6 links, lengths, masses and servos within `RANGES`.
"""

from collections.abc import Iterator
from itertools import count
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.gap.bench import families
from fishmj.gap.bench.cases import STRENGTH, BenchCase, draw_card
from fishmj.gap.laboratory.generators.detectability import BOUND
from fishmj.log import excitation
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

LOGS = 6  # of a session, drawn once a robot
OFF = 7  # of ten robots of a family that carry one
SINGLES, PAIRS = 3, 1
SPARSE = 3
PAIRED = (1.0, 3.0)  # of the typical magnitude: smaller ones leave few pairs of which each shows among healthy robots
RANGES = {  # of a drawn chain: low, high; log-uniform, as of fish that are built of hobby servos (chosen)
    "length": (0.42, 0.75),  # m
    "height": (0.15, 0.23),  # of the length
    "width": (0.5, 0.8),  # of the height
    "tail": (1.0, 1.6),  # height of the tail fin, of the body's
    "mass": (0.92, 1.08),  # of what the outline displaces
    "head": (0.32, 0.48),  # of the length, of three links or more
    "torque": (1.0, 3.5),  # N m at stall
    "speed": (4.0, 8.0),  # rad/s without load
}
LINKS = (2, 6)
VOLTS = (5.0, 7.4, 12.0)
SLOWEST = 0.05  # body lengths a second; what swims slower is drawn again
DRAWS = 40
FIRST = 100_000_000  # seed of the first robot: beyond those of null runs, below those that tell a family's spread


class BenchRobot(NamedTuple):
    """One robot. drawn: True for a drawn description; seed: of its constants, its noise and its description."""

    id: str
    family: str
    drawn: bool
    seed: int
    cases: tuple[BenchCase, ...]


def robots(many: int, seed: int, names: tuple[str, ...], kinds, logs: int = LOGS) -> list[BenchRobot]:
    """Robots with `many` cases of these kinds in sum; the last one may carry fewer. A larger `many` keeps the earlier robots."""
    out: list[BenchRobot] = []
    left = many
    for robot in every(seed, names, logs):
        mine = tuple(case for case in robot.cases if case.kind in kinds)[:left]
        if mine:
            out.append(robot._replace(cases=mine))
        left -= len(mine)
        if not left:
            return out
    return out


def every(seed: int, names: tuple[str, ...], logs: int) -> Iterator[BenchRobot]:
    """Endless robots: the families in turn, in another order each time."""
    decks: dict[tuple[str, str], list[str]] = {(name, kind): [] for name in names for kind in ("single", "off")}
    for turn in count():
        order = np.random.default_rng([seed, 11, turn, len(names)]).permutation(len(names))
        for place in order:
            family = names[place]
            number = families.NAMES.index(family)
            carries = _carries(np.random.default_rng([seed, 12, number, turn // 10]), turn % 10)
            rng = np.random.default_rng([seed, 13, number, turn])
            first = int(np.random.default_rng([seed, 14, number, turn // 2]).integers(2))
            robot = FIRST + 1_000_000 * (seed % 500) + 10_000 * number + turn
            name = f"{family}-{seed}-{turn:04d}"
            session = sorted(rng.permutation(len(excitation.DESIGNED))[:logs])
            runs = tuple(excitation.DESIGNED[k] for k in session)
            hidden = _hidden(family, carries, decks, rng)
            told = [BenchCase(f"{name}-{i}", kind, effects, 1.0, runs, robot) for i, (kind, effects) in enumerate(hidden)]
            yield BenchRobot(name, family, (turn + first) % 2 == 1, robot, tuple(told))


def _carries(rng, place: int) -> list[str]:
    """Kinds of the cases of one of ten robots."""
    off = ["off"] if place in rng.permutation(10)[:OFF] else []
    return ["none", *["single"] * SINGLES, *["pair"] * PAIRS, *off]


def number_of(case: BenchCase) -> int:
    """Number of a case among those of its robot."""
    return int(case.id.rpartition("-")[2])


def is_searched(case: BenchCase, each: dict[str, float]) -> bool:
    """Returns True if a case is searched. each: mean square of each hidden effect, by the generator."""
    if case.kind not in ("single", "pair") or min(each.values()) > BOUND:
        return True
    return int(np.random.default_rng([case.seed, 16, number_of(case)]).integers(SPARSE)) == 0


def _hidden(family: str, kinds: list[str], decks: dict, rng) -> Iterator[tuple[str, dict]]:
    """Hidden effects of each case: (kind, {name: values})."""
    able = families.pool(family)
    for kind in kinds:
        source = able.off if kind == "off" else able.catalogued
        if kind == "pair":
            chosen = [str(n) for n in rng.choice(list(source), 2, replace=False)]
        else:
            chosen = [] if kind == "none" else [draw_card(decks[family, kind], list(source), rng)]
        low, high = np.log(PAIRED if kind == "pair" else STRENGTH)
        yield kind, {name: source[name].draw(rng, float(np.exp(rng.uniform(low, high)))) for name in chosen}


# ------------------------------------------------------------------------------------------------------------------- descriptions
class DescribedRobot(NamedTuple):
    """A robot's true description. redraws: number of rejected chains before it; speed: body lengths a second in its own water."""

    robot: Robot
    redraws: int
    speed: float


def describe_robot(one: BenchRobot) -> DescribedRobot:
    """The shipped fish, or the first drawn chain that swims in its family's own water.

    Raises ConfigError: none of `DRAWS` chains swims.
    """
    rng = np.random.default_rng([one.seed, 15])
    for redraws in range(DRAWS):
        robot = chain(rng, one.id) if one.drawn else load_robot("fish")
        try:
            speed = families.lengths_a_second(one.family, one.seed, robot)
        except SimDiverged:
            speed = 0.0
        if speed >= SLOWEST or not one.drawn:
            return DescribedRobot(robot, redraws, speed)
    raise ConfigError(f"gap bench: robot {one.id}: none of {DRAWS} drawn chains swims {SLOWEST:g} body lengths a second")


def chain(rng: np.random.Generator, name: str) -> Robot:
    """A drawn fish, made as `fishmj new` makes one."""
    from fishmj.mjcf.new.fish_toml import SIDE_SPAN, FishAnswers, robot_of
    from fishmj.mjcf.new.shape import joints_of, typical
    from fishmj.mjcf.servos import DataSheet

    drawn = {key: float(np.exp(rng.uniform(*np.log(ends)))) for key, ends in RANGES.items()}
    links, volts = int(rng.integers(LINKS[0], LINKS[1] + 1)), float(rng.choice(VOLTS))
    length = round(drawn["length"], 3)
    height = round(drawn["height"] * length, 4)
    outline = typical(length, height, round(drawn["width"] * height, 4), round(drawn["tail"] * height, 4))
    sheet = DataSheet(name="drawn", stall_torque=round(drawn["torque"], 3), no_load_speed=round(drawn["speed"], 2), voltage=volts)
    joints = joints_of(length, links, None if links == LINKS[0] else drawn["head"])
    mass, span = round(drawn["mass"] * outline.displaced, 4), round(SIDE_SPAN * length, 3)
    return robot_of(FishAnswers(name=name, outline=outline, mass=mass, joints=joints, sheet=sheet, side_span=span, origin={}))
