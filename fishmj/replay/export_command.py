"""The verb `fishmj log export`: a trial or a data set for Foxglove, spreadsheets and data frames.

It lies here and not in `log` because it knows robots: Foxglove draws the links of the one that a trial names.
"""

from argparse import Namespace
from pathlib import Path

from fishmj import console
from fishmj.log import export
from fishmj.log.foxglove import Solid
from fishmj.log.schema import TABLES
from fishmj.log.trial import Trial
from fishmj.mjcf.solids import solids
from fishmj.replay.scene import named_robot

EXAMPLES = """examples:
  fishmj log export runs/trial_07 --to mcap --out trial_07.mcap        open it in Foxglove: 3D panel, plots by path
  fishmj log export data/calm --to parquet --out calm_parquet          a folder a trial, a file a table
  fishmj log export data/calm --to csv --out calm_csv --tables pose,joint
"""


SOON = 2.0  # s; what is done by then needs no progress


def _place(text: str) -> Path:
    """A file or a folder that can be written."""
    return console.out_folder(text) if Path(text).is_dir() else console.out_file(text)


def options() -> console.Parser:
    """The arguments of `log export`."""
    parser = console.parser("log export", "A trial or a data set -> MCAP (Foxglove), CSV or Parquet.", examples=EXAMPLES)
    parser.add_argument("data", type=console.path, help="trial folder, samples.csv, data set or bundle (.npz)")
    parser.add_argument("--to", choices=export.FORMS, required=True, help="needed; mcap and parquet need the extra `logs`")
    parser.add_argument("--out", type=_place, required=True, help="file (one trial to mcap) or folder; must not exist")
    parser.add_argument("--tables", metavar="A,B", help=f"only these (default: all): {', '.join(TABLES)}")
    parser.add_argument("--force", action="store_true", help="replace what an export wrote there before (default: refuse)")
    return parser


def main(argv: list[str]) -> int:
    """The command `log export`. Returns the exit code."""
    return send(options().parse_args(argv))


def shape_of(trial: Trial) -> tuple[Solid, ...]:
    """The links of the shipped robot that a trial names; () where it names none."""
    robot = named_robot(trial)
    return () if robot is None else solids(robot)


def send(args: Namespace) -> int:
    """Export, and say what went out."""
    tables = None if args.tables is None else [name.strip() for name in args.tables.split(",")]
    with console.Progress(1, "export", unit="trials") as bar:

        def done(count: float, total: int) -> None:
            bar.total = total
            if bar.elapsed > SOON:
                bar.update(count)

        rows = export.export(args.data, args.to, args.out, tables=tables, force=args.force, shape=shape_of, done=done)
    shown = [{**row, "tables": ", ".join(f"{name} {n}" for name, n in row["tables"].items())} for row in rows]
    console.say(console.table(shown, ("trial", "tables", "bytes")), "", f"{len(rows)} trials ({args.to}) written to {args.out}")
    for row in rows:
        if row["absent"]:
            console.say(f"{row['trial']}: has no {', '.join(row['absent'])}")
    if args.json:
        console.emit_json({"to": args.to, "out": str(args.out), "trials": rows})
    return console.OK
