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
from itertools import count
from typing import Protocol, cast

import numpy as np

from fishmj.base.errors import ConfigError, FishmjError, LogError, OracleUnstable, SimDiverged
from fishmj.base.options import checked_array, shown_value
from fishmj.lbm_oracle.fluid.guard import MACH, Watch, numbers
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.device_steps import DeviceSteps
from fishmj.lbm_oracle.run.run_meta import about, plausible
from fishmj.lbm_oracle.run.time_refinement import FACTORS, Refinement, Tick, TickState, checkpoint
from fishmj.log import Trial, numbered
from fishmj.mjcf import load_robot
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import link_centres
from fishmj.mjcf.model import reference_pose
from fishmj.mjcf.servos import arrived_of, on_the_bus
from fishmj.water.flow import Flow

ALERT = 50  # ticks after one that was done again: the wake is still fast
PATIENCE = 2000  # turns that other tanks are given while one's device works
AUDIT = 50  # ticks between two that MuJoCo does again, where the device moves the fish by itself
_RUNS = count()  # of this process
CAUTION = 0.6  # of the limit: from this speed on, a tick keeps a checkpoint of its start


class JointDriver(Protocol):
    """Moves the joints through one tick; a new one for each tick, and for each repetition with finer steps."""

    @property
    def power(self) -> float:
        """Mean power that the servos drew, W."""

    def actuate(self, step: int) -> tuple:
        """Sets the joints' torque in this step of the tick; returns `fixed` and `value` of `FluidStructure.solve`."""

    def record(self) -> None:
        """Called when the step's equation is assembled and its launches are under way."""

    def follow(self) -> None:
        """Called after MuJoCo has done the step."""


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
        return servo_power(np.array(self.torques), np.array(self.rates), self.run.robot.servo.kb)


