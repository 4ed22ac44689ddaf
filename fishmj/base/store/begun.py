"""Options with which a folder of results was begun: the same command goes on in it, another one is refused."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fishmj.base.errors import ConfigError
from fishmj.base.store.atomic import plain, read_json, write_json


def same_as_begun(path: Path, options: dict) -> None:
    """Keeps the options in `path`. Raises ConfigError: its folder was begun with others, whose results would be mixed."""
    mine = dict(leaves(plain(options)))
    theirs = dict(leaves(read_json(path))) if path.is_file() else mine
    if other := [key for key in {**theirs, **mine} if theirs.get(key) != mine.get(key)]:
        told = "; ".join(f"{key} {theirs.get(key)!s:.40}, got {mine.get(key)!s:.40}" for key in other[:3])
        more = f" and {len(other) - 3} more" if len(other) > 3 else ""
        raise ConfigError(f"{path.parent} was begun with {told}{more}; repeat the options to go on, or take another --out")
    write_json(path, options)


def leaves(table: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yields names and values of a nested table: `{"task": {"memory": 8}}` has `task.memory`."""
    for key, value in table.items() if isinstance(table, dict) else [("", table)]:
        yield from leaves(value, f"{name}{key}.") if isinstance(value, dict) else [(f"{name}{key}", value)]
