"""One tick of a run, step by step on the host or all steps at once on the device, and ticks that overlap.

    HostTick      place_markers .. advance for each step (`FluidStructure.stepping`)
    DeviceTick    queue all steps, wait for the state    (`DeviceSteps`)

Pipelined, the device starts tick n + 1 before the host reads tick n:

    host      queue 0, queue 1, read 0     queue 2, read 1     queue 3, read 2
    device             0                        1                   2

This needs a command latency of one tick or more, and water that does not move with the fish. Audited ticks, and ticks near the
limit of the time step, are read before the next one starts.
"""

from collections.abc import Callable, Generator
from itertools import count
from typing import Any, Protocol

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.guard import StabilityMonitor
from fishmj.lbm_oracle.immersed.coupling import FluidStructure, StepDriver
from fishmj.lbm_oracle.immersed.device_steps import DeviceSteps, StepResults
from fishmj.mjcf.description import Robot

PATIENCE = 2000  # turns that other tanks are given while one's device works
AUDIT = 50  # ticks between two that MuJoCo does again, where the device moves the fish by itself
CAUTION = 0.6  # of the speed limit: a faster tick keeps a checkpoint of its start and does not overlap the next one
_RUNS = count()  # of this process


class JointDriver(StepDriver, Protocol):
    """Moves the joints through one tick; a new one for each tick, and for each repetition with finer steps."""

    @property
    def power(self) -> float:
        """Mean power that the servos drew, W."""


class TickSource(Protocol):
    """Run as its ticks see it: commands, what is held, the limits of the time step, and what looks at the water."""

    coupled: FluidStructure
    robot: Robot
    watch: StabilityMonitor
    follow: Callable[[FluidStructure], None] | None
    on_device: bool
    pipelined: bool
    tethered: bool
    joints: int
    steps: int  # of a tick
    delay: int  # steps by which a command is late
    ticks: int
    fastest: float

    @property
    def alert(self) -> int:
        """Number of the tick until which checkpoints are kept, whatever the fish does."""

    @property
    def limit(self) -> float:
        """Greatest speed of a marker, m/s, for the grid's own time step."""

    def servo_target(self, step: int) -> np.ndarray:
        """Servo targets (J,) rad in step `step`."""

    def prescribed_velocity(self, dt: float) -> tuple:
        """Prescribed velocities of this step, `fixed` and `value`."""


class HostTick:
    """Tick of `turns` steps by the host. turns: number of calls of `advance` in the tick."""

    def __init__(self, coupled: FluidStructure, driver: JointDriver, watch: StabilityMonitor, turns: int):
        self.coupled, self.driver, self.watch, self.turns = coupled, driver, watch, turns

    def advance(self, turn: int) -> Generator[None, None, float]:
        """Does one step; returns the speed of the fastest corner after it, m/s."""
        yield from self.coupled.stepping(self.driver, turn)
        self.watch.end()  # the survey begun after the step before: its copies lie behind the velocity just waited for
        return self.coupled.body.fastest(self.coupled.boundary.corners)

    @property
    def power(self) -> float:
        """Mean power that the servos drew, W."""
        return self.driver.power


class DeviceTick:
    """Tick of `turns` times `DeviceSteps.count` steps by the device.

    Args:
        audit: MuJoCo does the steps again. prefetch: the next tick may start before this one is read.
    """

    def __init__(self, run: TickSource, device: DeviceSteps, turns: int, *, audit: bool, prefetch: bool):
        self.run, self.device, self.turns, self.audit, self.prefetch = run, device, turns, audit, prefetch
        self.results: list[StepResults] = []

    def advance(self, turn: int) -> Generator[None, None, float]:
        """Does one part of the tick; returns the speed of the fastest corner in it, m/s."""
        run, device, coupled, survey = self.run, self.device, self.device.coupled, None
        if not coupled.in_flight:
            device.queue(self._targets(run.ticks, turn), run.prescribed_velocity(coupled.body.dt)[0])
        if self.prefetch and self._can_prefetch():
            survey = self._prefetch_tick()
        coupled.in_flight = device.sets_in_flight > 1
        for _ in range(PATIENCE):
            yield
            if device.ready():
                break
        self.results.append(device.finish(self.audit))
        run.watch.end()  # the survey begun before these steps: it lies ahead of what was just waited for
        run.watch.pending = survey
        return self.results[-1].fastest

    @property
    def power(self) -> float:
        """Mean power that the servos drew, W."""
        torque, rate = (np.concatenate([getattr(part, name) for part in self.results]) for name in ("torque", "rate"))
        return servo_power(torque, rate[:, -self.run.joints :], self.run.coupled.body.model)

    def _targets(self, tick: int, part: int = 0) -> np.ndarray:
        """Servo targets (S, J) rad in the steps of one part of a tick."""
        run = self.run
        first = part * run.steps
        return np.array([run.servo_target(tick * run.steps + (first + i) // self.turns) for i in range(run.steps)])

    def _can_prefetch(self) -> bool:
        """Returns True if the next tick may start before the host reads this one."""
        run = self.run
        stays = run.follow is None or not getattr(run.follow, "moves_water", True)
        known = run.delay >= run.steps
        calm = run.fastest <= CAUTION * run.limit and run.ticks + 1 >= run.alert
        surveyed = run.watch.pending is None or not run.watch.due(run.coupled.fluid, run.steps)  # one survey at a time
        return run.pipelined and self.device.can_queue_next and stays and known and calm and surveyed and not run.tethered

    def _prefetch_tick(self) -> Any:
        """Queues the next tick behind the one under way; returns the survey between both, which is judged after it."""
        run, fluid, survey = self.run, self.run.coupled.fluid, None
        if run.watch.due(fluid, run.steps):
            with run.coupled.ordered_scope():
                run.watch.begin(fluid)
            survey, run.watch.pending = run.watch.pending, None
        self.device.queue_next(self._targets(run.ticks + 1))
        return survey


class Pipeline:
    """Makes the device's ticks of one run.

    Attributes:
        steps: by the factor of refinement, the steps of a tick or of one part of a finer tick.
        audit_offset: ticks by which its audits are late, so that tanks side by side do not all wait for MuJoCo in the same tick.
    """

    def __init__(self) -> None:
        self.steps: dict[int, DeviceSteps] = {}
        self.audit_offset = next(_RUNS) % AUDIT

    def tick(self, run: TickSource, coupled: FluidStructure, factor: int, stop_if_too_fast: bool) -> DeviceTick | None:
        """Tick on the device, in `factor` parts of finer steps.

        If the device does not compute this body or coupling, it returns None and clears `run.on_device`.
        """
        if factor not in self.steps:
            try:
                self.steps[factor] = DeviceSteps(coupled, run.steps)
            except ConfigError:
                run.on_device = False
                return None
        audit = run.ticks == 0 or run.ticks % AUDIT == self.audit_offset
        prefetch = factor == 1 and not audit and not stop_if_too_fast
        return DeviceTick(run, self.steps[factor], factor, audit=audit, prefetch=prefetch)


def servo_power(torque: np.ndarray, rate: np.ndarray, model: mujoco.MjModel) -> float:
    """Mean servo power over the steps, P = sum max(tau (tau - k_b w) / k_b, 0), W; torque N m and rate rad/s, (S, J).

    k_b is the damping of the fish's own joints, whose back-EMF it is.
    """
    kb = model.dof_damping[-torque.shape[1] :]
    return float(np.maximum(torque * (torque - kb * rate) / kb, 0.0).sum()) / len(torque)
