"""How effects act on a fish in a tank of the flow solver, in place of MuJoCo's own servos.

Each step of the water the hooks of the closed form (`dynamics.hooks`) are asked as on a bench in air, and what they give is the
body's drive (`lbm_oracle.immersed.driven_body`): torques and forces explicitly, dampings and masses in the matrix that finds fish
and water together. The effects' memory moves on by the water's step, and back with a tick that is done again.
"""

from typing import cast

import numpy as np

from fishmj.effects import EffectStack
from fishmj.effects.sites import Constants, FlowAt
from fishmj.engines.extensions import Commanded
from fishmj.lbm_oracle.immersed.body import DisplacedWater
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.driven_body import DrivenBody
from fishmj.lbm_oracle.run.run import Run
from fishmj.mjcf import build
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import DrawnFlow, Flow

CLOCK = 1  # place of the session's time in an effect's memory


class TankEffects:
    """The effects of one fish in its tank.

    Args:
        active: those of the description. row: (P,) this fish's parameters. memory: (M,) what they remember at its start.
        swimmer: its own constants, lists of floats.

    Attributes:
        memory: flat list, as it is now.
    """

    def __init__(self, robot: Robot, active: EffectStack, row, memory, swimmer: planar_chain.Swimmer):
        self.robot, self.active, self.row = robot, active, [float(x) for x in row]
        self.memory = [float(x) for x in memory][: len(active.memory)]
        self.chain, self.swimmer = active.begin(np, self.row, self.memory).fish(Constants(planar_chain.chain_of(robot), swimmer))
        self._pushed = any(effect.body is not None for effect in active.effects)
        self._still = [(0.0, 0.0)] * self.chain.n
        self._begun, self._tick, self._kept = self.memory[CLOCK], -1, list(self.memory)

    def stream(self, flow: Flow) -> Flow:
        """The tank's flow with what the effects add to its mean."""
        given = FlowAt(0.0, 0.0, 0.0, 0.0, 0.0)
        found = self.active.begin(np, self.row, self.memory).flow(given)
        if (found.u, found.v) == (0.0, 0.0):
            return flow
        drawn = flow.current()
        return DrawnFlow.of(drawn._replace(mean=drawn.mean + np.array([found.u, found.v])), flow)

    def body(self, dt: float) -> DrivenBody:
        """A new body with this fish's masses, for steps of dt [s]."""
        made = DrivenBody(build(self.robot, bare=True), DisplacedWater.of(self.robot), dt)
        mass = np.asarray(self.swimmer.mass, float)
        made.set_masses(mass * self.chain.mass, self.chain.com, mass * self.chain.inertia)
        return made

    def restart(self) -> None:
        """A session begins: its clock stands at its start, joints and gears are as they are."""
        self.memory[CLOCK], self._tick = self._begun, -1

    def begin_tick(self, tick: int) -> None:
        """Called at the start of every attempt at a tick: a second one remembers what the first did then."""
        if tick == self._tick:
            self.memory = list(self._kept)
        self._tick, self._kept = tick, list(self.memory)

    def push(self, body: DrivenBody, target) -> float:
        """Set what acts in the next step of the body, for what the bus delivered, (J,) rad; the servos' power in it, W."""
        q, v = body.data.qpos.tolist(), body.data.qvel.tolist()
        ch, sw = self.chain._replace(dt=body.dt), self.swimmer
        hooks = Commanded(np, self.active, self.row, self.memory, 0.0)
        drive, resist = hooks.servos(ch, sw, q, v, list(target))
        applied = np.zeros(body.dofs)
        if self._pushed:
            rhs, mass = [0.0] * (ch.n + 2), [[0.0] * (r + 1) for r in range(ch.n + 2)]
            hooks.body(ch, sw, q, planar_chain.kinematics(np, ch, q, v, self._still), rhs, mass)
            applied[:] = planar_chain.generalised(np, ch, q[2], rhs)
            body.added_mass = _generalised_mass(ch, q[2], mass)
            applied[3:] += drive
        else:
            applied[3:] = np.add(drive, hooks.passive)
        body.drive(applied, np.add(sw.kb, resist))
        self.memory = list(hooks.end(ch, sw, v, drive))
        return float(planar_chain.electrical_power(np, sw, v, drive))


class EffectRun(Run):
    """A `Run` whose joints are moved by a fish's effects and servos; arguments as there."""

    def __init__(self, added: TankEffects, *args, **options):
        self.added = added
        super().__init__(*args, **options)

    def begin(self) -> None:
        super().begin()
        self.added.restart()

    def _driver(self, coupled: FluidStructure, factor: int) -> "EffectServos":
        return EffectServos(self, coupled, factor)


class EffectServos:
    """The servos with the effects on their way, for one attempt at a tick."""

    def __init__(self, run: EffectRun, coupled: FluidStructure, factor: int):
        self.run, self.body, self.factor = run, cast(DrivenBody, coupled.body), factor
        self.watts: list[float] = []
        run.added.begin_tick(run.ticks)

    def actuate(self, step: int) -> tuple:
        run = self.run
        self.watts.append(run.added.push(self.body, run.servo_target(run.ticks * run.steps + step // self.factor)))
        return run.prescribed_velocity(self.body.dt)

    def record(self) -> None:
        """Their power is known already."""

    def follow(self) -> None:
        """Nothing to follow."""

    @property
    def power(self) -> float:
        return sum(self.watts) / len(self.watts)


def _generalised_mass(ch: planar_chain.Chain, heading: float, lower: list) -> np.ndarray:
    """T^T M T over (x, y, psi, j ..) of a mass matrix over (ax, ay, alpha_i), given by its lower triangle."""
    size = len(lower)
    whole = np.array([[lower[max(r, c)][min(r, c)] for c in range(size)] for r in range(size)], float)
    back = np.array([planar_chain.generalised(np, ch, heading, row) for row in np.eye(size).tolist()]).T
    return back @ whole @ back.T
