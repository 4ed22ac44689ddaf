"""The closed-form fish as machine code: the fastest engine on a CPU (extra `fast`).

The physics is `hydro_fit.chain.step`, translated and compiled (native.py), 16 fish to a vector loop, float32. Blocks of fish
are shared between threads that hold no lock. `advance` does what `planar.Engine.advance` does, to round-off.

    from NumPy          state, trace = engine.advance(state, commands, params, current, tick)
    inside jax.jit      the same call on the CPU; it becomes one `jax.pure_callback`, which runs no JAX code

Use it in `jit` and `scan` on the CPU; `vmap` runs it once for every entry of the mapped axis. Not differentiable.
"""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fishmj.engines import BUFFER, FishParams, FishState, Trace, approx, check_commands, native
from fishmj.errors import ConfigError
from fishmj.flow import Current
from fishmj.mjcf.description import Robot, load_robot

CHUNK = 8  # blocks of native.LANES fish below which a second thread does not pay


class Applied(NamedTuple):
    """What the water and servos do in one physics step (`hydro_fit.chain.Step.applied`)."""

    force: np.ndarray  # (B, nv) generalised force that makes MuJoCo take the same step, N and N m
    attached: np.ndarray  # (B,) attachment after the step
    power: np.ndarray  # (B,) servos, W


