"""Effects and faults that can be hidden in a generator's robot: effects of the catalogue in this room's formulas, and others.

An effect of the catalogue has the name, the units and the bounds of `fishmj.effects`; its action on the robot is
written here, mostly in MuJoCo's own fields. Effects that no generator can hide are refused by name: gains on the strip model's
own terms (cross-flow, tail, Munk moment, wake memory, walls), turbulence, gears with play, .. Faults are in `faults.py`.
"""

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np

from fishmj import effects
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.gap.laboratory.generators import random_numbers
from fishmj.gap.laboratory.generators.faults import FAULTS
from fishmj.gap.laboratory.generators.fish import Fish
from fishmj.gap.laboratory.generators.hidden_effect import Hidden

LOTTERIES = ("random", "random_odd")


# --------------------------------------------------------------------------------------- the catalogue, written independently
def coulomb_friction(fish: Fish, torque):
    """Adds dry friction to every joint, N m."""
    fish.friction += torque


def viscous_friction(fish: Fish, damping):
    """Sets MuJoCo's joint damping, beside the back-EMF; the motor feels the back-EMF alone."""
    fish.specs.append(lambda spec: _more_damping(spec, fish, damping))


def _more_damping(spec, fish, damping):
    for i in range(fish.joints):
        joint = spec.joint(f"j{i + 1}")
        joint.damping = np.asarray(joint.damping) + np.array([damping, 0.0, 0.0])


def servo_gain(fish: Fish, gain):
    """Scales the servos' gains kp and kv by 1 + gain."""
    fish.kp, fish.kv = fish.kp * (1.0 + gain), fish.kv * (1.0 + gain)


def torque_saturation(fish: Fish, limit):
    """Limits the servos' torque, N m."""
    fish.torque = np.minimum(fish.torque, limit)


def skin_stiffness(fish: Fish, stiffness):
    """Adds a spring to every joint, N m/rad."""
    fish.spring += stiffness


def joint_zero_offset(fish: Fish, offset1, offset2, offset3):
    """Shifts the encoders' zeros, rad; joints beyond the third share its value."""
    fish.zero += np.array([(offset1, offset2, offset3)[min(j, 2)] for j in range(fish.joints)])


def servo_deadband(fish: Fish, deadband):
    """Sets the firmware's dead band, rad."""
    fish.firmware.deadband = deadband


def command_gain_error(fish: Fish, gain):
    """Sets the firmware's relative error of commands."""
    fish.firmware.gain = gain


def command_quantisation(fish: Fish, step):
    """Sets the firmware's command step, rad."""
    fish.firmware.coarse = step


def rate_limit(fish: Fish, slowness):
    """Sets the firmware's least time per angle, s/rad."""
    fish.firmware.slowness = slowness


def move_time_ramp(fish: Fish, move_time):
    """Sets the firmware's time of each move, s."""
    fish.firmware.move_time = move_time


def voltage_sag(fish: Fish, resistance):
    """Sets the supply's internal resistance, ohm."""
    fish.resistance = resistance


def thermal_derating(fish: Fish, rate):
    """Sets the servos' rate of weakening, 1/s."""
    fish.derating = rate


def command_latency(fish: Fish, delay):
    """Delays the commands, s."""
    fish.network.latency += delay


def joint_sensor_delay(fish: Fish, delay):
    """Sets the age of joint readings, s."""
    fish.network.reading_delay = delay


def camera_latency(fish: Fish, delay):
    """Delays the poses, s."""
    fish.camera.latency += delay


def clock_offset(fish: Fish, offset, drift):
    """Sets offset [s] and drift of the camera's clock."""
    fish.camera.offset, fish.camera.drift = offset, drift


def latency_jitter(fish: Fish, sigma):
    """Sets the spread of late packets, s."""
    fish.network.late = sigma


def packet_loss(fish: Fish, probability):
    """Sets the probability of a lost packet."""
    fish.network.loss = probability


def body_mass(fish: Fish, mass, spread):
    """Adds mass [kg]: a part by each link's share of the weight, like water under the skin, the rest as a point in the head."""
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


def com_offset(fish: Fish, x):
    """Moves the head's centre of mass forward, m."""
    fish.com += x


def yaw_inertia(fish: Fish, inertia):
    """Adds yaw inertia to the head, kg m2."""
    fish.inertia += inertia


def surge_added_mass(fish: Fish, mass):
    """Adds added mass in surge, kg."""
    fish.added[0, 0] += mass


def sway_added_mass(fish: Fish, mass):
    """Adds added mass in sway, kg."""
    fish.added[1, 1] += mass


def yaw_added_mass(fish: Fish, inertia):
    """Adds added inertia in yaw, kg m2."""
    fish.added[2, 2] += inertia


def linear_surge_drag(fish: Fish, coefficient):
    """Adds linear drag on the head, N s/m."""
    fish.drag[0] += coefficient


def quadratic_drag(fish: Fish, coefficient):
    """Adds quadratic drag on the head, N s2/m2."""
    fish.drag[1] += coefficient


def yaw_drag(fish: Fish, coefficient):
    """Adds quadratic drag against turning, N m s2/rad2."""
    fish.drag[2] += coefficient


