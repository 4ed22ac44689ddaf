"""Data that a replay shows of a trial: the fish, its target, the flow and the power on one uniform clock.

The pose comes from `truth`, else from `pose`; joints from `truth`, else `joint`, else `cmd`. Everything is resampled to frames of
equal length for drawing only; no log is ever changed.

The water of a flow-solver run is drawn from its vorticity slices: one byte a cell, 128 + 127 omega_z / strong, as grey PNGs. Most
of the water is at rest, so they compress well. The page turns bytes into colours by the table that is made here, the film by the
same one.
"""

import base64
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fishmj.base.calib import robot_called
from fishmj.base.errors import ConfigError, LogError, MissingExtra, StoreError
from fishmj.lbm_oracle.output.slices import Slice, read_slice, slices_in
from fishmj.log import Trial, stacked
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import another_body, body_sha256, robot_sha256, structure_of
from fishmj.mjcf.reading import load_robot

FPS = 50.0
LONGEST = 3600.0  # s of one log; a page holds 50 frames of each of them
ARRIVAL = 0.1  # m, the ring around the target
TRACKS = ("#ff5a4d", "#b57bff", "#ffd24a", "#7be08a", "#c792ff")  # one colour a log, as CSS
BUDGET = 5_000_000  # bytes of all pictures; a third more as text in the page
APART = 0.3  # m: farther from the logged pose, the outline in a slice is another fish's
TONES = (  # value, red, green, blue, opacity: dark water at rest, so that eddies of either sense glow
    (-1.0, 0.80, 1.00, 1.00, 0.98),
    (-0.6, 0.25, 0.82, 1.00, 0.95),
    (-0.25, 0.07, 0.42, 0.95, 0.88),
    (-0.08, 0.03, 0.16, 0.42, 0.70),
    (0.0, 0.01, 0.07, 0.13, 0.62),
    (0.08, 0.36, 0.10, 0.16, 0.70),
    (0.25, 0.86, 0.22, 0.14, 0.88),
    (0.6, 1.00, 0.58, 0.14, 0.95),
    (1.0, 1.00, 0.97, 0.72, 0.98),
)


@dataclass(frozen=True)
class Track:
    """One trial on a uniform clock: F frames, N links. NaN where the log has no value."""

    label: str
    origin: str  # measured, synthetic or unknown
    t: np.ndarray  # (F,) s, from the trial's own start
    q: np.ndarray  # (F, 2 + N) m, rad; yaw unwrapped
    target: np.ndarray  # (F, 2) m
    flow: np.ndarray  # (F, 2) m/s, at the fish, mean over its links
    mean_flow: np.ndarray  # (2,) m/s, of the tank
    power: np.ndarray  # (F,) W
    speed: np.ndarray  # (F,) m/s over ground, over one beat
    pose_from: str
    joints_from: str

    @property
    def distance(self) -> np.ndarray:
        """Distance to the target, (F,) m."""
        return np.hypot(*(self.target - self.q[:, :2]).T)

    def frame(self, time: float) -> int:
        """Number of the frame at `time` s, the first or the last one outside."""
        return int(np.clip(round(time / self.t[-1] * (len(self.t) - 1)), 0, len(self.t) - 1))


def robot_of(trial: Trial, robot: "Robot | str | None" = None) -> Robot:
    """`robot` if given, else the shipped description that the trial's meta names; the default fish if it names none.

    Raises ConfigError: the log is of a robot that does not come with fishmj, and none is given.
    """
    if robot is not None:
        return load_robot(robot)
    if (named := named_robot(trial)) is None and (own := trial.value("robot")):
        told = f"the log is of robot {str(own)[:64]!r}, which does not come with fishmj"
        raise ConfigError(f"{trial.name or 'trial'}: {told}; name its description with --robot FILE.toml")
    return named or load_robot("fish")


def named_robot(trial: Trial) -> Robot | None:
    """The shipped description that the trial's meta names; None if there is none. A log's text is never used as a path.

    Raises ConfigError: the log is of another body of this name.
    """
    name = robot_called(trial.value("robot"))
    robot = load_robot(name) if name else None
    if robot is not None and another_body(trial.meta, robot):
        stated = f"meta.toml: body_sha256: got {str(trial.meta['body_sha256'])[:12]}, expected {body_sha256(robot)[:12]}"
        told = f"the log is of another body than the robot {robot.name!r} that comes with fishmj"
        raise ConfigError(f"{trial.name or 'trial'}: {stated}: {told}; name the description of its own with --robot FILE.toml")
    return robot


