"""Correlates the residual with every input. The residual test of classical identification (Ljung 1999, ch. 16), inputs named.

    rho(channel, input) = corr(residual, input), each record and column taken at the averages of gap/records/records.py
    bound               2.58 / sqrt(sum n / tau)         99 %, autocorrelation corrected

The largest rho / bound above LOUD is named by the effect for which such a correlation is the text-book sign.
"""

import numpy as np

from fishmj.gap.bench.baselines.baseline_answer import NOTHING, BaselineAnswer, correlation_time, unsized
from fishmj.gap.records.records import ChannelBlock, Record, ResidualLayout

LEVEL = 2.58
LOUD = 1.5  # times the bound: many pairs are looked at
STAIRS = 0.06  # s over which commands, which are stairs, are averaged
SIGN = {  # (channel, input) -> effect
    ("joint", "rate of the command"): "command_latency",
    ("joint", "command"): "command_gain_error",
    ("joint", "acceleration of the command"): "servo_gain",
    ("joint", "direction of the command"): "coulomb_friction",
    ("joint", "one"): "joint_zero_offset",
    ("position", "time"): "steady_current",
    ("position", "place"): "camera_scale",
    ("position", "direction of the heading"): "marker_offset",
    ("position", "speed"): "camera_latency",
    ("heading", "one"): "heading_marker_offset",
    ("heading", "time"): "joint_zero_offset",
    ("heading", "yaw rate"): "camera_latency",
    ("power", "one"): "power_offset",
    ("power", "rate of the command, absolute"): "voltage_sag",
}


def answer(plant, records: list[Record]) -> BaselineAnswer:
    """Answer with the most significant pair of channel and input."""
    layout = ResidualLayout(records)
    predicted = plant.predict(records, plant.null)
    residual = layout.residuals(predicted)[0]
    sums: dict[tuple[str, str], np.ndarray] = {}
    for b in layout.blocks:
        r = residual[b.where]
        for name, x in inputs(records[b.record], b, predicted[b.record]).items():
            scale = np.std(r) if name != "one" else 1.0
            if np.std(x) < 1e-9 and name != "one" or scale < 1e-12:
                continue
            a, c = (r, x) if name == "one" else (r - r.mean(), x - x.mean())
            independent = len(r) / max(correlation_time(r), correlation_time(x) if name != "one" else 1.0)
            part = np.array([independent, independent * float(a @ c) / np.sqrt(float(a @ a) * float(c @ c) + 1e-30)])
            key = (b.channel, name)
            sums[key] = sums.get(key, np.zeros(2)) + part
    loud = {key: abs(total) / n * np.sqrt(n) / LEVEL for key, (n, total) in sums.items() if n > 1}
    if not loud:
        return NOTHING
    key = max(loud, key=lambda k: loud[k])
    if loud[key] < LOUD:
        return NOTHING
    said, name = f"{key[0]} residual goes with {key[1]}, {loud[key]:.1f} times the 99 % bound", SIGN.get(key, "")
    return unsized(plant, name, said)


def inputs(record: Record, b: ChannelBlock, predicted: dict) -> dict[str, np.ndarray]:
    """Inputs for one column of one sensor. Commands enter as the motion of the model's joints, so that they are in phase."""
    at = np.clip((b.t / record.dt).astype(int), 0, len(record.commands) - 1)
    rate = np.gradient(record.commands, record.dt, axis=0)
    out = {"one": np.ones_like(b.t), "time": b.t}
    if b.sensor == "joint" and len(b.t) > 1:
        angle = np.add.reduceat(predicted["joint"][0][:, b.column], b.first) / b.counts
        speed = np.gradient(angle, b.t)
        out |= {"command": angle, "rate of the command": speed, "direction of the command": np.sign(speed)}
        out["acceleration of the command"] = np.gradient(speed, b.t)
    if b.sensor == "pose" and record.pose is not None:
        pose = np.stack([np.interp(b.t, record.pose.t, column) for column in record.pose.values.T])
        speed = np.gradient(pose, b.t, axis=1) if len(b.t) > 1 else np.zeros_like(pose)
        if b.channel == "heading":
            out["yaw rate"] = speed[2]
        else:
            heading = np.cos(pose[2]) if b.column == 0 else np.sin(pose[2])
            out |= {"place": pose[b.column], "speed": speed[b.column], "direction of the heading": heading}
    if b.sensor == "power":
        out["rate of the command, absolute"] = smoothed(np.abs(rate).sum(1), record.dt)[at]
    return out


def smoothed(values: np.ndarray, dt: float) -> np.ndarray:
    """Running mean over `STAIRS` seconds."""
    width = max(1, round(STAIRS / dt))
    return np.convolve(values, np.ones(width) / width, mode="same")
