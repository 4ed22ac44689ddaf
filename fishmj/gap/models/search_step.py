"""The longest step at which a robot may be searched."""

from collections.abc import Sequence

import numpy as np

from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import RobotDescription
from fishmj.gap.models.robot_sizes import RobotSizes
from fishmj.gap.records.shooting import RobotRecord, assumed, thinned


def coarsest(robot: RobotDescription, sizes: RobotSizes, records: Sequence[RobotRecord], without: frozenset[str]) -> int:
    """Largest stride whose relative error in the response to each effect, at a small usual size, is below `step_error`.

    without: effects that are not searched.
    """
    limits = assumed("segments")
    some = thinned(list(records[:1]), int(limits["tried"]))
    exact = RigidRobot(robot, sizes, without=without)
    rows = np.tile(exact.nothing, (1 + len(exact.active.names), 1))
    for k, p in enumerate(p for effect in exact.active.effects for p in effect.parameters):
        rows[1 + k, len(exact.constants) + k] = p.typical[0]

    def changes(model: RigidRobot) -> np.ndarray:
        seen = model.predict(some, rows)[0]["joint"]
        return ((seen[1:] - seen[0]) / some[0].joint.sigma).reshape(len(rows) - 1, -1)

    known = changes(exact)
    size = np.maximum(np.linalg.norm(known, axis=1), np.sqrt(known.shape[1]))  # below the noise, any error is allowed
    stride = int(limits["step"] / robot.dt)
    while stride > 1:
        off = np.linalg.norm(changes(RigidRobot(robot, sizes, without=without, stride=stride)) - known, axis=1) / size
        if np.all(off < limits["step_error"]):
            break
        stride = 2 * stride // 3
    return max(stride, 1)
