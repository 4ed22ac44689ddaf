"""The closed-form fish as machine code: the fastest engine on a CPU (extra `fast`).

The physics is `planar_chain.step`, translated and compiled (numba_build.py), 16 fish in a vector loop. The network of a learnt
residual is a separate loop, which takes the weights as an argument (residual_lanes.py). Threads work on blocks of fish without
the GIL. `advance` equals `planar.PlanarEngine.advance` to round-off. The motion of a fish is bit-identical in any batch and with
any number of threads.

    from NumPy          state, trace = engine.advance(state, commands, params, current, tick)
    inside jax.jit      the same call, on the CPU, as one host callback by name (`host_call`), so that JAX can cache the program
                        on disk. No JAX code runs in the callback, because it could deadlock. `vmap` calls it once for each
                        entry of the mapped axis.

Not differentiable: use `planar` for gradients.
"""

import ctypes
import hashlib
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from ctypes import POINTER, c_char_p, c_int, c_int64, c_size_t, c_uint32, c_void_p
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError
from fishmj.engines import (
    Copied,
    FishParams,
    FishState,
    Trace,
    check_commands,
    fast_math,
    numba_build,
    residual_lanes,
    rows_of,
    ticks_per,
)
from fishmj.engines.extensions import Extensions
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import strip_forces
from fishmj.water.flow import Current

WATER = len(strip_forces.Coefficients._fields) - 2  # coefficients of a water besides k and cn of each link
CHUNK = 8  # minimal number of blocks of numba_build.LANES fish for a thread; with fewer it is slower
DTYPES: dict[int, np.dtype] = {11: np.dtype(np.float32), 12: np.dtype(np.float64)}  # XLA_FFI_DataType
METADATA = 1  # XLA_FFI_Extension_Type of the query when the name is registered
INTERNAL = 13  # XLA_FFI_Error_Code
_BOUND: dict[str, Any] = {}  # name -> its C function, which must live as long as any program that calls it


class Applied(NamedTuple):
    """Forces and memory after one physics step of water and servos."""

    force: np.ndarray  # (B, nv) generalised force that makes MuJoCo take the same step, N and N m
    attached: np.ndarray  # (B,) attachment after the step
    power: np.ndarray  # (B,) servos, W
    memory: np.ndarray  # (B, M) after the step


