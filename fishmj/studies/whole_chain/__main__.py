"""Holding station through the whole chain of the robot, against the direct simulation: same fish, water, streams, targets.

    python -m fishmj.studies.whole_chain --out runs/whole_chain                     24 trials, drawn frames, 2 % radio loss
    python -m fishmj.studies.whole_chain --trials 2 --marks poses --out runs/look   no frames: poses with the task's noise

Chain: the host of `fishmj deploy` in lockstep with the loopback robot; camera frames that a tracker reads, servo counts, radio
latency and loss, supervisor, limits. Direct: `evaluate`'s own loop. Both swim the nominal fish in the compiled engine.

    distance      between the true reference point and the target
    RMSE          of it from the first entry into 0.1 m until 30 s; of a trial that does not arrive 10 to 30 s
    within        the mean of chain - direct, paired by trial, and its 95 % bootstrap interval

0 s is where the policy takes over. The chain's fish drifts a little before, while robot and host greet.
"""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fishmj import console, cores
from fishmj.calib import constant
from fishmj.controllers.learned import LearnedController
from fishmj.deploy import arming, wiring
from fishmj.deploy.links import Fishmj1Link
from fishmj.deploy.localiser import InStep
from fishmj.deploy.pilot import PolicyPilot
from fishmj.deploy.swim import Plan, Rig, Swim
from fishmj.deploy.trial_log import TrialLog
from fishmj.evaluate import metrics, protocol, run_trials
from fishmj.evaluate.protocol import Trials
from fishmj.loopback import faults
from fishmj.loopback.lockstep import LockstepCamera, LockstepClock, LockstepTransport, PoseTracker
from fishmj.loopback.settings import Settings, artist_of, calibration_of, make_robot
from fishmj.mjcf.description import load_robot
from fishmj.store import read_json, write_json
from fishmj.water.choice import in_water

SECONDS = 30.0
SPEEDS, REPEATS = (0.1, 0.2, 0.3), 1
MARKS = ("tag", "colour", "poses")
LIMIT = 0.02  # m


class Watched(LockstepClock):
    """A lockstep clock that keeps the true path, (s, m, m) a row."""

    def __init__(self, robot):
        super().__init__(robot)
        self.path: list[tuple[float, float, float]] = []

    def sleep_until(self, t: float) -> None:
        super().sleep_until(t)
        pose = self.robot.pose()
        self.path.append((self.now(), float(pose[0]), float(pose[1])))


def swum(item: int, trials: Trials, policy: str, marks: str, loss: float) -> dict:
    """One trial through the chain: its figures, {"rmse" m, "arrival" s or None, "share_of_fixes", "complete", "ended"}."""
    (starts, targets), flow = trials.ends(), trials.flows()[item]
    (x, y, yaw), (there_x, there_y) = starts[item].tolist(), targets[item].tolist()
    settings = Settings(
        body="fitted", engine="compiled", start=(x, y, yaw), flow=flow, seed=item, marks="tag" if marks == "poses" else marks,
        faults=faults.parse([f"loss={loss}"]) if loss else (),
    )  # fmt: skip
    clock, description = Watched(make_robot(settings)), load_robot("fish")
    link, controller = Fishmj1Link(LockstepTransport(clock)), LearnedController(description, policy)
    if marks == "poses":
        localiser = InStep(LockstepCamera(clock), PoseTracker(seed=item))
    else:
        parser = console.parser("studies.whole_chain", "")
        wiring.tracker_options(parser)
        tracker = wiring.make_tracker(parser.parse_args(["--tracker", marks]), calibration_of(settings))
        localiser = InStep(LockstepCamera(clock, artist_of(settings)), tracker)
    rig = Rig(
        robot=description, link=link, localiser=localiser, clock=clock,
        examine=lambda info: arming.examine(link, info, description, controller, False),
    )  # fmt: skip
    localiser.open()
    with (
        TemporaryDirectory() as folder,
        TrialLog(Path(folder) / "swim", {"origin": "synthetic", "robot": "fish"}, 3, every=1e6) as log,
    ):
        swim = Swim(rig, PolicyPilot(controller), Plan(seconds=SECONDS, target=(there_x, there_y)), log)
        outcome = swim.run()
    camera = outcome.figures["camera"]
    told = {"complete": outcome.complete, "ended": outcome.words, "share_of_fixes": camera["fixes"] / max(camera["frames"], 1)}
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


def one(out: Path, trials: Trials, policy: str, marks: str, loss: float, item: int) -> dict:
    """The figures of a trial, kept in `out`."""
    file = out / f"{policy.replace('/', '_')}_{marks}_{loss:g}_{item:02d}.json"
    if not file.is_file():
        write_json(file, swum(item, trials, policy, marks, loss))
    return read_json(file)


def main(argv: list[str]) -> int:
    """Exit code 0: the chain is within 0.02 m of the direct simulation; 1: it is not."""
    parser = console.parser("studies.whole_chain", __doc__ or "")
    parser.add_argument("--policy", type=console.text, default="station", help="shipped name or file")
    parser.add_argument("--trials", type=console.whole(2, 72), default=24, help="of 24 a repeat: 3 speeds, 8 directions")
    parser.add_argument("--marks", choices=MARKS, default="tag", help="what is drawn and tracked; poses: no frames")
    parser.add_argument("--loss", type=console.number(0, 0.5), default=0.02, help="share of datagrams that get lost, each way")
    parser.add_argument("--seed", type=console.whole(0, 2**31), default=40, help="of the trials")
    parser.add_argument("--jobs", type=console.whole(1, 256), default=cores.usable_cores())
    parser.add_argument("--out", type=console.out_folder, required=True)
    args = parser.parse_args(argv)
    repeats = -(-args.trials // 24)
    trials = protocol.trials(speeds=SPEEDS, repeats=repeats, seed=args.seed, randomisation=0.0, duration=SECONDS)
    count = min(args.trials, len(trials))
    args.out.mkdir(parents=True, exist_ok=True)
    done = partial(one, args.out, trials, args.policy, args.marks, args.loss)
    rows: list[dict] = []
    with ProcessPoolExecutor(args.jobs) as pool, console.Progress(count, "trials", "trials") as bar:
        for row in pool.map(done, range(count)):
            rows.append(row)
            bar.update(len(rows))
    robot = in_water(load_robot("fish"), "fitted")
    direct = metrics.figures(run_trials.run(LearnedController(robot, args.policy), robot, trials, engine="compiled"))
    chain = np.array([row["rmse"] for row in rows])
    found = metrics.difference("rmse_after_arrival", direct["rmse_after_arrival"][:count], chain)
    told = {
        "n": count,
        "direct_rmse_m": float(np.mean(direct["rmse_after_arrival"][:count])),
        "chain_rmse_m": float(np.mean(chain)),
        "difference_m": [found.value, found.low, found.high],
        "arrived_direct": int(np.sum(direct["arrival"][:count])),
        "arrived_chain": sum(row["arrival"] is not None for row in rows),
        "complete": sum(row["complete"] for row in rows),
        "share_of_fixes": float(np.mean([row["share_of_fixes"] for row in rows])),
        "ended": sorted({row["ended"] for row in rows if not row["complete"]}),
    }
    write_json(args.out / "whole_chain.json", told)
    console.say(console.table([told | {"difference_m": f"{found.value:+.4f} ({found.low:+.4f} to {found.high:+.4f})"}]))
    if args.json:
        console.emit_json(told)
    return console.OK if abs(found.value) <= LIMIT and told["complete"] == count else console.FAILED_CHECK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
