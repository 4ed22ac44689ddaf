"""One fish in MuJoCo and its water, behind one interface.

StripWater    strips and learnt residual through `mjcb_passive` (water.injection): MuJoCo itself solves with M + M_a
WrenchWater   the same as a wrench on every link through `xfrc_applied` (water.link_wrench), without a callback
HookedWater   the closed form with all additions, effects included, through `qfrc_applied`; planar root:
              (M + h D) qacc = servo + applied     MuJoCo moves the fish by forces of the closed form, as in the engine `batch`
MujocoWater   MuJoCo's own fluid, or air

The first three hold `swimmer`, whose `water` may be replaced between steps, and the water's memory: `attached`, `memory`.
"""

from collections.abc import Callable
from typing import Any, Protocol

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.engines.extensions import Extensions
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.injection import Handle, checked_step, installed
from fishmj.water.link_wrench import LinkWrench
from fishmj.water.planar_water import PlanarWater
from fishmj.water.spatial_water import FreeWater

INJECTIONS = ("callback", "xfrc", "qfrc")  # ways of a structured or fitted water into MuJoCo
DRY = dict(cf=0.0, ca_forward=0.0, ca_backward=0.0, ke=0.0)  # coefficients of no water at all, besides k and cn


class Water(Protocol):
    """Interface of the water around the fish of `Sim`.

    Attributes:
        power: electrical power of the servos in the last step, W.
    """

    power: float

    def set_flow(self, flow, ambient) -> None:
        """Sets the water velocity at the links (N, 2) m/s and DU/Dt (2,) m/s2, world frame; constant until the next call."""

    def step(self, data: mujoco.MjData) -> None:
        """Does one physics step. Raises SimDiverged, and the errors of the water itself."""


def _of_strips(name: str) -> Any:
    return property(lambda self: getattr(self.strips, name), lambda self, value: setattr(self.strips, name, value))


class InjectedWater:
    """Strips, and a learnt residual if there is one, put into MuJoCo.

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
    """Strips through the passive callback, which is installed during each step only."""

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
    """MuJoCo alone: air, or its own fluid, which has one uniform wind."""

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
    """One fish in the closed form, in NumPy, with its memory from step to step.

    Args:
        make_hooks: memory -> the hooks of one `planar_chain.step`; None adds nothing.

    Attributes:
        attached: attachment state of the tail, 0..1. memory: flat list of the hooks' memory.
    """

    def __init__(self, ch: planar_chain.Chain, swimmer: planar_chain.Swimmer, make_hooks: Callable | None = None, memory=()):
        self.chain, self.swimmer, self.make_hooks = ch, swimmer, make_hooks
        self.attached: Any = 0.5
        self.memory = list(memory)

    def advance(self, q, v, target, flow, ambient) -> planar_chain.Step:
        """Does one physics step from q and v; arguments as `planar_chain.step`. Attachment and memory advance."""
        hooks = None if self.make_hooks is None else self.make_hooks(self.memory)
        s = planar_chain.step(np, self.chain, self.swimmer, q, v, self.attached, target, flow, ambient, hooks)
        self.attached, self.memory = s.attached, list(s.memory)
        return s


class HookedWater(SingleFish):
    """Water of one planar fish with all additions, wet or on a bench in air."""

    def __init__(self, robot: Robot, added: Extensions, swimmer: planar_chain.Swimmer, wet: bool = True):
        ch, parameters = planar_chain.chain_of(robot), added.row.tolist()
        water = swimmer.water if wet else swimmer.water._replace(k=[0.0] * ch.n, cn=[0.0] * ch.n, **DRY)
        make_hooks = lambda memory: added.hooks(np, parameters, memory, wet=float(wet))
        super().__init__(ch, swimmer._replace(water=water), make_hooks, added.memory.tolist())
        self.wet, self.power = wet, 0.0
        self.set_flow(np.zeros((ch.n, 2)), np.zeros(2))

    def set_flow(self, flow, ambient) -> None:
        """Sets the water velocity at the links (N, 2) m/s and DU/Dt (2,) m/s2; zero in air."""
        share = 1.0 if self.wet else 0.0
        self.flow, self.ambient = (share * np.asarray(flow)).tolist(), (share * np.asarray(ambient)).tolist()

    def step(self, data: mujoco.MjData) -> None:
        """Does one physics step with the forces of the closed form. Raises SimDiverged."""
        s = self.advance(data.qpos.tolist(), data.qvel.tolist(), data.ctrl.tolist(), self.flow, self.ambient)
        data.qfrc_applied[:] = s.applied
        checked_step(data.model, data)
        self.power = float(s.power)


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
        ConfigError: an injection that does not fit; effects with a free root or in MuJoCo's own fluid.
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
    strips = {"planar": PlanarWater, "free": FreeWater}[root](robot, swimmer, learnt=added.learnt)
    return {"callback": StripWater, "xfrc": WrenchWater}[way](model, strips)


def drive_power(swimmer: planar_chain.Swimmer, rates, data: mujoco.MjData) -> float:
    """Servo power of the last step, W, from the drive torque that MuJoCo applied and the rates (J,) before it."""
    return float(planar_chain.electrical_power(np, swimmer, [0.0, 0.0, 0.0, *rates], data.actuator_force))
