"""The 72 trials on a robot: their order, their place in the tank, their files, and a session that can be resumed.

order     speed by speed, so that the pump is changed twice; within a speed round by round, so that a sinking battery
          does not hide in one direction
OUT/session.json   the session's settings, and the skipped trials with reasons
OUT/host/NAME      the whole log of every try          OUT/trials/NAME   of an accepted try, cut to the time under the policy
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.store import Manifest, read_json, write_json
from fishmj.deploy.loop.supervisor import Condition, SwimState
from fishmj.deploy.loop.swim_loop import SwimOutcome
from fishmj.evaluate.protocol import Trials, TrialSpec
from fishmj.log import Table, Trial, read_trial, write_trial
from fishmj.log.trial_folder import META_FILE
from fishmj.water.flow_map.flow_map import FlowMap, TankWater

HOST, KEPT, SESSION = "host", "trials", "session.json"
SCHEMA = "fishmj.trials/1"
BEFORE = 1.0  # s before the policy took over that are kept: the pose at its start lies between two fixes
BEHIND = 0.5  # s after the end: the last fix arrives late
TABLES = ("cmd", "joint", "pose", "power", "obs", "action", "target")


class Place(NamedTuple):
    """One trial in the tank: name, specification, number in `Trials.items`, start (m, m, rad) and target (m, m)."""

    name: str
    spec: TrialSpec
    number: int
    start: tuple[float, float, float]
    target: tuple[float, float]


def order(trials: Trials) -> list[Place]:
    """Every trial with its place, in the order of execution."""
    start, target = trials.ends()
    key = lambda k: (trials.items[k].speed, trials.items[k].repeat, trials.items[k].los)
    made = []
    for k in sorted(range(len(trials)), key=key):
        x, y, yaw = start[k].tolist()
        spec = trials.items[k]
        made.append(Place(spec.name, spec, k, (x, y, float(np.arctan2(np.sin(yaw), np.cos(yaw)))), tuple(target[k].tolist())))
    return made


def waters_of(flow_map: FlowMap | None, speeds: Sequence[float]) -> dict[float, TankWater]:
    """The setting of the pump for each ordered speed; empty without a map. Raises ConfigError: a speed that no setting gives."""
    return {} if flow_map is None else {speed: flow_map.for_speed(speed) for speed in sorted(set(speeds))}


def stream_direction(waters: Mapping[float, TankWater]) -> float:
    """Direction of flow, rad, mean over the settings; 0 without a map, along the tank's x."""
    angles = [water.direction for water in waters.values()] or [0.0]
    return float(np.arctan2(np.mean(np.sin(angles)), np.mean(np.cos(angles))))


def condition_of(place: Place, water: TankWater | None) -> dict[str, Any]:
    """Meta data of a trial on its condition and its water."""
    spec = place.spec
    about: dict[str, Any] = {
        "condition": {"speed": spec.speed, "los_deg": round(float(np.degrees(spec.los)), 3), "repeat": spec.repeat},
        "seed": int(spec.seed[0]),
        "excitation": "station holding",
        "start": list(place.start),
        "source": "fishmj deploy trials",
    }
    if water is not None:
        about["pump"] = {"setting": water.pump, "intensity": water.intensity}
        about["pump"] |= {} if water.length is None else {"length": water.length}
    return about