class CompiledEngine(Copied):
    """Compiled closed-form engine; compiles at the first `advance` or `forces` (seconds, cached on disk).

    Args:
        robot: description or name.
        threads: maximal number of threads; default, the CPUs that this process may use.
        dtype: of `advance`: "float32", or "float64" for comparisons (about half as fast).
    Raises:
        MissingExtra: numba is not installed.
    """

    jittable = True  # through a host callback, on a CPU only

    def __init__(self, robot: "Robot | str" = "fish", threads: int | None = None, dtype: str = "float32"):
        if dtype not in fast_math.PRECISIONS:
            raise ConfigError(f"compiled engine: dtype = {dtype!r}; choose one of {', '.join(fast_math.PRECISIONS)}")
        if threads is not None and threads < 1:
            raise ConfigError(f"compiled engine: threads = {threads}; expected 1 or more")
        numba_build.require_numba()
        self.robot, self.dtype = load_robot(robot), np.dtype(dtype)
        self.arguments = self.robot, threads, dtype
        self.steps, self.ticks = ticks_per(self.robot)
        self.buffer, self.added = rows_of(self.robot), Extensions.of(self.robot)
        self._packed: dict[np.dtype, list[np.ndarray]] = {}
        self.threads = threads or usable_cores()
        self._pool: ThreadPoolExecutor | None = None
        self._owner = 0  # id of the process that made the thread pool

    def _numbers(self, dtype: np.dtype) -> list[np.ndarray]:
        """Each learnt residual as one flat array; an empty one if there is none."""
        of, dt = self._packed, self.robot.timing.physics_dt
        if dtype not in of:
            packed = [residual_lanes.flat_weights(learnt, dt, dtype) for learnt in self.added.nets]
            of[dtype] = packed or [np.zeros(0, dtype)]
        return of[dtype]

    @cached_property
    def _advance(self):
        return numba_build.load(self.robot, "advance", fast_math.PRECISIONS[self.dtype.name]).advance

    @cached_property
    def _evaluate(self):
        return numba_build.load(self.robot, "evaluate", fast_math.DOUBLE).evaluate

    @cached_property
    def _look(self):
        return numba_build.load(self.robot, "look", fast_math.DOUBLE).look

    def advance(self, state: FishState, commands, params: FishParams, current: Current, tick):
        """Advances B fish by the T bus commands (B, T, J) [rad]; tick (B,) int counts bus ticks since t = 0.

        Returns:
            (FishState, Trace with T ticks), new arrays of the engine's dtype.
        Raises:
            ConfigError: an array has the wrong shape, a latency is negative, or a flow row lies outside the table.
        """
        check_commands(commands, self.robot.n_joints)
        self._advance  # noqa: B018  compile here, never inside a callback
        given = (state, commands, params, current, tick)
        return self._advance_traced(*given) if _is_traced(given) else self._advance_numpy(*given)

    def _advance_numpy(self, state, commands, params, current, tick):
        if (net := self._residual_indices(params.net)) is not None:
            part = lambda here: self._advance_numpy(
                *(_rows_of(tree, here) for tree in (state, commands, params)),
                _rows_of(current._replace(cell=(), table=()), here)._replace(cell=current.cell, table=current.table),
                np.asarray(tick)[here],
            )
            return _by_residual(net, part)
        batch, ticks, joints = commands.shape
        real, read = self.dtype, _reader(batch, self.dtype)
        fresh = lambda *args: np.array(read(*args))  # a copy, because the loop writes into its state
        q, v = fresh("state.q", state.q, joints + 3), fresh("state.v", state.v, joints + 3)
        attached, buffer = fresh("state.attached", state.attached), fresh("state.buffer", state.buffer, self.buffer, joints)
        memory = fresh("state.memory", state.memory, len(self.added.memory))
        delay = _reader(batch, np.dtype(np.int64))("params.delay", params.delay)
        if batch and delay.min() < 0:
            raise ConfigError(f"compiled engine, params.delay: got {delay.min()} physics steps, expected 0 or more")
        water, flow = _background(read, current, real)
        trace = tuple(np.empty((batch, ticks, size), real) for size in (3, joints, joints, 3, 1))
        swimmer = self._swimmer(read, params)
        bodies = ((q, v, _column(attached), memory), buffer, read("commands", commands, ticks, joints), swimmer)
        self._share(
            batch,
            self._advance,
            (self._residual_weights(params, real), *bodies, _column(delay), water, _column(read("tick", tick)), *flow, trace),
        )
        return FishState(q, v, attached, buffer, memory), Trace(*trace[:4], trace[4][..., 0])

    def forces(self, q, v, attached, params: FishParams, target, flow, ambient, memory=None) -> Applied:
        """`Step.applied`, attachment and power of one physics step over a batch, NumPy, float64.

        Args:
            q, v: (B, nv). attached: (B,). target: (B, J) present servo targets (encoder angles), rad.
            flow: (B, N, 2) water velocity at the links, m/s. ambient: (B, 2) DU/Dt, m/s2. World frame.
            memory: (B, M) of `FishState`; not needed for a robot without effects and residual.
        """
        if (net := self._residual_indices(params.net)) is not None:
            given = (q, v, attached, params, target, flow, ambient, *(() if memory is None else (memory,)))
            return _by_residual(net, lambda here: self.forces(*_rows_of(given, here)))
        batch, joints = len(q), self.robot.n_joints
        read = _reader(batch, np.dtype(np.float64))
        memory = read("memory", np.zeros((batch, 0)) if memory is None else memory, len(self.added.memory))
        state = (read("q", q, joints + 3), read("v", v, joints + 3), _column(read("attached", attached)), memory)
        around = read("flow", flow, joints + 1, 2).reshape(batch, 2 * joints + 2)
        given = (state, self._swimmer(read, params), read("target", target, joints), around, read("ambient", ambient, 2))
        out = tuple(np.empty((batch, size)) for size in (joints + 3, 1, 1, memory.shape[1]))
        self._share(batch, self._evaluate, (self._residual_weights(params, np.dtype(float)), *given, out))
        return Applied(out[0], out[1][:, 0], out[2][:, 0], out[3])

    def look(self, q, current: Current, tick) -> tuple[np.ndarray, np.ndarray]:
        """`flow.sample` at the link centres of q (B, nv) at bus tick (B,): (B, N, 2) m/s and (B, 2) m/s2, NumPy, float64."""
        batch, links = len(q), self.robot.n_joints + 1
        read = _reader(batch, np.dtype(np.float64))
        water, flow = _background(read, current, np.dtype(np.float64))
        out = np.empty((batch, 2 * links)), np.empty((batch, 2))
        self._share(batch, self._look, (read("q", q, links + 2), water, _column(read("tick", tick)), *flow, out))
        return out[0].reshape(batch, links, 2), out[1]

    def _residual_indices(self, net) -> np.ndarray | None:
        """Index (B,) of each fish's residual if the batch has several, else None; one kernel call handles one residual."""
        if len(self.added.nets) < 2 or (net := np.asarray(net, int)).size == 0 or (net == net[0]).all():
            return None
        return net

    def _residual_weights(self, params: FishParams, dtype: np.dtype) -> np.ndarray:
        """Weights of the residual that these fish share."""
        net = np.asarray(params.net, int)
        return self._numbers(dtype)[net[0] if len(self.added.nets) > 1 and net.size else 0]

    def _swimmer(self, read, params: FishParams) -> tuple:
        j = self.robot.n_joints
        water = 2 * (j + 1) + WATER
        sizes = {"mass": j + 1, "kp": j, "kv": j, "kb": j, "zero": j, "water": water, "effects": len(self.added.row)}
        return tuple(read(f"params.{name}", getattr(params, name), size) for name, size in sizes.items())

    def _share(self, batch: int, kernel, arguments: tuple) -> None:
        """Runs `kernel(first, stop, *arguments)` over all fish, split among threads in whole blocks."""
        blocks = -(-batch // numba_build.LANES)
        workers = max(1, min(self.threads, blocks // CHUNK))
        edges = [numba_build.LANES * (blocks * i // workers) for i in range(workers)] + [batch]
        others = [self._threads().submit(kernel, a, b, *arguments) for a, b in zip(edges[1:-1], edges[2:], strict=True)]
        kernel(edges[0], edges[1], *arguments)
        for other in others:
            other.result()

    def _threads(self) -> ThreadPoolExecutor:
        """Thread pool of this process; a forked process makes its own."""
        if self._pool is None or self._owner != os.getpid():
            self._pool, self._owner = ThreadPoolExecutor(max(1, self.threads - 1), "fishmj"), os.getpid()
        return self._pool

    def _advance_traced(self, state, commands, params, current, tick):
        """Calls the host with packed arrays and the flow table: each array of a callback costs some 20 us."""
        import jax
        import jax.numpy as jnp

        (batch, ticks, joints), real = commands.shape, self.dtype
        slim = current._replace(cell=jnp.broadcast_to(current.cell, (batch,)), table=None)
        leaves, tree = jax.tree_util.tree_flatten((state, commands, params, slim, tick))
        sizes = [leaf.shape[1:] for leaf in leaves]
        nv = joints + 3
        results = [(nv,), (nv,), (), (self.buffer, joints), self.added.memory.shape]
        results += [(ticks, 3), (ticks, joints), (ticks, joints), (ticks, 3), (ticks,)]
        width = sum(int(np.prod(size)) for size in results)

        def host(packed, table):
            state, commands, params, slim, tick = jax.tree_util.tree_unflatten(tree, _unpack(np.asarray(packed), sizes))
            current = slim._replace(cell=slim.cell[0], table=np.asarray(table))
            state, trace = self._advance_numpy(state, commands, params, current, tick)
            return _pack(np, [*state, *trace], batch, real)

        shape, given = jax.ShapeDtypeStruct((batch, width), real), (_pack(jnp, leaves, batch, real), current.table.astype(real))
        if jax.default_backend() == "cpu":
            does = f"{sizes} {results} {tree} {given[0].shape} {given[1].shape}"  # the module's name is the hash of its code
            # the weights are named separately: fitted waters of one shape share the module
            digest = hashlib.sha256(does.encode() + b"".join(a.tobytes() for a in self._numbers(real))).hexdigest()
            name = f"{self._advance.py_func.__module__}_{digest[:24]}"
            out = host_call(name, host, shape, *given)
        else:
            out = jax.pure_callback(host, shape, *given, vmap_method="sequential")
        out = _unpack(out, results)
        return FishState(*out[:5]), Trace(*out[5:])


def _rows_of(tree, here: np.ndarray):
    """Selects rows `here` of every array in nested tuples; empty tuples stay."""
    if not isinstance(tree, tuple):
        return np.asarray(tree)[here]
    rows = [_rows_of(part, here) for part in tree]
    return type(tree)(*rows) if hasattr(tree, "_fields") else tuple(rows)


def _by_residual(net: np.ndarray, of: Callable):
    """Calls `of` for the fish of each residual, and joins the results in the order of all fish."""
    groups = [np.flatnonzero(net == number) for number in np.unique(net)]
    order = np.argsort(np.concatenate(groups))

    def joined(*parts):
        if not isinstance(parts[0], tuple):
            return np.concatenate(parts)[order]
        made = [joined(*each) for each in zip(*parts, strict=True)]
        return type(parts[0])(*made) if hasattr(parts[0], "_fields") else tuple(made)

    return joined(*map(of, groups))


def _reader(batch: int, dtype: np.dtype):
    """Returns read(name, value, *sizes): `value` as a contiguous (batch, *sizes) array of dtype; it raises ConfigError."""

    def read(name: str, value, *sizes: int) -> np.ndarray:
        array = np.asarray(value, dtype, order="C")
        if array.shape != (batch, *sizes):
            raise ConfigError(f"compiled engine, {name}: got shape {array.shape}, expected {(batch, *sizes)}")
        return array

    return read


def _background(read, current: Current, real: np.dtype) -> tuple[tuple, tuple]:
    """Flow as arguments of the loops: the numbers of each fish, and the table with its cells."""
    table = np.ascontiguousarray(current.table, real)
    water = (
        read("current.mean", current.mean, 2),
        _column(read("current.rms", current.rms)),
        _column(_rows(read("current.row", current.row), table.shape)),
        read("current.offset", current.offset, 2),
        read("current.turn", current.turn, 2),
    )
    return water, (table.reshape(-1), table.shape[1], real.type(current.cell), table.ndim == 3)


def _rows(row: np.ndarray, table: tuple) -> np.ndarray:
    """Flow rows (B,), checked against the table's shape: the compiled loop does not check memory bounds."""
    square = len(table) == 4 and table[1] == table[2]
    if not (square or len(table) == 3) or table[-1] != 2 or 0 in table:
        raise ConfigError(f"current.table: got shape {table}, expected (S, n, n, 2) for turbulence or (S, T, 2) for gusts")
    if len(row) and not (row.min() >= 0 and row.max() < table[0]):
        raise ConfigError(f"current.row: got {row.min():g} to {row.max():g}, expected slices 0 to {table[0] - 1} of the table")
    return row


def _column(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1, 1)


def _pack(xp, arrays: list, batch: int, dtype):
    """Arrays (B, ...) side by side as one (B, width)."""
    return xp.concatenate([a.reshape(batch, int(np.prod(a.shape[1:]))).astype(dtype) for a in arrays], 1)


def _unpack(packed, sizes: list) -> list:
    """Inverse of `_pack`; sizes without the batch axis."""
    edges = np.cumsum([0, *(int(np.prod(size)) for size in sizes)])
    return [packed[:, a:b].reshape(len(packed), *size) for a, b, size in zip(edges[:-1], edges[1:], sizes, strict=True)]


def _is_traced(tree: Any) -> bool:
    if "jax" not in sys.modules:
        return False
    import jax

    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(tree))


def _struct(name: str, **fields) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": list(fields.items())})


_HEAD = {"struct_size": c_size_t, "extension": c_void_p}
_Version = _struct("Version", **_HEAD, major=c_int, minor=c_int)
_Metadata = _struct("Metadata", struct_size=c_size_t, version=_Version, traits=c_uint32)
_Extension = _struct("Extension", struct_size=c_size_t, type=c_int, next=c_void_p, metadata=POINTER(_Metadata))
_Api = _struct("Api", **_HEAD, version=_Version, internal=c_void_p, create_error=c_void_p)
_Error = _struct("Error", **_HEAD, message=c_char_p, code=c_int)
_Buffer = _struct("Buffer", **_HEAD, dtype=c_int, data=c_void_p, rank=c_int64, dims=POINTER(c_int64))
_Buffers = _struct("Buffers", **_HEAD, size=c_int64, types=c_void_p, items=POINTER(POINTER(_Buffer)))
_Frame = _struct("Frame", **_HEAD, api=POINTER(_Api), context=c_void_p, stage=c_int, arguments=_Buffers, results=_Buffers)
_Handler = ctypes.CFUNCTYPE(c_void_p, POINTER(_Frame))
_CreateError = ctypes.CFUNCTYPE(c_void_p, POINTER(_Error))


def host_call(name: str, function: Callable, shape, *arguments):
    """Calls the host like `jax.pure_callback(function, shape, *arguments, vmap_method="sequential")`, on the CPU, by name.

    `pure_callback` puts the address of a Python object into the program, so JAX cannot cache its machine code and compiles it in
    every process. Here the program holds only a name, which each process binds to its own function. The call frame is that of
    XLA's FFI (xla/ffi/api/c_api.h in jaxlib/include, major version 0).

    Args:
        name: identifies `function` and its shapes in any process; only the first function of a name is called.
        function: takes NumPy arrays, which it must neither change nor keep, and returns the result. It must not run JAX code.
        shape: jax.ShapeDtypeStruct of the result, float32 or float64, as the arguments.
    """
    import jax

    if name not in _BOUND:
        handler = _Handler(lambda frame: _answer(frame.contents, function))
        address = ctypes.cast(handler, c_void_p).value
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform="cpu")
        _BOUND[name] = handler
    return jax.ffi.ffi_call(name, shape, vmap_method="sequential")(*arguments)


def _answer(frame, function: Callable) -> int | None:
    """Handles one call; returns None, or the address of an XLA_FFI_Error."""
    if frame.extension:
        asked = ctypes.cast(frame.extension, POINTER(_Extension)).contents
        if asked.type == METADATA:
            version, known = asked.metadata.contents.version, frame.api.contents.version
            version.major, version.minor = known.major, known.minor
            return None
    try:
        arguments = [_array(frame.arguments.items[i].contents) for i in range(frame.arguments.size)]
        _array(frame.results.items[0].contents)[...] = function(*arguments)
    except BaseException as error:  # noqa: BLE001  an exception must not pass through C, where it would be lost
        api = frame.api.contents
        text = f"{type(error).__name__}: {error}".encode()
        return _CreateError(api.create_error)(_Error(ctypes.sizeof(_Error), None, text, INTERNAL))
    return None


def _array(buffer) -> np.ndarray:
    """NumPy view of an XLA buffer."""
    dtype, dims = DTYPES[buffer.dtype], buffer.dims[: buffer.rank]
    size = int(np.prod(dims)) * dtype.itemsize
    if not size:  # an empty buffer has no address
        return np.empty(dims, dtype)
    return np.frombuffer(memoryview((ctypes.c_char * size).from_address(buffer.data)), dtype).reshape(dims)
