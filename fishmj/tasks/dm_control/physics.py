"""dm_control `Physics` of the fish in its water: bus commands in, poses out.

    planar root   Q_water - M_a a goes into qfrc_applied before each mj_step      (`engines.single.closed_form`)
    free root     the water's wrench on every link goes into xfrc_applied         (`engines.single.WrenchWater`)

Both equal the callback's step to round-off and share nothing in the process: any number of environments and threads may run side
by side.

A `Physics` holds more than MuJoCo's state: commands under way, tail attachment, the flow. `copy`, a deep copy and a pickle
include all of it; `get_state` and `set_state` cover MuJoCo's part only.

`SolverPhysics` is a fish in the flow solver, `HybridPhysics` one in a fitted water with online correction by the solver. The
solver moves its own copy of the fish, one bus tick at a time. Its pose and velocity are copied to MuJoCo's data, so that
observations, rendering and named accessors work as in every water. Each episode fills a new tank, and first holds the fish for a
second, until the flow around it has developed.
"""

import copy
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from dm_control import mujoco as dm_mujoco
from dm_control.mujoco import wrapper
from dm_control.rl import control

from fishmj import engines
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.engines import FishParams, FishState
from fishmj.engines.planar import link_centres
from fishmj.engines.single import WrenchWater, closed_form
from fishmj.mjcf import passive_slot
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import build_spec, personalise, reference_pose, reference_qpos
from fishmj.mjcf.servos import arrived_of, on_the_bus
from fishmj.tasks.episode import TaskSpec
from fishmj.water.flow import BOXES, Current, DrawnFlow, Flow, sample
from fishmj.water.spatial_water import FreeWater

TARGET = "target"
COLOURS = {  # default and highlight: dm_control blends from one to the other with the reward
    "self": ((0.55, 0.58, 0.62, 1), (0.30, 0.75, 0.45, 1)),
    "effector": ((0.80, 0.65, 0.30, 1), (0.95, 0.85, 0.20, 1)),
    "target": ((0.75, 0.25, 0.20, 1), (0.20, 0.85, 0.35, 1)),
}
SHAPE = dict(contype=0, conaffinity=0)


def build_scene(robot: Robot, root: str = "planar") -> mujoco.MjSpec:
    """The robot's `MjSpec` with its surroundings; compile it outside any `inject` block.

    Bodies added to the fish: `tank` (fixed) and `target` (mocap: move it with `data.mocap_pos[0]`).
    """
    spec = build_spec(robot, root)
    for name, (default, highlight) in COLOURS.items():
        for suffix, rgba in (("", default), ("_default", default), ("_highlight", highlight)):
            spec.add_material(name=name + suffix, rgba=rgba)
    spec.add_material(name="tank", rgba=[0.55, 0.70, 0.78, 1], specular=0.0, shininess=0.0)
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.95, 0.97, 0.99], rgb2=[0.70, 0.80, 0.88], width=64, height=384,
    )  # fmt: skip
    bound, arrived = constant("task", "bound"), constant("protocol", "arrival_radius")
    _tank(spec.worldbody, bound, depth=constant("tank", "size")[2])
    target = spec.worldbody.add_body(name=TARGET, mocap=True)
    disc = dict(type=mujoco.mjtGeom.mjGEOM_CYLINDER, material="target", **SHAPE)
    target.add_geom(name="target", size=[0.02, 0.08, 0], **disc)
    target.add_geom(name="arrival", size=[arrived, 0.001, 0], pos=[0, 0, -0.09], **disc)
    head = spec.body(robot.links[0].name)
    for site in head.sites:
        site.material = "effector" if site.name == "nose" else "self"
    head.add_camera(name="follow", pos=[-1.3, 0, 0.7], xyaxes=[0, -1, 0, 0.45, 0, 1])
    spec.visual.headlight.diffuse, spec.visual.headlight.specular = [0.35] * 3, [0.0] * 3
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.visual.map.znear = 0.02
    return spec


