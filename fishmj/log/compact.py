"""Many short trials in one small file: every column as whole numbers of a step far below its noise.

    write_bundle("nulls.npz", trials)       step: a 20th of the sensor's noise (`sigma` of the meta data), 10 us of time stamps
    for trial in read_bundle("nulls.npz"): ...

x = step q, q stored as the whole number first and its differences after it, which deflate packs tightly: half a kilobyte a
second of a swim, a tenth of its folder. What is not in `KEPT` (velocities that a camera's own filter makes) is left out.
"""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from fishmj.errors import FishmjError, LogError, StoreError
from fishmj.log.npz_tables import row_place
from fishmj.log.trial import Trial
from fishmj.log.trial_check import check_table
from fishmj.names import checked
from fishmj.store import plain, read_npz, write_npz

SCHEMA = "fishmj.bundle/1"
KEPT = {"cmd": "tc", "joint": "tj", "pose": "txy", "power": "tVI"}  # first letters of the columns
STEPS = {"t": 1e-5, "c": 1e-5}  # s, rad
FINE = 20.0  # steps in a standard deviation of the noise
COARSE = 1e-6  # step of a column whose noise nobody states, of its own range


def write_bundle(path: "str | Path", trials: Iterable[Trial]) -> Path:
    """Write trials (synthetic or measured) into one file, atomically.

    Raises:
        LogError: no trial, two of one name, or a value that is not finite.
    """
    arrays, about = {}, []
    for trial in trials:
        if trial.name in {a["name"] for a in about}:
            raise LogError(f"{path}: two trials named {trial.name!r}; a bundle needs a name of its own for each")
        steps = {}
        for table, letters in KEPT.items():
            for column, values in trial.tables.get(table, {}).items():
                if column[0] in letters and column not in ("vx", "vy"):
                    step = _step(trial, column, values)
                    whole = np.rint(np.asarray(values, float) / step)
                    if not np.isfinite(whole).all():
                        raise LogError(f"{path}: trial {trial.name}, {table}.{column}: a value is not finite")
                    arrays[f"{len(about)}/{table}/{column}"] = _narrow(np.diff(whole.astype(np.int64), prepend=0))
                    steps[f"{table}/{column}"] = step
        about.append({"name": trial.name, "meta": trial.meta, "steps": steps})
    if not about:
        raise LogError(f"{path}: no trials to write")
    told = json.dumps(plain({"schema": SCHEMA, "trials": about}))
    return write_npz(path, arrays | {"about": np.frombuffer(told.encode(), np.uint8)})


def read_bundle(path: "str | Path") -> list[Trial]:
    """The trials of a bundle, in the order in which they were written.

    Raises:
        StoreError: missing, damaged, or no bundle. LogError: a table that breaks the schema. ConfigError: a name that is none.
    """
    arrays = read_npz(path)
    try:
        about = json.loads(arrays.pop("about").tobytes().decode())
        if about["schema"] != SCHEMA:
            raise StoreError(f"{path}: schema {about['schema']!r}, expected {SCHEMA!r}")
        out = []
        for i, one in enumerate(about["trials"]):
            tables: dict = {}
            if not isinstance(one["meta"], dict):
                raise TypeError(f"meta of trial {i + 1} is no table")
            for key, step in one["steps"].items():
                table, column = key.split("/")
                tables.setdefault(table, {})[column] = step * np.cumsum(arrays[f"{i}/{key}"].astype(np.int64))
            name = checked(one["name"], "trial", str(path))
            for table, columns in tables.items():
                check_table(table, columns, row_place(f"{path}:{name}/{table}"))
            out.append(Trial(one["meta"], tables, name=name))
        return out
    except FishmjError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError) as error:
        raise StoreError(f"{path}: not a bundle of trials ({error!r}); write it again with write_bundle") from error


def _step(trial: Trial, column: str, values) -> float:
    """Step of a column, in its own unit."""
    if column[0] in STEPS:
        return STEPS[column[0]]
    sigma = trial.value(f"sigma.{column}")
    return float(sigma) / FINE if sigma else COARSE * float(np.ptp(values) or 1.0)


def _narrow(whole: np.ndarray) -> np.ndarray:
    """The smallest integer type that holds them."""
    size = int(np.abs(whole).max(initial=0))
    kind = next(k for k in (np.int8, np.int16, np.int32, np.int64) if size <= np.iinfo(k).max)
    return whole.astype(kind)
