"""The swimming fish: planar chain in structured water, with every effect of the catalogue in it.

A parameter row is [constants (factors on the calibrated fish), effects]. The null row is the calibrated fish without effects.

`ServoStand` is the fish on a bench: hung in air on a thread, or put in water, with the few numbers of servo fits.

    air     no water forces, no added mass; at the reference point   F = -k (p - p_0) - c p',   N = -k_t (psi - psi_0) - c_t psi'
            with k = m g / l of a thread of length l
    water   the swimming fish

One model covers both: the constant `wet` is 1 or 0, by each record's medium. Constants kp, kd (all of the joint's
damping: back-EMF, controller, grease) are SI here, not factors.
"""

import hashlib
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base.units import G
from fishmj.effects.sites import SensorReadings
from fishmj.gap.models.kernel import Kernel, hermite, linear
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record, record_of
from fishmj.log import Trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.hooks import Effects

AT_ONCE = 256  # rollouts per batch, to limit memory
STRIDE = 5  # physics steps between samples; between them poses follow the cubic through angles and rates


class Constant(NamedTuple):
    """A factor on the calibrated fish, known only to within `sigma`."""

    name: str
    sigma: float


CONSTANTS = (
    Constant("mass", 0.03),
    Constant("kp", 0.1),
    Constant("kv", 0.1),
    Constant("added_mass_body", 0.1),
    Constant("added_mass_tail", 0.1),
    Constant("crossflow_body", 0.15),
    Constant("crossflow_tail", 0.15),
    Constant("friction", 0.2),
    Constant("form_drag", 0.2),
    Constant("trailing_edge", 0.15),
)


class ParameterRow:
    """Layout of a model's parameter rows: factors on its constants, then the parameters of its effects."""

    constants: tuple[Constant, ...]
    active: effects.EffectStack

    @property
    def nothing(self) -> np.ndarray:
        """(P,) row of the nominal model without any effect."""
        return np.array([1.0] * len(self.constants) + self.active.null)

    @property
    def null(self) -> np.ndarray:
        """(P,) row of the present model."""
        return self.nothing

    def index(self, effect: str, parameter: str) -> int:
        """Place of an effect's parameter in a row."""
        return len(self.constants) + self.active.index(effect, parameter)


