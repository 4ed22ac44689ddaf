"""One experiment in the flow solver with the second robot's electronics: placing, carriage, run, sensors, trial."""

from dataclasses import dataclass, field
from typing import cast

import numpy as np

from fishmj.campaign.hidden_lbm.hidden_body import Electronics, HiddenBody, Queue
from fishmj.excitation import PERIOD, Excitation
from fishmj.flow import Flow
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import fish_markers
from fishmj.lbm_oracle.run.domain import Domain, preset
from fishmj.lbm_oracle.run.run import JointDriver, LeftDomain, Run
from fishmj.lbm_oracle.run.setup import DomainWatch
from fishmj.mjcf.model import reference_qpos
from fishmj.virtual_robot import network, random_streams
from fishmj.virtual_robot.robot_constants import RobotConstants
from fishmj.virtual_robot.simulate import Recording
from fishmj.virtual_robot.state import at_rest
from fishmj.virtual_robot.trials import weather

CARRY = 1.5  # s that a carriage takes the fish along, or holds it in a stream: after them the drag stays within a tenth
WIDTH, PASSES = 3, 2  # of the immersed boundary


@dataclass(frozen=True, kw_only=True)
class Job:
    """One trial: a robot, an experiment, what its noise is drawn from.

    heavier: factor on all masses. slip: ratio of the hull at the paper's grid. flow: ordered stream, m/s and rad.
    """

    made: RobotConstants
    what: Excitation
    seed: int
    index: int
    name: str
    replicate_of: str = ""
    noise: float = 1.0
    slip: float = 1.0
    heavier: float = 1.0
    flow: tuple[float, float] = (0.0, 0.0)
    domain: Domain = field(default_factory=lambda: preset("laptop"))

    @property
    def steps(self) -> int:
        """Of the domain's own length."""
        return round((self.what.seconds + (CARRY if self.carried else 0.0)) / self.domain.dt)

    @property
    def stream(self) -> np.ndarray:
        """(2,) the ordered stream and a steady current, m/s."""
        tank = self.made.tank
        return np.array([tank.flow_x + tank.current_x, tank.flow_y + tank.current_y])

    @property
    def carried(self) -> bool:
        """Whether a carriage takes the fish along, or holds it in a stream, before it lets go."""
        return any(self.what.push) or bool(np.any(self.stream))


class HiddenRun(Run):
    """A `Run` on the second robot's servos; `tick` takes no notice of the command, the queue has them all.

    Raises:
        OracleUnstable, ConfigError: the job could not be set up.
    """

    def __init__(self, job: Job, device: str):
        self.job, what, made = job, job.what, job.made
        hand = random_streams.stream(job.seed, "placing", job.index).standard_normal(3) * job.noise
        start = np.array(what.start) + hand * np.array([made.placing[0], made.placing[0], made.placing[1]])
        state = at_rest(start, what.commands[0] + made.zero, made.motor.voltage, what.push)
        state.goal[:], state.aim[:], state.seen[:] = what.commands[0], what.commands[0], what.commands[0]
        state.ramp[:, :2] = what.commands[0][:, None]
        packets = network.deliver(made.network, made.odd, what.t, what.commands, job.seed, job.index, job.noise)
        gust = weather(made, what.seconds, job.seed, job.index)
        self.electronics = Electronics(made, state, Queue(packets.times, packets.commands), gust)
        coupled, edge = _coupled(job, device, carriage(start, what.push, CARRY), what.commands[0] + made.zero)
        super().__init__(coupled, made.robot, latency=0.0, follow=edge)
        if job.carried:
            try:
                self._carry(start)
            except LeftDomain as error:
                self.stopped = str(error)
        self.electronics.place(_hidden(coupled))
        self.begin()

    @property
    def end(self) -> int:
        """Ticks of the whole experiment."""
        return round(self.job.what.seconds / PERIOD)

    @property
    def done(self) -> bool:
        return self.ticks >= self.end or bool(self.stopped)

    def recording(self) -> Recording:
        """Every finished tick, a row a millisecond."""
        whole = self.electronics.recording()
        rows = round(self.ticks * PERIOD * 1000)
        return Recording(whole.t[:rows], whole.data[:rows])

    def _carry(self, start: np.ndarray) -> None:
        """Take the fish along, or hold it, joints still, until t = 0 at `start`."""
        dt, push = self.coupled.body.dt, self.job.what.push
        steps = round(CARRY / dt)
        before = carriage(start, push, CARRY)
        for i in range(steps):
            after = carriage(start, push, CARRY - (i + 1) * dt)
            _hidden(self.coupled).set_torque(np.zeros(3), np.zeros(3))
            self.coupled.step(np.ones(6), np.array([*(after - before) / dt, 0.0, 0.0, 0.0]))
            if self.follow is not None:
                self.follow(self.coupled)
            before = after
        self.coupled.join_stream()
        self.coupled.take_wrench(CARRY)

    def _driver(self, coupled: FluidStructure, factor: int) -> JointDriver:
        return ElectronicsDriver(self.electronics, coupled, self.ticks)


class ElectronicsDriver:
    """The joints' torque from the electronics for one tick; a joint that friction holds is prescribed not to move."""

    power = 0.0  # their own record has it

    def __init__(self, electronics: Electronics, coupled: FluidStructure, tick: int):
        self.electronics, self.body, self.began = electronics, _hidden(coupled), tick * PERIOD
        electronics.begin_tick(tick)
        electronics.place(self.body)

    def actuate(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        self.electronics.actuate(self.body, self.began + step * self.body.dt)
        return np.concatenate([np.zeros(3), self.electronics.held]), np.zeros(6)

    def record(self) -> None:
        """Nothing to keep."""

    def follow(self) -> None:
        self.electronics.follow(self.body)


def _hidden(coupled: FluidStructure) -> HiddenBody:
    return cast(HiddenBody, coupled.body)


def carriage(start: np.ndarray, push, before: float) -> np.ndarray:
    """Pose (3,) `before` s ahead of t = 0 of a carriage with steady velocity `push` in its own axes, at `start` at t = 0."""
    u, v, r = push
    turned = -r * before
    yaw = start[2] + turned
    if abs(turned) < 1e-9:
        along, across = before * u, before * v
    else:  # the chord of an arc, in the axes at the start of it
        s, c = np.sin(r * before) / r, (1.0 - np.cos(r * before)) / r
        along, across = u * s - v * c, u * c + v * s
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([start[0] - (c * along - s * across), start[1] - (s * along + c * across), yaw])


def _coupled(job: Job, device: str, pose: np.ndarray, joints: np.ndarray) -> tuple[FluidStructure, DomainWatch]:
    """Fish and water at the start; the stream and a steady current are the water's own."""
    made, domain = job.made, job.domain
    stream = job.stream
    speed, direction = float(np.hypot(*stream)), float(np.arctan2(stream[1], stream[0]))
    flow = Flow(speed=speed, direction=direction, turbulence="none")
    fluid = Fluid(domain.lattice, domain.shape, device, boundaries=domain.boundaries, flow=flow)
    body = HiddenBody(made, domain.dt, job.heavier)
    body.place(reference_qpos(body.model, tuple(pose), joints))
    markers = fish_markers(made.robot, domain.dx, slip=job.slip, width=WIDTH)
    coupled = FluidStructure(fluid, body, markers, slip=job.slip, width=WIDTH, passes=PASSES)
    edge = DomainWatch(domain, float(pose[2]))
    while edge.follow(coupled):  # a window starts round its fish
        pass
    return coupled, edge
