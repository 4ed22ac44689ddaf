"""Which water a description swims in, as the header of a policy holds it and as a judgement compares it."""

import json
from hashlib import sha256
from pathlib import Path

from fishmj import calib, store
from fishmj.errors import UnknownName
from fishmj.mjcf.description import Robot

STRUCTURED, SURROGATE, BASE = "structured", "surrogate", "-base"


def water_identity(robot: Robot) -> dict[str, str]:
    """The water of a robot in names and one hash.

    Returns:
        {"name", "kind", "sha256"}. kind `structured`: the description's strips, hashed with all their coefficients. kind
        `fitted`, or `base` without the learnt residual: the sha256 of its TOML, which names that of its weights.
    Raises:
        UnknownName, StoreError, ConfigError: there is no such fitted water, or its file cannot be read.
    """
    label = str(robot.water.get("model", STRUCTURED))
    if label == STRUCTURED:
        table = {key: value for key, value in robot.water.items() if key != "model" and value is not None}
        return {"name": label, "kind": STRUCTURED, "sha256": sha256(_text(table)).hexdigest()}
    path, base = _file(label, robot), label.endswith(BASE)
    name = str(calib.read_toml(path).get("name", path.stem))
    return {"name": f"{name}{BASE}"[:64] if base else name, "kind": "base" if base else "fitted", "sha256": store.sha256(path)}


def _text(table: dict) -> bytes:
    return json.dumps(store.plain(table), sort_keys=True, default=str).encode()


def _file(label: str, robot: Robot) -> Path:
    """The TOML of a fitted water: of a path, of a name, or of the one that ships for this robot."""
    if label.endswith(".toml"):
        return Path(label)
    shipped = calib.waters()
    name = label.removesuffix(BASE)
    if name == SURROGATE:
        name = robot.name if robot.name in shipped else next(iter(shipped), name)
    for folder in calib.WATERS:
        if (path := folder / f"{name}.toml").is_file():
            return path
    raise UnknownName("fitted water", label, shipped)
