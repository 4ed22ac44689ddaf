"""Does each part of the model earn its place? The same data fitted without it, judged on the same held-out records."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fishmj.hydro_fit import chain
from fishmj.hydro_fit.check import judge
from fishmj.hydro_fit.fit.prior import flat
from fishmj.hydro_fit.fit.recipe import Fit, Settings
from fishmj.hydro_fit.model import HydroModel, robot_hash
from fishmj.hydro_fit.record import Record
from fishmj.mjcf.description import Robot

VARIANTS: dict[str, dict] = {
    "strips by forces alone": {"residual": False, "rollout": False},
    "strips, rollout fit": {"residual": False},
    "residual without memory": {"memory": False},
    "residual with wake, no rollout fit": {"rollout": False},
    "residual with wake": {},
}
SHOWN = (
    "speed_error_mean",
    "speed_error_max",
    "yaw_rate_error_mean",
    "power_error_mean",
    "thrust_error",
    "freerun_position_error",
)


def ablate(
    robot: Robot, train: Sequence[Record], val: Sequence[Record], test: Sequence[Record], *, settings: Settings, say: Callable
) -> list[dict]:
    """One row of figures a variant, the unfitted strips first.

    Args:
        settings: of the whole model; each variant changes some. say: called with each row when it is there.
    """
    rows = [{"variant": "strips, prior coefficients"} | _figures(unfitted(robot), robot, test)]
    say(rows[-1])
    for name, changes in VARIANTS.items():
        fit = Fit(robot, train, val, dataset={}, settings=replace(settings, **changes))
        rows.append({"variant": name} | _figures(fit.run(), robot, test))
        say(rows[-1])
    return rows


def unfitted(robot: Robot) -> HydroModel:
    """The robot's own water table as a model."""
    water, ch = chain.nominal(robot).water, chain.chain_of(robot)
    members = np.tile(flat(water), (5, 1))
    return HydroModel(
        name="prior",
        robot=robot.name,
        robot_sha256=robot_hash(robot),
        dt=ch.dt,
        slip=1.0,
        base=water,
        members=members,
        alone=np.concatenate([members[:1], members]),
    )


def _figures(model: HydroModel, robot: Robot, test: Sequence[Record]) -> dict:
    found = judge(model, robot, test)["figures"]
    return {key: found[key] for key in SHOWN}
