"""`python -m fishmj new`: describe your fish: eight answers, a table of sections or a photo become a checked description."""

import argparse
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any

from fishmj.base import console
from fishmj.base.errors import ConfigError, UsageError

EXAMPLES = """examples:
  fishmj new                                                     asks eight questions
  fishmj new carp --length 0.6 --height 0.11 --width 0.07 --tail-height 0.14 --mass 1.6 --links 5 --servo lx-824
  fishmj new carp --length "60 cm" --links 5 --yes               defaults for the rest
  fishmj new carp --sections table.csv --unit mm --joints 0.215,0.285,0.355 --mass 1.1 --servo lx-824
  fishmj new carp --photo side.png --length 0.54 --nose right --mass 1.1 --width 0.062 --links 4 --servo lx-824
  fishmj new carp --yes --stall-torque 20kgcm --no-load-speed 0.16s/60deg --voltage 7.4 --stall-current 3
  fishmj new --check carp.toml                                   after an edit: the same checks

Exit 1: a check says that the description is wrong; a new one was written all the same.
"""


def options() -> console.Parser:
    """The arguments of `new`."""
    summary = "Describe your fish: from eight answers, a table of sections or a photo to a checked description."
    p = console.parser("new", summary, examples=EXAMPLES)
    p.add_argument("name", nargs="?", metavar="NAME", help="of the fish, in logs, waters and policies (asked; default my_fish)")
    out = "description to write (default NAME.toml); NAME.png goes beside it"
    p.add_argument("--out", type=console.out_file, metavar="FILE", help=out)
    p.add_argument("--force", action="store_true", help="overwrite files that are there")
    p.add_argument("--yes", action="store_true", help="ask nothing: defaults for what is missing")
    check = "check a description that is there, such as an edited one, and write nothing (default: describe a new fish)"
    p.add_argument("--check", type=console.path, metavar="FILE", help=check)
    _answers(p.add_argument_group("answers", "a length may be 0.6, '60 cm' or 600mm, a mass 1.3 or 1300g; without a unit SI"))
    _outline(p.add_argument_group("measured outline, in place of length, height, width and tail height"))
    _data_sheet(p.add_argument_group("servo from its data sheet, in place of --servo; all at one voltage"))
    return p


def _answers(group) -> None:
    """Adds options for the answers. An option without a type is parsed later, because its range depends on earlier answers."""
    from fishmj.mjcf.new.answers import FIN, HEIGHT, LENGTH, TAIL, TALL, WIDE, WIDTH
    from fishmj.mjcf.new.fish_toml import SIDE_SPAN
    from fishmj.mjcf.new.quantity import quantity
    from fishmj.mjcf.new.shape import LINKS
    from fishmj.mjcf.servos import SHELF

    share = "{}, {:g} to {:g} of the length (asked; default {:g} of {})"
    few, share_of_head, span = console.whole(*LINKS), console.number(0.1, 0.8), quantity("length", 0.0, 1.0)
    sheets = f"{', '.join(SHELF)}, or a TOML file with the data sheet (asked; default lx-824)"
    rows = (
        ("length", "M", None, "nose to tail fin, {:g} to {:g} m (asked; default 0.6)".format(*LENGTH)),
        ("height", "M", None, share.format("greatest height of the body", *HEIGHT, TALL, "it")),
        ("width", "M", None, share.format("greatest width of the body", *WIDTH, WIDE, "the height")),
        ("tail-height", "M", None, share.format("of the tail fin", *TAIL, FIN, "the body's")),
        ("mass", "KG", None, "as it swims, half to twice what the hull displaces (asked; default what it displaces)"),
        ("links", "N", few, "rigid links, {} to {} (asked; default 4)".format(*LINKS)),
        ("joints", "M,..", None, "in place of --links: the joints' distances from the nose (default: by --links)"),
        ("head", "SHARE", share_of_head, "of the length, 0.1 to 0.8, with --links (default 0.4)"),
        ("servo", "NAME", console.text, sheets),
        ("side-fin", "M", span, f"span of each side fin, 0 for none (default {SIDE_SPAN:g} of the length)"),
    )
    for name, metavar, kind, words in rows:
        group.add_argument(f"--{name}", type=kind, metavar=metavar, help=words)


def _outline(group) -> None:
    """Options of a table of sections and of a photo."""
    from fishmj.mjcf.new.answers import WIDE
    from fishmj.mjcf.new.quantity import KINDS, quantity

    words = "columns x,height,width from nose to tail; units in the header or by --unit (default none)"
    group.add_argument("--sections", type=console.path, metavar="CSV", help=words)
    words = "of the table where its header does not say (default m)"
    group.add_argument("--unit", choices=tuple(KINDS["length"].units), help=words)
    words = "from the side, PNG or JPG; scale from --length or --scale, widths from --width (default none)"
    group.add_argument("--photo", type=console.path, metavar="PNG", help=words)
    words = "of the photo, m per pixel, 1e-06 to 0.1 (default from --length)"
    group.add_argument("--scale", type=quantity("scale", 1e-6, 0.1), metavar="M", help=words)
    words = "side of the photo that the nose points to (default: the end that looks like a head, which is said)"
    group.add_argument("--nose", choices=("left", "right"), help=words)
    words = "of a photo's fish without --width: greatest width over height, 0.05 to 3 (default %(default)g)"
    group.add_argument("--width-ratio", type=console.number(0.05, 3.0), default=WIDE, metavar="R", help=words)


