"""Trials of a robot as a result of `fishmj.evaluate`: the same figures, tables and page, with results in other waters beside.

    pose      fixes of the camera at their own time, linear between them, on bus ticks; the true pose is not measured
    velocity  differences of these poses; the figures average it over a beat
    power     V I of the battery's lead, electronics included; NaN without a meter, so that no figure of it appears
    left      the bus tick at which the host stopped a fish that had left its area

A folder of `fishmj evaluate --out` beside it gives the same trials in another water: only their figures, from its trials.csv.
"""

import csv
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.calib import robot_called
from fishmj.base.errors import ConfigError, LogError, MissingExtra, StoreError
from fishmj.base.store import read_json, write_text
from fishmj.deploy.trials.schedule import KEPT, Place
from fishmj.evaluate import metrics
from fishmj.evaluate.metrics import UNITS, Result
from fishmj.evaluate.protocol import MeasuredTrials, Trials, measured
from fishmj.log import Trial, read_trial, stacked
from fishmj.log.trial_folder import META_FILE
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import robot_names
from fishmj.water.flow_map.flow_map import TankWater, preset_for

TANK, LOOPBACK = "tank", "loopback"
HOLE = 1.0  # s without a row of the meter, a beat, in which nobody knows what was drawn
ALONE = "Put the same trials in simulated water beside it (fishmj deploy trials says how), and it is compared with those."
OF_THE_ROBOT = ("power", "energy_per_metre", "cost_of_transport")  # what is missing without a meter


def measured_trials(trials: Trials, waters: Mapping[float, TankWater]) -> MeasuredTrials:
    """The trials in the measured water."""
    kind = preset_for([water.length for water in waters.values()])[0] if waters else "none"
    return measured(trials, {speed: water.intensity for speed, water in waters.items()}, kind, seen=True)


def result_of(
    name: str, sha256: str, robot: Robot, trials: Trials, places: Sequence[Place], logs: Mapping[str, Trial], engine: str
) -> Result:  # fmt: skip
    """The accepted trials as a result; missing ones are left out.

    Raises ConfigError: there is none; LogError: one without poses.
    """
    there = sorted((place for place in places if place.name in logs), key=lambda place: place.number)
    if not there:
        raise ConfigError("trials: none is accepted yet; there is nothing to judge")
    some = replace(trials, items=tuple(place.spec for place in there))
    dt = robot.timing.bus_dt
    t = np.arange(round(trials.duration / dt) + 1) * dt
    k = np.arange(round(trials.duration / robot.timing.control_dt)) * robot.timing.control_dt
    rows = [_row(logs[place.name], place, robot, t, k) for place in there]
    arrays: dict[str, Any] = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    target = np.array([place.target for place in there])
    away = np.linalg.norm(arrays["pose"][:, :, :2] - target[:, None], axis=-1)
    distance, action = metrics.frozen(away, arrays["left"]), arrays.pop("action")
    return Result(
        controller=name, policy_sha256=sha256, robot=robot, trials=some, engine=engine, t=t, target=target, distance=distance,
        action=None if np.isnan(action).all() else action, **arrays,
    )  # fmt: skip


