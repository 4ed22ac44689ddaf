"""Waters of one fish in MuJoCo, with one interface.

StripWater    strips and learnt residual through `mjcb_passive` (water.injection): MuJoCo itself solves with M + M_a
WrenchWater   the same as a wrench on every link through `xfrc_applied` (water.link_wrench), without a callback
HookedWater   the closed form with all additions, effects included, through `qfrc_applied`; planar root:
              (M + h D) qacc = servo + applied     MuJoCo moves the fish by forces of the closed form, as in the engine `batch`
CompiledWater the same by compiled code (extra `fast`), as in the engine `batch`
MujocoWater   MuJoCo's own fluid, or air

All except the last have `swimmer`, whose `water` may be replaced between steps, and the water's state `attached` and `memory`.
"""

from collections.abc import Callable
from copy import copy
from typing import Any, Protocol

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, MissingExtra, UnknownName
from fishmj.engines import FishParams, nominal_params
from fishmj.engines import swimmer as swimmer_of
from fishmj.engines.extensions import Extensions
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.injection import Handle, checked_step, installed
from fishmj.water.link_wrench import LinkWrench
from fishmj.water.planar_water import PlanarWater
from fishmj.water.spatial_water import FreeWater

INJECTIONS = ("callback", "xfrc", "qfrc")  # methods that couple a structured or fitted water to MuJoCo
DRY = dict(cf=0.0, ca_forward=0.0, ca_backward=0.0, ke=0.0)  # coefficients in air, besides k and cn


class Water(Protocol):
    """Interface of the water around the fish of `Sim`. power: electrical power of the servos in the last step, W."""

    power: float

    def set_flow(self, flow, ambient) -> None:
        """Sets the water velocity at the links (N, 2) m/s and DU/Dt (2,) m/s2, world frame; constant until the next call."""

    def step(self, data: mujoco.MjData) -> None:
        """Does one physics step. Raises SimDiverged, and the errors of the water itself."""


def _of_strips(name: str) -> Any:
    return property(lambda self: getattr(self.strips, name), lambda self, value: setattr(self.strips, name, value))


class InjectedWater:
    """Strips, and a learnt residual if there is one, coupled to MuJoCo.

    Args:
        strips: the water itself. advance: function that does one physics step of MuJoCo's data in it.

    Attributes:
        swimmer, attached, memory: those of `strips`; may be read and replaced between steps.
    """

    swimmer, attached, memory = _of_strips("swimmer"), _of_strips("attached"), _of_strips("memory")

    def __init__(self, strips: PlanarWater, advance: Callable[[mujoco.MjData], None]):
        self.strips, self.power, self._advance = strips, 0.0, advance

    def set_flow(self, flow, ambient) -> None:
        """Sets the water velocity at the links (N, 2) m/s and DU/Dt (2,) m/s2."""
        self.strips.set_flow(flow, ambient)

    def step(self, data: mujoco.MjData) -> None:
        """Does one physics step and computes the servo power. Raises SimDiverged, and the errors of the water itself."""
        rates = data.qvel[-data.ctrl.size :].copy()
        self._advance(data)
        self.power = drive_power(self.strips.swimmer, rates, data)


class StripWater(InjectedWater):
    """Strips through the passive callback, which is installed only during a step."""

    def __init__(self, model: mujoco.MjModel, strips: PlanarWater):
        handle = Handle(model, strips)

        def advance(data: mujoco.MjData) -> None:
            with installed(handle) as fish:
                fish.step(data)

        super().__init__(strips, advance)


class WrenchWater(InjectedWater):
    """Strips through a wrench on every link; works in any thread."""

    def __init__(self, model: mujoco.MjModel, strips: PlanarWater):
        super().__init__(strips, LinkWrench(model, strips).step)


