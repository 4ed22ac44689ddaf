"""The verb `fishmj log export`: a trial or a data set for Foxglove, spreadsheets and data frames.

It belongs here and not in `log` because it needs robots: Foxglove draws the links of the one that a trial or `--robot` names.
"""

from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.log import export
from fishmj.log.foxglove import Solid
from fishmj.log.trial import TABLES, Trial, stacked
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import solids
from fishmj.mjcf.reading import load_robot
from fishmj.view.replay.replay_data import named_robot

EXAMPLES = """examples:
  fishmj log export runs/trial_07 --to mcap --out trial_07.mcap        open it in Foxglove: 3D panel, plots by path
  fishmj log export data/calm --to parquet --out calm_parquet          a folder a trial, a file a table
  fishmj log export data/calm --to csv --out calm_csv --tables pose,joint
"""
SOON = 2.0  # s; what is done by then needs no progress


def _place(text: str) -> Path:
    """Path of a file or a folder that can be written."""
    return console.out_folder(text) if Path(text).is_dir() else console.out_file(text)


def options() -> console.Parser:
    """The arguments of `log export`."""
    parser = console.parser("log export", "A trial or a data set -> MCAP (Foxglove), CSV or Parquet.", examples=EXAMPLES)
    parser.add_argument("data", type=console.path, help="trial folder, samples.csv, data set or bundle (.npz)")
    parser.add_argument("--to", choices=export.FORMS, required=True, help="needed; mcap and parquet need the extra `logs`")
    parser.add_argument("--out", type=_place, required=True, help="file (one trial to mcap) or folder; must not exist")
    robot = "mcap: name or TOML of the fish to draw; default: the shipped one that a log names"
    parser.add_argument("--robot", type=console.text, help=robot)
    parser.add_argument("--tables", metavar="A,B", help=f"only these (default: all): {', '.join(TABLES)}")
    parser.add_argument("--force", action="store_true", help="replace what an export wrote there before (default: refuse)")
    return parser


def shape_of(trial: Trial, robot: Robot | None = None) -> tuple[Solid, ...]:
    """Links of `robot`, or of the shipped robot that a trial names; () if it names none.

    Raises ConfigError: the trial has another number of joints than `robot`.
    """
    own = robot or named_robot(trial)
    found = [stacked(trial.tables[n], c) for n, c in (("joint", "j#"), ("truth", "j#"), ("cmd", "c#")) if n in trial.tables]
    if robot and found and found[0].shape[1] != robot.n_joints:
        have = f"trial {trial.name} has {found[0].shape[1]} joints, {robot.name} has {robot.n_joints}"
        raise ConfigError(f"log export --robot: {have}; name the description of the fish that was logged")
    return () if own is None else solids(own)


def main(argv: list[str]) -> int:
    """The command `log export`: exports, and prints what was written. Returns the exit code."""
    args = options().parse_args(argv)
    if args.robot and args.to != "mcap":
        raise ConfigError(f"log export: --robot is for --to mcap, where the fish is drawn; leave it out for {args.to}")
    tables = None if args.tables is None else [name.strip() for name in args.tables.split(",")]
    robot, arrows = load_robot(args.robot) if args.robot else None, []

    def shape(trial: Trial) -> tuple[Solid, ...]:
        drawn = shape_of(trial, robot)
        arrows.extend([] if drawn else [trial.value("robot")])
        return drawn

    with console.Progress(1, "export", unit="trials") as bar:

        def done(count: float, total: int) -> None:
            bar.total = total
            if bar.elapsed > SOON:
                bar.update(count)

        rows = export.export(args.data, args.to, args.out, tables=tables, force=args.force, shape=shape, done=done)
    shown = [{**row, "tables": ", ".join(f"{name} {n}" for name, n in row["tables"].items())} for row in rows]
    console.say(console.table(shown, ("trial", "tables", "bytes")), "", f"{len(rows)} trials ({args.to}) written to {args.out}")
    if arrows:
        console.say(f"robot {arrows[0] or 'not said'}: not a shipped one, drawn as an arrow; --robot my_fish.toml draws it")
    for row in rows:
        if row["absent"]:
            console.say(f"{row['trial']}: has no {', '.join(row['absent'])}")
    if args.json:
        console.emit_json({"to": args.to, "out": str(args.out), "trials": rows})
    return console.OK
