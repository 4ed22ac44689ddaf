"""Names from files: what a robot, link, controller, effect or trial may be called.

A name ends up in folder names, generated source, pages and shell lines, so it is letters, digits, `_`, `.` and `-` only, at
most 64 of them, and never `.` or `..`.
"""

import re

from fishmj.base.errors import ConfigError

PATTERN = r"[A-Za-z0-9_.-]{1,64}"
_NAME = re.compile(PATTERN + r"\Z")


def is_name(text: object) -> bool:
    """Whether `text` can stand in a path, a page and a shell line as it is."""
    return isinstance(text, str) and _NAME.match(text) is not None and set(text) != {"."} and not text.startswith("-")


def checked(text: object, what: str, where: str = "") -> str:
    """`text` when it is a name.

    Args:
        what: it names, for the message: "robot", "link". where: file and block.
    Raises:
        ConfigError: it is not; shows what it would be with the other characters replaced.
    """
    if isinstance(text, str) and is_name(text):
        return text
    place = f"{where}: " if where else ""
    shown = repr(text) if len(repr(text)) <= 80 else repr(text)[:76] + "...'"
    near = f"; for example {nearest(text)!r}" if isinstance(text, str) and nearest(text) else ""
    raise ConfigError(
        f"{place}{what} name {shown}: expected 1 to 64 letters, digits, '_', '.' or '-', the first of them no '-'{near}"
    )


def nearest(text: str) -> str:
    """A name made of `text`: other characters become `_`; empty when nothing is left."""
    made = re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_.-")[:64]
    return made if is_name(made) else ""


def split_member(water: str) -> tuple[str, str | None]:
    """`NAME#2` or `file.toml#2` -> (name or file, "2"), one member of a fitted water's ensemble; without one (water, None)."""
    whole, mark, number = water.rpartition("#")
    return (whole, number) if mark and not number.endswith(".toml") else (water, None)  # a folder may have a # in its name
