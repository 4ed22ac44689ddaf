"""`fishmj <verb> ...`: the same `main(argv)` that `python -m fishmj.<verb>` calls.

A verb is a module, or a package with `__main__.py`, in this folder; its summary is the first line of its docstring,
read without importing it. A verb that this build does not have is not listed.
"""

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from fishmj import __version__, console
from fishmj.errors import UnknownName

# in the order of a day's work
VERBS = (
    "doctor",
    "demo",
    "new",
    "train",
    "evaluate",
    "experiments",
    "log",
    "replay",
    "play",
    "bench",
    "calibrate",
    "gap",
    "deploy",
    "hydro_fit",
    "lbm_oracle",
)
_HERE = Path(__file__).resolve().parent


def source(verb: str) -> Path | None:
    """The file that holds the verb's `main`, or None where this build has none."""
    return next((p for p in (_HERE / verb / "__main__.py", _HERE / f"{verb}.py") if p.is_file()), None)


def present() -> dict[str, str]:
    """The verbs of this build with one line each."""
    return {verb: _summary(path) for verb in VERBS if (path := source(verb)) is not None}


def _summary(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    first = text.strip().partition("\n")[0]
    said = first.partition(": ")[2] if first.startswith("`") else first
    return said[:1].upper() + said[1:]


def load(verb: str) -> console.Main:
    """Import the verb's module and return its `main`."""
    path = source(verb) if verb in VERBS else None
    if path is None:
        raise UnknownName("verb", verb, present())
    return import_module(f"fishmj.{verb}.__main__" if path.name == "__main__.py" else f"fishmj.{verb}").main


def usage() -> str:
    verbs = present()
    wide = max(map(len, verbs))
    return "\n".join(
        [
            "usage: fishmj VERB [options]     fishmj VERB --help",
            "",
            *(f"  {verb:<{wide}}  {summary}" for verb, summary in verbs.items()),
            "",
            "The same as python -m fishmj.VERB.",
            "Exit 0: an answer; 1: a check that fails; 2: bad input; 3: too short or too quiet to tell.",
        ]
    )


def dispatch(argv: list[str]) -> int | None:
    if not argv or argv[0] in ("-h", "--help", "help"):
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
