"""`fishmj <verb> ...`: the same `main(argv)` that `python -m fishmj.<verb>` calls.

A verb is a folder of this package with `__main__.py`, or a module in it with `main`: it is found, not listed. Its summary is the
first line of its docstring, read without importing it.
"""

import ast
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from fishmj import __version__, console
from fishmj.errors import UnknownName

# where a verb stands in the help, in the order of a day's work; one that is not named here stands at the end
SECTIONS = {
    "begin": ("doctor", "demo", "new"),
    "policies": ("train", "evaluate", "replay", "play"),
    "the robot": ("deploy",),
    "a robot's logs": ("log", "calibrate", "gap", "effects"),
    "the water": ("hydro_fit", "lbm_oracle", "campaign"),
    "synthetic robots, speed": ("virtual_robot", "bench"),
}
OTHERS = "more"
NO_VERBS = {"cli", "__main__"}
_HERE = Path(__file__).resolve().parent


def sources() -> dict[str, Path]:
    """Verb -> the file that holds its `main`, in the order of the help."""
    folders = {path.parent.name: path for path in _HERE.glob("*/__main__.py")}
    modules = {path.stem: path for path in _HERE.glob("*.py") if path.stem not in NO_VERBS and _has_main(path)}
    found = modules | folders
    known = [verb for part in SECTIONS.values() for verb in part if verb in found]
    return {verb: found[verb] for verb in (*known, *sorted(found.keys() - set(known)))}


def present() -> dict[str, str]:
    """The verbs with one line each."""
    return {verb: _summary(path) for verb, path in sources().items()}


def _has_main(path: Path) -> bool:
    return re.search(r"^def main\(", path.read_text(encoding="utf-8"), re.MULTILINE) is not None


def _summary(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    first = text.strip().partition("\n")[0]
    said = first.partition(": ")[2] if first.startswith("`") else first
    return said[:1].upper() + said[1:]


def load(verb: str) -> console.Main:
    """Import the verb's module and return its `main`.

    Raises:
        UnknownName: there is no such verb.
    """
    found = sources()
    if verb not in found:
        raise UnknownName("verb", verb if len(verb) <= console.SHOWN else verb[: console.SHOWN] + "...", found)
    return import_module(f"fishmj.{verb}.__main__" if found[verb].name == "__main__.py" else f"fishmj.{verb}").main


def usage() -> str:
    """Every verb by section, the exit codes, the environment."""
    verbs = present()
    wide = max(map(len, verbs))
    named = {verb for part in SECTIONS.values() for verb in part}
    sections = {**SECTIONS, OTHERS: tuple(verb for verb in verbs if verb not in named)}
    lines = ["usage: fishmj VERB [options]     fishmj VERB --help"]
    for title, part in sections.items():
        rows = [f"  {verb:<{wide}}  {verbs[verb]}" for verb in part if verb in verbs]
        lines += ["", title, *rows] if rows else []
    return "\n".join(
        [
            *lines,
            "",
            "example: fishmj evaluate dob --speeds 0.2 --repeats 1 --out runs/dob",
            "",
            "exit codes",
            *(f"  {code:>3}  {meaning}" for code, meaning in console.EXITS.items()),
            "",
            "fishmj VERB is python -m fishmj.VERB. --json prints one JSON object last, of an error too.",
            "Reports and pages that are there are replaced; data sets, trials and runs only with --overwrite or --force.",
            f"{console.TRACEBACK}=1 in the environment shows the traceback of every error.",
        ]
    )


def dispatch(argv: list[str]) -> int | None:
    """Print the help or the version, or hand over to the verb."""
    if argv[1:] and argv[0] in console.HELP:
        return load(argv[1])([*argv[2:], "--help"])
    if not argv or argv[0] in console.HELP:
        console.say(usage())
        return console.OK if argv else console.BAD_INPUT
    if argv[0] in ("-V", "--version"):
        console.say(f"fishmj {__version__}")
        return console.OK
    return load(argv[0])(argv[1:])


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the console script; returns the exit code."""
    return console.run(dispatch, sys.argv[1:] if argv is None else argv)


if __name__ == "__main__":
    raise SystemExit(main())
