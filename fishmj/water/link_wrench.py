"""Coupling of the water to MuJoCo by wrenches on the links in `data.xfrc_applied`: no callback, for any thread and loop.

    fish = LinkWrench(model, PlanarWater(robot, swimmer, learnt=...))
    while swimming:
        fish.apply(data)                before every mj_step
        mujoco.mj_step(model, data)

MuJoCo solves (M + h D) a = f + sum J^T wrench. The wrench contains the added mass times a, so this module first solves for a with
MuJoCo's matrix and forces; the step equals that of `injection` to round-off:

    (M + M_a + h D) a = f + Q,    wrench_i = explicit force_i - A_i a_i      about the link's centre of mass, world axes
"""

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.water.injection import checked_step, rows_of_mass
from fishmj.water.planar_water import PlanarWater


class LinkWrench:
    """Water of one model; shares nothing with other models or threads.

    Put your own forces on the fish into `data.qfrc_applied` (mujoco.mj_applyFT) before `apply`, because the added mass also
    depends on them. Do not write to the links' rows of `data.xfrc_applied`. Contacts and constraints are not supported; models of
    `fishmj.mjcf.build` have neither.

    Args:
        model: from `fishmj.mjcf.build`, root as the water's.
        water: `PlanarWater` or `spatial_water.FreeWater`.

    Raises ConfigError: the water has another root, the model is not a single chain, or its integrator is not Euler.
    """

    def __init__(self, model: mujoco.MjModel, water: PlanarWater):
        rows_of_mass(model, water, "LinkWrench")
        if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
            raise ConfigError("LinkWrench: the model's integrator is not Euler, the only one supported; set it to Euler")
        self.model, self.water = model, water
        self._taken: tuple | None = None  # (time, attachment, memory one step later) of the last `apply`

    def begin(self, attached: float = 0.5, memory: "list | None" = None) -> None:
        """Sets the water's memory after a reset or jump of `data`, by default to that of a fish at rest."""
        self.water.attached, self.water.memory = attached, self.water.at_rest() if memory is None else memory
        self._taken = None

    def apply(self, data: mujoco.MjData) -> None:
        """Writes the wrenches of this state to `data.xfrc_applied`; calling it twice for one state is safe.

        The water's memory advances by itself: once for every step that `data.time` has made since the last call.

        Raises:
            ConfigError: `data.time` is neither unchanged nor one step further. SimDiverged: a force is not finite.
            All errors of the water; neither data nor memory has then changed.
        """
        if self._taken is not None:
            self._advance_memory(data.time)
        wrenches = self.wrenches(data)
        self._taken = data.time, *self.water.following(self.model, data)
        data.xfrc_applied[1 : len(wrenches) + 1] = wrenches

    def wrenches(self, data: mujoco.MjData) -> np.ndarray:
        """Force [N] and moment [N m] of the water on every link about its centre of mass, world axes, (N, 6); pure.

        Updates only fields of `data` that MuJoCo derives from state and commands. Raises SimDiverged as `apply`.
        """
        model, water = self.model, self.water
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        added, force = water.forces(model, data)
        if not (np.isfinite(force).all() and np.isfinite(added).all()):
            raise water.blame(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        mass += added
        if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP:
            mass[np.diag_indices(model.nv)] += model.opt.timestep * model.dof_damping
        force = force + data.qfrc_passive - data.qfrc_bias + data.qfrc_actuator + data.qfrc_applied
        return water.wrenches(model, data, np.linalg.solve(mass, force))

    def step(self, data: mujoco.MjData) -> None:
        """Does `apply` and one `mj_step`, and advances the water's memory.

        Raises SimDiverged: a force or the state is not finite. All errors of the water; nothing has then changed.
        """
        self.apply(data)
        checked_step(self.model, data)
        self._advance_memory(data.time)

    def _advance_memory(self, time: float) -> None:
        """Advances the memory if a step was made since the last `apply`."""
        since, attached, memory = self._taken or (time, None, None)
        self._taken = None
        if time == since:
            return
        if abs(time - since - self.model.opt.timestep) > 1e-9:
            raise ConfigError(
                f"LinkWrench: data.time went from {since:.4f} s to {time:.4f} s, expected one step of"
                f" {self.model.opt.timestep:g} s; call apply before every mj_step, and begin after a reset"
            )
        self.water.attached, self.water.memory = attached, memory
