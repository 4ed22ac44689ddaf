"""Coupling of the water to MuJoCo by a callback: added mass goes into the mass matrix, other forces into the passive forces.

MuJoCo calls `mjcb_passive` once per step, between the factorisation of M and the solve. Here it
    1. rebuilds M from the pose (mj_makeM), so that a second call or an extra mj_forward never adds twice,
    2. adds M_a and factors again (mj_factorM); Euler's implicit damping then works on M + M_a as well,
    3. adds the water's explicit generalised force to qfrc_passive.
Nothing reads qfrc_actuator or qfrc_bias, which are stale at that moment. The callback is pure; the water's memory advances once
for each step in `Handle.step`.

An exception must not pass through MuJoCo's C frames, which would abort the process. An exception in the water is stored;
`Handle.step` restores the state and raises it. After a plain mj_step it is raised when the block ends.

MuJoCo has one callback per process (`mjcf.passive_slot`): this module dispatches on the model, ignores other models, refuses a
callback slot in use by other code, works in one thread (`link_wrench` in any), and always cleans up.
"""

from contextlib import contextmanager

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, InjectionError, SimDiverged
from fishmj.mjcf import passive_slot
from fishmj.water.planar_water import PlanarWater

_handles: dict[int, "Handle"] = {}  # address of the model -> its water


class Handle:
    """Model with its water within an `inject` block."""

    def __init__(self, model: mujoco.MjModel, water):
        rows = rows_of_mass(model, water, "inject")
        self.model, self.water = model, water
        self.error: BaseException | None = None
        self._pattern = rows, model.M_colind.copy()

    def step(self, data: mujoco.MjData) -> None:
        """Does one `mj_step`, and advances the water's memory by one step.

        Raises:
            SimDiverged: a force or the state is not finite.
            All errors of the water; the state is then as before the step.
        """
        following = self.water.following(self.model, data)
        before = data.time, data.qpos.copy(), data.qvel.copy()
        checked_step(self.model, data, self)
        if self.error is not None:
            data.time, data.qpos[:], data.qvel[:] = before
            self.raise_error()
        self.water.attached, self.water.memory = following

    def raise_error(self) -> None:
        """Raises the error that the callback stored, once."""
        error, self.error = self.error, None
        if error is not None:
            raise error

    def passive(self, model, data) -> None:
        """Callback: adds M_a to M, and the explicit force to qfrc_passive."""
        added, force = self.water.forces(model, data)
        if not (np.isfinite(force).all() and np.isfinite(added).all()):
            raise self.water.blame(model, data)
        mujoco.mj_makeM(model, data)
        data.M[:] += added[self._pattern]
        mujoco.mj_factorM(model, data)
        data.qfrc_passive[:] += force


def rows_of_mass(model: mujoco.MjModel, water: PlanarWater, who: str) -> np.ndarray:
    """Row of each entry of the model's mass matrix. Raises ConfigError for a model that this water does not support."""
    root = "free" if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE else "planar"
    if water.root != root:
        raise ConfigError(f"{who}: the model's root is {root!r}, the water's {water.root!r}; build both with the same root")
    rows = np.repeat(np.arange(model.nv), model.M_rownnz)
    if len(rows) != model.nv * (model.nv + 1) // 2:
        raise ConfigError(
            f"{who}: the mass matrix of {model.nv} degrees of freedom has {len(rows)} entries, expected a full lower"
            " triangle; the water needs one serial chain of links, built by fishmj.mjcf.build"
        )
    return rows


def inject(model: mujoco.MjModel, water: PlanarWater):
    """Context manager that couples `model` to `water`; blocks nest, with one model each.

    Args:
        model: from `fishmj.mjcf.build`, root as the water's.
        water: `PlanarWater` or `spatial_water.FreeWater`.

    Yields:
        Handle, whose `step(data)` advances the fish by one physics step.

    Raises InjectionError: the callback is in use by other code or another thread, or the model has a water already.
    """
    return installed(Handle(model, water))


@contextmanager
def installed(handle: Handle):
    """Context manager that registers this handle with the callback; as `inject`."""
    key = handle.model._address
    if key in _handles:
        raise InjectionError("inject: this model has a water already; use one block for each model")
    if not _handles or passive_slot.taken_by_another_thread():
        passive_slot.install(_dispatch)
    _handles[key] = handle
    try:
        yield handle
        handle.raise_error()
    finally:
        del _handles[key]
        if not _handles:
            passive_slot.remove()


def checked_step(model: mujoco.MjModel, data: mujoco.MjData, handle: Handle | None = None) -> None:
    """Does `mj_step`; raises an error if MuJoCo has silently reset the fish.

    MuJoCo responds to a NaN or a huge number by a reset to qpos0 and a warning counter; the previous state is lost.

    Raises SimDiverged: names the quantity and the degree of freedom.
    """
    before = data.warning.number.copy()
    time = data.time
    mujoco.mj_step(model, data)
    if handle is not None and handle.error is not None:
        return  # the water's own error is more specific
    grown = np.flatnonzero(data.warning.number > before)
    if len(grown):
        kind = mujoco.mjtWarning(int(grown[0])).name.removeprefix("mjWARN_BAD").lower()
        dof = int(data.warning.lastinfo[grown[0]])
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, model.dof_jntid[min(dof, model.nv - 1)])
        raise SimDiverged(
            f"MuJoCo reset the fish at t = {time:.3f} s: {kind} of joint {name!r} was not finite or was huge;"
            " reduce the time step, or check the forces applied to the model",
            time=time,
            term=kind,
            link=name or "",
        )
    if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
        raise SimDiverged(f"the state is not finite at t = {time:.3f} s", time=time, term="state")


def _dispatch(model, data) -> None:
    handle = _handles.get(model._address)
    if handle is None or handle.error is not None:
        return
    try:
        handle.passive(model, data)
    except BaseException as error:  # noqa: BLE001  kept, raised outside MuJoCo's frames
        handle.error = error
