"""Planar body, averaged over the tail beat: motion of a robotic fish or a boat whose log has only the pose.

    (m + X) du/dt = (m + Y) w r + thrust A^2   - c V u             + fx        u, w relative to the water, V = |(u, w)|
    (m + Y) dw/dt = -(m + X) u r               - c V w - c_w |w| w + fy
    (I + N) dr/dt = (X - Y) u w - torque A^2 b         - c_r |r| r + n

A, b: amplitude and bias of the tail [rad], the inputs; X, Y, N: added mass; fx, fy, n: forces of the catalogue's effects.
Other drives replace thrust and torque (`DRIVES`).

Terms: Kirchhoff's body in ideal fluid, drag along the velocity (c) and across the body (c_w), mean thrust and torque of a small
tail. This is the published model of these robots (Wang & Tan 2015) without its lift.
A parameter row is [constants (factors on the hull), effects]. A record holds many short runs from known starts.
"""

from collections import namedtuple
from collections.abc import Iterable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fishmj import effects
from fishmj.effects import sites
from fishmj.effects.effect import Effect
from fishmj.effects.sites import Constants, FlowAt, SensorReadings
from fishmj.gap.models.kernel import Kernel
from fishmj.gap.models.swimming_fish import Constant, ParameterRow
from fishmj.gap.records.records import Sensor

SITES = {"body", "flow", "fish", "measure"}
MOTION = 6  # x, y, yaw, u, w, r
FAR = 1e3  # m, rad, pose of a diverged run
STILL = 1e-9  # m/s, makes the root of V differentiable at rest
NOT_HERE = {"crossflow_drag", "tail_normal_force", "power_offset", "joint_zero_offset"}  # already constants, or not measured


class Hull(NamedTuple):
    """Body, SI; forces for A = 1 rad. The constants of a row are factors on it."""

    mass: float
    inertia: float
    surge_added: float
    sway_added: float
    yaw_added: float
    thrust: float
    torque: float
    drag: float
    sway_drag: float
    yaw_drag: float


# (A, b) -> forward drive, clockwise drive; twin: A and b are the commands of the left and the right thruster
DRIVES = {
    "tail": lambda xp, a, b: (a * a, a * a * b),
    "linear": lambda xp, a, b: (a, -b),
    "propeller": lambda xp, a, b: (xp.abs(a) * a, -xp.abs(a) * a * b),
    "twin": lambda xp, a, b: (xp.abs(a) * a + xp.abs(b) * b, xp.abs(a) * a - xp.abs(b) * b),
}


class MeanGait(NamedTuple):
    """K short runs under one condition.

    starts: (K, 6) x, y, yaw in the tank, surge, sway over ground, yaw rate. commands: (T, 2) amplitude and bias at the model's
    steps since each start, or (K, T, 2) for commands per run. pose: displacement at the end of each run, in the frame
    of its start: ahead, left, turned; its stamps identify the runs. span: length of a run, s.
    """

    name: str
    group: str
    dt: float
    commands: np.ndarray
    starts: np.ndarray
    span: float
    pose: Sensor
    joint: None = None
    power: None = None


# inputs of the effects, plus the tail's mean sideways drive A^2 b, rad^3
Beaten: Any = namedtuple("Beaten", (*sites.BodyMotion._fields, "push"))  # type: ignore[misc]


class HullLink(NamedTuple):
    """Whole body as the only link of a chain, for effects that change masses."""

    mass: tuple
    inertia: tuple
    com: tuple


class Transfer(NamedTuple):
    """Factors on the link."""

    mass: list