def servo_power(torque: np.ndarray, rate: np.ndarray, kb: float) -> float:
    """Mean servo power over the steps, P = sum max(tau (tau - k_b w) / k_b, 0), W; torque N m and rate rad/s, (S, J)."""
    return float(np.maximum(torque * (torque - kb * rate) / kb, 0.0).sum()) / len(torque)


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
        ahead: pipelines ticks: tick n + 1 starts before the host reads tick n. Needs a command latency of one tick or more and
            a window that does not move. The water is then one tick ahead of the fish, and `FluidStructure.scope` refuses to
            show it. A fish whose speed doubles within one tick gets finer steps one tick later.

    Raises:
        ConfigError: the fluid's step does not divide the bus tick, or an invalid latency.
    """

    root: Callable[[float], np.ndarray] | None = None
    ahead = False
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
        self._at_once: dict[int, DeviceSteps] = {}  # by how many times finer the steps are
        self.coupled, self.robot = coupled, load_robot(robot)
        for name, does in (("prescribed", prescribed), ("follow", follow)):
            if not (does is None or callable(does)):
                raise ConfigError(f"run: {name} = {shown_value(does)}; expected a function, or None")
        self.tethered, self.prescribed, self.follow = tethered, prescribed, follow
        timing, dt = self.robot.timing, coupled.body.dt
        self.steps = round(timing.bus_dt / dt)
        if self.steps < 1 or abs(self.steps * dt - timing.bus_dt) > 1e-9:
            near = timing.bus_dt / max(1, round(timing.bus_dt / dt))
            raise ConfigError(f"run: the bus tick of {timing.bus_dt} s is no multiple of dt = {dt} s; nearest dt: {near:g} s")
        late = timing.command_latency if latency is None else float(numbers("run: latency", latency, low=0.0))
        self.delay = round(late / dt)
        self.joints = self.robot.n_joints
        self._refinement = Refinement(coupled)
        self._audited = next(_RUNS) % AUDIT  # tanks side by side do not all wait for MuJoCo in the same tick
        self.begin()

    def begin(self) -> None:
        """Starts from the present state: no ticks, no rows, the present joint angles.

        Raises ConfigError if the water is ahead.
        """
        if self.coupled.ahead:
            raise ConfigError("run: the water is ahead of the fish; begin before its first tick ahead")
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
        begun = self.coupled.ahead  # with the device's own steps, whatever the tick before has shown
        careful = not begun and (self.fastest > CAUTION * self.limit or self.ticks < self.alert)
        kept = checkpoint(self.coupled) if careful else None  # 164 bytes a cell: too much to copy before every tick
        try:
            if begun or self.fastest <= self.limit:  # else the tick before was too fast, and so will this one be
                done = yield from self._steps(self.coupled, 1, give_up=kept is not None)
        except (SimDiverged, OracleUnstable):
            if kept is None:
                raise
        power, raw, whole = done or (yield from self._again(cast(TickState, kept)))  # a tick stops only where one was kept
        self.ticks += 1
        self.rows.append((began, self.time, sent, self.pose, self.angles(), self.rates(), power, raw, whole))

    def _steps(self, coupled: FluidStructure, factor: int, give_up: bool = True) -> Generator[None, None, Tick | None]:
        """Does the steps of one tick, `factor` times finer: servo power W, link wrenches raw and whole.

        With `give_up` it returns None as soon as a marker is too fast for them.
        """
        at_once = self._device_steps(coupled, factor)
        if at_once is not None:
            return (yield from self._steps_at_once(at_once, factor, give_up))
        if coupled.ahead:
            raise ConfigError("run: the water is ahead of the fish, and the host cannot go on there; drive it as before")
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

    def _device_steps(self, coupled: FluidStructure, factor: int) -> DeviceSteps | None:
        """Steps of a whole tick on the device, or of finer ones in `factor` parts; None if the host does the steps."""
        led = self.prescribed or (self.tethered and (self.root is not None or self.coupled.ahead))
        if not self.on_device or led or type(self)._driver is not Run._driver:
            return None
        if factor not in self._at_once:
            try:
                self._at_once[factor] = DeviceSteps(coupled, self.steps)
            except ConfigError:  # a body or a coupling that the device does not compute
                self.on_device = False
        return self._at_once.get(factor)

    def _steps_at_once(self, at_once: DeviceSteps, factor: int, give_up: bool) -> Generator[None, None, Tick | None]:
        """Does the steps of one tick on the device; the host checks after every `1 / factor` of it. Results as `_steps`."""
        coupled, finished, later, seen = at_once.coupled, False, None, []
        audit = self.ticks == 0 or self.ticks % AUDIT == self._audited
        fastest = 0.0
        try:
            for part in range(factor):
                if not coupled.ahead:
                    at_once.queue(self._targets(self.ticks, part, factor), self.prescribed_velocity(coupled.body.dt)[0])
                if factor == 1 and not (audit or give_up) and self._goes_on(at_once):
                    later = self._begin_next(at_once)
                coupled.ahead = at_once.under_way > 1
                for _ in range(PATIENCE):
                    yield
                    if at_once.ready():
                        break
                seen.append(at_once.finish(audit))
                self.watch.end()  # the look begun before these steps: it lies ahead of what was just waited for
                fastest = max(fastest, seen[-1].fastest)
                self.watch.pending, self.fastest = later, fastest
                if give_up and fastest > factor * self.limit:
                    return None
                self._look(coupled)
            finished = True
        finally:
            if not finished:
                self.watch.pending, coupled.ahead = None, False
            if not coupled.ahead:
                coupled.join_stream()
        self.factor = factor
        torque, rate = (np.concatenate([getattr(part, name) for part in seen]) for name in ("torque", "rate"))
        drawn = servo_power(torque, rate[:, -self.joints :], self.robot.servo.kb)
        return drawn, *coupled.take_wrench(factor * self.steps * coupled.body.dt)

    def _targets(self, tick: int, part: int = 0, factor: int = 1) -> np.ndarray:
        """Servo targets (S, J) rad in the steps of a tick, or in one of the `factor` parts of a finer tick."""
        first = part * self.steps
        return np.array([self.servo_target(tick * self.steps + (first + i) // factor) for i in range(self.steps)])

    def _goes_on(self, at_once: DeviceSteps) -> bool:
        """Returns True if the next tick may start before the host reads this one."""
        stays = self.follow is None or not getattr(self.follow, "moves_water", True)
        known = self.delay >= self.steps
        calm = self.fastest <= CAUTION * self.limit and self.ticks + 1 >= self.alert
        seen = self.watch.pending is None or not self.watch.due(self.coupled.fluid, self.steps)  # one look at a time
        return self.ahead and at_once.goes_on and stays and known and calm and seen and not self.tethered

    def _begin_next(self, at_once: DeviceSteps) -> tuple | None:
        """Queues the next tick behind the one under way; returns the survey between both, which is judged after it."""
        fluid, looked = self.coupled.fluid, None
        if self.watch.due(fluid, self.steps):
            with self.coupled.behind_what_is_queued():
                self.watch.begin(fluid)
            looked, self.watch.pending = self.watch.pending, None
        at_once.queue_next(self._targets(self.ticks + 1))
        return looked

    def _look(self, coupled: FluidStructure) -> None:
        """Checks after a step, or after several in one: the watch surveys the water, a window follows its fish."""
        if not coupled.ahead and self.watch.due(coupled.fluid, coupled.together):
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
    def limit(self) -> float:
        """Greatest speed of a marker, m/s, for the grid's own time step."""
        return MACH * self.coupled.fluid.lattice.sound

    def _again(self, kept: TickState) -> Generator[None, None, Tick]:
        """Repeats the tick from its checkpoint with finer steps; counted in `refined`.

        Raises:
            OracleUnstable: too fast for the finest steps too. SimDiverged: the time step was not the cause.
        """
        self.coupled.wait_for_water()  # the look at the last tick's end is judged first
        done = yield from self._refinement.redo(kept, self._factors(), self._steps)
        if done is None:
            message = f"a marker moves at {self.fastest:.2f} m/s at t = {self.time:.3f} s; {FACTORS[-1]} sub-steps take"
            raise OracleUnstable(f"oracle: {message} {FACTORS[-1] * self.limit:.2f} m/s. Take a smaller dt", limit="mach")
        self.refined, self.alert = self.refined + 1, self.ticks + ALERT
        return done

    def _factors(self) -> tuple[int, ...]:
        """Factors of refinement to try, given the survey at the end of the previous tick, before any step of this one.

        If the water ended too fast for that tick's steps, faster than any marker, this tick needs finer ones.

        Raises:
            OracleUnstable: speed was not the cause, or its steps were the finest.
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

        Raises:
            LogError: nothing was recorded yet.
        """
        if not self.rows:
            raise LogError("oracle run: no tick was finished, nothing to write")
        rows = plausible(self.rows) if self.stopped else self.rows
        began, t, cmd, pose, joint, rate, power, raw, whole = (np.array(column) for column in zip(*rows, strict=True))
        q, v = np.concatenate([pose[:, :3], joint], 1), np.concatenate([pose[:, 3:], rate], 1)
        before = np.concatenate([self.first[None], q[:-1]])  # at the start of each tick
        flow = flow_at_links(self.coupled.fluid.flow, self.robot, before, self.start + began)
        servo, planar = self.robot.servo, [0, 1, 5]
        # with prescribed joints the servos' power is not known
        drawn = None if self.prescribed else (servo.voltage, (power + servo.idle_power) / servo.voltage)
        tables = log_tables(began, t, cmd, q, v, flow, whole[:, :, planar], raw[:, :, planar], drawn)
        return Trial(about(self, tables), tables)


