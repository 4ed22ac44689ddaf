"""`python -m fishmj replay LOG [LOG2]`: a self-contained MeshCat page of one or more logs, or a top-view film."""

import webbrowser
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.log import Trial, read_trial
from fishmj.view.replay.html import write_html
from fishmj.view.replay.replay_data import robot_of, unlike
from fishmj.view.replay.video import write_mp4, write_png

PAGE = Path("replay.html")
EXAMPLES = """examples:
  fishmj replay runs/trial_07                       replay.html beside you
  fishmj replay runs/sim runs/robot --open          two logs overlaid, in the browser
  fishmj replay runs/trial_07 --mp4 swim.mp4        a top-view film (no screen needed)
  fishmj replay runs/trial_07 --out a.html --speed 0.25
  fishmj replay runs/a --fields runs/a_fields       a flow-solver run with its vorticity

A LOG is a trial folder (meta.toml and tables) or a flat samples.csv, of an hour at most; see docs/search/logs.md. Add
#t=3.5&play=0&view=top to the address of a page to start it at 3.5 s, paused, seen from above. Keys in the page: space plays
and pauses, the arrows step, f follows the fish, v shows and hides the vorticity."""


def options() -> console.Parser:
    """The arguments of `replay`."""
    summary = "Write a replay of logs: one HTML file that needs no network. Files that are there are replaced."
    parser = console.parser("replay", summary, examples=EXAMPLES)
    add = parser.add_argument
    add("logs", type=console.path, nargs="+", metavar="LOG", help="trial folder or samples.csv; more than one are overlaid")
    page = f"the page to write; default {PAGE}, and none where only --mp4 or --png is asked for"
    add("--out", type=console.out_file, metavar="FILE", help=page)
    fields = "of the first log: vorticity slices by `lbm_oracle swim --fields`; by default none are shown"
    add("--fields", type=console.path, metavar="FOLDER", help=fields)
    add("--mp4", type=console.out_file, metavar="FILE", help="write a top-view film; by default none")
    add("--png", type=console.out_file, metavar="FILE", help="write a top-view picture, at --at seconds; by default none")
    add("--at", type=console.number(0, 1e6), default=0.0, metavar="S", help="time of the picture from the start")
    add("--speed", type=console.number(0.01, 100), default=1.0, help="playing speed, 1 = real time")
    robot = "description (name or TOML) of the log's fish; default the shipped one that the log names, else fish"
    add("--robot", type=console.text, help=robot)
    add("--title", type=console.text, help="heading of the page; by default the names of the logs")
    add("--open", action="store_true", help="open the page in the browser")
    return parser


def main(argv: list[str] | None = None) -> int:
    """The verb `replay`. Returns the exit code."""
    args = options().parse_args(argv)
    trials = [read_trial(path) for path in args.logs]
    ends = max(end - start for start, end in (trial.span for trial in trials))
    if args.png and args.at > ends:
        raise ConfigError(f"replay: --at {args.at:g} s, and the logs end at {ends:.2f} s; expected 0 to {ends:.2f}")
    title = args.title or " and ".join(trial.name or Path(path).stem for trial, path in zip(trials, args.logs, strict=True))
    for trial in trials:
        if note := drawn_as(trial, args.robot):
            console.warn(note)
    page = args.out or (PAGE if args.open or not (args.mp4 or args.png) else None)
    written = [write_html(trials, page, args.robot, title, speed=args.speed, fields=args.fields)] if page else []
    if args.mp4:
        written.append(write_mp4(trials, args.mp4, args.robot, speed=args.speed, title=title, fields=args.fields))
    if args.png:
        written.append(write_png(trials, args.png, args.at, args.robot, title=title, fields=args.fields))
    report(trials, written, as_json=args.json)
    if args.open:
        webbrowser.open(written[0].resolve().as_uri())
    return 0


def drawn_as(trial: Trial, robot: str | None) -> str:
    """Remark on a trial that is drawn as a robot other than its own. Raises ConfigError if it cannot be drawn as this one."""
    drawn, old = robot_of(trial, robot), trial.value("robot_sha256") is not None and trial.value("body_sha256") is None
    return unlike(trial, drawn) if old or robot is not None else ""


def report(trials: list[Trial], written: list[Path], *, as_json: bool) -> None:
    """Prints what was read and written."""
    for trial in trials:
        for note in trial.notes:
            console.warn(f"{trial.name}: {note}")
    sizes = [(str(path), path.stat().st_size) for path in written]
    if as_json:
        files = [{"path": path, "bytes": size} for path, size in sizes]
        console.emit_json({"files": files, "trials": [{"name": t.name, "span": t.span, "notes": t.notes} for t in trials]})
    else:
        console.say(*(f"wrote {path} ({size / 1e6:.2f} MB)" for path, size in sizes))


if __name__ == "__main__":
    raise SystemExit(console.run(main))
