"""Scales the second robot's water until its fish swims like the questioned model's.

    s* = argmin sum_k ((v_k(s) - v_k) / tolerance)^2 + sum (ln s / WIDE)^2        v: speed and yaw rate of `SWIMS`

A model with calibrated water (`fishmj calibrate water` states `[water] model = "structured"`) swims like the logged fish. The
second robot in its own water does not: its speed is off by tens of per cent, which makes a useless null. Four scales correct that
and keep the second robot's equations, so what remains is the difference of two forms of water calibrated to one fish. A
description with literature values is not scaled, because the second robot's water has such values too.
"""

from collections.abc import Callable
from itertools import count

import numpy as np
from scipy.optimize import least_squares

from fishmj.gap.laboratory.virtual_robot.robot_constants import AS_IT_IS, WaterScales, nominal
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records.movement import mean_speed_and_yaw_rate
from fishmj.gap.records.records import record_of
from fishmj.log import excitation
from fishmj.mjcf.description import Robot
from fishmj.water.choice import STRUCTURED
from fishmj.water.dynamics.tolerance import of_movement

SWIMS = ("gait", "gait_slow", "gait_fast", "gait_small", "turn_left", "tow_ahead", "tow_sideways")
WIDE = 0.7  # prior standard deviation of ln s (chosen: a factor of two)
STEP, ROUNDS = 0.05, 8  # difference of ln s for slopes; largest number of iterations


def scales_for(model, bars: Bars = silent_bar) -> WaterScales:
    """Scales for a searched model, found once per process; unit scales if its water was never calibrated."""
    key = repr(model.robot)
    if model.robot.water.get("model") != STRUCTURED:
        return AS_IT_IS
    if key not in _known:
        with bars(ROUNDS * (1 + len(AS_IT_IS)), "second robot's water", "swims") as bar:
            _known[key] = matched(model, bar.update)
    return _known[key]


_known: dict[str, WaterScales] = {}


def matched(model, tick: Callable[[int], None] = lambda done: None) -> WaterScales:
    """Scales by which the second robot swims like the model without its listed effects. tick: number of finished sets."""
    records, done = swim_second_robot(model.robot, AS_IT_IS, model.dt), count(1)
    shown = model.predict(records, getattr(model, "nothing", model.null))
    wanted = [mean_speed_and_yaw_rate(r.pose.t, p["pose"][0]) for r, p in zip(records, shown, strict=True)]

    def off(logs: np.ndarray) -> np.ndarray:
        out = list(logs / WIDE)
        for record, (speed, turn) in zip(
            swim_second_robot(model.robot, WaterScales(*np.exp(logs)), model.dt), wanted, strict=True
        ):
            mine, tolerance = mean_speed_and_yaw_rate(record.pose.t, record.pose.values), of_movement(speed, 0.0, turn)
            out += [(mine[0] - speed) / tolerance[0], (mine[1] - turn) / tolerance[1]]
        tick(next(done))
        return np.array(out)

    found = least_squares(off, np.zeros(len(AS_IT_IS)), diff_step=STEP, x_scale=WIDE, max_nfev=ROUNDS)
    return WaterScales(*np.exp(found.x).tolist())


def swim_second_robot(robot: Robot, scales: WaterScales, dt: float) -> list:
    """Records of the second robot on `SWIMS`, without noise and with its nominal constants."""
    from fishmj.gap.laboratory.virtual_robot.trials import trial_of

    made, out = nominal(robot, scales=scales), []
    for name in SWIMS:
        what = excitation.get(name, robot.n_joints)
        out.append(record_of(trial_of(made, what, 0, 0, 0.0, name, "", (0.0, 0.0)), dt))
    return out
