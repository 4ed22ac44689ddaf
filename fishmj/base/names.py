"""Valid names of robots, links, controllers, effects and trials that come from files.

A name ends up in folder names, generated source, pages and shell lines. So it has at most 64 characters, only letters, digits,
`_`, `.` and `-`, and is never `.` or `..`.
"""

import re

from fishmj.base.errors import ConfigError

PATTERN = r"[A-Za-z0-9_.-]{1,64}"
_NAME = re.compile(PATTERN + r"\Z")


def is_name(text: object) -> bool:
    """Returns True if `text` can stand unchanged in a path, a page and a shell line."""
    return isinstance(text, str) and _NAME.match(text) is not None and set(text) != {"."} and not text.startswith("-")


def checked(text: object, what: str, where: str = "") -> str:
    """Returns `text` if it is a valid name.

    Args:
        what: kind of the named thing, for the message: "robot", "link". where: file and block.

    Raises ConfigError: invalid; shows the name with the other characters replaced.
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
    """Makes a name of `text`: other characters become `_`; empty if nothing is left."""
    made = re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_.-")[:64]
    return made if is_name(made) else ""


def split_member(water: str) -> tuple[str, str | None]:
    """`NAME#2` or `file.toml#2` -> (name or file, "2"), one member of a fitted water's ensemble; without one (water, None)."""
    whole, mark, number = water.rpartition("#")
    return (whole, number) if mark and not number.endswith(".toml") else (water, None)  # a folder may have a # in its name


def strips_of(water: str) -> str:
    """Name or file of the strip model fitted alone: `NAME-base`, `FOLDER/NAME-base.toml`; `NAME#2` -> `NAME-base#2`."""
    whole, number = split_member(water)
    stem = whole.removesuffix(".toml")
    return f"{stem}-base{whole[len(stem) :]}{'' if number is None else f'#{number}'}"
