"""Named excitations and a sine gait, open loop on the robot, as trials that `fishmj calibrate` and `fishmj gap find` read.

The host's own swim plays the commands, with its supervisor, limits and log. `kept` then cuts the trial to the played part, from
the first command on, and adds the noise that was measured while the fish rested.
"""

from collections.abc import Callable, Mapping, Sequence
from math import degrees, inf, isfinite, pi, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.source import made_by
from fishmj.deploy.loop.command_limits import RATE
from fishmj.deploy.loop.pilot import PlayedPilot
from fishmj.deploy.loop.supervisor import SwimState
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimOutcome, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.log import Table, Trial, excitation, read_trial
from fishmj.log.excitation import LEAD, Excitation
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import identity

REPEATS = 3
QUIET = 8  # rows at least in which the noise of a channel is taken
SAME = 1e-6  # rad: a command that left as it was wanted
SESSIONS: Mapping[str, tuple[str, ...]] = {
    # without a carriage no run starts at a speed: `burst_and_coast` swims up to it, and coasting then shows the drag
    "session": (
        "gait",
        "chirp",
        "steps",
        "slow_triangle",
        "turn_left",
        "turn_right",
        "gait_fast",
        "burst_and_coast",
        "out_and_back",
    ),
    "calibrate": ("sine", "square", "impulse"),
    "air": excitation.DRY,
}


class ExperimentRun(NamedTuple):
    """One repeat of one experiment. name: of its folder; first: name of the first repeat, "" for the first itself."""

    name: str
    what: Excitation
    first: str


def runs(asked: Sequence[str], repeats: int, joints: int) -> list[ExperimentRun]:
    """Repeats of every experiment in rounds: each experiment once, then all over again.

    So a drift of the rig (battery, water) does not hide in one experiment.

    Raises UnknownName: no such experiment; ConfigError: one that needs a tow carriage.
    """
    names = [name for item in asked for name in SESSIONS.get(item, (item,))]
    found = {name: excitation.get(name, joints) for name in dict.fromkeys(names)}
    towed = [name for name, what in found.items() if any(what.push)]
    if towed:
        raise ConfigError(
            f"experiment {', '.join(towed)}: needs a tow carriage that lets the fish go at a speed; burst_and_coast and "
            "turn_left show the same without one (fishmj deploy experiment session)"
        )
    return [
        ExperimentRun(f"{name}_{k + 1}", what, f"{name}_1" if k else "") for k in range(repeats) for name, what in found.items()
    ]


class SineGait(NamedTuple):
    """A sine gait: joint k beats with A sin(2 pi f t - k lag) + bias.

    frequency: Hz. amplitude_deg, lag_deg, bias_deg: deg; the lag is between neighbours, a negative bias turns to the left.
    """

    frequency: float
    amplitude_deg: float
    lag_deg: float
    bias_deg: float = 0.0

    @property
    def name(self) -> str:
        """Name of the excitation, with its numbers: two gaits are not repeats of each other, nor of the library's `gait`."""
        return "_".join(["sine_gait", *(f"{value:g}" for value in self)])

    def commands(self, robot: Robot, seconds: float) -> np.ndarray:
        """Commands (T, J) rad for `seconds` s, one every bus tick.

        Raises ConfigError: a number that is not finite, angles beyond the servos' range, or a beat that they cannot follow.
        """
        servo, (frequency, amplitude, lag, bias) = robot.servo, (self[0], *np.radians(self[1:]))
        if not all(map(isfinite, self)):
            raise ConfigError(f"gait {','.join(map(str, self))}: expected finite numbers, HZ,AMPLITUDE_DEG,LAG_DEG[,BIAS_DEG]")
        most = 0.5 / robot.timing.bus_dt
        if not 0.0 < frequency < most:
            raise ConfigError(f"gait: {frequency:g} Hz; expected above 0 and below {most:g} Hz, half the rate of the commands")
        if not amplitude > 0.0:
            raise ConfigError(f"gait: amplitude {self.amplitude_deg:g} deg; expected above 0")
        if amplitude + abs(bias) > servo.range:
            text = f"amplitude {self.amplitude_deg:g} and bias {self.bias_deg:g} deg reach {degrees(amplitude + abs(bias)):g} deg"
            raise ConfigError(f"gait: {text}, the servos of {robot.name} {degrees(servo.range):g}; take less of either")
        fastest = min(servo.speed_no_load, RATE)
        if (needed := 2 * pi * frequency * amplitude) > fastest:
            most = fastest / (2 * pi * amplitude)
            text = f"{frequency:g} Hz at {self.amplitude_deg:g} deg turns at {needed:.3g} rad/s"
            bound = f"a joint of {robot.name} at {fastest:.3g} at most"
            raise ConfigError(f"gait: {text}, {bound}; take {most:.2g} Hz or less, or a smaller amplitude")
        return excitation.gait(frequency, amplitude, lag, bias, seconds, robot.n_joints, robot.timing.bus_dt)