class MujocoWater:
    """MuJoCo without our water: air, or MuJoCo's own fluid with one uniform wind."""

    def __init__(self, model: mujoco.MjModel, swimmer: planar_chain.Swimmer, wind: bool):
        self.model, self.swimmer, self.wind, self.power = model, swimmer, wind, 0.0

    def set_flow(self, flow, ambient) -> None:
        """Sets the wind of MuJoCo's fluid to the velocity at the head, m/s; air has none."""
        if self.wind:
            self.model.opt.wind[:2] = flow[0]

    def step(self, data: mujoco.MjData) -> None:
        """Does one physics step and computes the servo power. Raises SimDiverged."""
        rates = data.qvel[-data.ctrl.size :].copy()
        checked_step(self.model, data)
        self.power = drive_power(self.swimmer, rates, data)


class SingleFish:
    """One fish in the closed form, in NumPy, with its memory.

    Args:
        added: effects and learnt residual. wet: 0 on a bench in air.

    Attributes:
        parameters: of the effects, flat. attached: attachment state of the tail, 0..1. memory: flat, of effects and residual.
    """

    def __init__(self, ch: planar_chain.Chain, swimmer: planar_chain.Swimmer, added: Extensions, wet: float = 1.0):
        self.chain, self.swimmer, self.added, self.wet = ch, swimmer, added, wet
        self.parameters = added.row.tolist()
        self.start()

    def start(self) -> None:
        """Resets attachment and memory to those of a fish at rest."""
        self.attached: Any = 0.5
        self.memory: Any = self.added.memory.tolist()

    def advance(self, q, v, target, flow, ambient) -> planar_chain.Step:
        """Does one physics step from q and v; arguments as `planar_chain.step`. Attachment and memory advance."""
        hooks = self.added.hooks(np, self.parameters, self.memory, wet=self.wet)
        s = planar_chain.step(np, self.chain, self.swimmer, q, v, self.attached, target, flow, ambient, hooks)
        self.attached, self.memory = s.attached, list(s.memory)
        return s


class HookedWater(SingleFish):
    """Water of one planar fish with all additions, wet or on a bench in air."""

    def __init__(self, robot: Robot, added: Extensions, swimmer: planar_chain.Swimmer, wet: bool = True):
        ch = planar_chain.chain_of(robot)
        water = swimmer.water if wet else swimmer.water._replace(k=[0.0] * ch.n, cn=[0.0] * ch.n, **DRY)
        super().__init__(ch, swimmer._replace(water=water), added, float(wet))
        self.power = 0.0
        self.set_flow(np.zeros((ch.n, 2)), np.zeros(2))

    def set_fish(self, params: FishParams) -> None:
        """Sets the constants of this fish, water and effects included, from a batch of one."""
        one = FishParams(*(np.asarray(a)[0] for a in params))
        self.swimmer, self.parameters = swimmer_of(one), one.effects.tolist()

    def set_flow(self, flow, ambient) -> None:
        """Sets the water velocity at the links (N, 2) m/s and DU/Dt (2,) m/s2; zero in air."""
        self.flow, self.ambient = self.wet * np.asarray(flow), self.wet * np.asarray(ambient)

    def step(self, data: mujoco.MjData) -> None:
        """Does one physics step with the forces of the closed form. Raises SimDiverged."""
        data.qfrc_applied[:], power = self.forces(data.qpos, data.qvel, data.ctrl)
        checked_step(data.model, data)
        self.power = power

    def forces(self, q, v, target) -> tuple[Any, float]:
        """Generalised force (nv,) on MuJoCo's fish, N and N m, and servo power, W. Attachment and memory advance."""
        s = self.advance(q.tolist(), v.tolist(), target.tolist(), self.flow.tolist(), self.ambient.tolist())
        return s.applied, float(s.power)

    def __deepcopy__(self, memo: dict) -> "HookedWater":
        """Independent copy; a step replaces arrays and never writes into them."""
        return copy(self)


