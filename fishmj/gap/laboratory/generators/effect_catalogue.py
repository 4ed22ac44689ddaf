"""Effects and faults that a generator's robot can hide: effects of the catalogue, implemented independently, and faults.

An effect of the catalogue has the name, units and bounds of `fishmj.effects`; its action on the robot is implemented here, mostly
by fields of MuJoCo. Effects that no generator can hide are refused by name: gains on terms of the strip model (cross-flow, tail,
Munk moment, wake memory, walls), turbulence, backlash, .. Faults are in `uncatalogued_faults.py`.
"""

from collections.abc import Callable
from functools import cache, reduce

import numpy as np

from fishmj import effects
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.gap.laboratory.effect_text import check_range, finite_number, split_text
from fishmj.gap.laboratory.generators.robot_parameters import HiddenEntry, RobotParameters
from fishmj.gap.laboratory.generators.uncatalogued_faults import FAULTS
from fishmj.gap.laboratory.random_streams import generators_stream

LOTTERIES = ("random", "random_odd")


# ------------------------------------------------------------------------------------------- the catalogue, implemented once more
def added_to(field: str, *entry: int) -> Callable:
    """Returns an action that adds an effect's only parameter to a field of `RobotParameters` ("camera.scale") or to its entry."""
    *groups, key = field.split(".")

    def act(fish: RobotParameters, **values):
        (value,), group = values.values(), reduce(getattr, groups, fish)
        if entry:
            getattr(group, key)[entry] += value
        else:
            setattr(group, key, getattr(group, key) + value)

    return act


def viscous_friction(fish: RobotParameters, damping):
    """Adds to MuJoCo's joint damping, which holds the back-EMF too; the motor has the back-EMF alone."""
    fish.specs.append(lambda spec: _more_damping(spec, fish, damping))


def _more_damping(spec, fish, damping):
    for i in range(fish.joints):
        joint = spec.joint(f"j{i + 1}")
        joint.damping = np.asarray(joint.damping) + np.array([damping, 0.0, 0.0])


def servo_gain(fish: RobotParameters, gain):
    """Scales the servos' gains kp and kv by 1 + gain."""
    fish.kp, fish.kv = fish.kp * (1.0 + gain), fish.kv * (1.0 + gain)


def torque_saturation(fish: RobotParameters, limit):
    """Limits the servos' torque, N m."""
    fish.torque = np.minimum(fish.torque, limit)


def joint_zero_offset(fish: RobotParameters, offset1, offset2, offset3):
    """Shifts the encoders' zeros, rad; joints beyond the third share its value."""
    fish.zero += np.array([(offset1, offset2, offset3)[min(j, 2)] for j in range(fish.joints)])


def clock_offset(fish: RobotParameters, offset, drift):
    """Sets offset [s] and drift of the camera's clock."""
    fish.camera.offset, fish.camera.drift = offset, drift


def body_mass(fish: RobotParameters, mass, spread):
    """Adds mass [kg]: the share `spread` in proportion to the links' masses, like water under the skin, the rest as a point."""
    own = np.array([link.mass for link in fish.robot.links])
    fish.mass += spread * mass * own / own.sum()
    fish.specs.append(lambda spec: _payload(spec, fish, (1.0 - spread) * mass))


def _payload(spec, fish, mass):
    """Adds a point mass at the reference point: the head's centre of mass moves towards it."""
    if mass == 0.0:
        return
    body = spec.body(fish.robot.links[0].name)
    own, at = float(body.mass), np.asarray(body.ipos, float)
    body.mass, body.ipos = own + mass, at * own / (own + mass)
    turn = own * mass / (own + mass) * (at @ at * np.ones(3) - at**2)
    body.inertia = np.asarray(body.inertia) + turn


def steady_current(fish: RobotParameters, x, y):
    """Adds a steady current (x, y), m/s."""
    fish.flow[:2] += (x, y)


def swirl(fish: RobotParameters, rate):
    """Adds a rotation of the water about the tank's centre, rad/s."""
    fish.flow[3] -= rate
    fish.flow[4] += rate


def tether(fish: RobotParameters, stiffness, x, y):
    """Ties the head to a point (x, y) [m] by a spring, N/m."""
    fish.tether[:] = stiffness, x, y


