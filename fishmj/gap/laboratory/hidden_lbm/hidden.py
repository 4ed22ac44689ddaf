"""Flow solver as generator of logs: immersed fish with the second robot's servos, radio and camera, and hidden effects.

    from fishmj.gap.laboratory.hidden_lbm.hidden import generate_lbm
    trials = generate_lbm({"command_latency": {"delay": 0.04}}, ["gait", "steps", "tow_ahead"], seed=7)

The second robot computes actuator, timing and measurement effects; masses are set in the immersed body, a steady current in the
solver. Other effects of the water add their force in the second robot's water to the solver's. A seed fixes the robot (servo,
radio, masses, slip) and the noise, whatever is planted. A trial does not name the planted effect.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from fishmj.base.errors import ConfigError, OracleUnstable, SimDiverged
from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.hidden_lbm.hidden_body import Electronics, HiddenBody, Queue
from fishmj.gap.laboratory.session import CLOCKS, Effects, experiments, sent_commands, trial_meta
from fishmj.gap.laboratory.virtual_robot import network, sensors
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants
from fishmj.gap.laboratory.virtual_robot.simulate import StateRecording
from fishmj.gap.laboratory.virtual_robot.trials import SENSORS, plant, sense, sigmas, start_state, weather
from fishmj.hydro_fit.campaign.data.run_segments import DOUBT
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import PLAIN, Sharpness
from fishmj.lbm_oracle.run.domain import PREVIEWS, Domain, preset
from fishmj.lbm_oracle.run.run import JointDriver, LeftDomain, Run, TankRun
from fishmj.lbm_oracle.run.setup import DomainWatch, SwimSetup
from fishmj.lbm_oracle.run.spread import Waiting, side_by_side
from fishmj.log import Trial
from fishmj.log.excitation import PERIOD, Excitation
from fishmj.mjcf.description import Robot
from fishmj.water.flow import Flow

CARRY = 1.5  # s of towing, or of holding in a stream, before the release; the drag then stays within a tenth
WIDTH, PASSES = 3, 2  # of the immersed boundary
SLIPPERY = 0.02  # at nuisance 0.1 the slip ratio is 1 to 0.998 of the requested one: 15 % of the speed at s = 1
HEAVY = 0.2  # share of the nuisance that masses have; weighing is more exact
SHORTEST = 1.0  # s, of a trial


@dataclass(frozen=True, kw_only=True)
class Job:
    """One trial: a robot, an experiment, the seeds of its noise.

    heavier: factor on all masses. slip, sharpness: of the boundary. flow: set stream, m/s and rad. hand: seed of
    placing and packet delays, in place of the robot's own.
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
    hand: int | None = None
    sharpness: Sharpness = PLAIN

    @property
    def placing(self) -> int:
        """Seed of placing and radio."""
        return self.seed if self.hand is None else self.hand

    @property
    def steps(self) -> int:
        """Number of time steps of the domain's coarsest grid."""
        return round((self.what.seconds + (CARRY if self.carried else 0.0)) / self.domain.dt)

    @property
    def stream(self) -> np.ndarray:
        """Set stream plus steady current (2,), m/s."""
        tank = self.made.tank
        return np.array([tank.flow_x + tank.current_x, tank.flow_y + tank.current_y])

    @property
    def carried(self) -> bool:
        """True if a carriage tows the fish, or holds it in a stream, before the release."""
        return any(self.what.push) or bool(np.any(self.stream))


class HiddenRun(Run):
    """`Run` with the second robot's servos; `tick` ignores its command, since the queue holds all commands.

    Raises OracleUnstable, ConfigError: the job could not be set up.
    """

    def __init__(self, job: Job, device: str):
        self.job, what, made = job, job.what, job.made
        start, state = start_state(made, what, job.placing, job.index, job.noise)
        packets = network.deliver(made.network, made.odd, what.t, what.commands, job.placing, job.index, job.noise)
        gust = weather(made, what.seconds, job.seed, job.index)
        self.electronics = Electronics(made, state, Queue(packets.times, packets.commands), gust)
        stage = _stage(job, device, carriage(start, what.push, CARRY), what.commands[0] + made.zero)
        coupled = stage.assembled(HiddenBody(made, job.domain.body_level.dt, job.heavier))
        super().__init__(coupled, made.robot, latency=0.0, follow=DomainWatch(job.domain, stage.pose[2]))
        if job.carried:
            try:
                self._carry(start)
            except (LeftDomain, SimDiverged, OracleUnstable) as error:
                self.stopped = str(error)
        self.electronics.place(_hidden(coupled))
        self.begin()

    @property
    def end(self) -> int:
        """Number of ticks of the whole experiment."""
        return round(self.job.what.seconds / PERIOD)

    def recording(self) -> StateRecording:
        """Recording of all finished ticks, one row per millisecond."""
        whole = self.electronics.recording()
        rows = round(self.ticks * PERIOD * 1000)
        return StateRecording(whole.t[:rows], whole.data[:rows])

    def _carry(self, start: np.ndarray) -> None:
        """Tows or holds the fish, with fixed joints, so that it is at `start` at t = 0."""
        dt, push = self.coupled.body.dt, self.job.what.push
        steps, still = round(CARRY / dt), np.zeros(self.joints)
        before = carriage(start, push, CARRY)
        for i in range(steps):
            after = carriage(start, push, CARRY - (i + 1) * dt)
            _hidden(self.coupled).set_torque(still, still)
            self.coupled.step(np.ones(3 + self.joints), np.concatenate([(after - before) / dt, still]))
            if self.follow is not None:
                self.follow(self.coupled)
            before = after
        self.coupled.join_stream()
        self.coupled.take_wrench(CARRY)

    def _driver(self, coupled: FluidStructure, factor: int) -> JointDriver:
        return ElectronicsDriver(self.electronics, coupled, self.ticks)