def unlike(trial: Trial, robot: Robot) -> str:
    """Remark on drawing a trial as `robot`; "" if the trial is of that robot, or does not name one.

    Raises ConfigError: the trial is of a robot of another structure.
    """
    name, total, joints = (trial.value(key) for key in ("robot", "robot_sha256", "joints"))
    if not name or total in (robot_sha256(robot), robot_sha256(_timed(robot, trial))):
        return ""
    shipped, log = robot_called(name), f"{trial.name or 'trial'}: the log is of robot {str(name)[:64]!r}"
    own = load_robot(shipped) if shipped else None
    same = own is not None and not another_body(trial.meta, own) and (own.name != robot.name or total == robot_sha256(own))
    known = own if same else None
    a, b = ({} if one is None else structure_of(one) for one in (known, robot))
    other = next((f"{key} {a[key]}, expected {b[key]}" for key in ("links", "lengths", "joints") if a and a[key] != b[key]), "")
    if isinstance(joints, int) and joints != robot.n_joints:
        other = f"{joints} joints, expected {robot.n_joints}"
    if other:
        raise ConfigError(f"{log}, not to be drawn as {robot.name!r} of another structure: {other}; name its own with --robot")
    if name == robot.name and total is None:
        return ""
    same = trial.value("body_sha256") == body_sha256(robot)
    apart = "the same body, but other masses, servo, timing or effects" if same else "not the same description"
    return f"{log}{_sum(total)}, drawn as {robot.name!r}{_sum(robot_sha256(robot))}: {apart}"


def _timed(robot: Robot, trial: Trial) -> Robot:
    """The robot with the control step and command path of the trial, which options of a command may have changed."""
    given = {key: value for key in ("control_dt", "command_path") if (value := trial.value(f"timing.{key}")) is not None}
    return replace(robot, timing=replace(robot.timing, **given))


def _sum(total: object) -> str:
    return f" ({total[:12]})" if isinstance(total, str) else ""


def track(trial: Trial, robot: Robot, fps: float = FPS) -> Track:
    """Resamples a trial for drawing.

    Raises LogError: no pose, or one that spans more than an hour; ConfigError: the log has another number of joints than `robot`.
    """
    name = trial.name or "trial"
    pose_from = next((n for n in ("truth", "pose") if n in trial.tables), None)
    if pose_from is None:
        raise LogError(f"{name}: nothing to replay: no table truth or pose; it has {', '.join(trial.tables) or 'none'}")
    pose = trial.tables[pose_from]
    joints_from, joints, stamps = _joints(trial, robot)
    start, end = float(pose["t"][0]), float(pose["t"][-1])
    if end - start > LONGEST:
        raise LogError(_too_long(name, pose_from, np.asarray(pose["t"], float)))
    t = start + np.arange(max(2, int(round((end - start) * fps)) + 1)) / fps
    still = np.zeros((len(t), robot.n_joints))
    bend = np.stack([np.interp(t, stamps, column) for column in joints.T], 1) if joints_from else still
    place = [np.interp(t, pose["t"], pose[c]) for c in ("x", "y")] + [np.interp(t, pose["t"], np.unwrap(pose["yaw"]))]
    q = np.column_stack([*place, bend])
    return Track(
        label=str(trial.value("controller") or name),
        origin=str(trial.value("origin") or "unknown"),
        t=t - start,
        q=q,
        target=_target(trial, t),
        flow=_flow(trial, t),
        mean_flow=_mean_flow(trial),
        power=_power(trial, t),
        speed=_speed(t, q, fps),
        pose_from=pose_from,
        joints_from=joints_from or "none",
    )


