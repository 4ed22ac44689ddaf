"""`fishmj <verb> ...`: the same `main(argv)` that `python -m fishmj <verb>` calls.

`VERBS` names the module of each verb. Its summary is the first line of that module's docstring, read without importing it.
Installed packages add verbs by entry points in the group `fishmj.verbs` with the value `module:main`.
"""

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
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
}
VERBS = {verb: f"fishmj.{module}" for part in SECTIONS.values() for verb, module in part.items()}


def added() -> dict[str, str]:
    """Verb -> module, of verbs that installed packages add; those that only add commands to a verb of fishmj are left out."""
    return {point.name: point.module for point in entry_points(group=console.VERBS) if point.name not in VERBS}


def present() -> dict[str, str]:
    """One line for each verb."""
    return {verb: _summary(module) for verb, module in (VERBS | added()).items()}


def _summary(module: str) -> str:
    package, _, inside = module.partition(".")
    spec = find_spec(package)
    path = Path(spec.origin if spec and spec.origin else "").parent / f"{inside.replace('.', '/')}.py"
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "" if path.is_file() else ""
    first = text.strip().partition("\n")[0]
    said = first.partition(": ")[2] if first.startswith("`") else first
    return said[:1].upper() + said[1:]


def load(verb: str) -> console.Main:
    """Imports the verb's module and returns its `main`. Raises UnknownName: there is no such verb."""
    module = VERBS.get(verb) or added().get(verb)
    if module is None:
        short = verb if len(verb) <= console.SHOWN else verb[: console.SHOWN] + "..."
        raise UnknownName("verb", short, VERBS | added(), more=console.more_verbs())
    return import_module(module).main


def usage() -> str:
    """Help text: every verb by section, the exit codes, the environment."""
    verbs = present()
    wide = max(map(len, verbs))
    lines = ["usage: fishmj VERB [options]     fishmj VERB --help"]
    for title, part in {**SECTIONS, "added by installed packages": added()}.items():
        lines += ["", title, *(f"  {verb:<{wide}}  {verbs[verb]}" for verb in part)] if part else []
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
