"""Writes TOML, because the standard library only reads it.

Scalars, lists, nested tables (as `[a.b]` blocks) and lists of tables (inline). `None` has no TOML form: its key is left out.
"""

import json
import math
import re
from datetime import date, datetime, time
from pathlib import Path

import numpy as np

from fishmj.base.calib import DEEPEST
from fishmj.base.errors import LogError
from fishmj.log.limits import quoted

_BARE = re.compile(r"[A-Za-z0-9_-]+\Z")


def dumps(table: dict) -> str:
    """A TOML document that `tomllib.loads` reads back as `table` (tuples and arrays come back as lists).

    Raises LogError: a value has no TOML form; names its dotted key.
    """
    return "\n".join(_block(table, ())).strip() + "\n"


def inline(value) -> str:
    """One value on one line: `{column = "x", unit = "mm"}`."""
    return _value(value, ("value",))


def nested(meta: dict) -> dict:
    """Dotted keys unfolded: {"flow.speed": 0.2} -> {"flow": {"speed": 0.2}}; existing tables are merged into."""
    out: dict = {}
    for key, value in meta.items():
        *path, last = str(key).split(".")
        level = out
        if len(path) >= DEEPEST:
            raise LogError(f"meta key {quoted(key)}: {len(path) + 1} parts with dots between, expected {DEEPEST} at most")
        for part in path:
            level = level.setdefault(part, {})
            if not isinstance(level, dict):
                raise LogError(f"meta key {key!r}: {part!r} is a value already, so nothing can lie under it; rename one of them")
        value = nested(value) if isinstance(value, dict) else value
        if isinstance(level.get(last), dict) and isinstance(value, dict):
            level[last] = nested({**level[last], **value})
        else:
            level[last] = value
    return out


def _block(table: dict, path: tuple[str, ...]) -> list[str]:
    lines, blocks = [], []
    for key, value in table.items():
        where = (*path, str(key))
        if value is None:
            continue
        if isinstance(value, dict):
            body = _block(value, where)
            header = f"[{'.'.join(map(_key, where))}]"
            blocks += ["", header, *body] if not body or not body[0].startswith("[") else ["", *body]
        else:
            lines.append(f"{_key(key)} = {_value(value, where)}")
    return lines + blocks if lines else blocks[1:]


def _key(key) -> str:
    return str(key) if _BARE.match(str(key)) else _text(str(key))


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value, where: tuple[str, ...]) -> str:
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (str, Path)):
        return _text(str(value))
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else {math.inf: "inf", -math.inf: "-inf"}.get(value, "nan")
    if isinstance(value, (datetime, date, time)):
        return value.isoformat()
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(v, where) for v in value)}]"
    if isinstance(value, dict):
        inside = (f"{_key(k)} = {_value(v, (*where, str(k)))}" for k, v in value.items() if v is not None)
        return f"{{{', '.join(inside)}}}"
    raise LogError(f"meta key {'.'.join(where)!r}: {type(value).__name__} has no TOML form; use text, numbers, lists or tables")
