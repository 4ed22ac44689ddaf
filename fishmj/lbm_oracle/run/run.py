"""One fish in the flow solver, by bus ticks of 20 ms: what `swim`, data generation and the judge have in common.

    command -> clamp, quantise -> bus (latency) -> [ coupled step ] x n -> window follows -> record

    run = Run(coupled, robot)
    for n in range(500):
        run.tick(gait(run.time))
    trial = run.trial()

Driven by the servos, joints lag behind their commands as on the robot. `prescribed` joints follow a function of time to the
letter, `tethered` holds the root; the torques that this takes are the servo's and the tether's reaction.
"""

from collections.abc import Callable, Generator, Iterator
from typing import cast

import numpy as np
import warp as wp

from fishmj.errors import ConfigError, FishmjError, LogError, OracleUnstable, SimDiverged
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.run.joint_driver import JointDriver, Servos
from fishmj.lbm_oracle.run.stability import MACH, Watch
from fishmj.lbm_oracle.run.time_refinement import FACTORS, TickState, checkpoint, finer, hand_over, restore
from fishmj.log import SCHEMA, Trial, numbered
from fishmj.mjcf import load_robot
from fishmj.mjcf.centres import link_centres
from fishmj.mjcf.command_bus import arrived, on_the_bus
from fishmj.mjcf.identity import identity
from fishmj.mjcf.model import reference_pose
from fishmj.source import made_by

ALERT = 50  # ticks after one that was done again: the wake is still fast
CAUTION = 0.6  # of the limit: from this speed on, a tick keeps a checkpoint of its start

Tick = tuple[float, np.ndarray, np.ndarray]  # servo power W, link wrenches raw and whole


class LeftDomain(FishmjError, RuntimeError):
    """The fish reached the edge of its box of water; everything before is kept."""