ACTS: dict[str, Callable] = {
    "coulomb_friction": added_to("friction"),
    "viscous_friction": viscous_friction,
    "servo_gain": servo_gain,
    "torque_saturation": torque_saturation,
    "skin_stiffness": added_to("spring"),
    "joint_zero_offset": joint_zero_offset,
    "servo_deadband": added_to("firmware.deadband"),
    "command_gain_error": added_to("firmware.gain"),
    "command_quantisation": added_to("firmware.coarse"),
    "rate_limit": added_to("firmware.slowness"),
    "move_time_ramp": added_to("firmware.move_time"),
    "voltage_sag": added_to("resistance"),
    "thermal_derating": added_to("derating"),
    "command_latency": added_to("network.latency"),
    "joint_sensor_delay": added_to("network.reading_delay"),
    "camera_latency": added_to("camera.latency"),
    "clock_offset": clock_offset,
    "latency_jitter": added_to("network.late"),
    "packet_loss": added_to("network.loss"),
    "body_mass": body_mass,
    "com_offset": added_to("com"),
    "yaw_inertia": added_to("inertia"),
    "surge_added_mass": added_to("added", 0, 0),
    "sway_added_mass": added_to("added", 1, 1),
    "yaw_added_mass": added_to("added", 2, 2),
    "linear_surge_drag": added_to("drag", 0),
    "quadratic_drag": added_to("drag", 1),
    "yaw_drag": added_to("drag", 2),
    "body_lift": added_to("drag", 3),
    "steady_current": steady_current,
    "current_shear": added_to("flow", 3),
    "swirl": swirl,
    "tether": tether,
    "camera_scale": added_to("camera.scale"),
    "camera_yaw": added_to("camera.turned"),
    "heading_marker_offset": added_to("camera.heading"),
    "marker_offset": added_to("camera.marker"),
    "lens_distortion": added_to("camera.lens"),
    "power_offset": added_to("meter.offset"),
}


@cache
def hidden() -> dict[str, HiddenEntry]:
    """All effects and faults that can be hidden, effects of the catalogue first."""
    known = effects.catalogue()
    own = {name: HiddenEntry(name, known[name].parameters, act, True, known[name].about) for name, act in ACTS.items()}
    return own | {f.name: f for f in FAULTS}


def parse(texts: list[str], seed: int, family: str) -> dict[str, dict[str, float]]:
    """Parses the effects to hide: `NAME`, `NAME=value` (first parameter), `NAME:p=1,q=2`, `random`, `random_odd` (a fault).

    Missing values are drawn from the seed at typical size; `NAME:p=1` leaves the other parameters at their null.

    Raises UnknownName, ConfigError: no such effect here, no number, a value out of bounds, a repeated effect, none left to draw.
    """
    known = hidden()
    out: dict[str, dict[str, float]] = {}
    for position, text in enumerate(texts):
        rng = generators_stream(seed, "lottery", position)
        asked, (name, main, listed) = f"gap plant {text[:60]}", split_text(text)
        if name in LOTTERIES:
            left = [n for n, h in known.items() if h.catalogued == (name == "random") and n not in out]
            if main or listed is not None or not left:
                raise ConfigError(f"{asked}: {name} draws effect and size, so give no value; {len(left)} effects are left")
            name = str(rng.choice(left))
        if name not in known:
            if name in effects.catalogue():
                raise ConfigError(f"{asked}: generator {family} cannot hide {name}; it hides {', '.join(known)}")
            raise UnknownName("effect", name[:60], [*known, *LOTTERIES])
        if name in out:
            raise ConfigError(f"{asked}: {name} is given twice; write all its parameters in one NAME:p=1,q=2")
        values = known[name].draw(rng) if listed is None else dict(known[name].nulls)
        parameters = {p.name: p for p in known[name].parameters}
        for key, value in [(next(iter(parameters)), main)] if main else listed or ():
            values[key] = finite_number(asked, value, "NAME=0.03 or NAME:p=0.03,q=1")
        for key, number in values.items():
            if key not in parameters:
                raise UnknownName(f"parameter of {name}", key[:60], parameters)
            p = parameters[key]
            check_range(asked, key, number, p.low, p.high, p.unit)
        out[name] = values
    return out