class Session:
    """A folder of trials of a running session.

    Args:
        folder: of the session. what: policy, robot, seconds, seed, which must not change within a session.

    Raises ConfigError: the folder belongs to a session with other settings; names it.
    """

    def __init__(self, folder: Path, what: Mapping[str, Any]):
        self.folder, self.what = folder, dict(what)
        self.skipped: dict[str, str] = {}
        file = folder / SESSION
        if file.is_file():
            known = read_json(file)
            if not isinstance(known, dict) or known.get("schema") != SCHEMA:
                raise ConfigError(f"{file}: no session of deploy trials; choose another --out")
            for key, value in self.what.items():
                if known.get("what", {}).get(key) != value:
                    there = known.get("what", {}).get(key)
                    raise ConfigError(
                        f"{folder}: a session with {key} = {there!r}, here {value!r}; take another --out, or the same {key}"
                    )
            self.what = {**known.get("what", {}), **self.what}
            self.skipped = dict(known.get("skipped", {}))
        elif folder.is_dir() and any(folder.iterdir()):
            raise ConfigError(f"{folder}: exists and is no session of deploy trials; choose another --out")

    @property
    def accepted(self) -> set[str]:
        """Names of the finished trials."""
        return {path.parent.name for path in (self.folder / KEPT).glob(f"*/{META_FILE}")}

    def left(self, places: Sequence[Place]) -> list[Place]:
        """Trials that are neither finished nor skipped."""
        done = self.accepted | set(self.skipped)
        return [place for place in places if place.name not in done]

    def skip(self, name: str, why: str) -> None:
        """Marks a trial as skipped, with the reason."""
        self.skipped[name] = why
        self.save()

    def again(self) -> None:
        """Makes skipped trials pending again."""
        self.skipped = {}
        self.save()

    def save(self) -> None:
        """Writes the session's settings."""
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(self.folder / SESSION, {"schema": SCHEMA, "what": self.what, "skipped": self.skipped})

    def accept(self, name: str, log: Path, seconds: float) -> Trial:
        """Takes the log of a try as the trial of this name. Raises LogError, StoreError, ConfigError."""
        trial = cut(read_trial(log), name, seconds)
        write_trial(self.folder / KEPT / name, trial, overwrite=True, form="npz", precision="float64")
        return trial

    def read(self, places: Sequence[Place]) -> dict[str, Trial]:
        """The accepted trials of these places; rewrites the manifest of the data set."""
        done = self.accepted
        found = {place.name: read_trial(self.folder / KEPT / place.name) for place in places if place.name in done}
        if found:
            Manifest.of(self.folder / KEPT, {"source": "fishmj deploy trials"}).write(self.folder / KEPT)
        return found


def counts(outcome: SwimOutcome) -> bool:
    """Returns True if a swim counts as a trial: complete, or ended because the fish left its area, which counts as a failure."""
    return outcome.complete or (outcome.swim_seconds > 0.0 and bool(outcome.cause & Condition.LEFT_TANK))


def cut(trial: Trial, name: str, seconds: float) -> Trial:
    """A host's log on a clock that begins with the policy's control, up to `seconds`.

    Raises ConfigError: the policy never steered.
    """
    cmd = trial.tables.get("cmd", {})
    steered = cmd["state"] == int(SwimState.SWIMMING) if "state" in cmd else np.zeros(0, bool)
    if not steered.any():
        raise ConfigError(f"{trial.name}: the log holds no command of the policy")
    zero = float(cmd["t"][steered][0])
    swum = min(float(cmd["t"][steered][-1]) - zero, seconds)
    tables: dict[str, Table] = {}
    for table in (table for table in TABLES if table in trial.tables):
        rows = trial.tables[table]
        inside = (rows["t"] >= zero - BEFORE) & (rows["t"] <= zero + seconds + BEHIND)
        inside &= steered if table == "cmd" else True
        stamps = {c: v - zero for c, v in rows.items() if c in ("t", "t_taken", "t_rx")}
        if table == "target":  # written when it armed
            tables[table] = {c: v[-1:] for c, v in rows.items()} | {"t": np.zeros(1)}
        elif inside.any():
            tables[table] = {c: v[inside] for c, v in (rows | stamps).items()}
    meta = {key: value for key, value in trial.meta.items() if key != "clock"}
    meta |= {"clock": {table: trial.meta.get("clock", {}).get(table, "") for table in tables}, "swum_s": round(swum, 4)}
    return Trial(meta, tables, name=name)