def _data_sheet(group) -> None:
    """One option for each figure of a servo's data sheet."""
    from fishmj.mjcf.new.answers import NEEDED, SHEET
    from fishmj.mjcf.new.quantity import KINDS

    for key, figure in SHEET.items():
        default = "that of --servo" if key in NEEDED else "none"
        words = f"{figure.text}; {figure.low:g} to {figure.high:g} {KINDS[figure.kind].si} (default {default})"
        group.add_argument(f"--{key.replace('_', '-')}", type=figure.parse, metavar=figure.kind[0].upper(), help=words)


def main(argv: list[str]) -> int:
    """The verb `new`: asks, builds the fish, and writes and checks its description. Returns the exit code."""
    args = options().parse_args(argv)
    if args.check is not None:
        return check(args)
    from fishmj.mjcf.new import answers
    from fishmj.mjcf.new.fish_toml import SIDE_SPAN, FishAnswers
    from fishmj.mjcf.new.shape import read_sections

    given = given_answers(args)
    ask = None if args.yes or not (sys.stdin.isatty() and sys.stdout.isatty()) else input
    if args.name is not None or args.yes or args.out is not None:
        free(args, paths(args, str(args.name or "my_fish")))  # before anything is asked
    known: dict[str, Any] = {"head": args.head}
    seen = None
    if sheet := sheet_of(args):
        known["servo"] = sheet
    if args.sections is not None:
        known["outline"] = read_sections(args.sections, args.unit)
    if args.photo is not None:
        seen = read_side_view(args)
        known["outline"] = seen.outline
        console.say(*seen.notes)
    if "outline" in known:
        known |= {"length": known["outline"].length, "height": None, "width": None, "tail_height": None}
    known, origin = answers.gather(known, given, ask, defaults=args.yes)
    files = paths(args, known["name"])
    free(args, files)
    outline = answers.hull(known)
    span = args.side_fin if args.side_fin is not None else round(SIDE_SPAN * outline.length, 3)
    answered = {key: known[key] for key in ("name", "mass", "joints")}
    fish = FishAnswers(**answered, outline=outline, sheet=known["servo"], side_span=span, origin=origin)
    return finish(args, files, fish, seen)


def check(args) -> int:
    """Checks the description `--check` and prints the findings; it writes nothing. Returns the exit code."""
    from fishmj.mjcf.reading import load_robot

    usual = vars(options().parse_args([])) | {"check": args.check, "json": args.json}
    if beside := [key for key, value in vars(args).items() if value != usual[key]]:
        names = ", ".join(key if key == "name" else f"--{key.replace('_', '-')}" for key in beside)
        raise UsageError(f"new: --check with {names}: it reads {args.check} as it is; leave them out")
    facts, wrong = found_of(load_robot(args.check))
    if args.json:
        console.emit_json({"description": str(args.check), **facts, "passed": not wrong})
    return console.FAILED_CHECK if wrong else console.OK


def found_of(robot) -> tuple[dict[str, Any], bool]:
    """Swims the robot until its speed is steady; prints its checks. Returns the facts for JSON, True if one is wrong."""
    from fishmj.mjcf.new.swim_check import checks, swim_of
    from fishmj.sim import Sim
    from fishmj.water.choice import chosen

    swim = swim_of(Sim(chosen(robot).robot))  # without the note that a new fish has no fitted water
    found = checks(robot, swim)
    rows = [{"check": c.what, "found": c.found, "expected": c.expected, "": c.verdict} for c in found]
    console.say("", console.table(rows), "", *(f"{c.what}: {c.advice}" for c in found if c.advice))
    facts = {"name": robot.name, "speed": swim.speed, "lengths_per_second": swim.speed / robot.length, "torque": swim.torque}
    facts |= {"drive": swim.drive, "stall_torque": robot.servo.torque, "voltage": robot.servo.voltage}
    facts |= {"mass": round(robot.mass, 9), "checks": [c._asdict() for c in found]}
    return facts, any(c.verdict == "wrong" for c in found)


def finish(args, files: dict[str, Path], fish, seen) -> int:
    """Checks the description after reading it back, writes all files, and prints the findings. Returns the exit code."""
    from fishmj.base import store
    from fishmj.mjcf.new.fish_picture import picture
    from fishmj.mjcf.new.fish_toml import robot_of, toml_of
    from fishmj.mjcf.reading import robot_from_dict

    text = toml_of(robot_of(fish), fish)
    robot = robot_from_dict(tomllib.loads(text), str(files["description"]))  # nothing is written that does not read back
    facts, wrong = found_of(robot)
    store.write_text(files["description"], text)
    store.write_bytes(files["picture"], picture(robot))
    if seen is not None:
        store.write_bytes(files["outline"], seen.overlay)
    written = {key: str(files[key]) for key in ("description", "picture", *(("outline",) if seen is not None else ()))}
    console.say(*(f"wrote {path}" for path in written.values()), "", *next_steps(files["description"], robot.name))
    if args.json:
        notes = {} if seen is None else {"notes": list(seen.notes)}
        console.emit_json({**written, **facts, **notes, "passed": not wrong})
    return console.FAILED_CHECK if wrong else console.OK


