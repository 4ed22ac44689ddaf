"""Swims of the loopback robot through the host in lockstep, from target to target: healthy, or with an effect in mid-swim.

The whole chain of `fishmj deploy swim --link loopback` is included: radio, firmware, servo counts, supervisor, limits, log. No
frame is drawn: the fixes have the measured errors of the tag on clean frames (`loopback.lockstep.PoseTracker`).
"""

from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.control.learned import LearnedController
from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.link.links import Fishmj1Link
from fishmj.deploy.loop import arming
from fishmj.deploy.loop.pilot import PolicyPilot
from fishmj.deploy.loop.supervisor import SwimState
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.loopback.lockstep import LockstepCamera, LockstepClock, LockstepTransport, PoseTracker
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, make_robot
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.loopback.virtual_body import VirtualBody
from fishmj.deploy.monitor.tick_interpolation import as_heard
from fishmj.gap.laboratory.virtual_robot.trials import plant
from fishmj.log import read_trial
from fishmj.mjcf.reading import load_robot
from fishmj.water.flow import Flow
from studies.monitor.swims import ARENA, HEALTHY, HOLD, Effects, Tables

NUISANCE = 0.1  # relative half width of the draw of unmeasured constants, the loopback's own


class ChangingClock(LockstepClock):
    """Lockstep clock whose robot has other effects from `at` s of its swim on."""

    def __init__(self, robot: LoopbackRobot, robot_seed: int, flow: tuple[float, float]):
        super().__init__(robot)
        self.robot_seed, self.stream = robot_seed, flow
        self.change(HEALTHY)

    def change(self, effects: Effects) -> None:
        """Gives the robot these effects from now on."""
        body = self.robot.body
        if not isinstance(body, VirtualBody):
            raise ConfigError(f"monitor study: body {type(body).__name__}; expected the second robot's")
        body.change(plant(effects, self.robot_seed, nuisance=NUISANCE, robot=body.robot, flow=self.stream))


class Circuit(SwimLoop):
    """Swim from target to target, each held for a minute; effects set in at `at` s."""

    targets: np.ndarray  # (K, 2) m
    effects: Effects = HEALTHY
    at = 0.0

    def listen(self, now: float) -> None:
        """Reads the link and the camera, sets the present target, and starts the effects when they are due."""
        super().listen(now)
        if self.began is None:
            return
        self.observer.target = tuple(self.targets[int((now - self.began) / HOLD)])
        if self.effects and now - self.began >= self.at and isinstance(self.rig.clock, ChangingClock):
            self.rig.clock.change(self.effects)
            self.effects = HEALTHY


def swim(
    robot_seed: int, seed: int, seconds: float, effects: Effects = HEALTHY, at: float = 0.0, speed: float = 0.2,
    direction: float = pi, policy: str = "station",
) -> Tables:  # fmt: skip
    """Tables cmd, joint, pose and power of one swim, t in s since the policy took over; arguments as `swims.swim`.

    The stamp of a pose is later than its picture by the description's latency.

    Raises:
        ConfigError: the supervisor ended the swim.
    """
    described = load_robot("fish")
    draw = np.random.default_rng([seed, 23])
    x, y = draw.uniform(-ARENA, ARENA, 2).tolist()
    start = (x, y, float(draw.uniform(-pi, pi)))
    fish = make_robot(LoopbackSettings(seed=seed, flow=Flow(speed=speed, direction=direction), start=start, nuisance=NUISANCE))
    clock = ChangingClock(fish, robot_seed, (speed, direction))
    link, controller = Fishmj1Link(LockstepTransport(clock)), LearnedController(described, policy)
    localiser = InStep(LockstepCamera(clock), PoseTracker(seed=seed))
    localiser.open()
    rig = Rig(
        robot=described, link=link, localiser=localiser, clock=clock,
        examine=lambda info: arming.examine(link, info, described, controller, True),
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        trial = Path(folder) / "swim"
        with TrialLog(trial, {"origin": "synthetic", "robot": described.name}, described.n_joints, every=1e6) as log:
            tour = Circuit(rig, PolicyPilot(controller), SwimPlan(seconds=seconds), log)
            tour.targets = draw.uniform(-ARENA, ARENA, (int(seconds / HOLD) + 2, 2))
            tour.effects, tour.at = effects, at
            outcome = tour.run()
        if not outcome.complete:
            raise ConfigError(f"monitor study: robot {robot_seed}, swim {seed}: {outcome.words}")
        tables = as_heard(read_trial(trial).tables)
    swum = tables["cmd"]["t"][tables["cmd"]["state"] == int(SwimState.SWIMMING)]
    tables["pose"] = {**tables["pose"], "t": tables["pose"]["t_taken"] + described.timing.camera_latency}
    wanted = {"cmd": ("c1", "c2", "c3"), "joint": ("j1", "j2", "j3"), "pose": ("x", "y", "yaw"), "power": ("V", "I")}
    made: Tables = {}
    for name, columns in wanted.items():
        table = tables[name]
        inside = (table["t"] >= swum[0]) & (table["t"] <= swum[-1])
        made[name] = {column: np.asarray(table[column], float)[inside] for column in ("t", *columns)}
        made[name]["t"] = made[name]["t"] - swum[0]
    return made
