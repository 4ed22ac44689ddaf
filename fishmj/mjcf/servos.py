"""Servos: `[servo]` of a description from the figures of a data sheet, named servos, and the path of a command.

A position servo is a DC motor behind gears: at the voltage V it stalls at the torque T and turns freely at w0. With K its
constant, R its resistance, both referred to the output, and kb the slope of its torque-speed line

    kb = T / w0          K = V / w0          R = V K / T          K^2 / R = kb

R includes the gears' loss, so that the power of a stalled motor is V^2 / R = T w0: the real stall current is V / (R eta), eta the
share of the torque that passes the gears. A data sheet does not describe the controller: kp saturates at 12 deg of
error and kd is the motor's own kb, as in data/calib/paper.toml for the default fish.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10, pi, radians
from typing import Any

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.mjcf.description import RigSpec, Servo

SATURATES = radians(12.0)  # rad of error at which the drive reaches the stall torque
LEAST = 0.08  # of the stalled motor's torque; less does not come out of gears but of mixed-up units
KG_CM = 0.0980665  # N m
S_PER_60_DEG = pi / 3  # rad; over the seconds it is rad/s
RPM = 2 * pi / 60  # rad/s


@dataclass(frozen=True, kw_only=True)
class DataSheet:
    """Figures of a servo's data sheet, all at one voltage; SI units, rad/s."""

    name: str
    stall_torque: float  # N m
    no_load_speed: float  # rad/s
    voltage: float  # V
    stall_current: float | None = None  # A
    resolution: float = radians(0.24)  # rad
    idle_power: float = 0.3  # W, of its own board; 0.3 is a guess, as for the default fish
    bus: str = RigSpec.bus  # kind of servo bus (servo_buses.BUSES)
    source: str = ""

    @property
    def gear_efficiency(self) -> float | None:
        """Share of the stalled motor's torque that reaches the output, T w0 / (V I); None without a stall current."""
        return self.stall_torque * self.no_load_speed / (self.voltage * self.stall_current) if self.stall_current else None


SHELF = {
    sheet.name: sheet
    for sheet in (
        DataSheet(
            name="lx-824", stall_torque=17 * KG_CM, no_load_speed=S_PER_60_DEG / 0.2, voltage=7.4,
            source="Hiwonder LX-824: 17 kg cm, 0.2 s per 60 deg at 7.4 V (as in data/calib/paper.toml); 240 deg in 1000 counts",
        ),
        DataSheet(
            name="lx-16a", stall_torque=17 * KG_CM, no_load_speed=S_PER_60_DEG / 0.19, voltage=7.4,
            source="Hiwonder LX-16A: 17 kg cm, 0.19 s per 60 deg at 7.4 V; 240 deg in 1000 counts",
        ),
        DataSheet(
            name="ax-12a", stall_torque=1.5, no_load_speed=59 * RPM, voltage=12.0, stall_current=1.5, resolution=radians(0.29),
            bus="dynamixel-ax",
            source="ROBOTIS e-Manual, AX-12A: 1.5 N m at 12 V, 1.5 A; 59 rev/min at 12 V; 0.29 deg",
        ),
        DataSheet(
            name="xl330-m288", stall_torque=0.52, no_load_speed=103 * RPM, voltage=5.0, stall_current=1.47,
            resolution=2 * pi / 4096, idle_power=0.085, bus="dynamixel-x",
            source="ROBOTIS e-Manual, XL330-M288-T: 0.52 N m at 5 V, 1.47 A; 103 rev/min at 5 V; 4096 counts; standby 17 mA",
        ),
        DataSheet(
            name="xw540-t260", stall_torque=9.5, no_load_speed=40 * RPM, voltage=12.0, stall_current=4.9,
            resolution=2 * pi / 4096, bus="dynamixel-x",
            source="ROBOTIS e-Manual, XW540-T260-R, waterproof (IP 68): 9.5 N m at 12 V, 4.9 A; 40 rev/min at 12 V; 4096 counts",
        ),
    )
}  # fmt: skip


