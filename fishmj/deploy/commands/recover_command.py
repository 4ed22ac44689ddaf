"""`fishmj deploy recover`: makes the trial of a swim whose host was killed from its journal."""

from pathlib import Path

from fishmj.base import console
from fishmj.deploy.loop.trial_log import recovered

EXAMPLES = """examples:
  fishmj deploy recover runs/swim_07"""


def options() -> console.Parser:
    """The arguments."""
    made = console.parser(
        "deploy recover", "A trial of the journal that a swim left whose host was killed or lost its power.", examples=EXAMPLES
    )
    made.add_argument("folders", nargs="+", type=console.path, metavar="FOLDER", help="of the swim: --out of deploy swim")
    return made


def main(argv: list[str]) -> int:
    """The command. Exit code 0: every folder is a trial now; 2: one has no journal, or its swim is still running."""
    args = options().parse_args(argv)
    found = {}
    for folder in map(Path, args.folders):
        trial = recovered(folder)
        rows = {name: len(table["t"]) for name, table in trial.tables.items()}
        seconds = trial.span[1]
        console.say(f"{folder}: {seconds:.1f} s; rows: {', '.join(f'{name} {count}' for name, count in rows.items())}")
        found[str(folder)] = {"seconds": round(seconds, 3), "rows": rows}
    if args.json:
        console.emit_json(found)
    return console.OK
