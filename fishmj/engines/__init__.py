"""Engines: advance a batch of fish by bus ticks of 20 ms. All compute the same motion; they differ in speed and hardware.

planar    JAX, closed form; CPU and GPU, jit-able
compiled  numba, generated from the closed form; CPU (extra `fast`)
batch     MuJoCo C, many fish at once; the reference for evaluations
mjx       MuJoCo in JAX; GPU, jit-able
"""

from collections.abc import Generator
from math import ceil
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import shown_value
from fishmj.engines.extensions import Extensions, bus_rows, with_effects
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Current
from fishmj.water.prior import flat as flat_water
from fishmj.water.prior import unflat

ENGINES = {"planar": "PlanarEngine", "compiled": "CompiledEngine", "batch": "BatchEngine", "mjx": "MjxEngine"}  # module -> class
NAMES = tuple(ENGINES)
T = TypeVar("T")
Steps = Generator[None, None, T]  # yields while a device works, so that the host can do other work; returns its result
BUFFER = 9  # minimal length of the command buffer, newest last; allows latencies up to 7 ticks


class FishState(NamedTuple):
    """Physics of B fish with J joints: nv = 3 + J."""

    q: Any  # (B, nv) m, rad
    v: Any  # (B, nv) m/s, rad/s
    attached: Any  # (B,) tail attachment, 0..1
    buffer: Any  # (B, BUFFER, J) bus commands, rad, newest last; longer where the latency needs it (`rows_of`)
    memory: Any  # (B, M) internal state of effects and a learnt water (extensions.py); M = 0 without them


class FishParams(NamedTuple):
    """Parameters that differ from fish to fish."""

    mass: Any  # (B, N) factors
    kp: Any  # (B, J) N m/rad
    kv: Any  # (B, J) N m s/rad
    kb: Any  # (B, J) N m s/rad
    zero: Any  # (B, J) rad
    water: Any  # (B, 2 N + 11) coefficients of the strip model, flat
    delay: Any  # (B,) int, command latency in physics steps, effects included
    effects: Any  # (B, P) parameters of the robot's effects, in the order of its description
    net: Any  # (B,) int, index of the fish's learnt residual in `Extensions.nets`


class Trace(NamedTuple):
    """States at the end of each of T bus ticks."""

    pose: Any  # (B, T, 3) x, y, yaw of the reference point, m, rad
    joint: Any  # (B, T, J) encoder angles, rad
    rate: Any  # (B, T, J) rad/s
    velocity: Any  # (B, T, 3) true x', y', yaw', world frame
    power: Any  # (B, T) servos, W, mean over the tick


class Copied:
    """Base of stateless engines: a deep copy shares the engine, unpickling makes a new one.

    Attributes:
        arguments: its constructor's arguments.
    """

    arguments: tuple

    def __deepcopy__(self, memo: dict):
        return self

    def __reduce__(self):
        return type(self), self.arguments


def drained(steps: Steps[T]) -> T:
    """Runs a generator to its end and returns its value."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def make(name: str, robot: "Robot | str" = "fish", **options):
    """Makes an engine by name. Raises UnknownName, MissingExtra."""
    from importlib import import_module

    if name not in NAMES:
        raise UnknownName("engine", name, NAMES)
    robot = load_robot(robot)
    robot = in_water(robot, who=f"the engine {name}") if "model" in robot.water else robot  # already chosen, or chosen here
    return getattr(import_module(f"fishmj.engines.{name}"), ENGINES[name])(robot, **options)


def fastest() -> str:
    """Name of the fastest engine on a CPU: `compiled` if numba is installed, else `planar`. Both agree to round-off."""
    try:
        import numba  # noqa: F401
    except ImportError:
        return "planar"
    return "compiled"


def of(engine: Any, robot: Robot):
    """Engine from an argument: an engine itself, a name for this robot, or None for the fastest one.

    Raises UnknownName, MissingExtra: as `make`; ConfigError: the object has no `advance`.
    """
    if engine is None or isinstance(engine, str):
        return make(fastest() if engine is None else engine, robot)
    if isinstance(engine, type) or not callable(getattr(engine, "advance", None)):
        raise ConfigError(
            f"engine = {shown_value(engine)}; expected one of {', '.join(NAMES)}, or an engine object with `advance`"
        )
    return engine


def name_of(engine: Any) -> str:
    """Name of an engine in tables and logs: its own name, or that of its module."""
    return getattr(engine, "name", type(engine).__module__.rpartition(".")[2])


def nominal_params(robot: Robot, batch: int) -> FishParams:
    """Parameters of `batch` calibrated fish without randomisation (NumPy)."""
    s, added = planar_chain.nominal(robot), Extensions.of(robot)
    rows = lambda values: np.tile(np.asarray(values, float), (batch, 1))
    delay = round(command_latency(robot) / robot.timing.physics_dt)
    return FishParams(
        mass=rows(s.mass),
        kp=rows(s.kp),
        kv=rows(s.kv),
        kb=rows(s.kb),
        zero=rows(s.zero),
        water=rows(flat_water(s.water)),
        delay=np.full(batch, delay, np.int32),
        effects=rows(added.row),
        net=np.full(batch, s.net, np.int32),
    )


def command_latency(robot: Robot) -> float:
    """Command latency [s]: nominal, plus that of the description's effects."""
    added = Extensions.of(robot) if robot.effects else None
    return robot.timing.command_latency + (float(added.late(np, added.row, "command")) if added is not None else 0.0)


def swimmer(params: FishParams) -> planar_chain.Swimmer:
    """`Swimmer` of the closed form, with lists of components, from (B, ...) arrays."""
    columns = lambda a: [a[..., i] for i in range(a.shape[-1])]
    mass, kp, kv, kb, zero, water = (columns(a) for a in params[:6])
    return planar_chain.Swimmer(mass, kp, kv, kb, zero, unflat(water), params.net[...])


def at_rest(robot: Robot, pose) -> FishState:
    """Straight fish at rest over ground at poses (B, 3) [m, rad], commands at zero (NumPy)."""
    pose = np.asarray(pose, float)
    batch, joints = len(pose), robot.n_joints
    q = np.concatenate([pose, np.zeros((batch, joints))], -1)
    memory = np.tile(Extensions.of(robot).memory, (batch, 1))
    return FishState(q, np.zeros_like(q), np.full(batch, 0.5), np.zeros((batch, rows_of(robot), joints)), memory)


def rows_of(robot: Robot) -> int:
    """Length of this robot's command buffer: enough for its largest latency, effects included, and two commands for ramps."""
    longest = robot.timing.drawn_latency("command_latency")[1]
    return bus_rows(robot, max(BUFFER, ceil(longest / robot.timing.bus_dt - 1e-9) + 2))


def ticks_per(robot: Robot) -> tuple[int, int]:
    """Number of physics steps in a bus tick, and of bus ticks in a control step."""
    t = robot.timing
    return round(t.bus_dt / t.physics_dt), round(t.control_dt / t.bus_dt)


def check_commands(commands, joints: int) -> None:
    """Raises ConfigError unless `commands` is (B, T, J) rad."""
    if commands.ndim != 3 or commands.shape[-1] != joints:
        raise ConfigError(f"commands: got shape {commands.shape}, expected (fish, ticks, {joints}) joint angles in rad")


__all__ = [
    "BUFFER", "NAMES", "Extensions", "Current", "FishParams", "FishState", "Trace", "at_rest", "command_latency", "flat_water",
    "in_water", "make", "nominal_params", "rows_of", "swimmer", "with_effects",
]  # fmt: skip
