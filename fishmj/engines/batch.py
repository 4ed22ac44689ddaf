"""Many fish in MuJoCo's C engine: a persistent `mujoco.batch.Batch`, the water through `qfrc_applied`.

In each physics step the closed form solves (M + M_a + h D) a = f and hands MuJoCo the water's share Q_water - M_a a. MuJoCo
applies its own servo, solves its own M + h D and integrates. MuJoCo thus moves the fish, and the added mass acts without delay.
The closed form is evaluated in float64 by the compiled evaluator (extra `fast`), or by JAX without it.

Masses, inertias and servo gains differ from fish to fish inside MuJoCo's models as well (`expand`).
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from mujoco.batch import Batch

from fishmj import mjcf
from fishmj.base.cores import usable_cores
from fishmj.base.errors import MissingExtra, SimDiverged
from fishmj.engines import Copied, FishParams, FishState, Trace, check_commands, swimmer, ticks_per
from fishmj.engines.extensions import Extensions, stacked
from fishmj.engines.planar import link_centres
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.mjcf.servos import on_the_bus, targets_of_tick
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Current, sample

SMALLEST = 16  # with fewer fish a second thread is slower


class BatchEngine(Copied):
    """MuJoCo C, batched. NumPy in, NumPy out; not jit-able.

    Each thread has a `ThreadedBatch` with a part of the fish; MuJoCo, the evaluator and large NumPy operations release the GIL.

    Args:
        robot: description or name.
        threads: maximal number of threads; default, the CPUs that this process may use.
        evaluator: "compiled" (needs numba), "jax", or None for the faster one that is installed.
    """

    jittable = False

    def __init__(self, robot: "Robot | str" = "fish", threads: int | None = None, evaluator: str | None = None):
        self.robot = load_robot(robot)
        self.arguments = self.robot, threads, evaluator
        self.steps, self.ticks = ticks_per(self.robot)
        ch = planar_chain.chain_of(self.robot)
        self._parts = mjcf.build(self.robot, bare=True), *evaluator_of(self.robot, ch, evaluator)  # read-only
        self._start(threads or usable_cores())

    def _start(self, threads: int) -> None:
        """Allocates memory and threads, which copies of the engine do not share."""
        self.shoals = [ThreadedBatch(self.robot, *self._parts) for _ in range(threads)]
        self._table: tuple = (None, None)  # flow table as given, and its float64 copy
        self._pool = ThreadPoolExecutor(threads, "fishmj-batch")

    def __deepcopy__(self, memo: dict) -> "BatchEngine":
        twin = object.__new__(type(self))
        vars(twin).update(vars(self))
        twin._start(len(self.shoals))
        return twin

    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick):
        """Advances B fish by the T bus commands (B, T, J) [rad]; tick (B,) int counts bus ticks since t = 0.

        Returns:
            (FishState, Trace with T ticks), float64 NumPy.

        Raises SimDiverged: MuJoCo warned about or reset a fish; names the first.
        """
        commands = on_the_bus(self.robot.servo, np.asarray(commands, float))
        check_commands(commands, self.robot.n_joints)
        count = len(commands)
        used = max(1, min(len(self.shoals), count // SMALLEST))
        edges = [count * i // used for i in range(used + 1)]
        current, tick = Current(*(np.asarray(a) for a in current)), np.asarray(tick)
        mean, rms, row, offset, turn, table, cell = current
        if self._table[0] is not table:
            self._table = table, np.ascontiguousarray(table, float)
        table = self._table[1]
        jobs = []
        for i, j in zip(edges, edges[1:], strict=False):
            part = lambda tree: type(tree)(*(np.asarray(a)[i:j] for a in tree))  # noqa: B023, E731  used at once
            flow = Current(mean[i:j], rms[i:j], row[i:j], offset[i:j], turn[i:j], table, cell)
            jobs.append((part(state), commands[i:j], part(params), flow, tick[i:j]))
        others = [self._pool.submit(shoal.advance, *job) for shoal, job in zip(self.shoals[1:], jobs[1:], strict=False)]
        results = [self.shoals[0].advance(*jobs[0]), *(other.result() for other in others)]
        bad = np.concatenate([edge + lost for edge, (_, _, lost) in zip(edges, results, strict=False)])
        if len(bad):
            raise SimDiverged(
                f"batch: {len(bad)} of {count} fish diverged, the first is number {bad[0]}; MuJoCo reset them to their start."
                " Check their parameters, the flow and the commands",
                term="state",
                states=bad,
            )
        join = lambda trees: type(trees[0])(*(np.concatenate(leaves) for leaves in zip(*trees, strict=True)))
        return join([r[0] for r in results]), join([r[1] for r in results])


class ThreadedBatch:
    """Fish of one thread and their persistent MuJoCo batch."""

    def __init__(self, robot: Robot, model, evaluate, look):
        self.model, self.evaluate, self.look = model, evaluate, look
        self.steps, _ = ticks_per(robot)
        self.ramp = robot.timing.command_path == "move_time"
        self._batch: Any = None
        self._params: FishParams | None = None

    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick):
        """Advances like `BatchEngine.advance`, for quantised commands.

        Returns (FishState, Trace, indices of the fish that diverged).
        """
        count, length, joints = commands.shape
        params = FishParams(*(np.ascontiguousarray(a, float) for a in params))._replace(delay=np.asarray(params.delay, int))
        batch = self._models(count, params)
        batch.qpos[:], batch.qvel[:] = state.q, state.v
        attached, buffer = np.array(state.attached, float), np.array(state.buffer, float)
        memory = np.array(state.memory, float)
        before = batch.warning[:, :, 1].copy()  # counters; column 0 is the last degree of freedom
        q, v, ctrl, applied = batch.qpos, batch.qvel, batch.ctrl, batch.qfrc_applied
        blank = lambda n: np.empty((count, length, n))
        out = Trace(blank(3), blank(joints), blank(joints), blank(3), np.zeros((count, length)))
        for k in range(length):
            buffer = np.concatenate([buffer[:, 1:], commands[:, k : k + 1]], 1)
            flow, ambient = self.look(q, current, tick + k)
            for target in targets_of_tick(np, buffer, params.delay, self.steps, self.ramp):
                force, attached, power, memory = self.evaluate(q, v, attached, params, target, flow, ambient, memory)
                ctrl[:], applied[:] = target, force
                batch.step()
                out.power[:, k] += power / self.steps
            out.pose[:, k], out.joint[:, k] = q[:, :3], q[:, 3:] - params.zero
            out.velocity[:, k], out.rate[:, k] = v[:, :3], v[:, 3:]
        lost = (batch.warning[:, :, 1] > before).any(-1) | ~np.isfinite(q).all(-1) | ~np.isfinite(v).all(-1)
        return FishState(q.copy(), v.copy(), attached, buffer, memory), out, np.flatnonzero(lost)

    def _models(self, count: int, params: FishParams):
        """Batch of `count` fish with these masses and gains."""
        if self._batch is None or self._batch.nsim != count:
            self._batch, self._params = Batch(self.model, count, 1), None
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


def evaluator_of(robot: Robot, ch: planar_chain.Chain, name: str | None) -> tuple:
    """Functions that evaluate water and flow in float64; those of the compiled engine release the GIL.

    Returns:
        f(q, v, attached, params, target, flow, ambient, memory) -> (applied (B, nv), attached, power, memory (B, M)), and
        g(q, current, tick) -> (flow (B, N, 2), ambient (B, 2)).
    """
    if name != "jax":
        try:
            from fishmj.engines.compiled import CompiledEngine as Compiled

            compiled = Compiled(robot, threads=1)  # called from the thread of each `ThreadedBatch`
            compiled._evaluate, compiled._look  # noqa: B018  compile now, not in the first step
            return compiled.forces, compiled.look
        except MissingExtra:
            if name == "compiled":
                raise
    return _jax_evaluator(ch, Extensions.of(robot)), lambda q, *given: sample(np, given[0], link_centres(np, ch, q), given[1])


def _jax_evaluator(ch: planar_chain.Chain, added: Extensions):
    import jax
    import jax.numpy as jnp

    @jax.jit
    def forces(q, v, attached, params, target, flow, ambient, memory):
        columns = lambda a: [a[:, i] for i in range(a.shape[1])]
        links, hooks = [columns(flow[:, i]) for i in range(ch.n)], added.hooks(jnp, columns(params.effects), columns(memory))
        around = (columns(target), links, columns(ambient))
        s = planar_chain.step(jnp, ch, swimmer(params), columns(q), columns(v), attached, *around, hooks)
        return jnp.stack(s.applied, -1), s.attached, s.power, stacked(jnp, s.memory, memory)

    def evaluate(*arguments):
        with jax.enable_x64(True):
            return tuple(np.asarray(a) for a in forces(*arguments))

    return evaluate
