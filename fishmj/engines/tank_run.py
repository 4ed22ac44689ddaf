"""Runs of a fish with effects in a tank of the flow solver; effects that act in each step replace MuJoCo's servos.

Each step of the water calls the hooks of the closed form (`dynamics.hooks`) as in air. Their results drive the body
(`lbm_oracle.immersed.driven_body`): torques and forces explicitly, damping and masses in the matrix of the coupled solve. The
effects' memory advances with the water's step, and is restored if a tick is repeated.
"""

from typing import cast

import mujoco
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
from fishmj.mjcf.model import personalise
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import DrawnFlow, Flow

CLOCK = 1  # index of the session's time in the memory
STEPPED = ("command", "servo", "gear", "body")  # sites at which an effect acts in each step


class TankEffects:
    """The effects of one fish in its tank.

    Args:
        active: effects of the description. row: (P,) this fish's parameters. memory: (M,) their initial memory.
        swimmer: its own constants, lists of floats.

    Attributes:
        memory: present memory, flat list.
        acting: True if they act in each step; else they only change masses in MuJoCo's model (`personalise`).
    """

    def __init__(self, robot: Robot, active: EffectStack, row, memory, swimmer: planar_chain.Swimmer):
        self.robot, self.active, self.row = robot, active, [float(x) for x in row]
        self.memory = [float(x) for x in memory][: len(active.memory)]
        described = planar_chain.chain_of(robot)
        self.chain, self.swimmer = active.begin(np, self.row, self.memory).fish(Constants(described, swimmer))
        self._pushed = any(effect.body is not None for effect in active.effects)
        masses = {name: getattr(self.chain, name) for name in ("mass", "com", "inertia")}
        stepped = any(getattr(effect, site) is not None for effect in active.effects for site in STEPPED)
        self.acting = stepped or described._replace(**masses) != self.chain
        self._still = [(0.0, 0.0)] * self.chain.n
        self._begun, self._tick, self._kept = self.memory[CLOCK], -1, list(self.memory)

    def stream(self, flow: Flow) -> Flow:
        """Flow of the tank, with the effects' velocity added to its mean."""
        given = FlowAt(0.0, 0.0, 0.0, 0.0, 0.0)
        found = self.active.begin(np, self.row, self.memory).flow(given)
        if (found.u, found.v) == (0.0, 0.0):
            return flow
        drawn = flow.current()
        return DrawnFlow.of(drawn._replace(mean=drawn.mean + np.array([found.u, found.v])), flow)

    def body(self, dt: float) -> DrivenBody:
        """New body with this fish's masses, for steps of dt [s]."""
        made = DrivenBody(build(self.robot, bare=True), DisplacedWater.of(self.robot), dt)
        mass = np.asarray(self.swimmer.mass, float)
        made.set_masses(mass * self.chain.mass, self.chain.com, mass * self.chain.inertia)
        return made

    def personalise(self, model: mujoco.MjModel) -> None:
        """Writes this fish's constants into MuJoCo's model, for effects that do not act in each step."""
        ch, sw = self.chain, self.swimmer
        model.body_mass[1:], model.body_ipos[1:, 0], model.body_inertia[1:, 2] = ch.mass, ch.com, ch.inertia
        personalise(model, mass=sw.mass, kp=sw.kp, kv=sw.kv, kb=sw.kb, zero=sw.zero)

    def restart(self) -> None:
        """Begins a session: resets its clock, and keeps the state of joints and gears."""
        self.memory[CLOCK], self._tick = self._begun, -1

    def begin_tick(self, tick: int) -> None:
        """Saves the memory at the first attempt at a tick, and restores it at a repetition."""
        if tick == self._tick:
            self.memory = list(self._kept)
        self._tick, self._kept = tick, list(self.memory)

    def push(self, body: DrivenBody, target) -> float:
        """Sets the drive of the body's next step for bus targets (J,) rad; returns the servos' power in it, W."""
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
    """`Run` with servos under the fish's effects; further arguments as for `Run`."""

    def __init__(self, added: TankEffects, *args, **options):
        self.added = added
        super().__init__(*args, **options)

    def begin(self) -> None:
        """Starts a run from the present state as `Run.begin`, and restarts the effects' clock."""
        super().begin()
        self.added.restart()

    def _driver(self, coupled: FluidStructure, factor: int) -> "EffectServos":
        return EffectServos(self, coupled, factor)


class EffectServos:
    """Servos with the effects of the fish, for one attempt at a tick."""

    def __init__(self, run: EffectRun, coupled: FluidStructure, factor: int):
        self.run, self.body, self.factor = run, cast(DrivenBody, coupled.body), factor
        self.watts: list[float] = []
        run.added.begin_tick(run.ticks)

    def actuate(self, step: int) -> tuple:
        """Sets the drive of this step; returns `fixed` and `value` of prescribed joints."""
        run = self.run
        self.watts.append(run.added.push(self.body, run.servo_target(run.ticks * run.steps + step // self.factor)))
        return run.prescribed_velocity(self.body.dt)

    def record(self) -> None:
        """Does nothing, because the power is known already."""

    def follow(self) -> None:
        """Does nothing."""

    @property
    def power(self) -> float:
        """Mean power of the servos, W."""
        return sum(self.watts) / len(self.watts)


def _generalised_mass(ch: planar_chain.Chain, heading: float, lower: list) -> np.ndarray:
    """T^T M T over (x, y, psi, j ..) of a mass matrix over (ax, ay, alpha_i), given by its lower triangle."""
    size = len(lower)
    whole = np.array([[lower[max(r, c)][min(r, c)] for c in range(size)] for r in range(size)], float)
    back = np.array([planar_chain.generalised(np, ch, heading, row) for row in np.eye(size).tolist()]).T
    return back @ whole @ back.T
