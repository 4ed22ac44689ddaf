"""One fish in the flow solver, by bus ticks of 20 ms: the common part of `swim`, data generation and the judge.

    command -> clamp, quantise -> bus (latency) -> [ coupled step ] x n -> window follows -> record

    run = Run(coupled, robot)
    for n in range(500):
        run.tick(gait(run.time))
    trial = run.trial()

With servos, joints lag behind their commands as on the robot. `prescribed` joints follow a function of time exactly. `tethered`
holds the root or moves it along `root`. The torques that this needs are the reaction of servos and tether.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from math import ceil
from typing import Any, cast

import numpy as np

from fishmj.base.errors import ConfigError, FishmjError, OracleUnstable, SimDiverged
from fishmj.base.options import checked_array, shown_value
from fishmj.lbm_oracle.fluid.guard import MACH, SPEED_LU, StabilityMonitor, numbers
from fishmj.lbm_oracle.fluid.lattice import RATIO
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.run.pipeline import CAUTION, DeviceTick, HostTick, JointDriver, Pipeline, servo_power
from fishmj.lbm_oracle.run.run_log import trial_of
from fishmj.lbm_oracle.run.time_refinement import FACTORS, STAY, Refinement, Tick, TickState, checkpoint
from fishmj.log import Trial
from fishmj.mjcf import load_robot
from fishmj.mjcf.model import reference_pose
from fishmj.mjcf.servos import arrived_of, on_the_bus


class Servos:
    """Servos of the model, or joints that follow a function of time exactly."""

    def __init__(self, run: "Run", coupled: FluidStructure, factor: int):
        self.run, self.body, self.factor = run, coupled.body, factor
        self.torques: list[np.ndarray] = []
        self.rates: list[np.ndarray] = []

    def actuate(self, step: int) -> tuple:
        """Sets the servos' targets for this step; returns `fixed` and `value` of prescribed joints."""
        run = self.run
        if run.prescribed is None:
            self.body.data.ctrl[:] = run.servo_target(run.ticks * run.steps + step // self.factor)
        return run.prescribed_velocity(self.body.dt)

    def record(self) -> None:
        """Records joint rates and servo torques at the start of the step."""
        self.rates.append(self.run.rates())
        self.torques.append(self.body.data.actuator_force.copy())

    def follow(self) -> None:
        """Does nothing."""

    @property
    def power(self) -> float:
        """Mean power that the servos drew, W."""
        return servo_power(np.array(self.torques), np.array(self.rates), self.body.model)


class LeftDomain(FishmjError, RuntimeError):
    """Error: the fish reached the edge of its box of water; everything before is kept."""


class Run:
    """A coupled fish with its command path and its log.

    Args:
        coupled: fish and water. robot: description, path or name.
        tethered: the root does not move over ground.
        prescribed: joint angles as a function of time [s] -> (J,) rad, in place of the servos.
        latency: of commands, s; the robot's nominal one by default.
        follow: called with the coupled fish after every step: it moves a window, or checks a tank's walls. It may use the water
            in `FluidStructure.scope` only.
        on_device: do all steps of a tick in one, with the fish's motion on the device (`DeviceSteps`), if only servos drive a
            plain body; by default on an accelerator. `follow` is then called once a tick.

    Attributes:
        root: path of a tethered fish, t -> (x, y, yaw), m and rad, t in s since the run began; None holds it still.
        pipelined: tick n + 1 starts before the host reads tick n (`pipeline`). Needs a command latency of one tick or more and
            a window that does not move. The water is then one tick ahead of the fish, and `FluidStructure.scope` refuses to
            show it. A fish whose speed doubles within two ticks gets finer steps one or two ticks later.

    Raises ConfigError: a bus tick is not a whole number of steps of the water, on every level, or an invalid latency.
    """

    root: Callable[[float], np.ndarray] | None = None
    pipelined = False
    boundary_name = "plain"  # for the log

    def __init__(
        self,
        coupled: FluidStructure,
        robot="fish",
        *,
        tethered: bool = False,
        prescribed: Callable[[float], np.ndarray] | None = None,
        latency: float | None = None,
        follow: Callable[[FluidStructure], None] | None = None,
        on_device: bool | None = None,
    ):
        self.on_device = coupled.fluid.device.is_cuda if on_device is None else on_device
        self.coupled, self.robot = coupled, load_robot(robot)
        for name, does in (("prescribed", prescribed), ("follow", follow)):
            if not (does is None or callable(does)):
                raise ConfigError(f"run: {name} = {shown_value(does)}; expected a function, or None")
        self.tethered, self.prescribed, self.follow = tethered, prescribed, follow
        timing, dt = self.robot.timing, coupled.body.dt
        self.steps = round(timing.bus_dt / dt)
        if self.steps < 1 or abs(self.steps * dt - timing.bus_dt) > 1e-9:
            near = timing.bus_dt / max(1, round(timing.bus_dt / dt))
            raise ConfigError(f"run: the bus tick of {timing.bus_dt} s is no multiple of dt = {dt} s; nearest dt: {near:.12g} s")
        levels = coupled.fluid.levels
        if self.steps % RATIO ** (len(levels) - 1):
            coarse, tick = levels[-1].lattice.dt, timing.bus_dt
            near = tick / ceil(tick / coarse)
            raise ConfigError(f"run: the bus tick of {tick} s is no multiple of the coarse dt = {coarse:g} s; take {near:.12g} s")
        late = timing.command_latency if latency is None else float(numbers("run: latency", latency, low=0.0))
        self.delay = round(late / dt)
        self.joints = self.robot.n_joints
        self._refinement, self._pipeline = Refinement(coupled, round(STAY / timing.bus_dt)), Pipeline()
        self.begin()

    def begin(self) -> None:
        """Starts from the present state: no ticks, no rows, the present joint angles.

        Raises ConfigError if the water is ahead.
        """
        if self.coupled.in_flight:
            raise ConfigError("run: the water is ahead of the fish; begin before its first pipelined tick")
        self.ticks = 0
        self.commands = [self.angles()]  # on the bus; number 0 was there before t = 0
        self.start = self.coupled.time
        self.first = np.concatenate([self.pose[:3], self.commands[0]])  # (3 + J,) m, rad, when the run began
        self.pushed = self.pose[3:]
        self.rows: list[tuple] = []
        self.stopped = ""  # why the run ended early
        self.watch = StabilityMonitor()
        self.fastest = self.coupled.body.fastest(self.coupled.boundary.corners)  # marker in the last tick, m/s
        self.factor = 1  # of the last tick that was done: how many times finer its steps were
        self.refined = 0  # ticks that were done with finer steps
        self._refinement.begin()

    @property
    def time(self) -> float:
        """Time since the run began, s."""
        return self.coupled.time - self.start

    @property
    def pose(self) -> np.ndarray:
        """Pose and rates (x, y, yaw, x', y', yaw') of the reference point, tank frame, m and rad."""
        return reference_pose(self.coupled.body.model, self.coupled.body.data)

    def angles(self) -> np.ndarray:
        """Joint angles (J,) rad."""
        return self.coupled.body.data.qpos[-self.joints :].copy()

    def rates(self) -> np.ndarray:
        """Joint rates (J,) rad/s."""
        return self.coupled.body.data.qvel[-self.joints :].copy()

    def tick(self, command=None) -> None:
        """Advances one bus tick after sending `command`, (J,) rad; prescribed joints take none.

        Raises:
            SimDiverged, OracleUnstable: the state of fish or water is not finite. LeftDomain: from `follow`.
            Rows recorded before the error stay.
        """
        for _ in self.ticking(command):
            pass

    def ticking(self, command=None) -> Iterator[None]:
        """Advances one tick; yields when the device has work and the host could serve another tank (`ConcurrentRuns`)."""
        sent = self._send(command)
        began, done = self.time, None
        begun = self.coupled.in_flight  # with the grid's own steps, whatever the tick before has shown
        least = self._refinement.least_at(self.ticks)
        led = self.ticks == 0 and (self.prescribed is not None or self.root is not None)  # it may begin at any speed
        doubted = led or self.watch.pending is not None or self.ticks < self.alert or self.fastest > CAUTION * self.limit
        kept = checkpoint(self.coupled) if doubted and not begun else None  # 164 bytes a cell: too much before every tick
        if kept is not None:
            least = self._judged(least)
        try:
            if begun or (least == 1 and self.fastest <= self.limit):  # a tick after one that was too fast will be so, too
                done = yield from self._run_tick(self.coupled, 1, stop_if_too_fast=kept is not None)
        except (SimDiverged, OracleUnstable):
            if kept is None:
                raise
        power, raw, whole = done or (yield from self._redo_tick(cast(TickState, kept), least))  # it stops only with a checkpoint
        self.ticks += 1
        self.rows.append((began, self.time, sent, self.pose, self.angles(), self.rates(), power, raw, whole))

    def _run_tick(
        self, coupled: FluidStructure, factor: int, stop_if_too_fast: bool = True
    ) -> Generator[None, None, Tick | None]:
        """Does the steps of one tick, `factor` times finer: servo power W, link wrenches raw and whole.

        With `stop_if_too_fast` it returns None as soon as a marker is too fast for them.
        """
        tick = self._device_tick(coupled, factor, stop_if_too_fast) or self._host_tick(coupled, factor)
        fastest, finished = 0.0, False
        try:
            for turn in range(tick.turns):
                fastest = self.fastest = max(fastest, (yield from tick.advance(turn)))
                if stop_if_too_fast and fastest > factor * self.limit:
                    return None  # before the wrong water is followed or surveyed: the checkpoint is what counts
                self._sample_diagnostics(coupled)
            finished = True
        finally:
            if not finished:
                self.watch.pending, coupled.in_flight = None, False  # a survey would judge water that is thrown away
            if not coupled.in_flight:
                coupled.join_stream()
        self.factor = factor
        return tick.power, *coupled.take_wrench(factor * self.steps * coupled.body.dt)

    def _device_tick(self, coupled: FluidStructure, factor: int, stop_if_too_fast: bool) -> DeviceTick | None:
        """The tick on the device; None if the host does the steps."""
        led = self.prescribed or (self.tethered and (self.root is not None or self.coupled.in_flight))
        if not self.on_device or led or type(self)._driver is not Run._driver:
            return None
        return self._pipeline.tick(self, coupled, factor, stop_if_too_fast)

    def _host_tick(self, coupled: FluidStructure, factor: int) -> HostTick:
        if coupled.in_flight:
            raise ConfigError("run: the water is ahead of the fish, and the host cannot go on there; drive it as before")
        return HostTick(coupled, self._driver(coupled, factor), self.watch, self.steps * factor)

    def _sample_diagnostics(self, coupled: FluidStructure) -> None:
        """Checks after a step, or after several in one: the watch surveys the water, a window follows its fish."""
        if not coupled.in_flight and self.watch.due(coupled.fluid, coupled.steps_since_sync):
            with coupled.scope():
                self.watch.begin(coupled.fluid)
        if self.follow is not None:
            self.follow(coupled)

    def _send(self, command) -> np.ndarray:
        """Puts a command on the bus; returns it, (J,) rad, as it is sent."""
        wanted = self.prescribed(self.time) if self.prescribed else command
        sent = on_the_bus(self.robot.servo, checked_array("run: command, joint angles in rad", wanted, (self.joints,)))
        self.commands.append(sent)
        return sent

    def _driver(self, coupled: FluidStructure, factor: int) -> JointDriver:
        """Driver of the joints for one tick."""
        return Servos(self, coupled, factor)

    @property
    def alert(self) -> int:
        """Number of the tick until which checkpoints are kept, whatever the fish does."""
        return self._refinement.until

    @property
    def limit(self) -> float:
        """Greatest speed of a marker, m/s, for the grid's own time step."""
        return MACH * self.coupled.fluid.lattice.sound

    def _redo_tick(self, kept: TickState, least: int) -> Generator[None, None, Tick]:
        """Repeats the tick from its checkpoint with finer steps; counted in `refined`.

        Raises OracleUnstable: too fast for the finest steps too; SimDiverged: the time step was not the cause.
        """
        factors = tuple(factor for factor in FACTORS if factor >= least)
        done = yield from self._refinement.redo(kept, factors, self._run_tick)
        if done is None:
            message = f"a marker moves at {self.fastest:.2f} m/s at t = {self.time:.3f} s; {FACTORS[-1]} sub-steps take"
            raise OracleUnstable(f"oracle: {message} {FACTORS[-1] * self.limit:.2f} m/s. Take a smaller dt", limit="mach")
        self.refined += 1
        water = self.watch.speed / (SPEED_LU * self.coupled.fluid.lattice.velocity)
        self._refinement.note(self.ticks, self.factor, max(self.fastest / self.limit, water))
        return done

    def _judged(self, least: int) -> int:
        """Judges the survey at the end of the last tick; returns the least factor of this tick.

        Water that was too fast or too dense needs finer steps than the last tick had.

        Raises OracleUnstable: the water failed in another way, or the last tick had the finest steps.
        """
        self.coupled.wait_for_water()
        try:
            self.watch.end()
        except OracleUnstable as error:
            least = FACTORS[0] * self.factor
            if error.limit not in ("speed", "density") or least > FACTORS[-1]:
                raise
        return least

    def servo_target(self, step: int) -> np.ndarray:
        """Servo targets (J,) rad in step `step`: the newest command that is old enough."""
        return arrived_of(self.commands, step, self.delay, self.steps, self.robot.timing.command_path == "move_time")

    def prescribed_velocity(self, dt: float) -> tuple:
        """Prescribed velocities of this step, `fixed` and `value` (n,) of `FluidStructure.solve`, or None for both."""
        if not (self.tethered or self.prescribed):
            return None, None
        n = self.coupled.body.dofs
        fixed, value = np.zeros(n), np.zeros(n)
        if self.tethered:
            fixed[: n - self.joints] = 1.0
            if self.root is not None:
                value[:3] = (self.root(self.time + dt) - self.pose[:3]) / dt
        if self.prescribed:
            fixed[-self.joints :] = 1.0
            value[-self.joints :] = (self.prescribed(self.time + dt) - self.angles()) / dt
        return fixed, value

    def trial(self) -> Trial:
        """All ticks so far in the log's schema: commands at the start of each tick, the rest at its end, wrenches as means.

        If a run stopped because water that failed threw the fish faster than a log allows, those last ticks are left out.

        Raises LogError: nothing was recorded yet.
        """
        return trial_of(self)


class ConcurrentRuns:
    """Runs that tick together in one process; one that stops (see `Run.stopped`) stays as it is, the others continue.

    The host serves one tank while the device works on another's water. Every tank has its own stream; `tick` visits all tanks,
    finishes one step of each and begins its next. Tanks share nothing, so results do not depend on their number or order.
    `pipelined`: no caller reads the water between two ticks (`Run.pipelined`).
    """

    def __init__(self, runs: Sequence[Run], *, pipelined: bool = False):
        if not runs:
            raise ConfigError("tanks: no runs")
        self.runs = list(runs)
        for run in self.runs if pipelined else ():
            run.pipelined = True

    @property
    def swimming(self) -> list[int]:
        """Indices of the runs that have not stopped."""
        return [i for i, run in enumerate(self.runs) if not run.stopped]

    def tick(self, commands=None) -> list[int]:
        """Advances all runs by one bus tick; commands (B, J) rad, or None for prescribed joints.

        Returns the indices still swimming. Raises ConfigError if there is not one command for every tank.
        """
        for _ in self.ticking(commands):
            pass
        return self.swimming

    def ticking(self, commands=None) -> Iterator[None]:
        """Advances all runs by one tick; yields after every round, so that other tanks can have their turn."""
        if commands is not None and len(commands) != len(self.runs):
            raise ConfigError(f"tanks: {len(commands)} commands for {len(self.runs)} tanks; stopped ones count")
        going = {i: self.runs[i].ticking(None if commands is None else commands[i]) for i in self.swimming}
        while going:
            for i in list(going):
                try:
                    next(going[i])
                except StopIteration:
                    del going[i]
                except (LeftDomain, SimDiverged, OracleUnstable) as error:
                    self.runs[i].stopped = str(error)
                    del going[i]
            yield


class TankRun:
    """A run up to its last tick, or until it stops, as the work of one tank (`spread.side_by_side`).

    Args:
        end: ticks in all. result: called with the run at its end. command: returns (J,) rad before a tick, None if joints are
            prescribed.
    """

    def __init__(self, run: Run, end: int, result: Callable[[Run], Any], command: Callable[[], np.ndarray] | None = None):
        self.run, self.end, self.result, self.command = run, end, result, command

    @property
    def water(self) -> float:
        """Seconds of water so far."""
        return self.run.time

    def ticking(self) -> Iterator[None]:
        """Does all ticks, pausing when other tanks can have their turn."""
        tank = ConcurrentRuns([self.run])
        while self.run.ticks < self.end and not self.run.stopped:
            yield from tank.ticking(None if self.command is None else self.command()[None])

    def finished(self) -> Any:
        """Returns the result."""
        return self.result(self.run)
