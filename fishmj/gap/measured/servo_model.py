"""Servo on a pendulum: the actuator alone, with the logged supply voltage.

    duty   = clip(gain (goal - angle), +-most)                     set by the firmware; 0 with the torque off
    torque = stall duty - on k_b w                                 stall: torque at full duty and the rig's nominal voltage
    (m l^2 + J) dw/dt = torque - D w - m g l sin(angle) + effects  at their sites servo and gear

The log, which holds the set duty, determines the firmware's gain and the largest duty. A parameter row is
[constants (factors on the nominal servo), effects].
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base.units import G
from fishmj.effects.effect import Effect
from fishmj.effects.sites import Gear, SensorReadings, ServoDrive
from fishmj.gap.models.kernel import Kernel, hermite
from fishmj.gap.models.swimming_fish import Constant, ParameterRow
from fishmj.gap.records.records import Sensor

DT = 0.002  # s
STRIDE = 2  # steps between samples
LEAD = 1.0  # ohm; a sag resistance of 1 ohm gives the measured voltage
NOT_HERE = {"joint_hydro_damping"}  # water


class ServoMotor(NamedTuple):
    """Nominal servo, SI. The constants of a row are factors on it."""

    stall: float  # N m at full duty
    back_emf: float  # N m s/rad, with the torque on
    viscous: float  # N m s/rad
    armature: float  # kg m2


class Pendulum(NamedTuple):
    """Load and supply."""

    mass: float  # kg
    length: float  # m
    voltage: float  # V, nominal


class PendulumLog(NamedTuple):
    """One log. commands: (T, 5) at the model's steps: goal [rad], torque on (0 or 1), supply [V], gain [duty/rad], largest duty.

    start: angle and rate at t = 0. session: time since the first log, s.
    """

    name: str
    group: str
    dt: float
    commands: np.ndarray
    joint: Sensor
    start: tuple[float, float]
    session: float
    pose: None = None
    power: None = None


def measured_rail(xp, p, s, memory, h):
    """(k_p, k_v, limit)' = share (k_p, k_v, limit), share = 1 - (R / 1 ohm) (V_0 - V) / V_0 with V from the log.

    The firmware sets the duty cycle, so the supply voltage scales the whole torque, not only its limit.
    """
    share = 1.0 - p.resistance * s.current
    return s._replace(kp=share * s.kp, kv=share * s.kv, limit=share * s.limit), memory


class OneServo(ParameterRow):
    """Model of one servo. Args: motor: nominal. rig: load and supply. constants: fitted factors.

    catalogue: effects, by default those of `acting`. dt: time step, s. centred: delays commands by half a step. The rates of this
    (leapfrog) scheme lie between two steps and would otherwise respond half a step early.
    """

    def __init__(
        self,
        motor: ServoMotor,
        rig: Pendulum,
        constants: tuple[Constant, ...] | None = None,
        catalogue: Iterable[Effect] | None = None,
        dt: float = DT,
        centred: bool = False,
    ):
        self.motor, self.rig, self.dt, self.lag = motor, rig, dt, 0.5 * centred
        self.constants = tuple(Constant(n, 0.3) for n in ServoMotor._fields) if constants is None else constants
        chosen = acting() if catalogue is None else catalogue
        sagging = (replace(e, servo=measured_rail) if e.name == "voltage_sag" else e for e in chosen)  # from the measured voltage
        self.active = effects.EffectStack(sagging, joints=1)

    @cached_property
    def kernel(self) -> Kernel:
        """Compiled rollouts."""
        states = 2 + len(self.active.memory)
        look = lambda state, row: state[:2]
        return Kernel(self._step, look, states=states, inputs=5, parameters=len(self.null), watched=2)

    def _step(self, state, command, row):
        import jax.numpy as jnp

        factors = {c.name: row[i] for i, c in enumerate(self.constants)}
        m = self.motor._replace(**{name: getattr(self.motor, name) * f for name, f in factors.items()})
        angle, rate = state[:2]
        goal, on, volts, gain, most = command
        session = self.active.begin(jnp, row[len(self.constants) :], state[2:])
        target = session.command(0, goal, self.dt)
        sag = (1.0 - volts / self.rig.voltage) / LEAD  # share of the nominal voltage, as a current through LEAD
        s = ServoDrive(target - angle, angle, rate, gain * m.stall, 0.0, m.back_emf, most * m.stall, sag, session.time)
        s = session.servo(0, s, self.dt)
        drive = on * jnp.minimum(jnp.maximum(s.kp * s.error - s.kv * rate, -s.limit), s.limit)
        g = session.gear(0, Gear(drive, angle, rate, 0.0, 0.0, 0.0, s.kb, s.limit), self.dt)
        weight = self.rig.mass * G * self.rig.length
        inertia = self.rig.mass * self.rig.length**2 + m.armature
        resist = on * s.kb + m.viscous + g.resist
        rate = (inertia * rate + self.dt * (g.drive + g.torque - weight * jnp.sin(angle))) / (inertia + self.dt * resist)
        return [angle + self.dt * rate, rate, *session.end(0.0, self.dt)]

    def predict(self, records: list[PendulumLog], rows) -> list[dict]:
        """Encoder readings at the stamps of every record, for parameter rows (R, P): {"joint": (R, K, 1)}."""
        rows = np.atleast_2d(np.asarray(rows, float))
        longest = max(len(r.commands) for r in records)
        inputs = np.stack([np.pad(r.commands, ((0, longest - len(r.commands)), (0, 0)), mode="edge") for r in records])
        lengths = np.array([len(r.commands) for r in records])
        which = np.repeat(np.arange(len(records)), len(rows))
        parameters = list(rows[:, len(self.constants) :].T)
        late = {c: np.asarray(self.active.delay(np, parameters, c)) * np.ones(len(rows)) for c in ("command", "joint")}
        memory = np.array(self.active.memory)
        starts = np.array([[*r.start, *memory] for r in records])
        starts[:, 3] = [r.session for r in records]
        out = self.kernel(
            which,
            inputs,
            lengths,
            np.tile(rows, (len(records), 1)),
            np.repeat(starts, len(rows), 0),
            np.tile(late["command"] / self.dt + self.lag, len(records)),
            STRIDE,
            longest // STRIDE + 2,
        )
        out = out.reshape(len(records), len(rows), *out.shape[1:])
        return [{"joint": self._sense(r, mine, parameters, late["joint"])} for r, mine in zip(records, out, strict=True)]

    def _sense(self, record: PendulumLog, out, parameters, late) -> np.ndarray:
        t = record.joint.t[None, :] - late[:, None]
        angle = hermite(out[..., :1], out[..., 1:], STRIDE * self.dt, t)
        still = np.zeros_like(t)
        readings = SensorReadings(t, still, still, still, angle, still)
        return self.active.measure(np, [column[:, None] for column in parameters], readings).joint


def acting() -> list[Effect]:
    """Effects of the catalogue that apply to a servo on a bench and show in its log."""
    out = []
    for e in effects.catalogue().values():
        here = set(e.sites) <= {"servo", "gear", "command", "measure"} and set(e.delays) <= {"command", "joint"}
        if here and "joint" in e.shows and not e.stochastic and e.name not in NOT_HERE:
            out.append(e)
    return out