def next_steps(path: Path, name: str) -> list[str]:
    """Lines with the next commands to type."""
    own = shlex.quote(str(path))
    return [
        "next",
        f"  fishmj play --robot {own} --controller drift                                     look at it",
        f"  fishmj train --preset quick --robot {own} --out runs/{name}",
        f"  fishmj evaluate runs/{name} --robot {own} --repeats 1",
        "before a policy leaves the computer",
        f"  fishmj hydro_fit --fish {own} --out runs/water     its water from the flow solver; without a GPU a preview",
        f"  fishmj log import LOGS --out data/{name} --robot {own}     your own logs, then fishmj calibrate and fishmj gap find",
    ]


def paths(args, name: str) -> dict[str, Path]:
    """Paths of the files to write: description, picture and, with a photo, outline."""
    out = args.out if args.out is not None else Path(f"{name}.toml")
    if out.suffix != ".toml":
        raise UsageError(f"new: --out {out}: a description's name ends in .toml; for example {out.with_suffix('.toml')}")
    made = {"description": out, "picture": out.with_suffix(".png")}
    return made | ({"outline": out.with_name(f"{out.stem}-outline.png")} if args.photo is not None else {})


def free(args, files: dict[str, Path]) -> None:
    """Raises ConfigError if one of the files exists already."""
    there = [str(path) for path in files.values() if path.exists()]
    if there and not args.force:
        raise ConfigError(f"new: {', '.join(there)}: there already; add --force to overwrite, or choose another --out")
    if args.photo is not None and args.photo.resolve() in {path.resolve() for path in files.values()}:
        raise ConfigError(f"new: {args.photo}: the photo itself would be overwritten; choose another --out")


def given_answers(args) -> dict[str, str]:
    """Answers on the command line, as text by question. Raises UsageError if two of them exclude each other."""
    if args.links is not None and args.joints is not None:
        raise UsageError("new: --links and --joints: one of them, not both")
    if args.sections is not None and args.photo is not None:
        raise UsageError("new: --sections and --photo: one of them, not both")
    measured = "--sections" if args.sections is not None else "--photo" if args.photo is not None else ""
    taken = {"--sections": ("length", "height", "width", "tail_height"), "--photo": ("height", "tail_height")}.get(measured, ())
    for key in taken:
        if getattr(args, key) is not None:
            raise UsageError(f"new: --{key.replace('_', '-')} with {measured}: the outline says it; leave it out")
    for key, goes in (("scale", "--photo"), ("nose", "--photo"), ("unit", "--sections")):
        if getattr(args, key) is not None and measured != goes:
            raise UsageError(f"new: --{key} goes with {goes}")
    texts = {key: getattr(args, key) for key in ("name", "mass", "servo")}
    texts |= {"joints": args.joints if args.joints is not None or args.links is None else str(args.links)}
    if not measured:
        texts |= {key: getattr(args, key) for key in ("length", "height", "width", "tail_height")}
    if args.joints is not None and "," not in args.joints:
        texts["joints"] = f"{args.joints} m" if args.joints.strip().isdecimal() else args.joints
    return {key: text for key, text in texts.items() if text is not None}


def sheet_of(args):
    """The servo of the data sheet options, or None without any. Raises UsageError if they are incomplete."""
    from fishmj.mjcf.new.answers import NEEDED, SHEET
    from fishmj.mjcf.servos import DataSheet

    figures = {key: getattr(args, key) for key in SHEET if getattr(args, key) is not None}
    if not figures:
        return None
    missing = [key for key in NEEDED if key not in figures]
    if missing or args.servo is not None:
        what = f"without --{', --'.join(missing)}" if missing else "with --servo"
        options = ", ".join(f"--{key}" for key in figures)
        raise UsageError(f"new: {options} {what}: give all of a data sheet, or a --servo".replace("_", "-"))
    return DataSheet(name="data-sheet", source="data sheet figures, given on the command line", **figures)


def read_side_view(args):
    """Outline from the photo; the options for length and width serve as answers and as its scale."""
    from fishmj.mjcf.new.answers import LENGTH
    from fishmj.mjcf.new.photo import read_photo
    from fishmj.mjcf.new.quantity import quantity

    sizes = {}
    for key, (low, high) in (("length", LENGTH), ("width", (0.001, LENGTH[1]))):
        try:
            sizes[key] = None if getattr(args, key) is None else quantity("length", low, high)(getattr(args, key))
        except argparse.ArgumentTypeError as error:
            raise UsageError(f"new: --{key}: {error}") from error
    return read_photo(args.photo, scale=args.scale, nose=args.nose, width_ratio=args.width_ratio, **sizes)


if __name__ == "__main__":
    raise SystemExit(console.run(main))