class ElectronicsDriver:
    """Joint torques from the electronics for one tick; a joint held by friction is prescribed not to move."""

    power = 0.0  # recorded by the electronics

    def __init__(self, electronics: Electronics, coupled: FluidStructure, tick: int):
        self.electronics, self.body, self.began = electronics, _hidden(coupled), tick * PERIOD
        electronics.begin_tick(tick)
        electronics.place(self.body)

    def actuate(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Sets the joints' law for one step; returns flags of the prescribed motions, and their rates, which are zero."""
        self.electronics.actuate(self.body, self.began + step * self.body.dt)
        fixed = np.concatenate([np.zeros(3), self.electronics.held])
        return fixed, np.zeros(len(fixed))

    def record(self) -> None:
        """Does nothing."""

    def follow(self) -> None:
        """Passes the solver's state to the electronics."""
        self.electronics.follow(self.body)


def _hidden(coupled: FluidStructure) -> HiddenBody:
    return cast(HiddenBody, coupled.body)


def carriage(start: np.ndarray, push, before: float) -> np.ndarray:
    """Pose (3,) of a carriage, `before` s before it reaches `start` at t = 0 with constant velocity `push` in its own axes."""
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


def _stage(job: Job, device: str, pose: np.ndarray, joints: np.ndarray) -> SwimSetup:
    """Fish and water at the start; the water carries the stream and a steady current."""
    flow = Flow(speed=float(np.hypot(*job.stream)), direction=float(np.arctan2(job.stream[1], job.stream[0])))
    x, y, yaw = pose.tolist()
    grid: dict[str, Any] = {"domain": job.domain, "device": device, "width": WIDTH, "passes": PASSES}
    grid["sharpness"] = job.sharpness
    return SwimSetup(robot=job.made.robot, flow=flow, slip=job.slip, pose=(x, y, yaw), joints=tuple(joints.tolist()), **grid)


def generate_lbm(
    effects: Effects,
    excitations: Iterable[str | Excitation],
    seed: int,
    noise: float = 1.0,
    nuisance: float = 0.1,
    domain: "str | Domain" = "laptop",
    device: str = "cpu",
    slip: float = 1.0,
    *,
    flow: tuple[float, float] = (0.0, 0.0),
    robot: "str | Robot" = "fish",
    tanks: int = 1,
    say: Callable[[str], None] = lambda text: None,
) -> list[Trial]:
    """One trial per excitation, in order; a repeated one is a replicate with its own noise.

    Args:
        effects, noise, flow: as in `virtual_robot.generate`. nuisance: relative half width of servo and radio constants; masses
            have a fifth of it, and slip is drawn from (1 - 0.02 nuisance) `slip` to `slip`.
        domain: box of water, or its name; "laptop" is a preview. slip: ratio of the hull. robot: description, file or name.
        tanks: experiments that run at once.

    Raises:
        UnknownName, ConfigError: as in `virtual_robot.generate`; no such domain. OracleUnstable: an experiment could not be set
            up, or less than a second of it is valid.
    """
    waiting = jobs(effects, excitations, seed, noise, nuisance, domain, slip, flow=flow, robot=robot)
    order = [job.name for job in waiting]
    made: dict[str, Trial] = {}
    for run in run_jobs(waiting, device, tanks):
        made[run.job.name] = trial = trial_of(run)
        say(f"{trial.name}: {trial.span[1]:.1f} s")
    return [made[name] for name in order]


def jobs(
    effects: Effects,
    excitations: Iterable[str | Excitation],
    seed: int,
    noise: float = 1.0,
    nuisance: float = 0.1,
    domain: "str | Domain" = "laptop",
    slip: float = 1.0,
    *,
    flow: tuple[float, float] = (0.0, 0.0),
    robot: "str | Robot" = "fish",
) -> list[Job]:
    """Experiments of one robot, to be run; arguments as in `generate_lbm`."""
    box = preset(domain) if isinstance(domain, str) else domain
    if not 0.0 <= slip <= 1.0:
        raise ConfigError(f"slip = {slip}; expected a ratio from 0 (no slip) to 1 (free slip)")
    made = plant(effects, seed, nuisance=nuisance, robot=robot, flow=flow)
    rng = random_streams.stream(seed, "immersed")
    heavier, smooth = 1.0 + HEAVY * nuisance * rng.uniform(-1, 1), slip * (1.0 - SLIPPERY * nuisance * rng.uniform(0, 1))
    same: dict[str, Any] = {"noise": noise, "slip": smooth, "heavier": heavier, "flow": flow, "domain": box}
    session = experiments(excitations, made.robot.n_joints)
    return [
        Job(made=made, what=what, seed=seed, index=index, name=name, replicate_of=first, **same)
        for what, index, name, first in session
    ]


def run_jobs(waiting: "Iterable[Job] | Waiting", device: str = "cpu", tanks: int = 1) -> Iterator[HiddenRun]:
    """Runs jobs, `tanks` at once; yields each run when it ends. Several devices (`spread`) share the queue."""
    queue: Waiting = deque(waiting) if isinstance(waiting, Iterable) else waiting

    def start(job: Job) -> TankRun:
        run = HiddenRun(job, device)
        return TankRun(run, run.end, lambda run: run, lambda: np.zeros(run.joints))

    return side_by_side(queue, start, tanks=tanks)


class OwnedJobs:
    """Queue of jobs from pairs of an owner and its job: `run_jobs` takes the jobs, `owner` returns the owner of a run."""

    def __init__(self, waiting: Waiting):
        self.waiting = waiting
        self.of: dict[int, Any] = {}

    def __bool__(self) -> bool:
        return bool(self.waiting)

    def popleft(self) -> Job:
        """Takes the next job."""
        owner, job = self.waiting.popleft()
        self.of[id(job)] = owner
        return job

    def owner(self, run: HiddenRun) -> Any:
        """Owner of a run's job; forgets the pair."""
        return self.of.pop(id(run.job))


def trial_of(run: HiddenRun, *, noise: float | None = None, draw: int | None = None) -> Trial:
    """Sensor readings of a finished run, or of the valid part of a failed run.

    noise: factor on the sensors' noise in place of the job's. draw: index of the noise draw, by default the job's. Raises
    OracleUnstable: less than a second is valid.
    """
    job, made, what = run.job, run.job.made, run.job.what
    record, ticks = run.recording(), run.ticks
    if run.stopped and not run.stopped.startswith("left_domain"):
        ticks = max(0, ticks - round(DOUBT / PERIOD))
        rows = round(ticks * PERIOD * 1000)
        record = record._replace(t=record.t[:rows], data=record.data[:rows])
    if ticks * PERIOD < SHORTEST:
        raise OracleUnstable(
            f"{job.name}: only {ticks * PERIOD:.2f} s are valid; {run.stopped}. Try another seed or a finer grid"
        )
    tables = {"cmd": sent_commands(what.t[:ticks], what.commands[:ticks])}
    factor, number = job.noise if noise is None else noise, job.index if draw is None else draw
    streams = {name: random_streams.stream(job.seed, name, number) for name in SENSORS}
    tables |= sense(made, record, streams, (0.0, float(record.t[-1])), factor)
    tables["pose"] = sensors.on_its_clock(made.camera, sensors.track(made.camera, tables["pose"]))
    return Trial(_meta(run, tables, factor), tables, name=job.name)


def _meta(run: HiddenRun, tables: dict, noise: float) -> dict:
    job, box, what = run.job, run.job.domain, run.job.what
    grid = {"domain": box.name, "dx": box.dx, "dt": box.dt, "shape": list(box.shape), "kernel": WIDTH, "passes": PASSES}
    return trial_meta(
        job.made.robot.name, "lbm", what, job.replicate_of, job.flow, sigma=sigmas(job.made, noise),
        clock={table: CLOCKS[table] for table in tables}, engine="numpy", source="fishmj.campaign.hidden_lbm.hidden",
        notes=": immersed fish, electronics of the second robot",
        after={
            "water": {"grid": grid | {"preview": box.name in PREVIEWS, "device": str(run.coupled.fluid.device)}},
            "push": {"carried": CARRY if any(what.push) else 0.0},
            "controller": {"refined_ticks": run.refined, "stopped": " ".join(run.stopped.split())},
        },
    )  # fmt: skip
