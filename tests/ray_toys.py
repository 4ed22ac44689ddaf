"""A made-up segment runner for the tests of the Ray pool: no water, arrays of the right shapes, a worker that can be killed."""

import os
import signal
from pathlib import Path

import numpy as np

from fishmj.hydro_fit.campaign.data.run_segments import Finished


def run(waiting, device, go_on, *, setup, tanks=1):
    """Leaves a line in the folder `segment.drive["diary"]` for every segment begun; dies while `dies` lines are not reached."""
    for segment in list(waiting):
        diary = Path(segment.drive["diary"]) / segment.id
        with diary.open("a", encoding="utf-8") as file:
            file.write(f"{os.getpid()}\n")
        if len(diary.read_text(encoding="utf-8").splitlines()) <= segment.drive.get("dies", 0):
            os.kill(os.getpid(), signal.SIGKILL)
        yield toy(segment, setup)


def toy(segment, setup):
    """A record that depends on the segment only."""
    joints, ticks = setup.robot.n_joints, round(segment.seconds / 0.02)
    wave = np.sin(np.arange(ticks) / 7 + len(segment.id))
    wide = lambda *shape: wave.reshape(-1, *[1] * len(shape)) * np.ones(shape)
    arrays = {"q": wide(3 + joints), "v": wide(3 + joints), "command": wide(joints), "power": 2 + wave}
    arrays |= {"wrench": wide(joints + 1, 3), "raw": wide(joints + 1, 3), "flow": np.zeros((ticks, joints + 1, 2))}
    names = ("id", "block", "episode", "split", "replicate_of")
    meta = {name: getattr(segment, name) for name in names} | setup.about | {"segment": segment.table(), "origin": "synthetic"}
    meta["grid"] = meta["grid"] | {"slip": segment.slip}
    still = {"q": [0.0] * (3 + joints), "v": [0.0] * (3 + joints)}
    return Finished(
        segment, meta | {"start": still, "tick": 0.02, "rows": ticks, "seconds": segment.seconds, "stopped": ""}, arrays
    )
