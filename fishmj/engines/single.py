"""One fish in MuJoCo to which something is added (effects, a learnt water), and what its sensors report.

applied = what MuJoCo, which knows the rigid fish and its servos, lacks of the closed form's acceleration
(M + h D) qacc = servo + applied          MuJoCo moves the fish, the closed form says how, as in the engine `batch`
"""

import mujoco
import numpy as np

from fishmj.dynamics import planar_chain
from fishmj.effects.sites import Measured
from fishmj.engines.extensions import Extensions
from fishmj.errors import ConfigError
from fishmj.mjcf.description import Robot
from fishmj.water.injection import checked_step

DRY = dict(cf=0.0, ca_forward=0.0, ca_backward=0.0, ke=0.0)  # coefficients of no water at all, besides k and cn


class SingleFish:
    """The water of one planar fish with everything that is added to it; memory and attachment advance in `step`.

    Attributes:
        power: of the servos in the last step, W.
    """

    def __init__(self, robot: Robot, added: Extensions, swimmer: planar_chain.Swimmer, wet: bool = True):
        self.chain, self.added, self.wet = planar_chain.chain_of(robot), added, wet
        n = self.chain.n
        water = swimmer.water if wet else swimmer.water._replace(k=[0.0] * n, cn=[0.0] * n, **DRY)
        self.swimmer = swimmer._replace(water=water)
        self.parameters, self.memory = added.row.tolist(), added.memory.tolist()
        self.attached, self.power = 0.5, 0.0
        self.set_flow(np.zeros((n, 2)), np.zeros(2))

    @classmethod
    def of(cls, robot: Robot, added: Extensions, swimmer: planar_chain.Swimmer, root: str, water: str) -> "SingleFish | None":
        """None where nothing is added. Raises ConfigError where it cannot be."""
        if added.active is None and (added.learnt is None or water != "structured"):
            return None
        if root != "planar" or water == "ellipsoid":
            raise ConfigError(
                f"{robot.name}: effects and a learnt water act on a fish with a planar root in structured water or none, got"
                f" root = {root!r}, water = {water!r}; take those, or a robot without [[effect]]"
            )
        return cls(robot, added, swimmer, water == "structured")

    def set_flow(self, flow, ambient) -> None:
        """Water velocity at the links (N, 2) m/s and DU/Dt (2,) m/s2, world frame."""
        share = 1.0 if self.wet else 0.0
        self.flow, self.ambient = (share * np.asarray(flow)).tolist(), (share * np.asarray(ambient)).tolist()

    def step(self, data: mujoco.MjData) -> None:
        """One `mj_step`. Raises SimDiverged."""
        hooks = self.added.hooks(np, self.parameters, self.memory, wet=float(self.wet))
        state = (data.qpos.tolist(), data.qvel.tolist(), self.attached, data.ctrl.tolist())
        s = planar_chain.step(np, self.chain, self.swimmer, *state, self.flow, self.ambient, hooks)
        data.qfrc_applied[:] = s.applied
        checked_step(data.model, data)
        self.attached, self.memory, self.power = s.attached, list(s.memory), float(s.power)


def reported(added: Extensions, t, pose, joint, rate, power):
    """What the sensors say at the times t (T,) of what happened: (pose (T, 6), joint (T, J), rate (T, J), power (T,)).

    Delays read the cubic through the samples and their rates (power: the straight line), held before the first sample.
    """
    if added.active is None:
        return pose, joint, rate, power
    late = {clock: t - np.asarray(added.late(np, added.row, clock, t)) for clock in ("pose", "joint", "power")}
    x, y, yaw = cubic(t, pose[:, :3], pose[:, 3:], late["pose"]).T
    moved = np.stack([np.interp(late["joint"], t, column) for column in rate.T], 1)
    seen = Measured(t, x, y, yaw, cubic(t, joint, rate, late["joint"]), np.interp(late["power"], t, power))
    seen = added.active.measure(np, added.row.tolist(), seen)
    return np.concatenate([np.stack([seen.x, seen.y, seen.yaw], 1), pose[:, 3:]], 1), seen.joint, moved, seen.power


def cubic(t, values, rates, at):
    """Hermite's cubic through evenly spaced samples (T, C) with their rates, at the times `at`."""
    if len(t) < 2:
        return values
    h = (t[-1] - t[0]) / (len(t) - 1)
    place = np.clip((at - t[0]) / h, 0.0, len(t) - 1.0)
    i = np.minimum(place.astype(int), len(t) - 2)
    s = (place - i)[:, None]
    a, b, da, db = values[i], values[i + 1], h * rates[i], h * rates[i + 1]
    return a + s * (da + s * (3 * (b - a) - 2 * da - db + s * (2 * (a - b) + da + db)))
