"""Gains of the controllers: data/calib/controllers.toml, every one with unit and source."""

from functools import cache

import numpy as np

from fishmj.calib import calib_folder, read_toml
from fishmj.errors import ConfigError, UnknownName
from fishmj.mjcf.description import Robot


@cache
def _file() -> dict:
    return read_toml(calib_folder() / "controllers.toml")


def gains_of(section: str, changes: dict | None = None) -> dict:
    """Values of one section, some of them changed.

    A section with `like = "other"` starts from that section. Raises UnknownName for a gain that does not exist.
    """
    table = dict(_file()[section])
    base = table.pop("like", None)
    values = gains_of(base) if base else {}
    values.update({key: entry["value"] for key, entry in table.items()})
    for key in changes or {}:
        if key not in values:
            raise UnknownName(f"gain of {section}", key, values)
    return {**values, **(changes or {})}


def gait_of(robot: Robot, name: str) -> dict:
    """The section `gait`, for the controller `name` of this robot; `lag` is in rad.

    Raises:
        ConfigError: the robot has not the joints that the gait is for.
    """
    gait = gains_of("gait")
    lag = np.radians(gait["lag_deg"])
    if len(lag) != robot.n_joints:
        raise ConfigError(
            f"controller {name}: its gait is for {len(lag)} joints, {robot.name} has {robot.n_joints}; use drift or a policy"
        )
    return {**gait, "lag": lag}
