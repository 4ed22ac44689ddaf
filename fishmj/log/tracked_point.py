"""The point of the body that a camera tracks, and what an import assumes of a camera that is not described.

A marker at (ahead, left) of the reference point, in the frame of the body, is seen at p + R(yaw) (ahead, left). So the reference
point p, which the schema asks for, is known exactly from the marker and the heading of the same row.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.trial import Trial

KEY = "marker"  # of the meta data: (ahead, left) [m] of the tracked point, which `pose` is already rid of
FORM = "two numbers AHEAD,LEFT in m, such as 0.05,0"
FARTHEST = 3.0  # m between a marker and the reference point; more is in cm or mm
_ASSUMED = {
    KEY: "the camera tracks the robot's reference point, the centre of mass of the straight robot (else --marker AHEAD,LEFT)",
    "latency.pose": "a pose is camera_latency of the robot's description old at its stamp, a command acts command_latency later "
    "(else --camera-latency S; fishmj calibrate latency measures both)",
}


def stated(meta: Mapping) -> tuple[float, float] | None:
    """The marker that a map's `[meta]` states, if any. Raises LogError: it is not two numbers."""
    if (said := meta.get(KEY)) is None:
        return None
    number = lambda v: isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= FARTHEST
    if not isinstance(said, list) or len(said) != 2 or not all(map(number, said)):
        raise LogError(f"[meta] {KEY} = {str(said)[:40]}; expected {FORM}, each up to {FARTHEST:g}")
    return float(said[0]), float(said[1])


def referred(trial: Trial, marker: tuple[float, float]) -> Trial:
    """The trial with the pose of its reference point in place of the marker's; one without a pose stays as it is.

    Raises LogError: it is rid of a marker already.
    """
    if KEY in trial.meta:
        said = f"its pose is of the reference point already, {KEY} = {trial.meta[KEY]} in its meta data"
        raise LogError(f"{trial.name}: {said}; leave --marker out")
    if "pose" not in trial.tables:
        return trial
    pose, (ahead, left) = trial.tables["pose"], marker
    c, s = np.cos(pose["yaw"]), np.sin(pose["yaw"])
    moved = {"x": pose["x"] - c * ahead + s * left, "y": pose["y"] - s * ahead - c * left}
    note = f"pose: of the reference point; the camera tracked a point {ahead:g} m ahead and {left:g} m to the left of it"
    meta = {**trial.meta, KEY: [ahead, left]}
    return replace(trial, meta=meta, tables={**trial.tables, "pose": {**pose, **moved}}, notes=(*trial.notes, note))


def unsaid(trial: Trial) -> set[str]:
    """Keys of the meta data that would describe the camera of a trial and are not there; none without a pose."""
    return {key for key in _ASSUMED if "pose" in trial.tables and trial.value(key) is None}


def assumed(keys: Collection[str]) -> list[str]:
    """One line on what is assumed where these keys are not stated; none if all are."""
    lines = "; ".join(text for key, text in _ASSUMED.items() if key in keys)
    return [f"assumed, since not stated: {lines}"] if lines else []
