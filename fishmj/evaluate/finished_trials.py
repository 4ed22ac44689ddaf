"""Controllers that a judgement has finished, kept until it has finished all: the same command then goes on with the next one.

A file is taken only by a judgement under the same conditions: controller, robot, water, trials, engine, and the code and
constants of this package, all in its name by hash. A judgement that comes to its end removes what it kept.
"""

import hashlib
import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fishmj import console, interrupt, store
from fishmj.errors import StoreError
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.result import Result
from fishmj.mjcf.description import Robot
from fishmj.source import package_sha256

ARRAYS = ("t", "target", "pose", "velocity", "joint", "rate", "power", "command", "obs", "action", "distance", "left")


class FinishedTrials:
    """What is finished of one judgement. folder: --out; None keeps nothing. engine: its name."""

    def __init__(self, folder: Path | None, robot: Robot, trials: Trials, engine: str, names: list[str]):
        self.folder, self.robot, self.trials, self.engine = folder, robot, trials, engine
        self.names = names
        self.done: list[str] = []

    def find(self, brain) -> Result | None:
        """The finished judgement of a controller, if there is one; says so."""
        path = self._path(brain)
        if path is None or not path.is_file():
            return None
        try:
            arrays = store.read_npz(path)
            given: dict[str, Any] = {name: arrays.get(name) for name in ARRAYS}
        except StoreError:  # damaged: judged again
            return None
        console.warn(f"{brain.name} was judged before under the same conditions: taken from {path}")
        known: dict[str, Any] = {"controller": brain.name, "policy_sha256": getattr(brain, "sha256", ""), "engine": self.engine}
        return Result(robot=self.robot, trials=self.trials, **known, **given)

    def keep(self, brain, result: Result) -> Result:
        """Add a finished controller: its arrays."""
        self.done.append(brain.name)
        path = self._path(brain)
        if self.folder is None or path is None or len(self.names) == 1:
            return result
        if not path.is_file():
            arrays = {name: value for name in ARRAYS if (value := getattr(result, name)) is not None}
            store.write_npz(path, arrays)
        return result

    @property
    def unfinished(self) -> list[str]:
        """Controllers that are not judged yet."""
        return self.names[len(self.done) :]

    def words(self) -> str:
        """What is kept, and how to go on."""
        if self.folder is None:
            return "nothing was kept: with --out DIR every finished controller is"
        return f"{self.folder} holds {len(self.done)} of {len(self.names)} controllers; {interrupt.again()}"

    def end(self) -> None:
        """All are finished and reported."""
        if self.folder is not None:
            shutil.rmtree(self.folder / "judged", ignore_errors=True)

    def _path(self, brain) -> Path | None:
        if self.folder is None:
            return None
        what = {
            "controller": [brain.name, getattr(brain, "sha256", "")],
            "robot": repr(self.robot),
            "water": water_of(self.robot),
            "trials": asdict(self.trials),
            "engine": self.engine,
            "code": package_sha256(),
        }
        mark = hashlib.sha256(json.dumps(what, sort_keys=True, default=str).encode()).hexdigest()[:16]
        return self.folder / "judged" / f"{brain.name}_{mark}.npz"


def water_of(robot: Robot) -> list[str]:
    """Hashes of the files of a fitted water."""
    path = Path(str(robot.water.get("model", "")))
    return [store.sha256(file) for file in sorted(path.parent.glob(f"{path.stem}*")) if path.is_file() and file.is_file()]
