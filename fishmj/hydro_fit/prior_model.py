"""The water of a description with nothing fitted, as a model: the baseline of checks, and the first water of corrections."""

import numpy as np

from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import body_sha256
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import flat


def unfitted(robot: Robot) -> HydroModel:
    """Model with the robot's own water table."""
    water, ch = planar_chain.nominal(robot).water, planar_chain.chain_of(robot)
    members = np.tile(flat(water), (5, 1))
    return HydroModel(
        name="prior",
        robot=robot.name,
        robot_sha256=robot_hash(robot),
        body_sha256=body_sha256(robot),
        dt=ch.dt,
        slip=1.0,
        base=water,
        members=members,
        alone=np.concatenate([members[:1], members]),
    )
