"""`gap measured NAME|all`: the workflow on measured data of real robots, by each set's own protocol.

FISHMJ_MEASURED=data/public fishmj gap measured tail_fish
"""

from importlib import import_module

from fishmj import console
from fishmj.errors import UnknownName

SETS = ("tail_fish", "servo_xl330", "usv_coastdown", "tendon_fish")


def main(argv: list[str]) -> int:
    parser = console.parser("gap measured", __doc__)
    parser.add_argument("name", help=f"{', '.join(SETS)}, or all; FISHMJ_MEASURED names the folder that holds them")
    args = parser.parse_args(argv)
    if args.name not in (*SETS, "all"):
        raise UnknownName("measured set", args.name, (*SETS, "all"))
    reports = {}
    for name in SETS if args.name == "all" else (args.name,):
        said, reports[name] = import_module(f"fishmj.studies.measured_robots.{name}").run(console.say)
        console.say(said, "")
    if args.json:
        console.emit_json(reports if args.name == "all" else reports[args.name])
    return console.OK