class SwimmingFish(ParameterRow):
    """The swimming fish.

    Args: robot: description, path or name. catalogue: effects; default, all that change the mean of a log.
    """

    def __init__(self, robot: "Robot | str" = "fish", catalogue=None):
        self.robot = load_robot(robot)
        self.dt = self.robot.timing.physics_dt
        self.joints = self.inputs = self.robot.n_joints
        chosen = effects.catalogue().values() if catalogue is None else catalogue
        lasting = [e for e in chosen if not e.stochastic]
        self.active = effects.EffectStack(lasting, self.joints, effects.RobotScales.of(self.robot))
        self.constants = CONSTANTS
        self.chain = planar_chain.chain_of(self.robot)
        self.nominal = planar_chain.nominal(self.robot)
        self.latency = self.robot.timing.command_latency
        self.camera = self.robot.timing.camera_latency
        self.states = 2 * (self.joints + 3) + 2 + len(self.active.memory)  # q, v, attachment, energy, memory

    @property
    def null(self) -> np.ndarray:
        """(P,) row of the present model: with the effects that its description lists."""
        return self.row(self.robot)

    def records(self, trials: Sequence[Trial]) -> list[Record]:
        """The trials, ready to be predicted. Raises LogError."""
        return [record_of(trial, self.dt, self.camera) for trial in trials]

    def row(self, robot: Robot) -> np.ndarray:
        """(P,) row of another description's effects on this fish; effects outside this model's catalogue are left out."""
        row, mine = self.nothing, {effect.name for effect in self.active.effects}
        for fitted in robot.effects:
            for name, interval in fitted.parameters.items() if fitted.name in mine else ():
                row[self.index(fitted.name, name)] = interval.value
        return row

    @cached_property
    def fingerprint(self) -> str:
        """Text that changes with anything that changes the predictions of the row `nothing`."""
        return hashlib.sha256(repr((self.robot, self.camera, self.latency)).encode()).hexdigest()[:16]

    @cached_property
    def kernel(self) -> Kernel:
        """Compiled rollouts; tens of seconds the first time on a machine."""
        n = len(self.constants) + len(self.active.null) + 2  # and the current of the log
        watched = 2 * (self.joints + 3) + 1
        return Kernel(self._step, self._look, states=self.states, inputs=self.inputs, parameters=n, watched=watched)

    def _step(self, state, command, row):
        """One physics step in components."""
        import jax.numpy as jnp

        nv, n = self.joints + 3, self.chain.n
        q, v, attached, energy = state[:nv], state[nv : 2 * nv], state[2 * nv], state[2 * nv + 1]
        hooks = self._hooks(jnp, row, state[2 * nv + 2 :])
        target = [hooks.session.command(j, command[j], self.dt) for j in range(self.joints)]
        flow = [(row[-2], row[-1])] * n
        s = planar_chain.step(jnp, self._chain(row), self._swimmer(row), q, v, attached, target, flow, (0.0, 0.0), hooks)
        return [*s.q, *s.v, s.attached, energy + s.power * self.dt, *s.memory]

    def _hooks(self, xp, row, memory) -> Effects:
        """The effects of a row."""
        return Effects(xp, self.active, row[len(self.constants) : -2], memory)

    def _chain(self, row) -> planar_chain.Chain:
        """The chain of a row; a plant whose rows change its constants has its own."""
        return self.chain

    def _look(self, state, row):
        nv = self.joints + 3
        return [*state[: 2 * nv], state[2 * nv + 1]]

    def _swimmer(self, row) -> planar_chain.Swimmer:
        """The calibrated fish times the constants of a row."""
        c = {constant.name: row[i] for i, constant in enumerate(CONSTANTS)}
        s, w = self.nominal, self.nominal.water
        k = [a * f for a, f in zip(w.k, self._of_links(c, "added_mass"), strict=True)]
        cn = [a * f for a, f in zip(w.cn, self._of_links(c, "crossflow"), strict=True)]
        water = w._replace(k=k, cn=cn, cf=w.cf * c["friction"], ke=w.ke * c["trailing_edge"])
        water = water._replace(ca_forward=w.ca_forward * c["form_drag"])
        scaled = lambda values, factor: [value * factor for value in values]
        return s._replace(mass=scaled(s.mass, c["mass"]), kp=scaled(s.kp, c["kp"]), kv=scaled(s.kv, c["kv"]), water=water)

    def _of_links(self, c: dict, name: str) -> list:
        """Factor of each link: the constant NAME_body, of the last one NAME_tail."""
        return [c[f"{name}_body"]] * (self.chain.n - 1) + [c[f"{name}_tail"]]

    def added_mass(self) -> np.ndarray:
        """(3,) added mass of the straight fish at rest as described: ahead, to the side [kg], in yaw [kg m2]."""
        rest, still = [0.0] * (self.joints + 3), [(0.0, 0.0)] * self.chain.n
        pose = planar_chain.kinematics(np, self.chain, rest, rest, still)
        m = planar_chain.mass_matrix(self.chain, self.nominal, pose, rigid=False)
        turning = range(2, self.joints + 3)  # all links of a rigid fish turn with the head
        return np.array([m[0][0], m[1][1], sum(m[max(r, c)][min(r, c)] for r in turning for c in turning)])

    def predict(self, records: list[Record], rows) -> list[dict]:
        """Predicted sensor readings for every parameter row (R, P) on every record.

        Returns:
            One dictionary a record: {"joint": (R, K, J), "pose": (R, K, 3), "power": (R, K, 1)} at its stamps.
        """
        rows = np.atleast_2d(np.asarray(rows, float))
        few = max(1, AT_ONCE // len(rows))
        return [p for i in range(0, len(records), few) for p in self._together(records[i : i + few], rows)]

    def _together(self, records: list[Record], rows: np.ndarray) -> list[dict]:
        """Predictions for as many records as fit into a cache at a time."""
        longest = max(len(r.commands) for r in records)
        inputs = np.stack([np.pad(r.commands, ((0, longest - len(r.commands)), (0, 0)), mode="edge") for r in records])
        lengths = np.array([len(r.commands) for r in records])
        which = np.repeat(np.arange(len(records)), len(rows))
        effect_rows, flow = rows[:, len(self.constants) :], np.array([r.flow for r in records])
        late = self.active.delay(np, list(effect_rows.T), "command") * np.ones(len(rows))
        delay = np.tile((late + self.latency) / self.dt, len(records))
        whole = np.concatenate([np.tile(rows, (len(records), 1)), flow[which]], 1)
        start = np.concatenate([self._starts(r, effect_rows) for r in records])
        out = self.kernel(which, inputs, lengths, whole, start, delay, STRIDE, longest // STRIDE + 2)
        out = out.reshape(len(records), len(rows), *out.shape[1:])
        return [self._sense(record, mine, rows) for record, mine in zip(records, out, strict=True)]

    def _starts(self, record: Record, effect_rows) -> np.ndarray:
        """(R, S) states behind the measured start of the record: at rest, or with the given push.

        Errors of camera and encoders are removed by fixed-point iteration: true = shown - (seen(true) - true).
        """
        nv, rows = self.joints + 3, len(effect_rows)
        parameters = [column[:, None] for column in effect_rows.T]
        shown = np.tile(np.concatenate([record.start, record.joints]), (rows, 1))
        true, at = shown.copy(), np.zeros((rows, 1))
        for _ in range(2):
            x, y, yaw = (true[:, i : i + 1] for i in range(3))
            seen = self.active.measure(np, parameters, SensorReadings(t=at, x=x, y=y, yaw=yaw, joint=true[:, None, 3:], power=at))
            joint = np.broadcast_to(seen.joint, (rows, 1, self.joints))[:, 0]
            seen = np.concatenate([np.broadcast_to(v, (rows, 1)) for v in (seen.x, seen.y, seen.yaw)] + [joint], 1)
            true = true + (shown - seen)
        state = np.zeros((rows, self.states))
        state[:, :nv], state[:, 2 * nv] = true, 0.5
        c, s = np.cos(true[:, 2]), np.sin(true[:, 2])
        u, w, r = record.push
        state[:, nv : nv + 3] = np.stack([c * u - s * w, s * u + c * w, np.full(rows, r)], 1)
        state[:, 2 * nv + 2 :] = self.active.memory
        state[:, 2 * nv + 3] = record.session
        return state

    def _sense(self, record: Record, out, rows) -> dict:
        """The sensors of one record from its samples (R, K, O)."""
        nv, h = self.joints + 3, STRIDE * self.dt
        parameters = [column[:, None] for column in rows[:, len(self.constants) :].T]
        nominal = {"pose": self.camera}
        seen: dict[str, np.ndarray] = {}
        for clock in ("joint", "pose", "power"):
            sensor = getattr(record, clock)
            if sensor is None:
                continue
            late = self.active.delay(np, parameters, clock, sensor.t + record.session) + nominal.get(clock, 0.0)
            t = sensor.t - late * np.ones((len(out), 1))
            first, last = {"pose": (0, 3), "joint": (3, nv), "power": (0, 0)}[clock]
            state = hermite(out[..., first:last], out[..., nv + first : nv + last], h, t)
            none = np.zeros((1, 1))  # of the other sensors: broadcast
            x, y, yaw = (state[..., i] for i in range(3)) if clock == "pose" else (none,) * 3
            joint = state if clock == "joint" else np.zeros((1, 1, self.joints))
            power = none
            if clock == "power":
                energy = out[..., -1]
                power = (linear(energy, h, t) - linear(energy, h, t - h)) / h + self.robot.servo.idle_power
            report = SensorReadings(t=t, x=x, y=y, yaw=yaw, joint=joint, power=power)
            report = self.active.measure(np, parameters, report)
            if clock == "pose":
                seen[clock] = np.stack([report.x, report.y, report.yaw], -1)
            else:
                seen[clock] = report.joint if clock == "joint" else report.power[..., None]
        if record.placed is not None:
            seen["placed"] = self._placed(record, parameters, len(out))
        if record.weighed is not None:
            seen["weighed"] = mass_properties.predicted(self, rows)[:, None]
        return seen

    def _placed(self, record: Record, parameters, rows: int) -> np.ndarray:
        """(R, 1, 3) poses as the camera would show a fish at rest at its intended start."""
        x, y, yaw = np.broadcast_to(record.place, (rows, 1, 3)).transpose(2, 0, 1)
        none = np.zeros((rows, 1))
        still = SensorReadings(t=none, x=x, y=y, yaw=yaw, joint=np.tile(record.joints, (rows, 1, 1)), power=none)
        seen = self.active.measure(np, parameters, still)
        return np.stack([seen.x, seen.y, seen.yaw], -1)


# --------------------------------------------------------------------------------------------------------------------- on a bench
THREAD = 1.0  # m, between hook and fish
SWAY_DAMPING, TWIST, TWIST_DAMPING = 0.25, 0.03, 0.01  # N s/m, N m/rad, N m s/rad: too small to matter, chosen
HULL = ("mass", "added_mass_body", "added_mass_tail", "crossflow_body", "crossflow_tail", "trailing_edge")
STAND_CONSTANTS = (Constant("kp", np.inf), Constant("kd", np.inf), *(c for c in CONSTANTS if c.name in HULL))
WET = "wet"


class HangingInAir(Effects):
    """Effects of the fish, with the forces of the thread."""

    def body(self, ch, sw, q, k, rhs, m) -> None:
        """Adds the thread's spring and damping forces, in air only, to `rhs`."""
        super().body(ch, sw, q, k, rhs, m)
        dry, xp = 1.0 - self.wet, self.xp
        c, s = xp.cos(q[2]), xp.sin(q[2])
        spring = sum(ch.mass) * G / THREAD
        along, across = c * q[0] + s * q[1], c * q[1] - s * q[0]
        rhs[0] = rhs[0] - dry * (spring * along + SWAY_DAMPING * k.u[0])
        rhs[1] = rhs[1] - dry * (spring * across + SWAY_DAMPING * k.w[0])
        rhs[2] = rhs[2] - dry * (TWIST * q[2] + TWIST_DAMPING * k.omega[0])


class ServoStand(SwimmingFish):
    """The fish on a bench.

    Args: robot: description, path or name. `delays`: rows may shift the commands and the camera against the robot's own.
    """

    def __init__(self, robot: "Robot | str" = "fish"):
        super().__init__(robot, [effects.get(name) for name in ("coulomb_friction", "command_latency", "camera_latency")])
        self.constants = (*STAND_CONSTANTS, Constant(WET, 0.0))

    @property
    def null(self) -> np.ndarray:
        """(P,) row of the described robot; `wet` is 1."""
        s = self.robot.servo
        hull = [1.0] * (len(STAND_CONSTANTS) - 2)
        return np.array([s.kp, s.kb + s.kv, *hull, 1.0, *self.active.null])

    def place(self, name: str) -> int:
        """Place of a constant in a row."""
        return [c.name for c in self.constants].index(name)

    def _chain(self, row) -> planar_chain.Chain:
        """The chain of a row, in air without any drag of the strips, including that in the chain's constants."""
        strips, wet = self.chain.strips, row[self.place(WET)]
        linear = None if strips.linear is None else tuple(wet * part for part in strips.linear)
        return self.chain._replace(strips=strips._replace(linear=linear))

    def _swimmer(self, row) -> planar_chain.Swimmer:
        c = {constant.name: row[i] for i, constant in enumerate(self.constants)}
        s, w, wet = self.nominal, self.nominal.water, c[WET]
        k = [wet * a * f for a, f in zip(w.k, self._of_links(c, "added_mass"), strict=True)]
        cn = [wet * a * f for a, f in zip(w.cn, self._of_links(c, "crossflow"), strict=True)]
        water = w._replace(k=k, cn=cn, cf=wet * w.cf, ke=wet * w.ke * c["trailing_edge"])
        water = water._replace(ca_forward=wet * w.ca_forward, ca_backward=wet * w.ca_backward)
        joints, kv = range(self.joints), self.robot.servo.kv
        return s._replace(
            mass=[m * c["mass"] for m in s.mass], kp=[c["kp"] for _ in joints], kb=[c["kd"] - kv for _ in joints], water=water
        )

    def _hooks(self, xp, row, memory) -> HangingInAir:
        return HangingInAir(xp, self.active, row[len(self.constants) : -2], memory, row[self.place(WET)])

    def predict(self, records: list[Record], rows) -> list[dict]:
        """Predictions as of `SwimmingFish.predict`; `wet` follows each record's medium, and a thread hangs at the origin."""
        rows = np.atleast_2d(np.asarray(rows, float)).copy()
        out: list[dict] = [{} for _ in records]
        for medium, wet in (("air", 0.0), ("water", 1.0)):
            mine = [i for i, record in enumerate(records) if record.medium == medium]
            if mine:
                rows[:, self.place(WET)] = wet
                placed = [records[i] if wet else records[i]._replace(start=np.zeros(3)) for i in mine]
                found = super().predict(placed, rows)
                for i, prediction in zip(mine, found, strict=True):
                    out[i] = prediction
        return out
