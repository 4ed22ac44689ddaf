"""Data classes of a robotic fish: links, fins, servos, timing. SI units, radians.

A description is a TOML file (`data/calib/fish.toml` is the paper's fish) or these dataclasses built by hand. Links are
listed from nose to tail; each hangs on the rear end of the one before it by a servo hinge about the vertical axis.
"""

from dataclasses import dataclass, field
from math import pi, radians
from typing import TYPE_CHECKING

from fishmj.base.calib import constant

if TYPE_CHECKING:
    from fishmj.effects.effect_calibration import FittedEffect

COMMAND_PATHS = ("linear", "hold", "move_time")
CELL = (3.2, 3.7, 4.2)  # V of a LiPo cell: under load, below which it is damaged; nominal; full
LOW_SHARE = CELL[0] / CELL[1]  # of the servos' voltage, where it is not one of LiPo cells
WATER_NEEDS = ("k", "cn", "cf", "ca_forward", "ca_backward", "ke", "lift_a", "lift_b", "stall_angle", "stall_width", "stall_lag")
FASTEST = 100.0  # rad/s, twice the 456 rev/min at 6 V of ROBOTIS XL330-M077-T (e-Manual), the fastest servo on record here
LIFT_ROUNDED = 1e-6  # lift_a and lift_b are written in nine digits, so that a fitted sum of 0.5 may be less


@dataclass(frozen=True, kw_only=True)
class Link:
    """One rigid link. Sections and com are measured from the link's front end, backwards."""

    name: str
    length: float  # m
    mass: float  # kg
    sections: tuple[tuple[float, float, float], ...]  # (station, height, width) m, elliptical
    com: tuple[float, float, float] | None = None  # (back from the front, left, up) m; None = centroid
    fin_from: float | None = None  # behind this station the section is a plate, m
    colour: tuple[float, float, float] | None = None  # RGB 0..1; None = of the palette, by index (mjcf.drawing)


@dataclass(frozen=True, kw_only=True)
class Fin:
    """A fixed pair of horizontal plates (damps roll)."""

    name: str
    link: str
    station: tuple[float, float]  # front and rear edge from the link's front, m
    span: float  # of each plate, m
    count: int = 2


@dataclass(frozen=True, kw_only=True)
class Servo:
    """A position servo: torque = clip(kp e - kv w, +-torque) - kb w, the torque-speed line of a DC motor.

    kb = torque / speed_no_load is the back-EMF slope, kv = kd - kb the controller's damping. [N m/rad, N m s/rad, N m, rad/s]
    """

    kp: float = 8.0
    kd: float = 0.32
    torque: float = 1.667
    speed_no_load: float = 5.236
    voltage: float = 7.4
    resistance: float = 6.27
    constant: float = 1.413
    range: float = pi / 3  # rad, commands are clamped to +-range
    resolution: float = radians(0.24)  # rad
    idle_power: float = 1.5  # W, whole robot

    @property
    def kb(self) -> float:
        """Back-EMF damping seen at the output shaft, N m s/rad."""
        return self.torque / self.speed_no_load

    @property
    def kv(self) -> float:
        """Damping that the position controller adds to the back-EMF, N m s/rad; rounding never makes it negative."""
        return max(self.kd - self.kb, 0.0)


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Steps and delays of the robot and its host, s."""

    physics_dt: float = 0.004
    bus_dt: float = 0.02
    control_dt: float = 0.2
    command_path: str = "linear"
    command_latency: float = 0.06
    camera_latency: float = 0.065
    velocity_window: int = 6  # frames

    def drawn_latency(self, key: str) -> tuple[float, float]:
        """Range of `command_latency` or `camera_latency` of a randomised fish, s.

        The paper's; for a description whose own latency lies outside of it, as wide about that one, and never below 0. A latency
        of 0 is taken as not measured.
        """
        (low, high), own = constant("randomisation", key), getattr(self, key)
        half = 0.5 * (high - low)
        return (low, high) if own == 0.0 or low <= own <= high else (max(own - half, 0.0), own + half)


@dataclass(frozen=True, kw_only=True)
class RigSpec:
    """Wiring, supply and paint of the robot, needed by its host but not by a simulation. One entry a joint, from the head.

    None means not stated; properties of `Robot` such as `servo_ids` then give the default.
    """

    bus: str = "lx"  # a name of servo_buses.BUSES
    baud: int | None = None  # None: the bus's own
    servo_ids: tuple[int, ...] | None = None
    signs: tuple[int, ...] | None = None  # -1 for a servo that turns the other way
    zeros: tuple[float, ...] | None = None  # rad, where a servo stands, from its middle, when its joint is straight
    low_voltage: float | None = None  # V, below it for a second the swim ends
    red: tuple[tuple[float, float], ...] | None = None  # painted bands of the head link: (x, width) m, body frame, x rising
    yellow: tuple[tuple[float, float], ...] | None = None
    paint_height: float = -0.005  # m over the water


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A complete description: the input of `mjcf.build` and of the water."""

    name: str
    links: tuple[Link, ...]
    servo: Servo = field(default_factory=Servo)
    fins: tuple[Fin, ...] = ()
    timing: Timing = field(default_factory=Timing)
    rig: RigSpec = field(default_factory=RigSpec, repr=False)  # no part of the fish that waters and logs are of
    water: dict = field(default_factory=dict)
    title: str = ""
    density_water: float = 1000.0  # kg/m3
    hull: str = field(default="turbulent", repr=False)  # or laminar: its boundary layer, for the flow solver's `wall_stress`
    effects: "tuple[FittedEffect, ...]" = field(default=(), repr=False)  # what calibration added, in the order in which it acts
    file: str = field(default="", repr=False, compare=False)  # from which it was read; "" if it was built by hand
    notes: tuple[str, ...] = field(default=(), repr=False, compare=False)  # what the reader was told: assumed, or unlikely

    @property
    def n_joints(self) -> int:
        """Number of joints, one less than links."""
        return len(self.links) - 1

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return sum(link.mass for link in self.links)

    @property
    def length(self) -> float:
        """Straight length, m."""
        return sum(link.length for link in self.links)

    @property
    def servo_ids(self) -> tuple[int, ...]:
        """Numbers on the servo bus, from the head to the tail; 1 to the number of joints unless the rig states them."""
        return self.rig.servo_ids or tuple(range(1, self.n_joints + 1))

    @property
    def low_voltage(self) -> float:
        """Voltage below which the battery counts as low, V.

        Unless the rig states it: 3.2 V for each LiPo cell, if the servos' voltage is a multiple of 3.7 to 4.2 V a cell; else 86 %
        of that voltage.
        """
        volts, (lowest, nominal, full) = self.servo.voltage, CELL
        cells = next((n for n in range(1, 15) if nominal * n - 1e-9 <= volts <= full * n + 1e-9), 0)
        return self.rig.low_voltage or round(lowest * cells or LOW_SHARE * volts, 2)