def body_lift(fish: Fish, coefficient):
    """Adds side force at a drift angle, N s2/m2."""
    fish.drag[3] += coefficient


def steady_current(fish: Fish, x, y):
    """Adds a steady current (x, y), m/s."""
    fish.flow[:2] += (x, y)


def current_shear(fish: Fish, rate):
    """Adds a gradient of the current across the tank, 1/s."""
    fish.flow[3] += rate


def swirl(fish: Fish, rate):
    """Adds a rotation of the water about the tank's centre, rad/s."""
    fish.flow[3] -= rate
    fish.flow[4] += rate


def tether(fish: Fish, stiffness, x, y):
    """Ties the head to a point (x, y) [m] by a spring, N/m."""
    fish.tether[:] = stiffness, x, y


def camera_scale(fish: Fish, scale):
    """Sets the relative error of the camera's scale."""
    fish.camera.scale = scale


def camera_yaw(fish: Fish, angle):
    """Turns the camera against the tank, rad."""
    fish.camera.turned = angle


def heading_marker_offset(fish: Fish, angle):
    """Turns the heading marker, rad."""
    fish.camera.heading = angle


def marker_offset(fish: Fish, x):
    """Moves the tracked marker forward, m."""
    fish.camera.marker = x


def lens_distortion(fish: Fish, k1):
    """Sets the lens's radial distortion, 1/m2."""
    fish.camera.lens = k1


def power_offset(fish: Fish, power):
    """Sets the power meter's offset, W."""
    fish.meter.offset = power


ACTS: tuple[Callable, ...] = (
    *(coulomb_friction, viscous_friction, servo_gain, torque_saturation, skin_stiffness, joint_zero_offset, servo_deadband),
    *(command_gain_error, command_quantisation, rate_limit, move_time_ramp, voltage_sag, thermal_derating),
    *(command_latency, joint_sensor_delay, camera_latency, clock_offset, latency_jitter, packet_loss),
    *(body_mass, com_offset, yaw_inertia, surge_added_mass, sway_added_mass, yaw_added_mass),
    *(linear_surge_drag, quadratic_drag, yaw_drag, body_lift, steady_current, current_shear, swirl, tether),
    *(camera_scale, camera_yaw, heading_marker_offset, marker_offset, lens_distortion, power_offset),
)


@cache
def hidden() -> dict[str, Hidden]:
    """All effects and faults that can be hidden, effects of the catalogue first."""
    known = effects.catalogue()
    own = {f.__name__: Hidden(f.__name__, known[f.__name__].parameters, f, True, known[f.__name__].about) for f in ACTS}
    return own | {f.name: f for f in FAULTS}


def parse(texts: list[str], seed: int, family: str) -> dict[str, dict[str, float]]:
    """Parses the effects to hide: `NAME`, `NAME=value` (first parameter), `NAME:p=1,q=2`, `random`, `random_odd` (a fault).

    Missing values are drawn from the seed at typical size; `NAME:p=1` leaves the other parameters at their null.

    Raises:
        UnknownName, ConfigError: no such effect here, no number, a value out of bounds, an effect twice, none left to draw.
    """
    known = hidden()
    out: dict[str, dict[str, float]] = {}
    for position, text in enumerate(texts):
        rng = random_numbers.stream(seed, "lottery", position)
        name, colon, listed = text.partition(":")
        main = "" if colon else name.partition("=")[2]
        name = name.partition("=")[0]
        if name in LOTTERIES:
            left = [n for n, h in known.items() if h.catalogued == (name == "random") and n not in out]
            if colon or main or not left:
                raise ConfigError(f"gap plant {text[:60]}: {name} draws one of the {len(left)} that are left, and its size")
            name = str(rng.choice(left))
        if name not in known:
            if name in effects.catalogue():
                raise ConfigError(f"gap plant {text[:60]}: generator {family} cannot hide {name}; it hides {', '.join(known)}")
            raise UnknownName("effect", name[:60], [*known, *LOTTERIES])
        if name in out:
            raise ConfigError(f"gap plant {text[:60]}: {name} is there already; say all of it in one NAME:p=1,q=2")
        values = known[name].draw(rng) if not colon else dict(known[name].nulls)
        pairs = [(known[name].parameters[0].name, main)] if main else [p.partition("=")[::2] for p in listed.split(",") if colon]
        for key, value in pairs:
            values[key.strip()] = _number(text, value)
        _within(text, known[name], values)
        out[name] = values
    return out


def _number(text: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise ConfigError(f"gap plant {text[:60]}: {value[:40]!r} is no finite number; write NAME=0.03 or NAME:p=0.03,q=1 (SI)")
    return number


def _within(text: str, what: Hidden, values: Mapping[str, float]) -> None:
    known = {p.name: p for p in what.parameters}
    for name, value in values.items():
        if name not in known:
            raise UnknownName(f"parameter of {what.name}", name[:60], known)
        p = known[name]
        if not p.low <= value <= p.high:
            raise ConfigError(f"gap plant {text[:60]}: {name} = {value:g}; expected {p.low:g} to {p.high:g} {p.unit}")