def play(
    rig: Rig, run: ExperimentRun, folder: Path, meta: Mapping[str, Any], *, medium: str = "water", wait: float = 10.0,
    stop: Callable[[], bool] = lambda: False, bound: float = inf,
) -> tuple[SwimOutcome, Trial | None]:  # fmt: skip
    """Plays one experiment on a rig; the host's whole log stays in `folder`.

    Args:
        medium: "air" if the fish hangs and no camera is needed. stop: as `SwimLoop`. bound: m, as `SwimPlan`.

    Returns:
        the outcome, and the trial for a data set; None if it did not play to the end.
    """
    plan = SwimPlan(seconds=run.what.seconds, wait=wait, pose=medium == "water", bound=bound)
    about = {**meta, "medium": medium, "excitation": run.what.id, "replicate_of": run.first}
    with TrialLog(folder, about, rig.robot.n_joints) as log:
        outcome = SwimLoop(rig, PlayedPilot(run.what.commands), plan, log, stop=stop).run()
    if not outcome.complete:
        return outcome, None
    return outcome, kept(read_trial(folder), run)


def meta_of(robot: Robot, flow: tuple[float, float] | None, simulated: bool, notes: str = "") -> dict[str, Any]:
    """Meta data of every trial of a session. flow: (m/s, rad), None if unknown."""
    speed, direction = flow or (0.0, 0.0)
    return {
        "origin": "synthetic" if simulated else "measured",
        **identity(robot),
        "water": "loopback" if simulated else "tank",
        "flow": {"speed": speed, "direction": direction, "known": flow is not None},
        "push": [0.0, 0.0, 0.0],
        "target": [0.0, 0.0],
        "controller": "open loop",
        "policy_sha256": "",
        "seed": 0,
        "notes": notes,
        "licence": "",
        "source": "fishmj deploy experiment",
        **made_by("numpy"),
    }


def kept(trial: Trial, run: ExperimentRun) -> Trial:
    """Part of a host's log for a data set: from the first played command to the last, on a clock from there.

    Raises ConfigError: nothing was played.
    """
    cmd = trial.tables["cmd"]
    played = cmd["state"] == int(SwimState.SWIMMING)
    if not played.any():
        raise ConfigError(f"{trial.name}: the log holds no command of the experiment")
    zero, end = float(cmd["t"][played][0]), float(cmd["t"][played][0]) + run.what.seconds
    tables: dict[str, Table] = {}
    for name in ("cmd", "joint", "pose", "power"):
        if name not in trial.tables:
            continue
        table = trial.tables[name]
        inside = (table["t"] >= zero - 1e-9) & (table["t"] <= end)
        inside &= played if name == "cmd" else True
        if inside.any():
            since = np.maximum(table["t"][inside] - zero, 0.0)
            tables[name] = {column: values[inside] for column, values in table.items()} | {"t": since}
    tables["cmd"] = _as_sent(tables["cmd"])
    tables = {name: {c: v for c, v in table.items() if c.rstrip("0123456789") in KEPT} for name, table in tables.items()}
    known = {name: value for name, value in trial.meta.items() if name != "clock"}
    clock = {name: trial.meta["clock"][name] for name in tables}
    return Trial({**known, "clock": clock, "sigma": noise_at_rest(tables)}, tables, name=run.name)


KEPT = ("t", "c", "asked", "seq", "j", "w", "temp", "x", "y", "yaw", "quality", "V", "I")


def _as_sent(table: Table) -> Table:
    """Table without the wanted commands if they were sent unchanged."""
    asked = [name for name in table if name.startswith("asked")]
    same = all(np.max(np.abs(table[name] - table["c" + name.removeprefix("asked")])) < SAME for name in asked)
    return {name: values for name, values in table.items() if not (same and name in asked)}


def noise_at_rest(tables: Mapping[str, Table]) -> dict[str, float]:
    """Standard deviation of each channel while the fish rests before its first movement; a channel without rows is left out.

    Neighbouring rows are subtracted, so that a slow drift does not count: var(x_k - x_{k-1}) = 2 sigma^2. An encoder that stays
    on one count has the noise of a count, step / sqrt(12).
    """
    found: dict[str, float] = {}
    for name, columns in (("joint", ("j",)), ("pose", ("x", "y", "yaw")), ("power", ("V", "I"))):
        table = tables.get(name, {})
        for column in [c for c in table if c.rstrip("0123456789") in columns]:
            values = table[column][table["t"] < LEAD]
            if len(values) < QUIET:
                continue
            steps = np.abs(np.diff(table[column]))
            count = float(steps[steps > 1e-9].min()) if name == "joint" and (steps > 1e-9).any() else 0.0
            found[column] = max(float(np.sqrt(np.mean(np.diff(values) ** 2) / 2)), count / sqrt(12))
    return {column: sigma for column, sigma in found.items() if sigma > 0.0}


def placing(what: Excitation) -> str:
    """Start pose of the fish in words, for the operator."""
    x, y, yaw = what.start
    return f"put the fish at x = {x:.2f} m, y = {y:.2f} m, heading {np.degrees(yaw):.0f} deg, straight and at rest"
