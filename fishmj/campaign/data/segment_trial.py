"""A record as a trial in the log's own schema, for replay and whatever else reads trial folders."""

import numpy as np

from fishmj.hydro_fit.record import SegmentRecord
from fishmj.log import SCHEMA, Trial, numbered
from fishmj.mjcf.description import Robot


def trial_of(record: SegmentRecord, robot: Robot) -> Trial:
    """Tables cmd, joint, pose, truth, flow, wrench and, where servos drove the joints, power; times from the record's start."""
    t, began = record.t, record.t - record.tick
    pose, joint, speed, rate = record.q[:, :3], record.q[:, 3:], record.v[:, :3], record.v[:, 3:]
    place = dict(zip(("x", "y", "yaw"), pose.T, strict=True))
    wrench: dict[str, np.ndarray] = {}
    for names, values in ((("f#x", "f#y", "m#"), record.wrench), (("r#x", "r#y", "n#"), record.raw)):
        for name, column in zip(names, np.moveaxis(values, -1, 0), strict=True):
            wrench |= numbered(name, column)
    tables = {
        "cmd": {"t": began, **numbered("c#", record.command)},
        "joint": {"t": t, **numbered("j#", joint), **numbered("w#", rate)},
        "pose": {"t": t, **place},
        "truth": {"t": t, **place, **dict(zip(("vx", "vy", "wz"), speed.T, strict=True))}
        | {**numbered("j#", joint), **numbered("k#", rate)},
        "flow": {"t": began, **numbered("u#x", record.flow[..., 0]), **numbered("u#y", record.flow[..., 1])},
        "wrench": {"t": t, **wrench},
    }
    if np.isfinite(record.power).all():
        volts = robot.servo.voltage
        tables["power"] = {"t": t, "V": np.full(len(t), volts), "I": record.power / volts}
    return Trial(_meta(record, tables), tables, name=record.id)


def _meta(record: SegmentRecord, tables: dict) -> dict:
    meta = record.meta
    segment = meta["segment"]
    return {
        "schema": SCHEMA,
        "origin": meta["origin"],
        "robot": meta["robot"]["name"],
        "medium": "water",
        "flow": {**segment["flow"], "known": True},
        "excitation": segment["drive"]["kind"],
        "replicate_of": meta["replicate_of"],
        "controller": segment["drive"].get("controller", ""),
        "water": "lbm",
        "oracle": {**meta["grid"], "stopped": meta["stopped"]},
        "seed": segment["flow"]["seed"],
        "clock": {name: "simulation" for name in tables},
        "versions": meta["versions"],
        "source": "fishmj.campaign",
        "licence": "Apache-2.0",
        "notes": f"synthetic: {meta['block']}, split {meta['split']}",
    }
