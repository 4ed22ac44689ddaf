"""Saved rows of an experiment, one JSON line each, so that an interrupted command continues with the missing parts."""

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

from fishmj.base import store
from fishmj.base.source import package_sha256
from fishmj.evaluate.experiments.paper_experiment import ExperimentSetup, Row
from fishmj.water.water_identity import water_identity


def options_of(setup: ExperimentSetup) -> dict[str, Any]:
    """Options that all rows and the report of a folder share: policy, robot, water, seed, size."""
    policy = {"name": setup.leader, "sha256": getattr(setup.brain, "sha256", "")}
    robot = sha256(f"{setup.robot!r} {setup.robot.effects!r}".encode()).hexdigest()[:16]
    water = water_identity(setup.robot) if setup.solver is None else {"name": "lbm", "solver": setup.solver.said}
    return {"policy": policy, "robot": robot, "water": water, "seed": setup.seed, "quick": setup.quick}


def identity_of(setup: ExperimentSetup) -> str:
    """Hash (16 characters) of everything on which a row depends: options, the solver's water, the code."""
    what = [options_of(setup), water_identity(setup.robot), repr(setup.solver), package_sha256()]
    return store.json_sha256(what)[:16]


class ExperimentRows:
    """Rows of one experiment in `<folder>/<name>.jsonl`, rewritten as a whole with each new row.

    Lines with another identity and incomplete lines are ignored, and removed by the first new row.
    """

    def __init__(self, folder: Path, name: str, identity: str):
        self.path, self.identity = folder / f"{name}.jsonl", identity
        self.rows: dict[str, Row] = {}
        self.cpu: dict[str, float] = {}  # s of each part
        try:
            text = self.path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            text = ""
        for line in text.splitlines():
            try:
                one = json.loads(line)
                if one["identity"] == identity:
                    self._add(one["key"], one["row"], one["cpu_s"])
            except (ValueError, KeyError, TypeError):
                continue

    def add(self, key: str, row: Row, cpu: float) -> None:
        """Keeps a row. Raises StoreError."""
        self._add(key, json.loads(json.dumps(row, allow_nan=False)), round(cpu, 2))
        lines = [{"key": k, "identity": self.identity, "cpu_s": self.cpu[k], "row": r} for k, r in self.rows.items()]
        store.write_text(self.path, "".join(json.dumps(one) + "\n" for one in lines))

    def _add(self, key: str, row: Row, cpu: float) -> None:
        self.rows[key], self.cpu[key] = row, cpu
