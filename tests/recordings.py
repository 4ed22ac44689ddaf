"""Small recordings in foreign formats, written for tests. Synthetic: shaped like the real ones, measured by no one."""

import json
import math
from pathlib import Path

import numpy as np

MCAP_MAP = """
[meta]
origin = "measured"
robot = "swift"

[tables.cmd]
topic = "/bus/command"
t = "publish_time"
columns = { c1 = "position.0", c2 = { field = "position.1", unit = "deg" } }

[tables.pose]
topic = "/camera/fish"
t = "header.stamp"
columns.x = { field = "pose.x", unit = "mm" }
columns.y = { field = "pose.y", unit = "mm" }
columns.yaw = { field = "heading", unit = "deg" }
"""


def tail_fish(root: Path, frames=60) -> Path:
    """Two trials of one condition (the second without a control file), with an ASTATES file that nobody should read."""
    folder = root / "Amp15Bias-20"
    folder.mkdir(parents=True)
    t = np.arange(frames) / 30 + 2 / 30
    yaw = 0.3 + 0.1 * np.sin(2 * math.pi * 2.3 * t)
    rows = np.stack([t, 0.05 + 0.01 * np.sin(t), 0.01 * np.cos(t), np.gradient(yaw, t), yaw, 0.7 + 0.05 * t, 0.6 + 0.01 * t], 1)
    text = "".join(" ".join(f"{v:.6f}" for v in row) + " \r\n" for row in rows)
    (folder / "STATES1.txt").write_bytes(text.encode())
    (folder / "STATES2.txt").write_bytes(text.encode())
    (folder / "ASTATES1.txt").write_text("0.7 0.001 0.001 -0.004 -0.18 \n")
    stamps = 0.25 + np.cumsum(0.078 + 0.005 * np.sin(np.arange(frames)))
    (folder / "control15-201.txt").write_text("".join(f"{v:.3f} 15 -20 \n" for v in stamps))
    return root


def servo(root: Path, rows=40) -> Path:
    """A pendulum log with irregular stamps and a load register that wraps."""
    root.mkdir(parents=True, exist_ok=True)
    t = 0.0035 + np.cumsum(0.005 + 0.0004 * np.sin(1.7 * np.arange(rows)))
    entries = [
        {
            "position": 0.4 * math.sin(6 * v),
            "speed": 2.4 * math.cos(6 * v),
            "load": round(-80 * math.cos(6 * v)) % 65536,
            "input_volts": 7.3,
            "temp": 28,
            "timestamp": v,
            "goal_position": 0.5 * math.sin(6 * v),
            "torque_enable": True,
        }
        for v in t.tolist()
    ]
    log = {"mass": 0.49, "length": 0.1, "kp": 200, "vin": 7.4, "motor": "xl330", "trajectory": "sin_sin", "entries": entries}
    (root / "made_up.json").write_text(json.dumps(log))
    return root


def tendon(root: Path, frames=40) -> Path:
    """A body that swims along -x of the picture while its tail beats; pixels, y down, and the head-aligned metres beside them."""
    root.mkdir(parents=True, exist_ok=True)
    t = np.arange(frames) / 60
    along = np.array([0, 132, 320, 350, 380, 410, 440, 470, 540.0])
    side = np.clip(along - 140, 0, None)[None, :] * 0.3 * np.sin(2 * math.pi * t[:, None])
    turn = 0.2
    x = 1800 - 100 * t[:, None] + along * math.cos(turn) - side * math.sin(turn)
    y = 1200 + along * math.sin(turn) + side * math.cos(turn)
    pixels = np.stack([x, y], -1)
    np.savetxt(root / "markers_f1_00.csv", pixels.reshape(frames, -1), delimiter=",")
    metres = pixels * 0.142 / np.hypot(*(pixels[:, 1] - pixels[:, 0]).T).mean()
    shape = metres - metres[:, :1]
    axis = shape[:, 1] / np.hypot(*shape[:, 1].T)[:, None]
    rotated = np.stack(
        [
            shape[..., 0] * axis[:, None, 0] + shape[..., 1] * axis[:, None, 1],
            shape[..., 1] * axis[:, None, 0] - shape[..., 0] * axis[:, None, 1],
        ],
        -1,
    )
    np.savetxt(root / "rotatedMarkers_f1_00.csv", rotated.reshape(-1, 2), delimiter=",")
    return root