def _too_long(name: str, table: str, t: np.ndarray) -> str:
    """Error message for a log of more than an hour, with the place to cut it."""
    row = int(np.argmax(np.diff(t)))
    pause = t[row + 1] - t[row]
    text = f"{name}: table {table!r} spans {t[-1] - t[0]:.6g} s, a replay shows at most {LONGEST:g} s; "
    if pause > 0.5 * (t[-1] - t[0] - LONGEST):
        return text + f"a gap of {pause:.6g} s after t = {t[row]:.6g} s (row {row + 2}): split the trial there"
    return text + f"split the trial, for example at t = {t[0] + LONGEST:.6g} s"


def tracks_of(trials: list[Trial], robots: list[Robot]) -> list[Track]:
    """All trials resampled; equal labels get number and name of the trial behind them."""
    tracks = [track(trial, robot) for trial, robot in zip(trials, robots, strict=True)]
    often = Counter(t.label for t in tracks)
    named = zip(tracks, trials, range(1, len(trials) + 1), strict=True)
    return [
        replace(t, label=f"{t.label} ({i}{': ' + trial.name if trial.name else ''})") if often[t.label] > 1 else t
        for t, trial, i in named
    ]


def _joints(trial: Trial, robot: Robot):
    for name, template in (("truth", "j#"), ("joint", "j#"), ("cmd", "c#")):
        if name not in trial.tables:
            continue
        values = stacked(trial.tables[name], template)
        if values.shape[1] != robot.n_joints:
            raise ConfigError(
                f"{trial.name or 'trial'}: table {name!r} has {values.shape[1]} joints, robot {robot.name!r} has "
                f"{robot.n_joints}; name the right description with --robot"
            )
        return name, values, trial.tables[name]["t"]
    return "", np.zeros((1, robot.n_joints)), np.zeros(1)


def _target(trial: Trial, t: np.ndarray) -> np.ndarray:
    """The last target set at or before each frame; before the first row, the first."""
    if "target" in trial.tables:
        table = trial.tables["target"]
        row = np.clip(np.searchsorted(table["t"], t, side="right") - 1, 0, None)
        return np.column_stack([table["x"][row], table["y"][row]])
    fixed = np.asarray(trial.value("target", ()), dtype=object).ravel()
    if len(fixed) >= 2 and all(isinstance(v, (int, float)) for v in fixed[:2]):
        return np.tile(np.array(fixed[:2], float), (len(t), 1))
    return np.full((len(t), 2), np.nan)


def _flow(trial: Trial, t: np.ndarray) -> np.ndarray:
    if "flow" in trial.tables:
        table = trial.tables["flow"]
        return np.column_stack([np.interp(t, table["t"], stacked(table, f"u#{c}").mean(1)) for c in "xy"])
    return np.tile(_mean_flow(trial), (len(t), 1))


def _mean_flow(trial: Trial) -> np.ndarray:
    """From the meta data, else the mean of the flow table, else NaN."""
    speed, direction = trial.value("flow.speed"), trial.value("flow.direction")
    if speed is not None and (direction is not None or not speed):
        return float(speed) * np.array([np.cos(direction or 0.0), np.sin(direction or 0.0)])
    if "flow" in trial.tables:
        return np.array([stacked(trial.tables["flow"], f"u#{c}").mean() for c in "xy"])
    return np.full(2, np.nan)


def _power(trial: Trial, t: np.ndarray) -> np.ndarray:
    if "I" not in trial.tables.get("power", {}):
        return np.full(len(t), np.nan)
    table = trial.tables["power"]
    return np.interp(t, table["t"], table["V"] * table["I"])