def servo_from_sheet(sheet: DataSheet, *, idle_power: float = 1.5, where: str = "servo") -> Servo:
    """A description's servo from data sheet figures at one voltage; formulas at the top of this file.

    Args:
        sheet: its stall current only checks the others: `resistance` includes the gears' loss.
        idle_power: electronics of the whole robot, W. where: names the servo in errors.

    Raises ConfigError: a figure is not positive, or they contradict each other: a stalled motor cannot give more than V I / w0,
    nor do gears consume nearly all of it.
    """
    stall, free, volts, current = sheet.stall_torque, sheet.no_load_speed, sheet.voltage, sheet.stall_current
    figures = {"stall torque": stall, "no-load speed": free, "voltage": volts, "resolution": sheet.resolution}
    for what, value in (figures | ({} if current is None else {"stall current": current})).items():
        if not (isfinite(value) and value > 0):
            raise ConfigError(f"{where}: {what} = {value}; expected a positive number")
    if not (isfinite(idle_power) and idle_power >= 0):
        raise ConfigError(f"{where}: idle power = {idle_power} W; expected 0 or more")
    eta = sheet.gear_efficiency
    if eta is not None and not LEAST <= eta <= 1.0 + 1e-9:
        raise ConfigError(
            f"{where}: {stall:.3g} N m, {free:.3g} rad/s and {current:.3g} A at {volts:.3g} V"
            f" contradict each other: {100 * eta:.3g} % of the stalled motor's torque would come out of its gears, expected"
            f" {100 * LEAST:g} to 100 %; are the units right (kg cm or N m, s/60deg or rpm), and all at one voltage?"
        )
    torque, speed = _digits(stall, 4), _digits(free, 4)
    constant = _digits(volts / speed, 4)
    return Servo(
        kp=_digits(torque / SATURATES, 2),
        kd=_up(torque / speed, 2),  # up: less than the back-EMF slope would be a controller that pushes
        torque=torque,
        speed_no_load=speed,
        voltage=volts,
        resistance=_digits(volts * constant / torque, 3),
        constant=constant,
        resolution=sheet.resolution,
        idle_power=idle_power,
    )


def _digits(value: float, n: int) -> float:
    """Rounded to n significant digits."""
    return float(f"{value:.{n}g}")


def _up(value: float, n: int) -> float:
    """Rounded up to n significant digits."""
    step = 10.0 ** (floor(log10(value)) - n + 1)
    return float(f"{ceil(value / step - 1e-9) * step:.{n + 1}g}")


# the command path from the bus to the servos; the same for one fish and for many, in every engine


def on_the_bus(servo: Servo, command, xp=np):
    """Commands (..., J) rad as the servos store them: clamped to the range, rounded to the resolution."""
    clamped = xp.minimum(xp.maximum(command, -servo.range), servo.range)
    return xp.rint(clamped / servo.resolution) * servo.resolution


def arrived(command: Callable[[Any], Any], step: int, delay, steps: int, ramp: bool):
    """Targets of the servos in physics step `step`, rad: the newest command that is `delay` steps old.

    Args:
        command: number of a command -> its angles; number 1 is sent in step 0, each further one a bus tick of `steps` steps
            later; number 0 and all below it are the command that was on the bus before.
        delay: physics steps, int or an array that broadcasts against the angles.
        ramp: the servo moves evenly from one command to the next in one tick (the path "move_time").
    """
    whole, part = divmod(step - delay, steps)
    newest = command(whole + 1)
    if not ramp:
        return newest
    before = command(whole)
    return before + (part + 1) / steps * (newest - before)


def arrived_of(commands: Sequence[np.ndarray], step: int, delay: int, steps: int, ramp: bool) -> np.ndarray:
    """Targets `arrived`, (J,) rad, of one fish with all its commands so far."""
    return arrived(lambda number: commands[max(number, 0)], step, delay, steps, ramp)


def targets_of_tick(xp, buffer, delay, steps: int, ramp: bool) -> list:
    """Targets `arrived` of many fish in each physics step of a bus tick: `steps` of (B, J) rad.

    Args:
        buffer: (B, R, J) rad, the last R commands; the newest is sent at the start of the tick. delay: (B,) physics steps.
    """
    fish, last = xp.arange(buffer.shape[0]), buffer.shape[1] - 1
    command = lambda number: buffer[fish, xp.maximum(last + number - 1, 0)[:, 0]]
    return [arrived(command, step, delay[:, None], steps, ramp) for step in range(steps)]