class Engine:
    """Compiled closed-form engine.

    Args:
        robot: description or name.
        threads: at most so many; default, the CPUs this process may use.
        dtype: "float32", or "float64" for comparisons (half as fast).
    Raises:
        MissingExtra: numba is not installed.
    """

    jittable = True  # through a host callback, CPU only

    def __init__(self, robot: "Robot | str" = "fish", threads: int | None = None, dtype: str = "float32"):
        if dtype not in approx.PRECISIONS:
            raise ConfigError(f"compiled engine: dtype = {dtype!r}; choose one of {', '.join(approx.PRECISIONS)}")
        if threads is not None and threads < 1:
            raise ConfigError(f"compiled engine: threads = {threads}; needs at least 1")
        self.robot, self.dtype = load_robot(robot), np.dtype(dtype)
        self.threads = threads or len(os.sched_getaffinity(0))
        self.kernel = native.load(self.robot, "advance", approx.PRECISIONS[dtype]).advance
        self._pool, self._owner = None, 0

    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick):
        """Advance B fish by the T bus commands (B, T, J) [rad]; tick (B,) int counts bus ticks since t = 0.

        Returns:
            (FishState, Trace with T ticks), new arrays of the engine's dtype.
        Raises:
            ConfigError: an array has the wrong shape, or a flow row lies outside the table.
        """
        check_commands(commands, self.robot.n_joints)
        given = (state, commands, params, current, tick)
        if "jax" in sys.modules and _is_traced(given):
            return self._advance_traced(given)
        return self._advance_numpy(*given)

    def _advance_numpy(self, state, commands, params, current, tick):
        batch, ticks, joints = commands.shape
        n, nv, real = joints + 1, joints + 3, self.dtype
        read = lambda name, value, *shape: _array(name, value, (batch, *shape), real)  # noqa: E731
        fresh = lambda name, value, *shape: np.array(read(name, value, *shape), order="C")  # noqa: E731
        q, v = fresh("state.q", state.q, nv), fresh("state.v", state.v, nv)
        attached = fresh("state.attached", state.attached).reshape(batch, 1)
        buffer = fresh("state.buffer", state.buffer, BUFFER, joints)
        shapes = (("mass", n), ("kp", joints), ("kv", joints), ("kb", joints), ("zero", joints), ("water", 2 * n + 9))
        swimmer = tuple(read(f"params.{name}", getattr(params, name), size) for name, size in shapes)
        delay = _array("params.delay", params.delay, (batch,), np.dtype(np.int64)).reshape(batch, 1)
        table = np.asarray(current.table, real)
        water = (
            read("current.mean", current.mean, 2),
            read("current.rms", current.rms).reshape(batch, 1),
            self._rows(current, batch, table),
            read("current.offset", current.offset, 2),
            read("current.turn", current.turn, 2),
        )
        clock = read("tick", tick).reshape(batch, 1)
        trace = tuple(np.empty((batch, ticks, size), real) for size in (3, joints, joints, 3, 1))
        flat, cells, cell = table.reshape(-1), table.shape[1], real.type(current.cell)
        tail = ((q, v, attached), buffer, read("commands", commands, ticks, joints), swimmer, delay, water, clock)
        self._share(batch, self.kernel, (*tail, flat, cells, cell, table.ndim == 3, trace))
        return FishState(q, v, attached[:, 0], buffer), Trace(*trace[:4], trace[4][..., 0])

    def _rows(self, current, batch: int, table) -> np.ndarray:
        """Slices of the flow table as floats (B, 1), checked: the compiled loop reads memory unguarded."""
        if table.ndim not in (3, 4) or table.shape[-1] != 2 or (table.ndim == 4 and table.shape[1] != table.shape[2]):
            raise ConfigError(f"current.table: got shape {table.shape}, expected (S, n, n, 2) for turbulence or (S, T, 2) for gusts")
        row = _array("current.row", current.row, (batch,), self.dtype).reshape(batch, 1)
        if batch and not (row.min() >= 0 and row.max() < len(table)):
            raise ConfigError(f"current.row: got {row.min():g} to {row.max():g}, expected 0 to {len(table) - 1}, the slices of the table")
        return row

    def forces(self, q, v, attached, params: FishParams, target, flow, ambient) -> Applied:
        """`Step.applied` of one physics step over a batch, float64.

        Args:
            q, v: (B, nv). attached: (B,). target: (B, J) encoder angles after the servo's delay, rad.
            flow: (B, N, 2) water velocity at the links, m/s. ambient: (B, 2) DU/Dt, m/s2. World frame.
        """
        batch, joints = len(q), self.robot.n_joints
        n, nv, real = joints + 1, joints + 3, np.dtype(np.float64)
        read = lambda name, value, *shape: _array(name, value, (batch, *shape), real)  # noqa: E731
        shapes = (("mass", n), ("kp", joints), ("kv", joints), ("kb", joints), ("zero", joints), ("water", 2 * n + 9))
        swimmer = tuple(read(f"params.{name}", getattr(params, name), size) for name, size in shapes)
        state = (read("q", q, nv), read("v", v, nv), read("attached", attached).reshape(batch, 1))
        water = (read("target", target, joints), read("flow", flow, n, 2).reshape(batch, 2 * n), read("ambient", ambient, 2))
        out = tuple(np.empty((batch, size)) for size in (nv, 1, 1))
        self._share(batch, self._evaluate, (state, swimmer, *water, out))
        return Applied(out[0], out[1][:, 0], out[2][:, 0])

    @cached_property
    def _evaluate(self):
        return native.load(self.robot, "evaluate", approx.DOUBLE).evaluate

    def _share(self, batch: int, kernel, arguments: tuple) -> None:
        """Run `kernel(first, stop, *arguments)` over all fish, whole blocks to each thread."""
        blocks = -(-batch // native.LANES)
        workers = max(1, min(self.threads, blocks // CHUNK))
        edges = [native.LANES * (blocks * i // workers) for i in range(workers)] + [batch]
        others = [self._threads().submit(kernel, a, b, *arguments) for a, b in zip(edges[1:-1], edges[2:], strict=True)]
        kernel(edges[0], edges[1], *arguments)
        for other in others:
            other.result()

    def _threads(self) -> ThreadPoolExecutor:
        """The pool of this process; a fork starts its own."""
        if self._pool is None or self._owner != os.getpid():
            self._pool, self._owner = ThreadPoolExecutor(max(1, self.threads - 1), "fishmj"), os.getpid()
        return self._pool

    def _advance_traced(self, given):
        import jax

        state, commands, _, _, _ = given
        (batch, ticks, joints), real = commands.shape, self.dtype
        shape = lambda *sizes: jax.ShapeDtypeStruct((batch, *sizes), real)  # noqa: E731
        after = FishState(shape(joints + 3), shape(joints + 3), shape(), shape(BUFFER, joints))
        trace = Trace(shape(ticks, 3), shape(ticks, joints), shape(ticks, joints), shape(ticks, 3), shape(ticks))
        return jax.pure_callback(self._advance_numpy, (after, trace), *given, vmap_method="sequential")


def _array(name: str, value, shape: tuple, dtype) -> np.ndarray:
    """`value` as a contiguous array, or one clear error."""
    array = np.ascontiguousarray(value, dtype)
    if array.shape != shape:
        raise ConfigError(f"compiled engine, {name}: got shape {array.shape}, expected {shape}")
    return array


def _is_traced(tree: Any) -> bool:
    import jax

    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(tree))
