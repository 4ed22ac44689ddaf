"""One trial through the whole chain of the robot, in lockstep: its figures, and the errors of its tracker's fixes.

Chain: drawn camera frames that a tracker reads, servo counts, radio latency and loss, the host with its supervisor and limits.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.control.learned import LearnedController
from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.link.links import Fishmj1Link
from fishmj.deploy.loop import arming, wiring
from fishmj.deploy.loop.pilot import PolicyPilot
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.loopback import bodies, faults
from fishmj.deploy.loopback.lockstep import FixNoise, LockstepCamera, LockstepClock, LockstepTransport, PoseTracker
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, artist_of, calibration_of, make_robot
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.tracker.fix import Fix, Tracker, wrapped
from fishmj.evaluate.protocol import Trials
from fishmj.mjcf.reading import load_robot
from studies.tracker.error_statistics import autocovariance

SECONDS = 30.0
MARKS = ("tag", "colour", "poses")


class Watched(LockstepClock):
    """Lockstep clock that records the true path, one row (s, m, m) each step."""

    def __init__(self, robot: LoopbackRobot):
        super().__init__(robot)
        self.path: list[tuple[float, float, float]] = []

    def sleep_until(self, t: float) -> None:
        """Advances the robot to time t, s, and records its position."""
        super().sleep_until(t)
        pose = self.robot.pose()
        self.path.append((self.now(), float(pose[0]), float(pose[1])))


class Remembering(LockstepCamera):
    """Lockstep camera that records the pose (3,) that each frame shows, by its stamp."""

    def open(self) -> None:
        """Opens the camera with an empty record."""
        super().open()
        self.shown: dict[float, np.ndarray] = {}

    def read(self, now: float) -> list[tuple[float, np.ndarray]]:
        """Frames up to `now`, s, as (time, image); records their poses."""
        self.shown |= {self.clock.origin + frame.t: frame.pose[:3] for frame in self.clock.robot.frames(self._since)}
        return super().read(now)


class Compared:
    """Tracker whose fixes are compared with the shown poses.

    Attributes:
        errors: (3,) m, m, rad of each frame, NaN without a fix.
    """

    def __init__(self, tracker: Tracker, camera: Remembering):
        self.tracker, self.camera = tracker, camera
        self.errors: list[np.ndarray] = []

    def reset(self) -> None:
        """Clears the tracker's memory."""
        self.tracker.reset()

    def locate(self, image: np.ndarray, t: float) -> Fix | None:
        """Fix of the tracker in an image at t, s, or None; records its error."""
        fix, truth = self.tracker.locate(image, t), self.camera.shown[t]
        error = np.full(3, np.nan)
        if fix is not None:
            error = np.array([fix.x - truth[0], fix.y - truth[1], wrapped(fix.yaw - truth[2])])
        self.errors.append(error)
        return fix


def run_trial(item: int, trials: Trials, policy: str, marks: str, loss: float, body: str) -> dict:
    """One trial through the chain.

    Args:
        marks: marks that are drawn and tracked; "poses": nothing is drawn, the errors are the measured ones of a tag on clean
            frames.
        loss: share of datagrams lost each way. body: body of the loopback robot, fitted or virtual.
    Returns:
        {"rmse" m, "arrival" s or None, "share_of_fixes", "complete", "ended", "covariance" (3, LAGS + 1) of x, y [m^2] and
        yaw [rad^2] of the fixes' errors}
    """
    (starts, targets), flow = trials.ends(), trials.flows()[item]
    (x, y, yaw), (there_x, there_y) = starts[item].tolist(), targets[item].tolist()
    settings = LoopbackSettings(
        body=body, engine=bodies.COMPILED, start=(x, y, yaw), flow=flow, seed=item, marks="tag" if marks == "poses" else marks,
        faults=faults.parse([f"loss={loss}"]) if loss else (),
    )  # fmt: skip
    clock, description = Watched(make_robot(settings)), load_robot("fish")
    link, controller = Fishmj1Link(LockstepTransport(clock)), LearnedController(description, policy)
    if marks == "poses":
        camera = Remembering(clock)
        tracker: Tracker = PoseTracker(FixNoise.measured(), seed=item)
    else:
        parser = console.parser("studies.whole_chain", "")
        wiring.tracker_options(parser)
        camera = Remembering(clock, artist_of(settings))
        tracker = wiring.make_tracker(parser.parse_args(["--tracker", marks]), calibration_of(settings))
    compared = Compared(tracker, camera)
    localiser = InStep(camera, compared)
    rig = Rig(
        robot=description, link=link, localiser=localiser, clock=clock,
        examine=lambda info: arming.examine(link, info, description, controller, False),
    )  # fmt: skip
    localiser.open()
    with (
        TemporaryDirectory() as folder,
        TrialLog(Path(folder) / "swim", {"origin": "synthetic", "robot": "fish"}, 3, every=1e6) as log,
    ):
        swim = SwimLoop(rig, PolicyPilot(controller), SwimPlan(seconds=SECONDS, target=(there_x, there_y)), log)
        outcome = swim.run()
    found = outcome.figures["camera"]
    told = {"complete": outcome.complete, "ended": outcome.words, "share_of_fixes": found["fixes"] / max(found["frames"], 1)}
    told["covariance"] = [autocovariance(column).tolist() for column in np.array(compared.errors).T]
    return told | figures(np.array(clock.path), swim.began or 0.0, targets[item])


def figures(path: np.ndarray, began: float, target: np.ndarray) -> dict:
    """RMSE and arrival of a path (T, 3) [s, m, m] that the policy steers from `began` s."""
    t = path[:, 0] - began
    distance = np.hypot(*(path[:, 1:] - target).T)
    inside = (t >= 0.0) & (t <= SECONDS + 1e-9)
    entered = np.flatnonzero(inside & (distance <= constant("protocol", "arrival_radius")))
    arrival = float(t[entered[0]]) if len(entered) else None
    counted = inside & (t >= (constant("protocol", "missed_window")[0] if arrival is None else arrival))
    return {"rmse": float(np.sqrt(np.mean(distance[counted] ** 2))), "arrival": arrival}