def log_tables(began, t, command, q, v, flow, whole, raw, power: tuple | None = None) -> dict[str, dict[str, np.ndarray]]:
    """Tables of the log's schema from T ticks of a fish with J joints and L links.

    Args:
        began, t: start and end of each tick, s. command: (T, J) rad. q, v: (T, 3 + J) at its end.
        flow: (T, L, 2) m/s at its start. power: voltage V, and current A (T,), if servos drove the joints.
        whole, raw: (T, L, 3) N, N, N m, means, with and without the interior water.
    """
    place, joint, rate = dict(zip(("x", "y", "yaw"), q[:, :3].T, strict=True)), q[:, 3:], v[:, 3:]
    wrench: dict[str, np.ndarray] = {}
    for names, values in ((("f#x", "f#y", "m#"), whole), (("r#x", "r#y", "n#"), raw)):
        for name, column in zip(names, np.moveaxis(values, -1, 0), strict=True):
            wrench |= numbered(name, column)
    truth = place | dict(zip(("vx", "vy", "wz"), v[:, :3].T, strict=True)) | numbered("j#", joint) | numbered("k#", rate)
    return {
        "cmd": {"t": began, **numbered("c#", command)},
        "joint": {"t": t, **numbered("j#", joint), **numbered("w#", rate)},
        "pose": {"t": t, **place},
        **({} if power is None else {"power": {"t": t, "V": np.full(len(t), power[0]), "I": power[1]}}),
        "truth": {"t": t, **truth},
        "flow": {"t": began, **numbered("u#x", flow[..., 0]), **numbered("u#y", flow[..., 1])},
        "wrench": {"t": t, **wrench},
    }


def flow_at_links(flow: Flow, robot: Robot, q: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Undisturbed flow at the links' centres, (T, N, 2) m/s, for states q (T, 3 + J) at times t (T,) s."""
    points = link_centres(robot, q)
    if flow.rms == 0.0:
        return np.broadcast_to(flow.mean[:2], points.shape).copy()
    deep = np.concatenate([points, np.zeros((*points.shape[:2], 1))], -1)
    return np.stack([flow.at(where, float(when))[:, :2] for where, when in zip(deep, t, strict=True)])


class ConcurrentRuns:
    """Runs that tick together in one process; one that stops (see `Run.stopped`) stays as it is, the others continue.

    The host serves one tank while the device works on another's water. Every tank has its own stream; `tick` visits all tanks,
    finishes one step of each and begins its next. Tanks share nothing, so results do not depend on their number or order.
    `ahead`: no caller reads the water between two ticks (`Run.ahead`).
    """

    def __init__(self, runs: Sequence[Run], *, ahead: bool = False):
        if not runs:
            raise ConfigError("tanks: no runs")
        self.runs = list(runs)
        for run in self.runs if ahead else ():
            run.ahead = True

    @property
    def swimming(self) -> list[int]:
        """Indices of the runs that have not stopped."""
        return [i for i, run in enumerate(self.runs) if not run.stopped]

    def tick(self, commands=None) -> list[int]:
        """Advances all runs by one bus tick; commands (B, J) rad, or None for prescribed joints.

        Returns the indices still swimming.

        Raises ConfigError if there is not one command for every tank.
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