def _speed(t: np.ndarray, q: np.ndarray, fps: float) -> np.ndarray:
    """Displacement over a centred second (one beat) divided by its length, so that the beat itself does not show."""
    reach = max(1, min(int(fps / 2), (len(t) - 1) // 2))
    back, ahead = np.clip(np.arange(len(t)) - reach, 0, None), np.clip(np.arange(len(t)) + reach, None, len(t) - 1)
    return np.hypot(*(q[ahead, :2] - q[back, :2]).T) / (t[ahead] - t[back])


@dataclass(frozen=True)
class Wake:
    """K slices at height z; `values` (ny, nx) uint8, north up, 128 = no vorticity, 1 and 255 = `strong` 1/s or more."""

    t: np.ndarray  # (K,) s, from the trial's own start
    z: float  # m
    strong: float  # 1/s
    rect: np.ndarray  # (K, 4) west, east, south, north edge, m
    values: tuple[np.ndarray, ...]

    def between(self, time: float) -> tuple[int, float]:
        """Number of the slice before `time` s, and the weight of the one after it."""
        i = int(np.clip(np.searchsorted(self.t, time, side="right") - 1, 0, max(len(self.t) - 2, 0)))
        if len(self.t) == 1:
            return 0, 0.0
        return i, float(np.clip((time - self.t[i]) / (self.t[i + 1] - self.t[i]), 0, 1))


def read_wake(folder: str | Path, trial: Trial, track: Track) -> Wake:
    """The slices of a run that fall into its trial.

    Raises ConfigError: no slices, or those of another run; StoreError: a damaged one.
    """
    start = float(trial.tables[track.pose_from]["t"][0])
    slices = [read_slice(path) for path in slices_in(folder)]
    slices = [one for one in slices if -0.5 <= one.t - start <= float(track.t[-1]) + 0.5]
    if not slices:
        raise ConfigError(f"{folder}: no slice in the {track.t[-1]:.2f} s of {track.label!r}; are these the fields of this run?")
    for one in slices:
        _same_fish(folder, one, track, start)
    strong = strongest(np.concatenate([one.omega_z.ravel() for one in slices]))
    images = [_bytes(one.omega_z, strong) for one in slices]
    rect = np.array([one.extent for one in slices])
    return Wake(np.array([one.t - start for one in slices]), slices[0].z, strong, rect, tuple(images))


def strongest(omega: np.ndarray) -> float:
    """Round colour scale for vorticity [1/s]: 1, 2 or 5 times a power of ten, above nine tenths of the values."""
    size = np.abs(omega[np.isfinite(omega)])
    moving = size[size > 0.02 * size.max(initial=0.0)]
    high = max(float(np.percentile(moving, 90)) if len(moving) else 0.0, 1e-3)
    power = 10.0 ** np.floor(np.log10(high))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * high))


def page_data(wake: Wake) -> dict:
    """Data of the page; if the pictures would be too large, cells are averaged two by two."""
    images = list(wake.values)
    while sum(map(len, packed := [_png(image) for image in images])) > BUDGET and min(images[0].shape) >= 16:
        images = [_halved(image) for image in images]
    return {
        "t": wake.t,
        "z": wake.z,
        "strong": wake.strong,
        "rect": wake.rect,
        "colours": base64.b64encode(colours().tobytes()).decode("ascii"),
        "images": [base64.b64encode(data).decode("ascii") for data in packed],
    }


def colours() -> np.ndarray:
    """(256, 4) uint8 RGBA for the bytes of a slice."""
    at, *channels = np.array(TONES).T
    value = (np.arange(256) - 128) / 127
    return (255 * np.stack([np.interp(value, at, channel) for channel in channels], -1) + 0.5).astype(np.uint8)


def _same_fish(folder, one: Slice, track: Track, start: float) -> None:
    if not one.outline:
        return
    rim = np.concatenate(one.outline)
    off = float(np.hypot(*(0.5 * (rim.min(0) + rim.max(0)) - track.q[track.frame(one.t - start), :2])))
    if off > APART:
        raise ConfigError(
            f"{folder}: at {one.t:.2f} s its fish is {off:.2f} m from where {track.label!r} has it; give the fields of this run"
        )


def _bytes(omega: np.ndarray, strong: float) -> np.ndarray:
    """(nx, ny) 1/s -> (ny, nx) uint8, north up."""
    value = np.clip(np.nan_to_num(omega / strong), -1, 1)
    return (128.5 + 127 * value).astype(np.uint8).T[::-1].copy()


def _halved(image: np.ndarray) -> np.ndarray:
    """Means of two by two cells; an odd last row or column counts double."""
    whole = np.pad(image, [(0, n % 2) for n in image.shape], mode="edge").astype(float)
    return (0.25 * (whole[::2, ::2] + whole[1::2, ::2] + whole[::2, 1::2] + whole[1::2, 1::2]) + 0.5).astype(np.uint8)


def _png(image: np.ndarray) -> bytes:
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise MissingExtra("opencv-python-headless", "view", "replays with the water") from error
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise StoreError("replay: OpenCV could not encode a slice as PNG")
    return data.tobytes()
