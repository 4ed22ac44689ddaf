"""Labels the state of a robot in every half second, from the tables alone, without a model.

The labels serve the localisation of a gap. A window carries every label that fits. A missing table removes its labels
(`Regimes.known` lists the available ones).

    rest            joints, command and body stand still
    joint_step      the command jumps within the window
    steady_swim     a beat goes on, its amplitude and the mean speed as in the window before
    ramp            the amplitude of the beat grows or falls
    coast           the body moves, the joints do not
    turn            the heading turns, averaged over a beat
    torque_limited  far from the command, yet not moving towards it fast
    creep           a joint moves, slower than 5 deg/s
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.trial import Trial, stacked

LENGTH = 0.5  # s, one window
LABELS = ("rest", "joint_step", "steady_swim", "ramp", "coast", "turn", "torque_limited", "creep")
# Thresholds, chosen for a fish of half a metre with hobby servos.
STILL_JOINT = math.radians(1.0)  # rad, peak to peak within a window: a servo's dead band and one count of its encoder
STILL_BODY = 0.01  # m/s
STEP = math.radians(8.0)  # rad between two commands that follow each other
CREEP = math.radians(5.0)  # rad/s
BEATING = math.radians(3.0)  # rad, amplitude
CHANGE = 0.25  # of the amplitude, from one beat to the next
TURNING = 0.2  # rad/s, averaged over a beat
BEHIND = math.radians(6.0)  # rad between command and joint
SLUGGISH = 0.5  # rad/s, below this a servo that is far behind is held back
MEASURED = ("joint", "pose", "velocity", "truth")


@dataclass(frozen=True)
class Regimes:
    """Labels of W windows. start: (W,) s; `is_[label]`: (W,) bool; known: the labels that the tables allow."""

    start: np.ndarray
    is_: dict[str, np.ndarray]
    known: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.start)

    def names(self, i: int) -> tuple[str, ...]:
        """The labels of one window."""
        return tuple(label for label in LABELS if self.is_[label][i])


def label(trial: Trial, *, beat: float | None = None) -> Regimes:
    """Labels the windows of one trial.

    Args:
        beat: period of the tail beat, s; None: from the gait table, else 1 s.

    Raises LogError: the trial is shorter than one window.
    """
    first, last = _span(trial)
    if beat is None:
        frequency = float(np.median(trial.tables.get("gait", {}).get("frequency", np.ones(1))))
        beat = 1.0 / frequency if frequency > 0 else 1.0
    count = int((last - first) / LENGTH + 1e-9)
    if count < 1:
        raise LogError(f"trial {trial.name or '(in memory)'}: {last - first:.3f} s long; one window takes {LENGTH:g} s")
    start = first + LENGTH * np.arange(count)
    windows = _Windows(trial, start, beat)
    labels = {**windows.of_command(), **windows.of_joints(), **windows.of_body()}
    known = tuple(name for name in LABELS if labels.get(name) is not None)
    is_ = {name: np.zeros(count, bool) if (found := labels.get(name)) is None else found for name in LABELS}
    return Regimes(start, is_, known)


def _span(trial: Trial) -> tuple[float, float]:
    """Time range of the measured tables; a command may run on after the camera stopped."""
    seen = {name: table for name, table in trial.tables.items() if name in MEASURED}
    return replace(trial, tables=seen).span if seen else trial.span


class _Windows:
    """Signals of one trial, reduced to one figure a window; None for a missing table."""

    def __init__(self, trial: Trial, start: np.ndarray, beat: float):
        self.trial, self.start, self.beat = trial, start, beat
        self.command = self._angles("cmd", "c#")
        self.joint = self._angles("joint", "j#") or self._angles("truth", "j#")
        pose = trial.tables.get("pose") or trial.tables.get("truth")
        self.pose = None if pose is None else (pose["t"], pose["x"], pose["y"], np.unwrap(pose["yaw"]))
        self.speed, self.spin = self._motion()
        moving = self.joint or self.command
        self.amplitude = self.stroke = None  # half the angle's range over a beat and over the window itself
        if moving is not None:
            self.amplitude, self.stroke = (self._over(*moving, _half_range, reach=reach) for reach in (self.beat, 0.0))
        elif "gait" in trial.tables:
            gait = trial.tables["gait"]
            self.amplitude = self.stroke = self._over(gait["t"], gait["amplitude"], np.mean)

    def _angles(self, table: str, template: str) -> tuple[np.ndarray, np.ndarray] | None:
        if table not in self.trial.tables:
            return None
        values = stacked(self.trial.tables[table], template)
        return (self.trial.tables[table]["t"], values) if values.shape[1] else None

    def _over(self, t: np.ndarray, values: np.ndarray, reduce, reach: float = 0.0) -> np.ndarray:
        """(W,) `reduce` of the rows of each window, widened to `reach` s around its middle; NaN without rows."""
        half = 0.5 * max(LENGTH, reach)
        middle = self.start + 0.5 * LENGTH
        low, high = np.searchsorted(t, middle - half), np.searchsorted(t, middle + half)
        return np.array([reduce(values[a:b]) if b > a else np.nan for a, b in zip(low, high, strict=True)])

    def _motion(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Speed over ground [m/s] and turning rate [rad/s] of each window, averaged over a beat."""
        if self.pose is None:
            table = self.trial.tables.get("velocity")
            if table is None:
                return None, None
            speed = np.abs(self._over(table["t"], table["surge"], np.mean, self.beat))
            return speed, self._over(table["t"], table["yaw_rate"], np.mean, self.beat) if "yaw_rate" in table else None
        t, x, y, yaw = self.pose
        reach = max(self.beat, LENGTH)
        middle = self.start + 0.5 * LENGTH
        before, after = np.clip(middle - reach / 2, t[0], t[-1]), np.clip(middle + reach / 2, t[0], t[-1])
        apart = np.maximum(after - before, 1e-9)
        moved = [np.interp(after, t, v) - np.interp(before, t, v) for v in (x, y, yaw)]
        return np.hypot(moved[0], moved[1]) / apart, moved[2] / apart

    def of_command(self) -> dict[str, np.ndarray | None]:
        """Label joint_step: neighbouring commands that differ by more than `STEP`, faster than in a beat."""
        if self.command is None:
            return {"joint_step": None}
        t, c = self.command
        jump = np.max(np.abs(np.diff(c, axis=0)), axis=1, initial=0.0)
        usual = np.median(jump) if len(jump) else 0.0  # a beat moves a little in every row, a step in one
        high = self._over(t[1:], jump, np.max)
        return {"joint_step": np.nan_to_num(high) > max(STEP, 4 * usual)}

    def of_joints(self) -> dict[str, np.ndarray | None]:
        out: dict[str, np.ndarray | None] = {"creep": None, "torque_limited": None}
        if self.joint is None:
            return out
        t, q = self.joint
        table = self.trial.tables.get("joint", {})
        rate = stacked(table, "w#") if "w1" in table else np.gradient(q, t, axis=0) if len(t) > 1 else np.zeros_like(q)
        fastest = self._over(t, np.max(np.abs(rate), axis=1), lambda some: float(np.quantile(some, 0.9)))
        moved = self._over(t, q, _half_range)
        out["creep"] = (2 * moved > STILL_JOINT) & (fastest < CREEP)
        if self.command is not None and self.command[1].shape[1] == q.shape[1]:
            wanted = _held(self.command, t)
            error = np.abs(wanted - q)
            sent = self.trial.tables["cmd"]
            on = _held((self.command[0], stacked(sent, "on#")), t) if "on1" in sent else 1.0
            stuck = np.any((error > BEHIND) & (np.abs(rate) < SLUGGISH) & (np.asarray(on) > 0.5), axis=1)
            out["torque_limited"] = np.nan_to_num(self._over(t, stuck.astype(float), np.mean)) > 0.5
        return out

    def of_body(self) -> dict[str, np.ndarray | None]:
        out: dict[str, np.ndarray | None] = dict.fromkeys(("rest", "coast", "steady_swim", "ramp"))
        out["turn"] = None if self.spin is None else np.abs(np.nan_to_num(self.spin)) > TURNING
        if self.amplitude is None or self.stroke is None:
            return out
        still = self.stroke < 0.5 * STILL_JOINT
        size = np.nan_to_num(self.amplitude)
        beats = size > BEATING
        lag = max(round(self.beat / LENGTH), 1)  # windows in a beat
        earlier = np.concatenate([np.full(min(lag, len(size)), np.nan), size[:-lag]])[: len(size)]
        change = np.abs(size - earlier) / np.maximum(np.maximum(size, earlier), 1e-9)
        out["ramp"] = (beats | (np.nan_to_num(earlier) > BEATING)) & (np.nan_to_num(change) > CHANGE)
        out["steady_swim"] = beats & (change <= CHANGE)
        if self.speed is None:
            out["rest"] = still
        else:
            fast = np.nan_to_num(self.speed) > STILL_BODY
            out["rest"], out["coast"] = still & ~fast, still & fast
            out["steady_swim"] &= fast
        return out


def _held(table: tuple[np.ndarray, np.ndarray], t: np.ndarray) -> np.ndarray:
    """Values (T, N) in force at `t`: a command holds until the next one."""
    return table[1][np.clip(np.searchsorted(table[0], t, side="right") - 1, 0, None)]


def _half_range(values: np.ndarray) -> float:
    return float(0.5 * np.max(np.ptp(values, axis=0)))