class CompiledWater(HookedWater):
    """The same water by compiled code, several times as fast. Raises MissingExtra without the extra `fast`."""

    def __init__(self, robot: Robot, added: Extensions, swimmer: planar_chain.Swimmer):
        from fishmj.engines.compiled import CompiledEngine

        super().__init__(robot, added, swimmer)
        self.engine = CompiledEngine(robot, threads=1)
        self.set_fish(nominal_params(robot, 1))
        self.forces(np.zeros(self.chain.n + 2), np.zeros(self.chain.n + 2), np.zeros(self.chain.n - 1))  # compile now
        self.start()

    def set_fish(self, params: FishParams) -> None:
        """Sets the constants of this fish, water and effects included, from a batch of one."""
        super().set_fish(params)
        self.params = params

    def forces(self, q, v, target) -> tuple[Any, float]:
        """Generalised force (nv,) on MuJoCo's fish, N and N m, and servo power, W. Attachment and memory advance."""
        row = lambda a: np.asarray(a, float)[None]
        state = q[None], v[None], row(self.attached), self.params
        made = self.engine.forces(*state, target[None], self.flow[None], self.ambient[None], row(self.memory))
        self.attached, self.memory = float(made.attached[0]), made.memory[0]
        return made.force[0], float(made.power[0])


def water_of(
    name: str,
    robot: Robot,
    root: str,
    model: mujoco.MjModel,
    swimmer: planar_chain.Swimmer,
    added: Extensions,
    injection: str | None = None,
) -> Water:
    """Water `name`: "ellipsoid", "none", else the strips and the learnt force of the robot's water.

    Args:
        injection: one of `INJECTIONS`; None: "qfrc" for a robot with effects, else "callback".

    Raises:
        UnknownName: no such injection.
        ConfigError: an injection that root or water do not support; effects with a free root or in MuJoCo's own fluid.
    """
    wet = name not in ("none", "ellipsoid")
    if injection is not None and injection not in INJECTIONS:
        raise UnknownName("injection", injection, INJECTIONS)
    if added.active is not None and (root != "planar" or name == "ellipsoid"):
        raise ConfigError(
            f"{robot.name}: effects act on a fish with a planar root in structured or fitted water or none, got"
            f" root = {root!r}, water = {name!r}; take those, or a robot without [[effect]]"
        )
    way = injection or ("callback" if added.active is None else "qfrc")
    if added.active is not None and way != "qfrc":
        raise ConfigError(f"{robot.name}: effects act in the closed form, got injection = {way!r}; take 'qfrc', or no [[effect]]")
    if injection is not None and not wet:
        raise ConfigError(f"{robot.name}: water = {name!r} has nothing to inject; leave injection = {injection!r} out")
    if way == "qfrc":
        if root != "planar":
            raise ConfigError(f"{robot.name}: injection = 'qfrc' is the closed form of a planar root; take 'callback' or 'xfrc'")
        return HookedWater(robot, added, swimmer, wet=wet)
    if not wet:
        return MujocoWater(model, swimmer, wind=name == "ellipsoid")
    strips = {"planar": PlanarWater, "free": FreeWater}[root](
        robot, swimmer, learnt=added.nets[int(swimmer.net)] if added.nets else None
    )
    return {"callback": StripWater, "xfrc": WrenchWater}[way](model, strips)


def closed_form(robot: Robot) -> HookedWater:
    """Closed form of one planar fish: compiled if the extra `fast` is installed, else in NumPy; the same numbers to round-off."""
    given = robot, Extensions.of(robot), planar_chain.nominal(robot)
    try:
        return CompiledWater(*given)
    except MissingExtra:
        return HookedWater(*given)


def drive_power(swimmer: planar_chain.Swimmer, rates, data: mujoco.MjData) -> float:
    """Servo power of the last step, W, from the drive torque that MuJoCo applied and the rates (J,) before it."""
    return float(planar_chain.electrical_power(np, swimmer, [0.0, 0.0, 0.0, *rates], data.actuator_force))