def boat(root: Path, rows=60, stray=False) -> Path:
    """Both layouts; with `stray`, one row whose stamp falls behind."""
    root.mkdir(parents=True, exist_ok=True)
    ms = 1544017908486 + np.cumsum(50 + 3 * (np.arange(rows) % 3))
    if stray:
        ms[30] -= 300
    bearing = 2.5 + 0.001 * np.arange(rows)
    saw = 2.0 + 0.4 * (np.arange(rows) % 20)
    six = [
        f"{s:.5f};-0.017;6.36215e+06;{715940 + i // 20};{b:.5f};{v}"
        for i, (s, b, v) in enumerate(zip(saw, bearing, ms, strict=True))
    ]
    (root / "surge_6.csv").write_text("\n".join(six) + "\n")
    twelve = [
        f"{s:.5f};-0.0138;{1.9 + 0.01 * i:.5f};{3.4 - 0.02 * i:.5f};{b:.5f};57.016;9.98519;0.82;0.35;-0.79;35.4;{v}"
        for i, (s, b, v) in enumerate(zip(saw, bearing, ms, strict=True))
    ]
    (root / "surge_12.csv").write_text("\n".join(twelve) + "\n")
    return root


def flat(root: Path, rows=30) -> Path:
    """Our own flat file, with units in its header."""
    root.mkdir(parents=True, exist_ok=True)
    t = 0.02 * np.arange(rows)
    lines = ["t [s],c1 [rad],j1 [rad],x [m],y [m],yaw [rad],V [V],I [A]"]
    lines += [f"{v:.4f},{0.3 * math.sin(6 * v):.6f},{0.3 * math.sin(6 * v - 0.2):.6f},{0.1 * v:.5f},0,0.1,7.4,0.4" for v in t]
    (root / "samples.csv").write_text("\n".join(lines) + "\n")
    return root


def recording(root: Path, messages=20, encoding="json", mapped=True) -> Path:
    """An MCAP file: commands and camera poses on topics of another's naming, and the mapping beside it."""
    from mcap.writer import Writer

    root.mkdir(parents=True, exist_ok=True)
    path = root / "swim.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        names = ("/bus/command", "/camera/fish") if mapped else ("/fish/cmd", "/fish/pose")
        channels = [writer.register_channel(topic=name, message_encoding=encoding, schema_id=0) for name in names]
        for i in range(messages):
            now = 1_700_000_000_000_000_000 + 20_000_000 * i
            angles = [0.01 * i, math.degrees(0.02 * i)]
            place = {"x": 10.0 * i, "y": -5.0 * i}
            stamp = {"sec": (now - 30_000_000) // 10**9, "nanosec": (now - 30_000_000) % 10**9}
            bodies = (
                ({"position": angles}, {"header": {"stamp": stamp}, "pose": place, "heading": 90.0})
                if mapped
                else ({"c1": 0.01 * i, "c2": 0.02 * i}, {"x": 0.01 * i, "y": 0.0, "yaw": 0.1})
            )
            for channel, body in zip(channels, bodies, strict=True):
                writer.add_message(channel, log_time=now + 1_000_000, publish_time=now, data=json.dumps(body).encode())
        writer.finish()
    if mapped:
        (root / "swim.toml").write_text(MCAP_MAP)
    return path


MAKERS = {
    "tail_fish": tail_fish,
    "servo_xl330": servo,
    "tendon_fish_markers": tendon,
    "usv_coastdown": boat,
    "flat_csv": flat,
}