def _tank(world, bound: float, depth: float) -> None:
    box = dict(type=mujoco.mjtGeom.mjGEOM_BOX, **SHAPE)
    tank = world.add_body(name="tank")
    tank.add_geom(name="floor", size=[bound, bound, 0.01], pos=[0, 0, -depth], material="tank", **box)
    for i, (name, x, y) in enumerate((("east", 1, 0), ("north", 0, 1), ("west", -1, 0), ("south", 0, -1))):
        size = [0.01, bound, 0.02] if i % 2 == 0 else [bound, 0.01, 0.02]
        tank.add_geom(name=f"{name}_edge", size=size, pos=[x * bound, y * bound, 0.02 - depth], rgba=[0.25, 0.32, 0.38, 1], **box)
    height = 2 * bound / 0.8284  # a 45-degree field of view shows the whole domain
    world.add_camera(name="top", pos=[0, 0, height], xyaxes=[1, 0, 0, 0, 1, 0])
    world.add_camera(name="corner", pos=[0, -1.5 * bound, 1.3 * bound], xyaxes=[1, 0, 0, 0, 0.65, 0.76])
    sun = dict(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, diffuse=[0.45] * 3, specular=[0.1] * 3)
    world.add_light(name="lamp", pos=[0, 0, height], dir=[0, 0, -1], **sun)


PERSONAL = ("body_mass", "body_inertia", "actuator_gainprm", "actuator_biasprm", "dof_damping")  # differ from fish to fish


@dataclass
class FishMemory:
    """State of a fish besides MuJoCo's data and its water: commands, flow, trace. Arrays are replaced, never modified."""

    robot: Robot
    params: FishParams  # batch of one
    current: Current
    buffer: np.ndarray  # (1, BUFFER, J) bus commands
    pending: np.ndarray  # (T, J) bus commands not yet sent
    steps: int  # physics steps in a bus tick
    keep: int  # bus ticks in a control step
    step: int = 0  # physics steps since the start
    yaw: float = 0.0  # unwrapped
    power: float = 0.0  # sum over this tick's steps so far, W
    rows: tuple = ()  # (pose, joint, rate, velocity, power) of the last bus ticks


