"""The fish on a bench: hung in air on a thread, or put in water, with the few numbers that a servo calibration turns.

    air     no water forces, no added mass; at the reference point   F = -k (p - p_0) - c p',   N = -k_t (psi - psi_0) - c_t psi'
            with k = m g / l of a thread of length l
    water   the swimming fish of `swimming_fish.py`

One model does both: the row's constant `wet` is 1 or 0, set by each record's medium. Constants kp, kd (all of the joint's
damping: back-EMF, controller, grease) are SI here, not factors.
"""

import numpy as np

from fishmj import effects
from fishmj.dynamics import planar_chain
from fishmj.dynamics.hooks import Effects
from fishmj.gap.models import swimming_fish
from fishmj.gap.models.swimming_fish import Constant, SwimmingFish
from fishmj.gap.records.records import Record
from fishmj.mjcf.description import Robot
from fishmj.units import G

THREAD = 1.0  # m, between hook and fish
SWAY_DAMPING, TWIST, TWIST_DAMPING = 0.25, 0.03, 0.01  # N s/m, N m/rad, N m s/rad: too small to matter, chosen
HULL = ("mass", "added_mass_body", "added_mass_tail", "crossflow_body", "crossflow_tail", "trailing_edge")
CONSTANTS = (
    Constant("kp", np.inf),
    Constant("kd", np.inf),
    *(c for c in swimming_fish.CONSTANTS if c.name in HULL),
)
WET = "wet"


class Hung(Effects):
    """The sites of the fish, with the thread."""

    def body(self, ch, sw, q, k, rhs, m) -> None:
        super().body(ch, sw, q, k, rhs, m)
        dry, xp = 1.0 - self.wet, self.xp
        c, s = xp.cos(q[2]), xp.sin(q[2])
        spring = sum(ch.mass) * G / THREAD
        along, across = c * q[0] + s * q[1], c * q[1] - s * q[0]
        rhs[0] = rhs[0] - dry * (spring * along + SWAY_DAMPING * k.u[0])
        rhs[1] = rhs[1] - dry * (spring * across + SWAY_DAMPING * k.w[0])
        rhs[2] = rhs[2] - dry * (TWIST * q[2] + TWIST_DAMPING * k.omega[0])


class ServoStand(SwimmingFish):
    """Args: robot: description, path or name. `delays`: rows may shift the commands and the camera against the robot's own."""

    def __init__(self, robot: "Robot | str" = "fish"):
        super().__init__(robot, [effects.get(name) for name in ("coulomb_friction", "command_latency", "camera_latency")])
        self.constants = (*CONSTANTS, Constant(WET, 0.0))

    @property
    def null(self) -> np.ndarray:
        """(P,) the robot as it is described; `wet` is 1."""
        s = self.robot.servo
        hull = [1.0] * (len(CONSTANTS) - 2)
        return np.array([s.kp, s.kb + s.kv, *hull, 1.0, *self.active.null])

    def place(self, name: str) -> int:
        """Place of a constant in a row."""
        return [c.name for c in self.constants].index(name)

    def _swimmer(self, row) -> planar_chain.Swimmer:
        c = {constant.name: row[i] for i, constant in enumerate(self.constants)}
        s, w, wet = self.nominal, self.nominal.water, c[WET]
        last = self.chain.n - 1
        tail = lambda body, end: [end if i == last else body for i in range(last + 1)]
        k = [wet * a * f for a, f in zip(w.k, tail(c["added_mass_body"], c["added_mass_tail"]), strict=True)]
        cn = [wet * a * f for a, f in zip(w.cn, tail(c["crossflow_body"], c["crossflow_tail"]), strict=True)]
        water = w._replace(k=k, cn=cn, cf=wet * w.cf, ke=wet * w.ke * c["trailing_edge"])
        water = water._replace(ca_forward=wet * w.ca_forward, ca_backward=wet * w.ca_backward)
        joints, kv = range(self.joints), self.robot.servo.kv
        return s._replace(
            mass=[m * c["mass"] for m in s.mass],
            kp=[c["kp"] for _ in joints],
            kb=[c["kd"] - kv for _ in joints],
            water=water,
        )

    def _step(self, state, command, row):
        import jax.numpy as jnp

        nv, n = self.joints + 3, self.chain.n
        q, v, attached, energy = state[:nv], state[nv : 2 * nv], state[2 * nv], state[2 * nv + 1]
        hooks = Hung(jnp, self.active, row[len(self.constants) : -2], state[2 * nv + 2 :], row[self.place(WET)])
        target = [command[j] for j in range(self.joints)]
        flow = [(row[-2], row[-1])] * n
        s = planar_chain.step(jnp, self.chain, self._swimmer(row), q, v, attached, target, flow, (0.0, 0.0), hooks)
        return [*s.q, *s.v, s.attached, energy + s.power * self.dt, *s.memory]

    def predict(self, records: list[Record], rows) -> list[dict]:
        """As `SwimmingFish.predict`; `wet` follows each record's medium, and a thread hangs at the origin."""
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
