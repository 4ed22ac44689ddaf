"""Additions to a robot's nominal model, common to all engines: the effects of its description, and a learnt water.

    added = Extensions.of(robot)
    s = planar_chain.step(xp, ch, sw, q, v, attached, target, flow, ambient, added.hooks(xp, parameters, memory))

`parameters` and `memory` are flat lists of scalars or arrays of one batch shape: the columns of `FishParams.effects` (B, P) and
of `FishState.memory` (B, M), the effects' memory first. Without additions both have no columns and the hooks are None.
"""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np

from fishmj import effects
from fishmj.base.errors import ConfigError
from fishmj.effects.effect_calibration import FittedEffect, activate
from fishmj.mjcf.description import Robot
from fishmj.water.choice import residuals_of
from fishmj.water.dynamics import planar_chain as chain
from fishmj.water.dynamics.hooks import Effects


class Commanded(Effects):
    """Effects with the site `command` before the servos: the target given to `planar_chain.step` is the one from the bus."""

    def servos(self, ch: chain.Chain, sw: chain.Swimmer, q, v, target):
        """Drive torque (N m) and damping (N m s/rad) of each joint, after the effects on the command."""
        return super().servos(ch, sw, q, v, [self.session.command(j, target[j], ch.dt) for j in range(ch.n - 1)])


@dataclass(frozen=True, eq=False)
class Extensions:
    """Effects and learnt water of one robot.

    Attributes:
        active: the effects, or None. row: (P,) their calibrated values. memory: (M,) initial memory of a fish.
        nets: the learnt residuals: none, one, or those of a family of waters, selected by `FishParams.net`.
        robot: the robot.
    """

    active: "effects.EffectStack | None"
    row: np.ndarray
    memory: np.ndarray
    nets: tuple
    robot: Robot

    @classmethod
    def of(cls, robot: Robot) -> "Extensions":
        """Additions that `robot.effects` and `robot.water["model"]` name. Raises ConfigError, UnknownName, StoreError."""
        active, row = (
            (None, np.zeros(0)) if not robot.effects else activate(robot.effects, robot.n_joints, effects.RobotScales.of(robot))
        )
        if active is not None and (idle := [e.name for e in active.effects if e.stochastic]):
            warnings.warn(
                f"{robot.name}: no simulator includes the stochastic {', '.join(idle)}; only data generators do", stacklevel=2
            )
        memory, nets = [] if active is None else list(active.memory), residuals_of(robot)
        if nets:
            from fishmj.water.residual_hooks import at_rest

            memory += at_rest()
        return cls(active, row, np.array(memory, float), nets, robot)

    @property
    def learnt(self) -> Any:
        """The learnt residual of a fish that is not randomised, or None."""
        return self.nets[0] if self.nets else None

    @cached_property
    def chain(self) -> chain.Chain:
        """Constants of the robot, computed once when first needed, because they take a millisecond."""
        return chain.chain_of(self.robot)

    def hooks(self, xp, parameters, memory, *, wet: float = 1.0) -> Any:
        """Hooks for one `planar_chain.step`, or None without additions."""
        parameters, memory = list(parameters), list(memory)
        inner = None
        if self.active is not None:
            inner = Commanded(xp, self.active, parameters, memory[: len(self.active.memory)], wet)
        if not self.nets:
            return inner
        from fishmj.water.residual_hooks import LearnedResidual

        return LearnedResidual(xp, self.chain, self.nets if len(self.nets) > 1 else self.nets[0], memory, inner)

    def late(self, xp, rows, clock: str, t=0.0):
        """Transport delay of a clock for parameter rows (B, P): (B,) s, or 0.0 if no effect delays it."""
        if self.active is None:
            return 0.0
        return self.active.delay(xp, [rows[..., i] for i in range(rows.shape[-1])], clock, t)

    def latest(self, clock: str) -> float:
        """Longest delay within the bounds of the effects, s."""
        slots = [] if self.active is None else self.active.slots
        delaying = [slot.effect for slot in slots if clock in slot.effect.delays]
        return sum(e.parameter(e.delays[clock]).high for e in delaying)


def stacked(xp, values, like):
    """Flat memory as (B, M) of the dtype of `like` (B, M)."""
    if like.shape[-1] == 0:
        return like
    return xp.stack([xp.broadcast_to(xp.asarray(v, dtype=like.dtype), like.shape[:-1]) for v in values], -1)


def bus_rows(robot: Robot, least: int) -> int:
    """Length of the command buffer, `least` or more, that holds every command delay within the effects' bounds."""
    return least + ceil(Extensions.of(robot).latest("command") / robot.timing.bus_dt - 1e-9) if robot.effects else least


def with_effects(robot: Robot, names: Iterable[str]) -> Robot:
    """Robot with these effects added to its list, at their null values if they are new.

    Raises UnknownName: not in the catalogue; ConfigError: a stochastic effect, which simulators do not support.
    """
    have, more = {fitted.name for fitted in robot.effects}, []
    for name in dict.fromkeys(names):
        if effects.get(name).stochastic:
            raise ConfigError(
                f"effect {name!r} is stochastic; only data generators support it, simulators do not; choose another"
            )
        if name not in have:
            more.append(FittedEffect(name, {}))
    return replace(robot, effects=(*robot.effects, *more)) if more else robot
