"""Swims to targets in all directions in a stream, by `deploy swim`, and the figure of each.

    healthy      the policy before the fault, the robot as it was           before       the same, with the fault
    unpatched    a policy of the model before any patch, with the fault     after        one of the patched model, with the fault

The swims of a seed are the same in all arms: stream, gusts, start, target, noise, and the robot's unmeasured constants.
"""

from pathlib import Path

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.options import angle_text
from fishmj.base.store import read_json, write_json
from fishmj.deploy.commands import swim_command
from fishmj.deploy.loop.supervisor import SwimState
from fishmj.evaluate import protocol
from fishmj.log import read_trial
from studies.whole_loop.steps import AFTER, HEALTHY, UNPATCHED, Fault, Loop, model_of, patched, record_output
from studies.whole_loop.tank import Tank

SPEED = 0.2  # of the stream, m/s, with gusts of 5 %
TICK = 0.02  # s, of the path that a figure is taken from


def swim(loop: Loop, seed: int, arm: str) -> None:
    """Swims to targets in all directions in a stream, the same for every arm of a seed. `swims/ARM.json` has a row for each."""
    folder = loop.folder(seed) / "swims"
    if (folder / f"{arm}.json").is_file() or arm == AFTER and not patched(loop, seed):
        return
    rows = [one_swim(loop, seed, arm, item) for item in range(loop.swims)]
    write_json(folder / f"{arm}.json", rows)


def one_swim(loop: Loop, seed: int, arm: str, item: int) -> dict:
    """Result of one swim: {"rmse" m, "arrival" s or None, "complete", "ended"}."""
    trials = protocol.trials(speeds=(SPEED,), repeats=-(-loop.swims // 8), seed=seed, turbulence="gust")
    starts, targets = trials.ends()
    kept, out = loop.folder(seed) / "swims" / f"{arm}_{item}.json", loop.folder(seed) / "swims" / f"{arm}_{item}"
    if kept.is_file():
        return read_json(kept)
    trained = arm in (UNPATCHED, AFTER)
    policy = str(loop.folder(seed) / f"trained_{arm}") if trained else loop.policy
    flow, (x, y, yaw) = f"{SPEED:g},{angle_text(trials.direction)}", starts[item]
    start, target = f"{x:.6f},{y:.6f},{angle_text(yaw)}", ",".join(f"{value:.6f}" for value in targets[item])
    hidden = "" if arm == HEALTHY else Fault.of(seed).options()
    words = ["--policy", policy, "--robot", model_of(loop, seed, arm), "--link", "loopback", f"--target={target}"]
    words += ["--flow", flow, "--seconds", f"{loop.seconds:g}", "--out", str(free(out))]
    robot = f"--seed {seed} --flow {flow} --turbulence gust --start={start} {hidden}"
    tank = Tank()
    with record_output(loop, seed, ["deploy", "swim", *words, "--loopback", robot]) as argv:
        swim_command.main(argv[2:], wire=tank.wire)
    log = read_trial(Path(argv[argv.index("--out") + 1]))
    cmd, event = log.tables["cmd"], [line for line in log.meta["host"]["events"] if "-> NEUTRAL" in line]
    steered = cmd["t"][cmd["state"] == int(SwimState.SWIMMING)] - cmd["t"][0] + tank.begun
    row = figures(tank.path, steered[0], steered[-1], targets[item], loop.seconds)
    row |= {"ended": event[0].split(": ", 1)[1] if event else ""}
    write_json(kept, row)
    return row


def figures(path: np.ndarray, began: float, ended: float, target: np.ndarray, seconds: float) -> dict:
    """RMSE, arrival, and True if a swim was complete.

    Args:
        path: (T, 4) [s, m, m, rad]. began, ended: s, first and last command of the policy; later rows do not count, and the
            distance of a swim that ended early stays at its last value. target: (2,) m. seconds: its planned duration.
    """
    t = np.arange(0.0, seconds + 1e-9, TICK)
    when = np.minimum(began + t, ended)
    distance = np.hypot(*(np.interp(when, path[:, 0], path[:, 1 + k]) - target[k] for k in range(2)))
    entered = np.flatnonzero((distance <= constant("protocol", "arrival_radius")) & (began + t <= ended))
    arrival = float(t[entered[0]]) if len(entered) else None
    counted = t >= (min(constant("protocol", "missed_window")[0], seconds / 3) if arrival is None else arrival)
    rmse = float(np.sqrt(np.mean(distance[counted] ** 2)))
    return {"rmse": rmse, "arrival": arrival, "complete": bool(ended - began > seconds - 2 * TICK)}


def free(folder: Path) -> Path:
    """Folder name that does not exist yet: an interrupted swim keeps its log."""
    return next(path for path in (folder, *(folder.with_name(f"{folder.name}.{k}") for k in range(2, 1000))) if not path.exists())
