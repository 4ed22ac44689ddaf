"""Faults inside the robot: supply, servos, heat; their effects on the body and on the readings.

Heat of a servo, first order:  T' = (T_water + K |I| - T) / tau,  I its share of the battery's current. K and tau are chosen, not
measured: a servo that is stalled at 1.2 A heads for 50 deg C in water of 20 deg C, with a time constant of five minutes.
"""

from collections.abc import Iterable
from math import isnan

from fishmj.base.errors import ConfigError
from fishmj.deploy.loopback.faults import FAULTS, LoopbackFault, active
from fishmj.deploy.loopback.firmware import in_counts
from fishmj.deploy.loopback.loopback_body import Body, BodyReadings
from fishmj.deploy.loopback.readings import Readings
from fishmj.deploy.protocols.messages import ServoFault
from fishmj.deploy.protocols.servo_bus import BUSES

WATER, RISE, TAU = 20.0, 25.0, 300.0  # deg C, K/A, s
HOTTER, HEATING = 80.0, 10.0  # deg C and K/s of a hot servo; servos let go at 85
SAGGED, COLLAPSE = 5.2, 0.05  # V at the lead, and s that the microcontroller lives on, when the supply breaks down
SAG = 0.75  # of the servos' voltage, at most
LOW = 0.97  # of the robot's low_voltage: a low battery, where no voltage is said
VOLT_STEP, AMPERE_STEP = 0.00125, 0.00025  # V and A, INA226 with a shunt of 10 milliohm


class RobotFaults:
    """Applies the faults of the robot itself.

    Raises ConfigError: a joint that the robot does not have, or a low battery that is not low for it.
    """

    def __init__(self, body: Body, faults: Iterable[LoopbackFault]):
        self.body, self._bus = body, BUSES[body.robot.rig.bus]
        self._faults = tuple(self._sized(fault) for fault in faults)
        self._heat = [WATER] * body.robot.n_joints
        self._read = [0.0] * body.robot.n_joints  # rad
        self._warmed = 0.0

    def _sized(self, fault: LoopbackFault) -> LoopbackFault:
        """The fault with a value of this robot. Raises ConfigError: the robot cannot have it."""
        robot = self.body.robot
        if FAULTS[fault.name].unit == "joint" and fault.value > robot.n_joints:
            raise ConfigError(f"fault {fault.name}={fault.value:g}: {robot.name} has {robot.n_joints} joints")
        if fault.name != "low_battery":
            return fault
        if isnan(fault.value):
            return fault._replace(value=LOW * robot.low_voltage)
        if fault.value >= robot.low_voltage:
            raise ConfigError(
                f"fault low_battery={fault.value:g}: {fault.value:g} V is no low battery of {robot.name}; expected less than its "
                f"low_voltage, {robot.low_voltage:g} V; low_battery without a voltage has {LOW * robot.low_voltage:.3g} V"
            )
        return fault

    def edges(self) -> list[float]:
        """Times [s] at which a fault of the body begins or ends."""
        return sorted({t for fault in self._faults for t in (fault.begin, fault.end) if t != float("inf")})

    def brown_outs(self) -> list[tuple[float, float]]:
        """(time of death, end of the reboot) of the microcontroller, s, of each brown-out."""
        return [(f.begin + min(COLLAPSE, f.end - f.begin), f.end + f.value) for f in self._faults if f.name == "brown_out"]

    def tell_the_body(self, now: float) -> None:
        """Sets the body's switches for the present time."""
        low, sag = active(self._faults, "low_battery", now), active(self._faults, "brown_out", now)
        self.body.supply(min(SAGGED, SAG * self.body.robot.servo.voltage) if sag else low.value if low else None)
        jammed = self._joints("stuck_servo", now)
        for joint in range(self.body.robot.n_joints):
            self.body.jam(joint, joint in jammed)

    def readings(self, now: float, sensed: BodyReadings, target: tuple[float, ...] | None) -> Readings:
        """Readings of the microcontroller at `now` [s]. target: last targets of the servos, rad, (J,)."""
        volts, amps = max(sensed.voltage, 0.0), sensed.current
        servo, joints = self.body.robot.servo, len(sensed.joint)
        jammed, silent = self._joints("stuck_servo", now), self._joints("silent_servo", now)
        counted = [in_counts(float(angle), self._bus.scale) for angle in sensed.joint]
        self._read = [self._read[k] if k in silent else angle for k, angle in enumerate(counted)]
        extra = [0.0] * joints
        for joint in jammed:  # the motor pushes against its gears: its drive's share of the current of a stalled one
            if target is not None:
                effort = min(servo.kp * abs(target[joint] - float(sensed.joint[joint])), servo.torque) / servo.torque
                extra[joint] = effort * effort * servo.voltage / servo.resistance
        idle = servo.idle_power / servo.voltage
        share = max(amps - idle, 0.0) / joints
        amps += sum(extra)
        self._warm(now, [share + e for e in extra])
        low = ServoFault.VOLTAGE if volts < self._bus.lowest else ServoFault.NONE
        return Readings(
            joint=tuple(self._read),
            voltage=round(volts / VOLT_STEP) * VOLT_STEP,
            current=round(amps / AMPERE_STEP) * AMPERE_STEP,
            servo_voltage=(volts,) * joints,
            temperature=tuple(self._heat),
            fault=tuple(low | ServoFault.NO_REPLY if k in silent else low for k in range(joints)),
        )

    def _joints(self, name: str, now: float) -> set[int]:
        """Joints (0 at the head) that have this fault now."""
        return {round(fault.value) - 1 for fault in self._faults if fault.name == name and fault.active(now)}

    def _warm(self, now: float, amps: list[float]) -> None:
        """Advances the temperatures to now."""
        dt, self._warmed = now - self._warmed, now
        heated = self._joints("hot_servo", now)
        for joint, current in enumerate(amps):
            if joint in heated:
                self._heat[joint] = min(self._heat[joint] + HEATING * dt, HOTTER)
            else:
                goal = WATER + RISE * abs(current)
                self._heat[joint] += (goal - self._heat[joint]) * min(dt / TAU, 1.0)
