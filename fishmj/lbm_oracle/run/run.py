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

from fishmj.errors import ConfigError, FishmjError, OracleUnstable, SimDiverged
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.run import run_log
from fishmj.lbm_oracle.run.joint_driver import JointDriver, Servos
from fishmj.lbm_oracle.run.stability import MACH, Watch
from fishmj.lbm_oracle.run.time_refinement import FACTORS, Refinement, Tick, TickState, checkpoint
from fishmj.log import Trial
from fishmj.mjcf import load_robot
from fishmj.mjcf.model import reference_pose
from fishmj.mjcf.servos import arrived, on_the_bus

ALERT = 50  # ticks after one that was done again: the wake is still fast
CAUTION = 0.6  # of the limit: from this speed on, a tick keeps a checkpoint of its start


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
        self._refinement = Refinement(coupled)
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
        """The same, pausing whenever the device has work and the host could look after another tank (`concurrent_runs`)."""
        sent = self._send(command)
        began, done = self.time, None
        careful = self.fastest > CAUTION * self.limit or self.ticks < self.alert
        kept = checkpoint(self.coupled) if careful else None  # 176 bytes a cell: too much to copy before every tick
        try:
            if self.fastest <= self.limit:  # else the tick before was too fast, and so will this one be
                done = yield from self._steps(self.coupled, 1, give_up=kept is not None)
        except (SimDiverged, OracleUnstable):
            if kept is None:
                raise
        power, raw, whole = done or (yield from self._again(cast(TickState, kept)))  # a tick stops only where one was kept
        self.ticks += 1
        self.rows.append((began, self.time, sent, self.pose, self.angles(), self.rates(), power, raw, whole))

    def _steps(self, coupled: FluidStructure, factor: int, give_up: bool = True) -> Generator[None, None, Tick | None]:
        """The steps of one tick, `factor` times finer: servo power W, link wrenches raw and whole.

        With `give_up` it returns None as soon as a marker is too fast for them.
        """
        count, corners = self.steps * factor, coupled.boundary.corners
        driver, finished = self._driver(coupled, factor), False
        self.fastest = 0.0
        try:
            for i in range(count):
                coupled.place_markers()
                coupled.assemble_response()
                fixed, value = driver.actuate(i)  # only now: the device is at K while the host works out the servos
                coupled.solve(fixed, value)
                coupled.push_water()
                driver.record()
                yield  # between the launches and the wait: the host serves other tanks while this one's device works
                coupled.advance()
                driver.follow()
                self.watch.end()  # the look begun after the step before: its copies lie behind the velocity just waited for
                self.fastest = max(self.fastest, coupled.body.fastest(corners))
                if give_up and self.fastest > factor * self.limit:
                    return None  # before the wrong water is followed or looked at: the checkpoint is what counts
                self._look(coupled)
            finished = True
        finally:
            coupled.join_stream()
            if not finished:
                self.watch.pending = None  # it would judge water that the checkpoint throws away
        self.factor = factor
        return driver.power, *coupled.take_wrench(count * coupled.body.dt)

    def _look(self, coupled: FluidStructure) -> None:
        """After a step: the watch looks at the water, a window follows its fish."""
        if self.watch.due(coupled.fluid):
            with coupled.scope():
                self.watch.begin(coupled.fluid)
        if self.follow is not None:
            self.follow(coupled)

    def _send(self, command) -> np.ndarray:
        """Put a command on the bus, (J,) rad as it is sent."""
        wanted = np.asarray(self.prescribed(self.time) if self.prescribed else command, float)
        if wanted.shape != (self.joints,) or np.isnan(wanted).any():
            raise ConfigError(f"run: command {wanted.tolist()}; expected {self.joints} finite joint angles in rad")
        sent = on_the_bus(self.robot.servo, wanted)
        self.commands.append(sent)
        return sent

    def _driver(self, coupled: FluidStructure, factor: int) -> JointDriver:
        """Who moves the joints through one tick."""
        return Servos(self, coupled, factor)

    @property
    def limit(self) -> float:
        """Greatest speed of a marker that the grid's own time step takes, m/s."""
        return MACH * self.coupled.fluid.lattice.sound

    def _again(self, kept: TickState) -> Generator[None, None, Tick]:
        """The tick from its checkpoint with finer steps; counted in `refined`.

        Raises:
            OracleUnstable: too fast for the finest ones, too. SimDiverged: it was not for the time step.
        """
        wp.synchronize_device(self.coupled.fluid.device)  # the look at the last tick's end is judged first
        done = yield from self._refinement.redo(kept, self._factors(), self._steps)
        if done is None:
            message = f"a marker moves at {self.fastest:.2f} m/s at t = {self.time:.3f} s; {FACTORS[-1]} sub-steps take"
            raise OracleUnstable(f"oracle: {message} {FACTORS[-1] * self.limit:.2f} m/s. Take a smaller dt", limit="mach")
        self.refined, self.alert = self.refined + 1, self.ticks + ALERT
        return done

    def _factors(self) -> tuple[int, ...]:
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

    def servo_target(self, step: int) -> np.ndarray:
        """What the servos aim at in step `step`, (J,) rad: the newest command that is old enough."""
        return arrived(self.commands, step, self.delay, self.steps, self.robot.timing.command_path == "move_time")

    def prescribed_velocity(self, dt: float) -> tuple:
        """`fixed` and `value` (n,) of this step (`FluidStructure.solve`), or None for both."""
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
        """Everything so far in the log's schema.

        Raises:
            LogError: nothing was recorded yet.
        """
        return run_log.trial(self)
