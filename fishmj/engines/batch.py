"""Many fish in MuJoCo's C engine: a persistent `mujoco.batch.Batch`, the water through `qfrc_applied`.

Each physics step the closed form solves (M + M_a + h D) a = f and hands MuJoCo the water's share Q_water - M_a a; MuJoCo
applies its own servo, solves its own M + h D and integrates. So MuJoCo moves the fish, and the added mass is never lagged.
The closed form is evaluated in float64 by the compiled evaluator (extra `fast`), or by JAX without it.

Masses, inertias and servo gains differ from fish to fish inside MuJoCo's models as well (`expand`).
"""

import os
from typing import Any

import numpy as np
from mujoco.batch import Batch

from fishmj import mjcf
from fishmj.engines import FishParams, FishState, Trace, check_commands, swimmer, ticks_per
from fishmj.engines.planar import arrived, link_centres, quantise
from fishmj.errors import MissingExtra, SimDiverged
from fishmj.flow import Current, sample
from fishmj.hydro_fit import chain
from fishmj.mjcf.description import Robot, load_robot


class Engine:
    """MuJoCo C, batched. NumPy in, NumPy out; not jit-able.

    Args:
        robot: description or name.
        threads: of MuJoCo's pool; default, the CPUs this process may use.
        evaluator: "compiled" (needs numba), "jax", or None for the faster one that is installed.
    """

    jittable = False

    def __init__(self, robot: "Robot | str" = "fish", threads: int | None = None, evaluator: str | None = None):
        self.robot = load_robot(robot)
        self.model = mjcf.build(self.robot, bare=True)
        self.chain = chain.chain_of(self.robot)
        self.steps, self.ticks = ticks_per(self.robot)
        self.ramp = self.robot.timing.command_path == "move_time"
        self.threads = threads or len(os.sched_getaffinity(0))
        self.evaluate = evaluator_of(self.robot, self.chain, self.threads, evaluator)
        self._batch: Any = None
        self._params: FishParams | None = None

    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick):
        """Advance B fish by the T bus commands (B, T, J) [rad]; tick (B,) int counts bus ticks since t = 0.

        Returns:
            (FishState, Trace with T ticks), float64 NumPy.

        Raises:
            SimDiverged: MuJoCo warned of, or reset, a fish; names the first.
        """
        commands = quantise(np, self.robot, np.asarray(commands, float))
        check_commands(commands, self.robot.n_joints)
        count, length, joints = commands.shape
        params = FishParams(*(np.ascontiguousarray(a, float) for a in params[:-1]), np.asarray(params.delay, int))
        batch = self._models(count, params)
        batch.qpos[:], batch.qvel[:] = state.q, state.v
        attached, buffer = np.array(state.attached, float), np.array(state.buffer, float)
        current = Current(*(np.asarray(a) for a in current))
        tick = np.asarray(tick)
        before = batch.warning[:, :, 1].copy()  # counters; column 0 is the last degree of freedom
        q, v, ctrl, applied = batch.qpos, batch.qvel, batch.ctrl, batch.qfrc_applied
        blank = lambda n: np.empty((count, length, n))  # noqa: E731
        out = Trace(blank(3), blank(joints), blank(joints), blank(3), np.zeros((count, length)))
        for k in range(length):
            buffer = np.concatenate([buffer[:, 1:], commands[:, k : k + 1]], 1)
            flow, ambient = sample(np, current, link_centres(np, self.chain, q), tick + k)
            for target in arrived(np, buffer, params.delay, self.steps, self.ramp):
                force, attached, power = self.evaluate(q, v, attached, params, target, flow, ambient)
                ctrl[:], applied[:] = target, force
                batch.step()
                out.power[:, k] += power / self.steps
            out.pose[:, k], out.joint[:, k] = q[:, :3], q[:, 3:] - params.zero
            out.velocity[:, k], out.rate[:, k] = v[:, :3], v[:, 3:]
        self._check(batch, before, q, v)
        return FishState(q.copy(), v.copy(), attached, buffer), out

    def _models(self, count: int, params: FishParams):
        """The batch of `count` fish with these masses and gains."""
        if self._batch is None or self._batch.nsim != count:
            self._batch, self._params = Batch(self.model, count, self.threads), None
        known = self._params
        if known is None or not all(np.array_equal(a, b) for a, b in zip(known[:5], params[:5], strict=True)):
            model, batch = self.model, self._batch
            batch.expand("body_mass")[:, 1:] = model.body_mass[1:] * params.mass
            batch.expand("body_inertia")[:, 1:] = model.body_inertia[1:] * params.mass[:, :, None]
            batch.expand("dof_damping")[:, 3:] = params.kb
            batch.expand("actuator_gainprm")[:, :, 0] = params.kp
            bias = batch.expand("actuator_biasprm")
            bias[:, :, 0], bias[:, :, 1], bias[:, :, 2] = params.kp * params.zero, -params.kp, -params.kv
            batch.set_const()
            self._params = FishParams(*(a.copy() for a in params))
        return self._batch

    def _check(self, batch, before, q, v) -> None:
        """Raise for a fish that MuJoCo put back to its start, or that left the finite numbers."""
        bad = np.flatnonzero((batch.warning[:, :, 1] > before).any(-1) | ~np.isfinite(q).all(-1) | ~np.isfinite(v).all(-1))
        if len(bad):
            raise SimDiverged(
                f"batch: {len(bad)} of {len(q)} fish diverged, the first is number {bad[0]}; MuJoCo reset them to their start."
                " Check their parameters, the flow and the commands",
                term="state",
                states=bad,
            )


def evaluator_of(robot: Robot, ch: chain.Chain, threads: int, name: str | None):
    """f(q, v, attached, params, target, flow, ambient) -> (applied (B, nv), attached (B,), power (B,)), float64."""
    if name != "jax":
        try:
            from fishmj.engines.compiled import Engine as Compiled

            compiled = Compiled(robot, threads)
            compiled._evaluate  # noqa: B018  compile now, not in the first step
            return compiled.forces
        except MissingExtra:
            if name == "compiled":
                raise
    return _jax_evaluator(ch)


def _jax_evaluator(ch: chain.Chain):
    import jax
    import jax.numpy as jnp

    @jax.jit
    def forces(q, v, attached, params, target, flow, ambient):
        columns = lambda a: [a[:, i] for i in range(a.shape[1])]  # noqa: E731
        links = [(flow[:, i, 0], flow[:, i, 1]) for i in range(ch.n)]
        s = chain.step(jnp, ch, swimmer(params), columns(q), columns(v), attached, columns(target), links, columns(ambient))
        return jnp.stack(s.applied, -1), s.attached, s.power

    def evaluate(*arguments):
        with jax.enable_x64(True):
            return tuple(np.asarray(a) for a in forces(*arguments))

    return evaluate