def _row(trial: Trial, place: Place, robot: Robot, t: np.ndarray, k: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of one trial at the bus ticks t (T + 1,) and the control steps k (K,)."""
    joints, tables = robot.n_joints, trial.tables
    if "pose" not in tables or len(tables["pose"]["t"]) < 2:
        raise LogError(f"{trial.name}: no poses; it cannot be judged")
    pose = tables["pose"]
    seen = pose["t_taken"] if "t_taken" in pose else pose["t"] - float(trial.value("latency.pose") or 0.0)
    on = lambda at, stamps, columns: np.stack([np.interp(at, stamps, column) for column in columns], -1)
    path = on(t, seen, (pose["x"], pose["y"], np.unwrap(pose["yaw"])))
    dt = robot.timing.bus_dt
    angle = (
        on(t, tables["joint"]["t"], stacked(tables["joint"], "j#").T) if "joint" in tables else np.full((len(t), joints), np.nan)
    )
    swum, meter = float(trial.value("swum_s") or t[-1]), tables.get("power")
    watts = np.full(len(t) - 1, np.nan)
    if meter is not None and _covers(meter["t"], swum):
        watts = np.interp(t[1:] - dt / 2, meter["t"], meter["V"] * meter["I"])
    left = int(swum / dt) + 1 if swum < t[-1] - 5 * dt else len(t)
    watts[left:] = 0.0  # no figure counts what comes after, but NaN would
    last = lambda name, sign, at, wide: _held(tables.get(name), sign, at, wide)
    return {
        "pose": path, "velocity": np.gradient(path, dt, axis=0), "joint": angle, "rate": np.gradient(angle, dt, axis=0),
        "power": watts, "command": last("cmd", "c#", t[:-1], joints), "obs": last("obs", "o#", k, 5 + 2 * joints),
        "action": last("action", "a#", k, joints), "left": np.array(left),
    }  # fmt: skip


def _covers(stamps: np.ndarray, end: float) -> bool:
    """Returns True if rows cover 0 to `end` s without a long hole: an interrupted meter has measured no mean."""
    inside = stamps[(stamps > 0.0) & (stamps < end)]
    return bool(np.diff(np.concatenate([[0.0], inside, [end]])).max() < HOLE)


def _held(table, sign: str, at: np.ndarray, wide: int) -> np.ndarray:
    """The newest row at each time (n, wide); NaN without a table."""
    if table is None or not len(table["t"]):
        return np.full((len(at), wide), np.nan)
    values = stacked(table, sign)
    return values[np.clip(np.searchsorted(table["t"], at + 1e-6, side="right") - 1, 0, None)]


def beside(folder: Path, policy: str, own: Result) -> Result:
    """The same trials in another water, from the trials.csv of an evaluation; NaN for trials that it lacks.

    Time series for pictures come from its logs, if it has them (`--log`).

    Raises StoreError: no trials.csv there, or a damaged one; ConfigError: of other controllers, or of none of these trials.
    """
    file = folder / "trials.csv"
    try:
        with open(file, encoding="utf-8", newline="") as text:
            rows = list(csv.DictReader(text))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StoreError(f"{file}: cannot be read ({error}); expected what fishmj evaluate --out writes") from error
    names = sorted({str(row.get("controller", "")).lstrip("'") for row in rows})
    if policy not in names:
        raise ConfigError(f"{file}: judges {', '.join(names) or 'nothing'}; expected {policy}, which swam here")
    try:
        found = {
            (float(row["speed"]), round(float(row["los_deg"])) % 360, int(row["repeat"])): row
            for row in rows
            if row["controller"].lstrip("'") == policy
        }
        wanted = [(t.speed, round(float(np.degrees(t.los))) % 360, t.repeat) for t in own.trials.items]
        number = lambda row, key: float(row[key]) if row is not None and row[key] else np.nan
        figures = {name: np.array([number(found.get(key), name) for key in wanted]) for name in UNITS}
        away = np.array([number(found.get(key), "left_domain_at") for key in wanted])
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{file}: no table of evaluate ({type(error).__name__}: {error})") from error
    if not set(wanted) & set(found):
        raise ConfigError(f"{file}: none of these trials: other speeds, lines of sight or repeats")
    if missing := len(set(wanted) - set(found)):
        console.warn(f"{folder}: {missing} of {len(wanted)} trials are not there")
    name, training = f"{policy}, {folder.resolve().name}", _training(folder, policy)
    made = own._replace(controller=name, policy_sha256="", policy=training, engine="", known=figures, action=None)
    gone = np.isfinite(away)
    if series := _series(folder / "logs", policy, own):
        ticks = np.where(gone, np.round(np.nan_to_num(away) / own.robot.timing.bus_dt).astype(int), len(own.t))
        away_from = np.linalg.norm(series["pose"][:, :, :2] - own.target[:, None], axis=-1)
        return made._replace(**series, left=ticks, distance=metrics.frozen(away_from, ticks))
    times = np.unique(away[gone])
    return made._replace(t=times, left=np.where(gone, np.searchsorted(times, away), len(times)))


def _training(folder: Path, policy: str) -> dict | None:
    """The training of the policy and what differed in the other water, from the results.json of its evaluation; None without."""
    try:
        rows = read_json(folder / "results.json")["results"]
        found = next(row["policy"] for row in rows if row["controller"] == policy)
        return found if {"said", "differs"} <= found.keys() else None
    except (StoreError, KeyError, TypeError, AttributeError, StopIteration):
        return None


def _series(logs: Path, policy: str, own: Result) -> dict[str, Any]:
    """True poses and rates (n, T + 1, 3) from the logs of `evaluate --log`, turned into the tank's stream; {} if one lacks."""
    names = [f"{policy}_{spec.name}" for spec in own.trials.items]
    if not all((logs / name / META_FILE).is_file() for name in names):
        return {}
    poses, velocities = [], []
    for name, place in zip(names, own.trials.ends()[0], strict=True):
        trial = read_trial(logs / name)
        if "truth" not in trial.tables:
            return {}
        turn = own.trials.direction - float(trial.value("flow.direction") or 0.0)
        c, s = np.cos(turn), np.sin(turn)
        first = {"x": c * place[0] + s * place[1], "y": c * place[1] - s * place[0], "yaw": place[2] - turn}
        x, y, yaw, u, v, r = (
            _at(own.t, trial.tables["truth"], key, first.get(key, 0.0)) for key in ("x", "y", "yaw", "vx", "vy", "wz")
        )
        poses.append(np.stack([c * x - s * y, s * x + c * y, yaw + turn], -1))
        velocities.append(np.stack([c * u - s * v, s * u + c * v, r], -1))
    return {"pose": np.stack(poses), "velocity": np.stack(velocities)}


def _at(t: np.ndarray, truth: Mapping[str, np.ndarray], column: str, first: float) -> np.ndarray:
    """A column of the table at t (T,) [s], `first` at 0 s."""
    values = np.append(first, truth[column])
    return np.interp(t, np.append(0.0, truth["t"]), np.unwrap(values) if column == "yaw" else values)


def condition(result: Result, notes: Sequence[str]) -> str:
    """One line on the conditions of the figures."""
    t = result.trials
    speeds = "/".join(f"{u:g}" for u in sorted(set(t.speed)))
    where = "on the loopback robot (synthetic)" if result.engine == LOOPBACK else "on the robot in its tank"
    about = f"{len(t)} trials of {t.duration:g} s {where}, flow {speeds} m/s, {t.turbulence_said}"
    return "; ".join([f"{about}, command path {result.robot.timing.command_path}", *notes])


def lacking(result: Result, logs: Mapping[str, Trial], wanted: int) -> list[str]:
    """Missing or only measured inputs of the figures, with the reason: a clause each."""
    lines = ["pose as the camera measured it, not the true one"]
    sigma = [trial.value("sigma.x") for trial in logs.values()]
    lines[0] += "" if not any(sigma) else f" (sigma {1e3 * float(np.median([s for s in sigma if s])):.1f} mm)"
    dark = int(np.isnan(result.power).any(1).sum())
    if dark:
        lines.append(
            f"no power in {dark} of {len(result.trials)} trials (no meter, or it paused): {', '.join(OF_THE_ROBOT)} missing"
        )
    if len(result.trials) < wanted:
        lines.append(f"{wanted - len(result.trials)} of {wanted} trials were not swum")
    return lines


def written(
    out: Path, results: list[Result], notes: Sequence[str], *, plots: bool = False, replay: str = ""
) -> tuple[dict[str, Any], list[str]]:  # fmt: skip
    """Writes results.json, trials.csv and report.html; returns their content, and the parts left out for lack of a package.

    replay: the command that plays the worst trial.
    """
    from fishmj.evaluate import trial_report

    lacks: list[str] = []
    found: dict[str, Any] = {"condition": condition(results[0], notes), "robot": robot_names(results[0].robot)}
    found["results"] = [metrics.summary(r) for r in results]
    try:
        pairs = trial_report.paired_entries(results)
    except ModuleNotFoundError as error:  # the host beside the tank: the robot's own figures stand without it
        lacks.append(f"no comparison with other waters: {error.name} is not installed on this computer")
        results, pairs = results[:1], []
        found["results"] = found["results"][:1]
    found["paired"] = pairs
    trial_report.save(out, results, found)
    shown: list[tuple[Path, str]] = []
    if plots:
        from fishmj.evaluate.plots import pictures

        try:
            shown = pictures([r for r in results if len(r.t) == len(results[0].t)], out)
        except MissingExtra as error:
            lacks.append(f"no pictures: {error}")
    write_text(out / "report.html", trial_report.page(results, found, shown, again=replay, alone=ALONE))
    return found, lacks


def waters_beside(folders: Sequence[Path]) -> list[str]:
    """Condition of each folder, from its results.json."""
    lines = []
    for folder in folders:
        try:
            lines.append(f"{folder.resolve().name}: {read_json(folder / 'results.json')['condition']}")
        except (StoreError, KeyError, TypeError):
            lines.append(f"{folder.resolve().name}: its results.json does not say in what water")
    return lines


def worst_replay(out: Path, result: Result, places: Sequence[Place], robot: str) -> str:
    """The command that plays the robot's worst trial. robot: its description, as it was named."""
    from fishmj.evaluate import trial_report

    spec = result.trials.items[trial_report.worst(result)]
    name = next(place.name for place in places if place.spec == spec)
    own = [] if robot_called(robot) else ["--robot", robot]
    return shlex.join(["fishmj", "replay", str(out / KEPT / name), *own])