class Physics(dm_mujoco.Physics):
    """A fish in water; make one with `Physics.of`.

    Attributes:
        water: the water with its memory, a `HookedWater`, or the strips of a free root; None if the solver moves the fish.
    """

    swim: FishMemory
    water: Any
    alone: str = ""  # why it cannot be copied

    @classmethod
    def of(cls, robot: Robot, root: str = "planar") -> "Physics":
        """Straight fish at rest in still water. Raises UnknownName for a root that does not exist."""
        physics = cls.from_model(wrapper.MjModel(passive_slot.compiled(build_scene(robot, root))))
        if root == "free" and robot.effects:
            raise ConfigError("suite: effects need a planar root; choose root = 'planar', or a robot without [[effect]]")
        physics.water = physics._water_of(robot, root)
        model = physics.model
        physics._nominal = {name: getattr(model, name).copy() for name in PERSONAL}
        rest, (steps, keep) = engines.at_rest(robot, [[0.0, 0.0, 0.0]]), engines.ticks_per(robot)
        physics.swim = FishMemory(
            robot=robot, params=engines.nominal_params(robot, 1), current=Flow().current(), buffer=rest.buffer,
            pending=np.zeros((0, robot.n_joints)), steps=steps, keep=keep,
        )  # fmt: skip
        return physics

    def _water_of(self, robot: Robot, root: str) -> Any:
        """The water around the fish at rest."""
        return FreeWater(robot, learnt=engines.Extensions.of(robot).learnt) if root == "free" else closed_form(robot)

    # ---- methods for a task ----

    def begin(self, pose, params: FishParams, current: Current) -> None:
        """Puts this fish (a batch of one) at rest at pose (3,) [m, rad] in this flow. Call inside `reset_context`."""
        self._personalise(params)
        self.data.qpos[:] = reference_qpos(self.model.ptr, pose, params.zero[0])
        self.data.qvel[:] = 0.0
        rest = engines.at_rest(self.swim.robot, np.asarray(pose)[None])
        self.swim = replace(  # a new object, because copies share the old one
            self.swim, params=params, current=current, buffer=rest.buffer, pending=self.swim.pending[:0],
            step=0, yaw=float(pose[2]), power=0.0, rows=(),
        )  # fmt: skip
        self._start_water(params)

    def send(self, commands) -> None:
        """Queues bus commands (T, J) [rad], one per bus tick; after them the last one is repeated."""
        commands = np.asarray(commands, float)
        if commands.ndim != 2 or commands.shape[1] != self.model.nu or not np.isfinite(commands).all():
            raise ConfigError(f"suite: commands of shape {commands.shape}; expected finite (ticks, {self.model.nu}) in rad")
        self.swim.pending, self.swim.rows = commands, ()

    def set_control(self, control) -> None:
        """Sets a constant command (J,) rad; it acts after the latency."""
        self.send(np.asarray(control, float)[None])

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances by physics steps. Raises dm_control's PhysicsError if the state of the fish is not finite."""
        with self.check_invalid_state():
            for _ in range(n_sub_steps):
                self._advance()
            if self.legacy_step:
                mujoco.mj_step1(self.model.ptr, self.data.ptr)

    # ---- named accessors, world frame, without noise or latency ----

    def reference_pose(self) -> np.ndarray:
        """(x, y, yaw) of the reference point, m, rad; yaw counts full turns."""
        pose = reference_pose(self.model.ptr, self.data.ptr)
        return np.array([pose[0], pose[1], self._unwrapped(pose[2])])

    def joint_angles(self) -> np.ndarray:
        """Encoder readings, (J,) rad."""
        return self.data.qpos[-self.model.nu :] - self.swim.params.zero[0]

    def joint_rates(self) -> np.ndarray:
        """Joint rates (J,) rad/s."""
        return self.data.qvel[-self.model.nu :].copy()

    def place_target(self, position) -> None:
        """Moves the target to (2,) m."""
        self.data.mocap_pos[0, :2] = position

    def trace(self) -> engines.Trace:
        """Trace of the bus ticks since the last `send`, one control step at most, as the engines' Trace with a batch of one."""
        if not self.swim.rows:
            empty, joints = np.zeros((1, 0, 3)), np.zeros((1, 0, self.model.nu))
            return engines.Trace(empty, joints, joints, empty, empty[..., 0])
        return engines.Trace(*(np.array(column)[None] for column in zip(*self.swim.rows, strict=True)))

    # ---- the loop ----

    def _next_tick(self) -> None:
        """Takes the next command from the queue and looks up the flow, both constant over the tick."""
        s = self.swim
        sent = on_the_bus(s.robot.servo, s.pending[:1]) if len(s.pending) else s.buffer[0, -1:]
        s.buffer = np.concatenate([s.buffer[:, 1:], sent[None]], 1)
        s.pending = s.pending[1:]
        s.power = 0.0
        if isinstance(self.water, FreeWater):
            mujoco.mj_kinematics(self.model.ptr, self.data.ptr)
            centres = np.array([[self.data.ptr.site(f"{link.name}_centre").xpos[:2] for link in s.robot.links]])
        else:
            centres = link_centres(np, self.water.chain, self.data.qpos[None])
        flow, ambient = sample(np, s.current, centres, np.array([s.step // s.steps]))
        self.water.set_flow(flow[0], ambient[0])

    def _target(self, part: int) -> np.ndarray:
        """Servo targets (J,) rad in one physics step of the running bus tick."""
        s = self.swim
        sent, ramp = s.buffer[0], s.robot.timing.command_path == "move_time"
        return arrived_of(sent, (len(sent) - 2) * s.steps + part, int(s.params.delay[0]), s.steps, ramp)

    def _advance(self) -> None:
        """Does one physics step; the first of a bus tick takes the next command and looks up the flow."""
        s, data = self.swim, self.data.ptr
        part = s.step % s.steps
        if part == 0:
            self._next_tick()
        data.ctrl[:] = self._target(part)
        # bind the model again, because a copy of this physics has its own
        water = WrenchWater(self.model.ptr, self.water) if isinstance(self.water, FreeWater) else self.water
        try:
            water.step(data)
        except SimDiverged as error:
            raise control.PhysicsError(str(error)) from error
        s.power = s.power + water.power
        s.step = s.step + 1
        if s.step % s.steps == 0:
            pose = reference_pose(self.model.ptr, self.data.ptr)
            s.yaw = self._unwrapped(pose[2])
            row = (np.array([*pose[:2], s.yaw]), self.joint_angles(), self.joint_rates(), pose[3:], s.power / s.steps)
            s.rows = (*s.rows, row)[-s.keep :]

    def _unwrapped(self, yaw: float) -> float:
        """Yaw, unwrapped relative to the last recorded one."""
        return float(yaw + 2 * np.pi * np.round((self.swim.yaw - yaw) / (2 * np.pi)))

    def _personalise(self, params: FishParams) -> None:
        """Writes one fish's masses and gains into the model, relative to the nominal ones."""
        model = self.model.ptr
        for name, value in self._nominal.items():
            getattr(model, name)[:] = value
        others = model.nbody - 1 - len(self.swim.robot.links)  # tank and target
        own = {name: getattr(params, name)[0] for name in ("kp", "kv", "kb", "zero")}
        personalise(model, mass=[*params.mass[0], *[1.0] * others], **own)

    def _start_water(self, params: FishParams) -> None:
        """Puts the water at rest around a fish with these constants, a batch of one."""
        water = self.water
        if isinstance(water, FreeWater):
            water.swimmer = engines.swimmer(FishParams(*(np.asarray(a)[0] for a in params)))
            if nets := engines.Extensions.of(self.swim.robot).nets:
                water.learnt = nets[int(water.swimmer.net)]
            nominal = FreeWater(self.swim.robot).geometry
            # a robot is trimmed after it is built, so each link's buoyancy equals its own weight
            water.geometry = replace(nominal, mass=nominal.mass * params.mass[0])
            water.attached, water.memory = 0.5, water.at_rest()
        else:
            water.set_fish(params)
            water.start()

    def copy(self, share_model: bool = False) -> "Physics":
        """Independent copy. Raises ConfigError for a water that cannot be copied."""
        own = self._own()
        new = super().copy(share_model)
        vars(new).update(own, swim=copy.copy(self.swim), water=copy.deepcopy(self.water))
        return new

    def _own(self) -> dict[str, Any]:
        """Attributes that this class adds to dm_control's. Raises ConfigError as `copy`."""
        if self.alone:
            raise ConfigError(f"suite: a fish in {self.alone} cannot be copied; load another environment with the same seed")
        return {name: getattr(self, name) for name in ("swim", "water", "_nominal", "legacy_step")}

    def __getstate__(self) -> tuple:
        return super().__getstate__(), self._own()

    def __setstate__(self, state: tuple) -> None:
        data, own = state
        super().__setstate__(data)
        self.__dict__.update(own)


__all__ = ["TARGET", "Physics", "FishMemory"]


class SolverPhysics(Physics):
    """A fish in a tank of the flow solver; make one with `SolverPhysics.in_tank`."""

    engine: Any  # fishmj.engines.lbm.LbmEngine of the running episode
    fish: engines.FishState
    alone = "the flow solver"

    @classmethod
    def in_tank(cls, rules: TaskSpec, options: dict) -> "SolverPhysics":
        """Straight fish; `options` are those of `fishmj.engines.lbm.LbmEngine`: domain, slip, device, finer.

        Raises ConfigError: a robot with effects that cannot act in the solver.
        """
        physics = cls.of(rules.robot)
        physics._solver, physics._setting = options, rules.setting
        physics.begin(np.zeros(3), physics.swim.params, physics.swim.current)
        return physics

    def _water_of(self, robot: Robot, root: str) -> None:
        """Returns None: the solver computes the forces."""

    def _start_water(self, params: FishParams) -> None:
        """Does nothing: the tank of `begin` is the water."""

    def begin(self, pose, params: FishParams, current: Current) -> None:
        """Fills a tank with this flow, with this fish at rest at pose (3,) [m, rad]. Call inside `reset_context`."""
        from fishmj.engines.lbm import LbmEngine

        super().begin(pose, params, current)
        flow = DrawnFlow.of(current, Flow(turbulence=self._setting.turbulence, box=BOXES[self._setting.box]))
        self.engine = LbmEngine(self.swim.robot, [flow], **self._solver)
        self.fish = engines.at_rest(self.swim.robot, np.asarray(pose)[None])
        self.fish.q[:, 3:] = params.zero  # the encoders read zero

    def step(self, n_sub_steps: int = 1) -> None:
        """Advances by physics steps, whole bus ticks only.

        Raises ConfigError: part of a bus tick; PhysicsError: the fish left the tank, or its water is not finite.
        """
        s = self.swim
        ticks, part = divmod(n_sub_steps, s.steps)
        if part:
            raise ConfigError(
                f"suite: {n_sub_steps} physics steps in the flow solver; expected a multiple of {s.steps}, whole bus ticks"
            )
        last = s.pending[-1:] if len(s.pending) else s.buffer[0, -1:]
        commands = np.concatenate([s.pending, np.repeat(last, ticks, 0)])[:ticks]
        self.fish, trace = self.engine.advance(self.fish, commands[None], s.params, s.current, np.array([s.step // s.steps]))
        if stopped := self.engine.stopped[0]:
            raise control.PhysicsError(f"the flow solver stopped: {stopped}")
        s.pending, s.step = s.pending[ticks:], s.step + n_sub_steps
        s.buffer = np.concatenate([s.buffer, commands[None]], 1)[:, -s.buffer.shape[1] :]
        s.rows = (*s.rows, *zip(*(column[0] for column in trace), strict=True))[-s.keep :]
        pose, joint = trace.pose[0, -1], trace.joint[0, -1] + s.params.zero[0]
        s.yaw = float(pose[2])
        self.data.qpos[:] = reference_qpos(self.model.ptr, pose, joint)
        self.data.qvel[:] = [*trace.velocity[0, -1], *trace.rate[0, -1]]
        self.data.time += ticks * s.robot.timing.bus_dt
        self.forward()


class HybridPhysics(Physics):
    """A fish in a corrected water; make one with `HybridPhysics.corrected`. Every episode starts with the uncorrected water.

    Attributes:
        hybrid: the corrections (`fishmj.engines.hybrid.Hybrid.report`).
    """

    hybrid: Any
    alone = "the water hybrid"

    @classmethod
    def corrected(cls, rules: TaskSpec, options: Any = None) -> "HybridPhysics":
        """Straight fish; options: `fishmj.engines.hybrid.HybridOptions`."""
        from fishmj.engines.hybrid import Hybrid

        setting = rules.setting
        physics = cls.of(rules.robot)
        kind = Flow(turbulence=setting.turbulence, box=BOXES[setting.box])
        physics.hybrid = Hybrid(rules.robot, options, kind=kind)
        physics._given = physics.swim.params, physics.swim.current
        return physics

    def begin(self, pose, params: FishParams, current: Current) -> None:
        """Starts an episode as `Physics.begin`, without corrections."""
        super().begin(pose, params, current)
        self._given = params, current
        self.hybrid.reset()

    def _next_tick(self) -> None:
        s, data, water = self.swim, self.data, self.water
        batch = lambda values: np.array([values], float)
        fish = FishState(batch(data.qpos), batch(data.qvel), batch(water.attached), s.buffer, batch(water.memory))
        s.params, s.current = self.hybrid.tick(fish, *self._given, s.step // s.steps)
        water.set_fish(s.params)
        super()._next_tick()
