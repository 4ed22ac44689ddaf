"""The swimming fish with adjustable water: the strip coefficients are parameters of a row.

row = [k and cn of head, body and tail as factors; the other coefficients in SI; the effects that the description lists]
"""

from typing import NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base.calib import calib_folder, read_toml
from fishmj.gap.models.swimming_fish import Constant, SwimmingFish
from fishmj.gap.records.records import Record
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water import prior
from fishmj.water.dynamics import planar_chain, strip_forces

WHERE = ("head", "body", "tail")
LIFT = 0.5  # that lift_a + lift_b are at least
LEAST = 0.05  # least prior standard deviation, as a share of the largest allowed value: for coefficients described as zero


class FreeNumber(NamedTuple):
    """An adjustable parameter of the water: its coefficient and, for a list, the place (head, body, tail)."""

    name: str
    coefficient: str
    where: str


class ParameterPrior(NamedTuple):
    """Described value of a number, its bounds, and one standard deviation of its prior.

    The prior is in data/calib/hydro_fit.toml; that of the strips' shape in calibrate.toml.
    """

    start: float
    low: float
    high: float
    sigma: float
    unit: str


def places(links: int) -> list[str]:
    """Place of each link: head, body or tail."""
    return ["head", *["body"] * (links - 2), "tail"]


def free_numbers(links: int) -> list[FreeNumber]:
    """All adjustable numbers for a fish of so many links."""
    lists = [FreeNumber(f"{c}_{w}", c, w) for c in ("k", "cn") for w in WHERE if w in places(links)]
    return lists + [FreeNumber(c, c, "") for c in strip_forces.Coefficients._fields[2:] if c not in prior.FIXED]


class StripWaterFish(SwimmingFish):
    """A fish in adjustable strip water.

    Args: robot: description, path or name, in the water of its own strips. more: names of effects that a row also has.
    """

    def __init__(self, robot: "Robot | str" = "fish", more: tuple[str, ...] = ()):
        robot = load_robot(robot)
        super().__init__(robot, [effects.get(name) for name in dict.fromkeys([*(f.name for f in robot.effects), *more])])
        self.free = free_numbers(len(robot.links))
        self.constants = tuple(Constant(name, np.inf) for name in (*(f.name for f in self.free), *strip_forces.SHAPE))

    @property
    def nothing(self) -> np.ndarray:
        """(P,) row of the described robot, without any effect."""
        described = [1.0 if f.where else float(getattr(self.nominal.water, f.coefficient)) for f in self.free]
        shape = [float(self.robot.water.get(name, default)) for name, default in strip_forces.SHAPE.items()]
        return np.array([*described, *shape, *self.active.null])

    def ranges(self) -> list[ParameterPrior]:
        """Range of every number, within the prior of its coefficient."""
        out = []
        for f, start in zip(self.free, self.nothing, strict=False):
            row, values = prior.table()[f.coefficient], np.atleast_1d(getattr(self.nominal.water, f.coefficient))
            low, high = row["low"], row["high"]
            if f.where:  # a factor on the coefficients of these links
                mine = [v for v, w in zip(values, places(self.chain.n), strict=True) if w == f.where]
                low, high = low / max(min(mine), 1e-9), high / max(max(mine), 1e-9)
            sigma = row["sd"] * max(start, LEAST * high)
            out.append(ParameterPrior(float(start), float(low), float(high), float(sigma), "factor" if f.where else row["unit"]))
        of_shape = read_toml(calib_folder() / "calibrate.toml")["water"]
        for name, start in zip(strip_forces.SHAPE, self.nothing[len(self.free) :], strict=False):
            row = of_shape[name]
            out.append(ParameterPrior(float(start), row["low"], row["high"], row["sd"], row["unit"]))
        return out

    def rows(self, thetas: np.ndarray) -> np.ndarray:
        """(R, P) of numbers (R, K)."""
        rows = np.tile(self.null, (len(thetas), 1))
        rows[:, : len(self.constants)] = thetas
        return rows

    def water(self, values) -> strip_forces.Coefficients:
        """Coefficients of the free numbers; entries may be arrays."""
        given, w = {f.name: value for f, value in zip(self.free, values, strict=False)}, self.nominal.water
        spread = lambda c: [v * given[f"{c}_{at}"] for v, at in zip(getattr(w, c), places(self.chain.n), strict=True)]
        single = {f.coefficient: given[f.name] for f in self.free if not f.where}
        # a smaller normal force would feed energy to the fish (docs/simulate/water.md)
        short = LIFT - single["lift_a"] - single["lift_b"]
        single["lift_b"] = single["lift_b"] + 0.5 * (short + abs(short))
        return w._replace(k=spread("k"), cn=spread("cn"), **single)

    def _chain(self, row) -> planar_chain.Chain:
        edge, held, linear = (row[len(self.free) + i] for i in range(len(strip_forces.SHAPE)))
        strips = self.chain.strips
        strips = strips._replace(edge_x=strips.tail_x * edge, held=held, linear=strip_forces.linear_parts(strips.p, linear))
        return self.chain._replace(strips=strips)

    def _swimmer(self, row) -> planar_chain.Swimmer:
        return self.nominal._replace(water=self.water([row[i] for i in range(len(self.free))]))


class GatedWater(StripWaterFish):
    """The same with numbers that may change over time: theta_k(t) = theta_k + delta_k g(t).

    row = [numbers theta, swings delta of each, effects]; g(t) is the last column of a record's commands.
    """

    def __init__(self, robot: "Robot | str" = "fish", more: tuple[str, ...] = ()):
        super().__init__(robot, more)
        self.inputs = self.joints + 1  # the gate beside the commands
        self.numbers = self.constants
        self.constants = (*self.numbers, *(Constant(f"{c.name} swing", np.inf) for c in self.numbers))

    @property
    def nothing(self) -> np.ndarray:
        """(P,) row of the described robot, without any effect."""
        described = super().nothing
        at = len(self.numbers)
        return np.concatenate([described[:at], np.zeros(at), described[at:]])

    def _step(self, state, command, row):
        at = len(self.numbers)
        turned = [row[k] + command[self.joints] * row[at + k] for k in range(at)]
        return super()._step(state, command[: self.joints], [*turned, *row[at:]])

    def gated(self, record: Record, gate: np.ndarray) -> Record:
        """The record with g (T,) as one more command."""
        return record._replace(commands=np.concatenate([record.commands, gate[:, None]], 1))


def strips_of(model: SwimmingFish, more: tuple[str, ...]) -> GatedWater:
    """Model of the same robot with the coefficients of its water and the effects `more` as numbers of a row; made once."""
    made = vars(model).setdefault("strips", {})
    if more not in made:
        made[more] = GatedWater(model.robot, more)
    return made[more]
