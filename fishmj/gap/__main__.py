"""Find where simulation and measurement disagree, name the missing effect, add it, show the gap shrink.

fishmj gap find DATA            what is missing, with its size, its rivals and the gap before and after
fishmj gap plant EFFECT --out   data in which an effect is hidden
fishmj gap next REPORT          the next most informative experiment
fishmj gap apply REPORT         the next version of the model
fishmj gap check MODEL          does a version still close the gap that it was written for
fishmj gap bench                the blind benchmark
fishmj gap fetch NAME           a public data set, checked
fishmj gap measured NAME        the workflow on measured data of real robots
"""

import sys
from importlib import import_module

from fishmj import console
from fishmj.errors import UnknownName

COMMANDS = {
    "find": "find",
    "plant": "plant",
    "next": "next_experiment",
    "apply": "apply",
    "check": "check",
    "bench": "bench.command",
    "fetch": "fetch",
    "measured": "measured.command",
}


def main(argv: list[str]) -> int:
    if not argv or argv[0] in ("-h", "--help"):
        console.say(__doc__ or "")
        return console.OK if argv else console.BAD_INPUT
    if argv[0] not in COMMANDS:
        raise UnknownName("gap command", argv[0], COMMANDS)
    return import_module(f"fishmj.gap.{COMMANDS[argv[0]]}").main(argv[1:])


if __name__ == "__main__":
    sys.exit(console.run(main))