class PlanarBody(ParameterRow):
    """Model of a planar body. Args: hull: nominal. constants: fitted factors.

    catalogue: effects, by default those of `acting`. drive: name in `DRIVES`.
    """

    def __init__(
        self, hull: Hull, constants: tuple[Constant, ...], catalogue: Iterable[Effect] | None = None, dt=0.02, drive: str = "tail"
    ):
        self.hull, self.constants, self.dt, self.drive = hull, constants, dt, DRIVES[drive]
        chosen = acting() if catalogue is None else list(catalogue)
        self.active = effects.EffectStack(chosen, joints=1)

    @cached_property
    def kernel(self) -> Kernel:
        """Compiled rollouts."""
        states, n = MOTION + len(self.active.memory), len(self.null)
        look = lambda state, row: state[:MOTION]
        return Kernel(self._step, look, states=states, inputs=2, parameters=n, watched=MOTION)

    def _step(self, state, command, row):
        import jax.numpy as jnp

        h, k = self._hull(row), self.dt
        x, y, yaw, gu, gw, r = state[:MOTION]
        session = self.active.begin(jnp, row[len(self.constants) :], state[MOTION:])
        c, s = jnp.cos(yaw), jnp.sin(yaw)
        water = session.flow(FlowAt(x, y, session.time, 0.0, 0.0))
        u, w = gu - (c * water.u + s * water.v), gw - (c * water.v - s * water.u)
        link = session.fish(Constants(HullLink((h.mass,), (h.inertia,), (0.0,)), Transfer([1.0])))
        mass, inertia, com = h.mass * link.swimmer.mass[0], link.chain.inertia[0], link.chain.com[0]
        beat, push = self.drive(jnp, command[0], command[1])
        along = h.drag * jnp.sqrt(u * u + w * w + STILL * STILL)
        fx = h.thrust * beat - along * u
        fy = -along * w - h.sway_drag * jnp.abs(w) * w
        n = -h.torque * push - h.yaw_drag * jnp.abs(r) * r
        forces = dict(fx=fx, fy=fy, n=n, mx=h.surge_added, my=h.sway_added, mn=h.yaw_added, push=push)
        where = dict(u=u, w=w, r=r, heading=yaw, x=x, y=y, time=session.time, tail=0.0, wet=1.0)
        rest = dict.fromkeys(sites.BodyMotion._fields, 0.0)  # fields that a single body lacks
        b = Beaten(**rest | where | forces | dict(sway_mass=h.sway_added, drag=h.drag))
        b = session.body(b, k)
        # forces = masses times accelerations in the ground frame; the centre of mass lies `com` ahead
        more = h.sway_added - h.surge_added
        ax = (b.fx + more * w * r + mass * com * r * r) / (mass + b.mx)
        fy, n = b.fy + more * u * r, b.n - more * u * w
        a, e, d = mass + b.my, mass * com, inertia + mass * com * com + b.mn
        det = a * d - e * e
        ay, ar = (d * fy - e * n) / det, (a * n - e * fy) / det
        ax, aw = ax + r * gw, ay - r * gu
        gu, gw, r = gu + k * ax, gw + k * aw, r + k * ar
        yaw2 = yaw + k * r
        mid = 0.5 * (yaw + yaw2)
        c, s = jnp.cos(mid), jnp.sin(mid)
        return [x + k * (c * gu - s * gw), y + k * (s * gu + c * gw), yaw2, gu, gw, r, *session.end(0.0, k)]

    def _hull(self, row) -> Hull:
        """The hull times the constants of a row."""
        factors = {constant.name: row[i] for i, constant in enumerate(self.constants)}
        return self.hull._replace(**{name: getattr(self.hull, name) * f for name, f in factors.items()})

    def predict(self, records: list[MeanGait], rows) -> list[dict]:
        """End of every run for parameter rows (R, P): {"pose": (R, K, 3)} per record, in the frame of each start."""
        rows = np.atleast_2d(np.asarray(rows, float))
        return [{"pose": self._covered(r, end, rows)} for r, end in zip(records, self.ends(records, rows), strict=True)]

    def ends(self, records: list[MeanGait], rows) -> list[np.ndarray]:
        """Motion (R, K, 6) at the end of every run, for each record."""
        common = int(np.gcd.reduce([round(r.span / self.dt) for r in records]))
        return [track[:, :, -1] for track in self.tracks(records, rows, common)]

    def tracks(self, records: list[MeanGait], rows, stride: int = 1) -> list[np.ndarray]:
        """Motion (R, K, N, 6) over every run, for each record: every `stride` steps of the model, from start to end."""
        rows = np.atleast_2d(np.asarray(rows, float))
        runs = [len(r.starts) for r in records]
        steps = np.array([round(r.span / self.dt) for r in records])
        own = [r.commands.ndim == 3 for r in records]  # the kernel takes a run with its own commands as a log
        commands = [c for r, alone in zip(records, own, strict=True) for c in (r.commands if alone else [r.commands])]
        longest = max(int(steps.max()), max(map(len, commands)))
        inputs = np.stack([np.pad(c, ((0, longest - len(c)), (0, 0)), mode="edge") for c in commands])
        which = np.repeat(
            np.arange(len(commands)), [k for n, alone in zip(runs, own, strict=True) for k in ([1] * n if alone else [n])]
        )
        lengths = np.repeat(steps, [n if alone else 1 for n, alone in zip(runs, own, strict=True)])
        starts = np.concatenate([r.starts for r in records])
        state = np.concatenate([starts, np.tile(self.active.memory, (len(starts), 1))], 1)
        many = len(rows)
        given = (np.tile(which, many), inputs, lengths, np.repeat(rows, len(starts), 0), np.tile(state, (many, 1)))
        out = self.kernel(*given, np.zeros(many * len(starts)), stride, int(steps.max()) // stride + 1)
        each = np.split(out.reshape(many, len(starts), *out.shape[1:]), np.cumsum(runs)[:-1], axis=1)
        return [track[:, :, : n // stride + 1] for track, n in zip(each, steps, strict=True)]

    def coasts(self, speeds: np.ndarray, rows, seconds: float, stride: int = 1) -> np.ndarray:
        """Speeds ahead (R, S, N) of a body without drive over `seconds`, from initial speeds (S,), every `stride` steps."""
        starts = np.zeros((len(speeds), MOTION))
        starts[:, 3] = speeds
        nothing = Sensor(np.zeros(0), np.zeros((0, 3)), np.ones(3))
        return self.tracks([MeanGait("coast", "coast", self.dt, np.zeros((1, 2)), starts, seconds, nothing)], rows, stride)[0][
            ..., 3
        ]

    def _covered(self, record: MeanGait, end: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Displacements (R, K, 3) as measured by a camera."""
        parameters = [column[:, None] for column in rows[:, len(self.constants) :].T]
        before = self._seen(parameters, np.broadcast_to(record.starts, end.shape), 0.0)
        after = self._seen(parameters, np.clip(np.nan_to_num(end, nan=FAR), -FAR, FAR), record.span)
        return covered(before, after, record.starts[:, 2])

    def _seen(self, parameters, motion, t) -> np.ndarray:
        """Measured pose (R, K, 3)."""
        flat = np.zeros(motion.shape[:-1])
        readings = SensorReadings(flat + t, motion[..., 0], motion[..., 1], motion[..., 2], flat[..., None], flat)
        readings = self.active.measure(np, parameters, readings)
        return np.stack([readings.x, readings.y, readings.yaw], -1)


def covered(before, after, heading) -> np.ndarray:
    """Displacement (..., 3) ahead, left, turned between two poses, in the frame of `heading` (...)."""
    d = after - before
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * d[..., 0] + s * d[..., 1], c * d[..., 1] - s * d[..., 0], d[..., 2]], -1)


def acting() -> list[Effect]:
    """Effects of the catalogue that apply to such a body and show in its log."""
    every = effects.catalogue().values()
    return [e for e in every if e.sites and set(e.sites) <= SITES and not e.stochastic and e.name not in NOT_HERE]