class Run:
    """A coupled fish with its command path and its log.

    Args:
        coupled: fish and water. robot: description, path or name.
        tethered: the root does not move over ground.
        prescribed: joint angles as a function of time [s] -> (J,) rad, in place of the servos.
        latency: of commands, s; the robot's nominal one by default.
        follow: called with the coupled fish after every step: a window moves, a tank looks after its walls. It touches the
            water in `FluidStructure.scope` only.

    Raises:
        ConfigError: the fluid's step does not divide the bus tick.
    """

    def __init__(
        self,
        coupled: FluidStructure,
        robot="fish",
        *,
        tethered: bool = False,
        prescribed: Callable[[float], np.ndarray] | None = None,
        latency: float | None = None,
        follow: Callable[[FluidStructure], None] | None = None,
    ):
        self.coupled, self.robot = coupled, load_robot(robot)
        self.tethered, self.prescribed, self.follow = tethered, prescribed, follow
        timing, dt = self.robot.timing, coupled.body.dt
        self.steps = round(timing.bus_dt / dt)
        if self.steps < 1 or abs(self.steps * dt - timing.bus_dt) > 1e-9:
            near = timing.bus_dt / max(1, round(timing.bus_dt / dt))
            raise ConfigError(f"run: the bus tick of {timing.bus_dt} s is no multiple of dt = {dt} s; nearest dt: {near:g} s")
        self.delay = round((timing.command_latency if latency is None else latency) / dt)
        self.joints = self.robot.n_joints
        self._finer: dict[int, FluidStructure] = {}
        self.begin()

    def begin(self) -> None:
        """From the state as it is: no ticks, no rows, the present joint angles on the bus."""
        self.ticks = 0
        self.commands = [self.angles()]  # on the bus; number 0 was there before t = 0
        self.start = self.coupled.time
        self.first = np.concatenate([self.pose[:3], self.commands[0]])  # (3 + J,) m, rad, when the run began
        self.pushed = self.pose[3:]
        self.rows: list[tuple] = []
        self.stopped = ""  # why the run ended early
        self.watch = Watch()
        self.fastest = 0.0  # marker in the last tick, m/s
        self.factor = 1  # of the last tick that was done: how many times finer its steps were
        self.refined = 0  # ticks that were done again with finer steps
        self.alert = 0  # until this tick checkpoints are kept whatever the fish does

    @property
    def time(self) -> float:
        """s since the run began."""
        return self.coupled.time - self.start

    @property
    def pose(self) -> np.ndarray:
        """(x, y, yaw, x', y', yaw') of the reference point, tank frame, m and rad."""
        return reference_pose(self.coupled.body.model, self.coupled.body.data)

    def angles(self) -> np.ndarray:
        """(J,) rad."""
        return self.coupled.body.data.qpos[-self.joints :].copy()

    def rates(self) -> np.ndarray:
        """(J,) rad/s."""
        return self.coupled.body.data.qvel[-self.joints :].copy()

    def tick(self, command=None) -> None:
        """Advance one bus tick after sending `command`, (J,) rad; prescribed joints take none.

        Raises:
            SimDiverged, OracleUnstable: fish or water left the finite numbers. LeftDomain: from `follow`.
            What was recorded before stays.
        """
        for _ in self.ticking(command):
            pass

    def ticking(self, command=None) -> Iterator[None]:
        """The same, pausing whenever the device has work and the host could look after another tank (see `tanks`)."""
        wanted = np.asarray(self.prescribed(self.time) if self.prescribed else command, float)
        if wanted.shape != (self.joints,) or np.isnan(wanted).any():
            raise ConfigError(f"run: command {wanted.tolist()}; expected {self.joints} finite joint angles in rad")
        sent = on_the_bus(self.robot.servo, wanted)
        self.commands.append(sent)
        began, kept, done = self.time, None, None
        if self.fastest > CAUTION * self.limit or self.ticks < self.alert:
            kept = checkpoint(self.coupled)
        try:
            if self.fastest <= self.limit:  # else the tick before was too fast, and so will this one be
                done = yield from self._steps(1, stop=kept is not None)
        except (SimDiverged, OracleUnstable):
            if kept is None:
                raise
        power, raw, whole = done or (yield from self._again(cast(TickState, kept)))  # a tick stops only where one was kept
        self.ticks += 1
        self.rows.append((began, self.time, sent, self.pose, self.angles(), self.rates(), power, raw, whole))

    @property
    def limit(self) -> float:
        """Greatest speed of a marker that the grid's own time step takes, m/s."""
        return MACH * self.coupled.fluid.lattice.sound

    def _steps(self, factor: int, stop: bool = True) -> Generator[None, None, Tick | None]:
        """The steps of one tick, `factor` times finer: servo power W, link wrenches raw and whole.

        With `stop` it gives up, and returns None, as soon as a marker is too fast for them.
        """
        coupled = self.coupled if factor == 1 else self._finer[factor]
        body, dt = coupled.body, coupled.body.dt
        self.fastest, count, corners = 0.0, self.steps * factor, coupled.boundary.corners
        driver, ended = self._driver(coupled, factor), False
        try:
            for i in range(count):
                coupled.ask()
                coupled.tell(*driver.drive(i))
                driver.begun()
                yield
                coupled.finish()
                driver.finished()
                self.watch.end()
                self.fastest = max(self.fastest, body.fastest(corners))
                if stop and self.fastest > factor * self.limit:
                    return None
                if self.watch.due(coupled.fluid):
                    with coupled.scope():
                        self.watch.begin(coupled.fluid)
                if self.follow is not None:
                    self.follow(coupled)
            ended = True
        finally:
            coupled.join()
            if not ended:
                self.watch.pending = None  # of an attempt that was given up
        self.factor = factor
        return driver.power, *coupled.take_wrench(count * dt)

    def _driver(self, coupled: FluidStructure, factor: int) -> JointDriver:
        """Who moves the joints through one tick."""
        return Servos(self, coupled, factor)

    def _again(self, kept: TickState) -> Generator[None, None, Tick]:
        """The tick from its checkpoint with finer steps; counted in `refined`.

        Raises:
            OracleUnstable: too fast for the finest ones, too. SimDiverged: it was not for the time step.
        """
        wp.synchronize_device(self.coupled.fluid.device)
        for factor in self._fine_enough():
            restore(self.coupled, kept)
            if factor not in self._finer:
                self._finer[factor] = finer(self.coupled, factor)
            hand_over(self.coupled, self._finer[factor])
            self._finer[factor].take_wrench(1.0)  # what an attempt that was given up had summed
            try:
                done = yield from self._steps(factor)
            except (SimDiverged, OracleUnstable):
                if factor == FACTORS[-1]:
                    raise
                continue
            if done is not None:
                hand_over(self._finer[factor], self.coupled)
                self.refined, self.alert = self.refined + 1, self.ticks + ALERT
                return done
        message = f"a marker moves at {self.fastest:.2f} m/s at t = {self.time:.3f} s; {FACTORS[-1]} sub-steps take"
        raise OracleUnstable(f"oracle: {message} {FACTORS[-1] * self.limit:.2f} m/s. Take a smaller dt", limit="mach")

    def _fine_enough(self) -> tuple[int, ...]:
        """Factors to try, after what was seen at the end of the tick before, where no step of this one was done.

        Water that ended too fast for that tick's steps, faster than any marker, asks for finer ones now.

        Raises:
            OracleUnstable: it was no matter of speed, or its steps were the finest.
        """
        try:
            self.watch.end()
        except OracleUnstable as error:
            left = tuple(factor for factor in FACTORS if factor > self.factor)
            if error.limit != "speed" or not left:
                raise
            return left
        return FACTORS

    def arrived(self, step: int) -> np.ndarray:
        """What the servos aim at in step `step`, (J,) rad: the newest command that is old enough."""
        return arrived(self.commands, step, self.delay, self.steps, self.robot.timing.command_path == "move_time")

    def held(self, dt: float):
        """Prescribed velocities of this step, or nothing."""
        if not (self.tethered or self.prescribed):
            return None, None
        n = self.coupled.body.dofs
        fixed, value = np.zeros(n), np.zeros(n)
        if self.tethered:
            fixed[: n - self.joints] = 1.0
        if self.prescribed:
            fixed[-self.joints :] = 1.0
            value[-self.joints :] = (self.prescribed(self.time + dt) - self.angles()) / dt
        return fixed, value

    def trial(self) -> Trial:
        """Everything so far in the log's schema: commands at the start of each tick, the rest at its end, wrenches as means.

        Raises:
            LogError: nothing was recorded yet.
        """
        if not self.rows:
            raise LogError("oracle run: no tick was finished, nothing to write")
        began, t, cmd, pose, joint, rate, power, raw, whole = (np.array(column) for column in zip(*self.rows, strict=True))
        servo = self.robot.servo
        truth = dict(zip(("x", "y", "yaw", "vx", "vy", "wz"), pose.T, strict=True))
        tables = {
            "cmd": {"t": began, **numbered("c#", cmd)},
            "joint": {"t": t, **numbered("j#", joint), **numbered("w#", rate)},
            "pose": {"t": t, "x": pose[:, 0], "y": pose[:, 1], "yaw": pose[:, 2]},
            "power": {"t": t, "V": np.full(len(t), servo.voltage), "I": (power + servo.idle_power) / servo.voltage},
            "truth": {"t": t, **truth, **numbered("j#", joint), **numbered("k#", rate)},
            "flow": {"t": began, **self._flow(began, pose, joint)},
            "wrench": {"t": t, **_wrench(whole, "f#x", "f#y", "m#"), **_wrench(raw, "r#x", "r#y", "n#")},
        }
        if self.prescribed:  # what the servos would have drawn is not known
            del tables["power"]
        return Trial(self.meta(tables), tables)

    def _body_frame(self, rates: np.ndarray) -> list[float]:
        """Rates of the reference point (3,) in the tank frame as surge, sway [m/s] and yaw rate [rad/s]."""
        c, s = np.cos(self.first[2]), np.sin(self.first[2])
        return [float(c * rates[0] + s * rates[1]), float(c * rates[1] - s * rates[0]), float(rates[2])]

    def _flow(self, began, pose, joint) -> dict:
        """Undisturbed flow at the links' centres at the start of each tick, as columns."""
        flow = self.coupled.fluid.flow
        q = np.concatenate([self.first[None], np.concatenate([pose[:, :3], joint], 1)[:-1]])
        at = link_centres(self.robot, q)
        if flow.rms == 0.0:
            u = np.broadcast_to(flow.mean[:2], at.shape)
        else:
            deep = np.concatenate([at, np.zeros((*at.shape[:2], 1))], -1)
            u = np.stack([flow.at(x, float(self.start + t))[:, :2] for x, t in zip(deep, began, strict=True)])
        return {**numbered("u#x", u[..., 0]), **numbered("u#y", u[..., 1])}

    def meta(self, tables) -> dict:
        """What a reader must know about the run."""
        fluid, edge = self.coupled.fluid, self.coupled.boundary
        flow, lattice = fluid.flow, fluid.lattice
        water = {"dx": lattice.dx, "dt": lattice.dt, "shape": list(fluid.shape), "slip": self.coupled.slip}
        water |= {"subgrid": fluid.subgrid, "kernel": edge.width, "passes": edge.passes, "markers": edge.count}
        return {
            "schema": SCHEMA,
            "origin": "synthetic",
            **identity(self.robot),
            "medium": "water",
            "flow": {"speed": flow.speed, "direction": flow.direction, "turbulence": flow.turbulence}
            | {"intensity": flow.intensity, "seed": flow.seed, "known": True},
            "excitation": "prescribed joints" if self.prescribed else "servos",
            "replicate_of": "",
            "controller": "open loop",
            "start": self.first[:3].tolist(),
            "push": self._body_frame(self.pushed),
            "latency": {"pose": 0.0, "command": self.delay * self.coupled.body.dt},
            "water": "lbm",
            "oracle": {**water, "device": str(fluid.device), "tethered": self.tethered}
            | {"refined_ticks": self.refined, "stopped": self.stopped},
            "seed": flow.seed,
            "clock": {name: "simulation" for name in tables},
            **made_by("mujoco", "numpy", "warp-lang"),
            "source": "fishmj.lbm_oracle",
            "licence": "Apache-2.0",
            "notes": "simulated; joint and pose are exact, without sensor noise or camera latency. wrench: means over a tick; r"
            " and n are the raw exchange",
        }


def _wrench(values: np.ndarray, x: str, y: str, turn: str) -> dict:
    """(T, L, 6) -> planar columns."""
    return {**numbered(x, values[:, :, 0]), **numbered(y, values[:, :, 1]), **numbered(turn, values[:, :, 5])}
