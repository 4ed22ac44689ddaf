"""`fishmj <verb> ...`: the same `main(argv)` that `python -m fishmj <verb>` calls.

`VERBS` names the module of each verb. Its summary is the first line of that module's docstring, read without importing it.
"""

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from fishmj import __version__
from fishmj.base import console
from fishmj.base.errors import UnknownName

# section of the help, in the order of a day's work -> verb -> module with its `main`
SECTIONS = {
    "begin": {"doctor": "base.doctor", "demo": "view.demo", "new": "mjcf.new.__main__"},
    "policies": {
        "train": "train.__main__",
        "evaluate": "evaluate.__main__",
        "policy": "evaluate.policy_command",
        "experiments": "evaluate.experiments.__main__",
        "tune": "evaluate.tune_gains",
        "replay": "view.replay.__main__",
        "play": "view.play.__main__",
    },
    "the robot": {"deploy": "deploy.__main__"},
    "a robot's logs": {
        "log": "log.__main__",
        "calibrate": "gap.calibrate.__main__",
        "gap": "gap.__main__",
        "effects": "effects.__main__",
    },
    "the water": {
        "hydro_fit": "hydro_fit.__main__",
        "lbm_oracle": "lbm_oracle.__main__",
        "campaign": "hydro_fit.campaign.__main__",
    },
    "speed": {"bench": "evaluate.bench.__main__"},
}
VERBS = {verb: module for part in SECTIONS.values() for verb, module in part.items()}
_HERE = Path(__file__).resolve().parent


def present() -> dict[str, str]:
    """One line for each verb."""
    return {verb: _summary(_HERE / f"{module.replace('.', '/')}.py") for verb, module in VERBS.items()}


def _summary(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    first = text.strip().partition("\n")[0]
    said = first.partition(": ")[2] if first.startswith("`") else first
    return said[:1].upper() + said[1:]


def load(verb: str) -> console.Main:
    """Imports the verb's module and returns its `main`. Raises UnknownName: there is no such verb."""
    if verb not in VERBS:
        raise UnknownName("verb", verb if len(verb) <= console.SHOWN else verb[: console.SHOWN] + "...", VERBS)
    return import_module(f"fishmj.{VERBS[verb]}").main


def usage() -> str:
    """Help text: every verb by section, the exit codes, the environment."""
    verbs = present()
    wide = max(map(len, verbs))
    lines = ["usage: fishmj VERB [options]     fishmj VERB --help"]
    for title, part in SECTIONS.items():
        lines += ["", title, *(f"  {verb:<{wide}}  {verbs[verb]}" for verb in part)]
    return "\n".join(
        [
            *lines,
            "",
            "example: fishmj evaluate dob --speeds 0.2 --repeats 1 --out runs/dob",
            "",
            "exit codes",
            *(f"  {code:>3}  {meaning}" for code, meaning in console.EXITS.items()),
            "",
            "fishmj VERB is python -m fishmj VERB. --json prints one JSON object last, of an error too.",
            "Reports and pages that are there are replaced; data sets, trials and runs only with --overwrite or --force.",
            f"{console.TRACEBACK}=1 in the environment shows the traceback of every error.",
        ]
    )


def dispatch(argv: list[str]) -> int | None:
    """Prints the help or the version, or runs the verb."""
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
