"""The flow solver: known answers, convergence, gaits, force maps and drifts.

A verb is a module of this folder with `main(argv)`; one that this build does not have is not offered.
"""

from importlib import import_module
from importlib.util import find_spec

from fishmj import console
from fishmj.errors import UnknownName

VERBS = {
    "cases": "fishmj.lbm_oracle.ladder",
    "converge": "fishmj.lbm_oracle.converge",
    "swim": "fishmj.lbm_oracle.swim",
    "speeds": "fishmj.lbm_oracle.speeds",
    "forcemap": "fishmj.lbm_oracle.forcemap",
    "drift": "fishmj.lbm_oracle.drift",
}


def present() -> dict[str, str]:
    return {verb: module for verb, module in VERBS.items() if find_spec(module) is not None}


def main(argv: list[str]) -> int | None:
    verbs = present()
    if not argv or argv[0] in ("-h", "--help"):
        console.say("usage: fishmj lbm_oracle {" + ", ".join(verbs) + "} [options]     fishmj lbm_oracle VERB --help")
        return console.OK if argv else console.BAD_INPUT
    if argv[0] not in verbs:
        raise UnknownName("verb of lbm_oracle", argv[0], verbs)
    return import_module(verbs[argv[0]]).main(argv[1:])


if __name__ == "__main__":
    raise SystemExit(console.run(main))
