"""`fishmj log import`: import recordings with any column names."""

import shlex
import shutil
from argparse import ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NoReturn

from fishmj.base import calib, console, names
from fishmj.base.errors import FishmjError, LogError, UnknownName, UsageError
from fishmj.base.store import Manifest, write_text
from fishmj.base.store.manifest import MANIFEST
from fishmj.log import importers, measurements, physical_checks, tracked_point
from fishmj.log.dataset import write_dataset
from fishmj.log.importers import gather, guess, guessed, other_files, registry, table_forms
from fishmj.log.importers.column_guess import FileKind
from fishmj.log.importers.column_map import ColumnMap, read_map, written
from fishmj.log.importers.convert import convert, go_on, in_order
from fishmj.log.importers.set_option import UNUSED, overrides, refuse_unknown
from fishmj.log.limits import bare, kinds_first, typed
from fishmj.log.timebase import offsets
from fishmj.log.trial import SCHEMA, Trial
from fishmj.log.trial_check import PLAUSIBLE, read_bounds, relaxed_bounds, shipped_bounds
from fishmj.log.trial_folder import checked_meta

ABOUT = """\
Recordings -> a data set of trial folders with a manifest. Sources are never changed.

Without a map the columns are guessed from their names and values; the guess is shown and must be confirmed, on a
terminal by y, elsewhere by --yes. What is unclear is never taken: decide it with --set, or with a map.

Files of one folder are one trial when no two have the same columns (commands, camera, battery), and a trial each when
all have the same; a folder in a folder is looked at by itself; an MCAP file or rosbag2 is a trial; trial folders of our
own format are copied. Where that cannot tell, say --one-trial or --trial-each."""
EXAMPLE = """\
examples:
  fishmj log import commands.csv camera.csv battery.csv --out data/monday --robot swift --yes
  fishmj log import lab/ --out data/lab --set servo1=cmd.c1:deg --set cam_u=pose.x:px*0.0012
  fishmj log import lab/ --write-map MAP.toml        then edit it, and
  fishmj log import lab/ --out data/lab --columns MAP.toml"""
TABLE = "table"  # the format of what is read by its columns
HASHES = ("robot_sha256", "body_sha256")  # of the robot that a log itself names
NOTES = 20  # of one import that are shown
Described = Callable[[str], tuple[dict, float]]  # TOML of a robot -> keys of meta that identify it (mjcf.identity), length [m]
SOON = 5.0  # s before progress shows
LONGEST = 1000  # characters of a message


@dataclass
class ImportResult:
    """Result of an import: the trials to write, one at a time, and the sources that failed."""

    format: str
    trials: list[tuple[str, Callable[[], Trial]]] = field(default_factory=list)  # (name, function that gives the trial)
    skipped: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    guesses: guessed.Guesses = field(default_factory=list)
    maps: list[ColumnMap] = field(default_factory=list)
    page: dict = field(default_factory=dict)  # of weighings, beside the trials
    unsaid: set[str] = field(default_factory=set)  # keys of the meta data that some camera lacks


def options() -> console.Parser:
    """The arguments of `log import`."""
    sub = console.parser("log import", ABOUT, examples=EXAMPLE)
    add = sub.add_argument
    source = "files or folders: CSV and its kin, Parquet, .npz, MCAP, rosbag2, trial folders"
    add("source", type=console.path, nargs="+", help=source)
    add("--out", type=console.out_folder, help="the data set to write; must not exist; needed unless --write-map")
    add("--columns", type=console.path, metavar="MAP.toml", help="which column is which (docs/search/logs.md); default: guessed")
    write_map = "write the guess as a map to edit; with no --out nothing else is done; default: none"
    add("--write-map", type=console.out_file, metavar="MAP.toml", help=write_map)
    decided = "decide one column, or COLUMN=skip; FILE=skip or TOPIC=skip; may be repeated; default: none"
    add("--set", action="append", default=[], metavar="COLUMN=TABLE.COLUMN:UNIT", help=decided)
    add("--topics", type=console.path, metavar="MAP.toml", help="MCAP, rosbag2: which topic is which table; default: guessed")
    formats = f"{', '.join(sorted([*importers.FORMATS, TABLE]))}, or your own as module:function; default: found out"
    add("--format", type=console.text, help=f"{formats}; table: by its columns")
    mjcf = "of a robot in MJCF: refused, since fishmj gap find reads its logs as they are (default none)"
    add("--model", type=console.path, metavar="ROBOT.xml", help=mjcf)
    robot = "name, or the robot's TOML; stored in meta.robot with joint count and hashes; default: not said"
    add("--robot", type=console.text, help=robot)
    about = "name of the experiment, such as steps: of every trial, or of one; may be repeated; default: not said"
    add("--excitation", action="append", default=[], metavar="[TRIAL=]NAME", help=about)
    add("--start", type=_start, metavar="X,Y,DEG", help="where the fish was put [m, m, deg]; default: not said")
    current = "the water's speed and where it moves to in the camera's frame, m/s and deg; 0,0 is still water; default: not said"
    add("--flow", type=console.flow(5), metavar="M/S,DEG", help=current)
    point = "the point of the body that the camera tracks, m ahead and to the left of the reference point; default: that point"
    near = console.numbers(tracked_point.FORM, *[(-tracked_point.FARTHEST, tracked_point.FARTHEST)] * 2)
    add("--marker", type=near, metavar="AHEAD,LEFT", help=point)
    late = "age of a pose at its stamp, s, in place of the described camera_latency; default: not said"
    add("--camera-latency", type=console.number(0, 1), metavar="S", help=late)
    add("--medium", choices=("water", "air"), help="default: not said")
    add("--origin", choices=("measured", "synthetic"), help="default: measured")
    add("--licence", help="of the data, such as CC-BY-4.0; default: not said")
    plausible = "relax a bound on magnitude, such as reach=5000 (m); default: data/calib/plausible.toml"
    add("--plausible", type=_bounds, metavar="NAME=NUMBER", help=plausible)
    rule = sub.add_mutually_exclusive_group()
    rule.add_argument("--one-trial", action="store_true", help="the files of one folder are one trial; default: by their columns")
    rule.add_argument("--trial-each", action="store_true", help="every file is a trial; default: by their columns")
    bad = sub.add_mutually_exclusive_group()
    bad.add_argument("--strict", action="store_true", help="any bad file ends the import with exit 2 (the default)")
    bad.add_argument("--skip-bad", action="store_true", help="bad files are left out and listed; default: --strict")
    add("--yes", action="store_true", help="take the guess without being asked; default: ask on a terminal")
    return sub


def main(argv: list[str], described: Described) -> int:
    """The command `log import`: imports, writes, and reports what was imported and what was not. Returns the exit code."""
    args = options().parse_args(argv)
    with relaxed_bounds(args.plausible or {}):
        try:
            return _run(args, described)
        except LogError as error:  # names from files stand in it
            raise LogError(_line(str(error))) from error


def _run(args: Namespace, described: Described) -> int:
    if args.model is not None:
        instead = shlex.join(["fishmj", "gap", "find", str(args.source[0]), "--model", str(args.model)])
        instead += " reads a robot's logs as they are, without an import"
        raise UsageError(f"log import: --model: {instead}")
    if args.out is None and args.write_map is None:
        raise UsageError("log import: --out is missing; name the data set to write, or --write-map MAP.toml to see the guess")
    if args.out is not None and args.out.exists():
        raise LogError(f"{args.out}: exists; choose another name for the data set, or remove it first")
    if args.write_map is not None and args.write_map.exists():
        raise LogError(f"{args.write_map}: exists, and may hold your own lines; choose another name, or remove it first")
    for source in args.source:
        if args.out is not None and source.is_dir() and args.out.resolve().is_relative_to(source.resolve()):
            raise LogError(f"{args.out}: lies in {source}, which is imported and never changed; choose a place outside")
    meta, length = _meta(args, described)
    each = gather.excitations(args.excitation)
    found = _found(args)
    known = [name for name, _ in found.trials]
    if each and (unknown := sorted(set(each) - {"", *known})):
        raise UnknownName("trial of --excitation", unknown[0], known)
    if found.skipped and not args.skip_bad:
        _refuse_bad(args, found)
    guessed.show(found.guesses)
    if args.write_map is not None:
        _write_map(args, found)
        if args.out is None:
            if args.json:
                console.emit_json({"map": args.write_map, "guess": guessed.rows(found.guesses)})
            return console.OK
    if found.guesses:
        guessed.check_agreed(found.guesses, args.source[0], args.yes)
    rows, notes, told = _write(args, found, meta, each, length)
    for where, message in found.skipped.items():
        console.warn(f"left out: {_line(message if where in message else f'{where}: {message}')}")
    left = f", {len(found.skipped)} left out" if found.skipped else ""
    assumed = tracked_point.assumed(found.unsaid) if found.format != SCHEMA else []
    console.say(
        *(console.table(rows), "", *map(_line, found.notes), *_told(notes), *assumed),
        f"{len(rows)} trials ({found.format}) written to {args.out}{left}",
    )
    if args.json:
        console.emit_json(
            {
                **{"format": found.format, "out": str(args.out), "meta": told, "trials": rows, "assumed": assumed},
                **{"notes": notes, "skipped": found.skipped, "guess": guessed.rows(found.guesses)},
            }
        )
    return console.OK


# ------------------------------------------------------------------------------------------------------------- statements
def _meta(args: Namespace, described: Described) -> tuple[dict, float]:
    """Meta data from the command line (robot, start pose, flow, bounds on magnitude), and the robot's length [m], or 0."""
    length = 0.0
    meta: dict = {key: value for key in ("medium", "origin", "licence", "start") if (value := getattr(args, key)) is not None}
    if args.robot is not None:
        robot, length = robot_of(args.robot, described)
        meta |= robot
    if args.flow is not None:
        meta["flow"] = dict(zip(("speed", "direction", "known"), (*args.flow, True), strict=True))
    if args.camera_latency is not None:
        meta["latency"] = {"pose": args.camera_latency}
    if args.plausible:
        meta[PLAUSIBLE] = args.plausible
    return meta, length


def robot_of(text: str, described: Described) -> tuple[dict, float]:
    """Meta data that identify a robot, and its length: its TOML, a shipped one's file or its own name; any other name alone.

    Raises ConfigError: no such file, no valid description, or no name that may stand in a path.
    """
    source = text if text.endswith(".toml") else calib.robot_called(text)
    return described(source) if source else ({"robot": names.checked(text, "robot", "--robot")}, 0.0)


def _start(text: str) -> list[float]:
    return [*console.pose(shipped_bounds().start)(text)]


def _bounds(text: str) -> dict[str, float]:
    try:
        return read_bounds(text)
    except FishmjError as error:
        raise ArgumentTypeError(str(error)) from error


# --------------------------------------------------------------------------------------------------------------- discovery
def _found(args: Namespace) -> ImportResult:
    known = args.format or (registry.published(args.source[0]) if len(args.source) == 1 and not args.columns else "")
    if known and known != TABLE:
        return _in_format(args.source, known, args)
    stated = overrides(args.set)
    skip = frozenset(name for name, (place, _, _) in stated.items() if place == "skip")
    cache = gather.FileCache(args.topics is not None, args.topics is None and bool(args.columns or known), skip)
    together = True if args.one_trial else False if args.trial_each else None
    found = ImportResult(TABLE)
    items, passed = gather.plan(args.source, cache, together=together)
    found.notes += [*passed, *_changed(args.source)]
    found.page = next((page for source in args.source if source.is_dir() and (page := measurements.read(source))), {})
    mapped = [item for item in items if not item.own and len(item.files) == 1 and cache.mapped(item.files[0])]
    if args.topics is not None and not mapped:
        raise LogError(
            f"{args.source[0]}: --topics is for MCAP and rosbag2 recordings, and there is none; leave it out, or see --columns"
        )
    own = {item.files[0].resolve(): item.name for item in items if item.own}
    foreign = [item for item in items if not item.own and item.files and item not in mapped]
    if args.columns:
        _by_map(foreign, cache, args, found)
    else:
        _guessed(foreign, cache, stated, args.out is None, found)
    kinds = [kind for kinds, _ in found.guesses for kind in kinds]
    readers = {name: _readers(name, kinds, cache, bool(mapped)) for name in stated}
    if unused := {name: stated[name] for name, taken in readers.items() if not taken and (foreign or mapped or own)}:
        if foreign and not args.columns:
            guess.guess(kinds, unused)  # names the nearest
        which = UNUSED["columns" if foreign else "topics" if mapped else "folders"].format(args.columns)
        raise LogError(f"{args.source[0]}: --set {typed(next(iter(unused)))}: no effect on {which}")
    loads: list[tuple[str, Callable[[], Trial]]] = []
    for item in mapped:
        left = {name for name, taken in readers.items() if "topics" in taken} | cache.topics_left.get(item.files[0], set())
        loads.append((item.name, partial(_mapped, item, args.topics, left)))
    loads += [(item.name, partial(gather.read_own, item.files[0], own)) for item in items if item.own]
    found.trials = loads + found.trials
    if mapped or found.trials and not foreign:
        found.format = registry.sniff(mapped[0].files[0]) if mapped else SCHEMA
    found.skipped |= cache.skipped
    if not found.trials and not any(guessed.unclear(gs) or args.out is None for _, gs in found.guesses):
        _nothing(args, found)
    return found


def _readers(name: str, kinds: Sequence[FileKind], cache: gather.FileCache, mapped: bool) -> set[str]:
    """Readers that take a name of --set: "columns" of files, "topics" of a recording with a mapping, or "left" out by its name.

    A mapped recording takes what is left out and belongs to no file, and what tells robots apart, which it may hold, too.
    """
    if name in cache.left:
        return {"left"}
    columns = {"columns"} if any(kind.called(name) for kind in kinds) else set()
    shared = not columns or table_forms.may_tell_apart(name)
    return columns | ({"topics"} if mapped and shared and name in cache.skip else set())


def _by_map(items: list[gather.Item], cache: gather.FileCache, args: Namespace, found: ImportResult) -> None:
    """Reads the map of --columns for these files."""
    wanted = read_map(args.columns)
    known = {column for item in items for sheet in cache.sheets_of(item) for column in sheet.columns}
    refuse_unknown(args.columns, wanted.skip if items else (), known, "column")
    found.maps.append(wanted)
    found.trials += [(item.name, partial(_convert, item, cache, wanted)) for item in items]


def _guessed(items: list[gather.Item], cache: gather.FileCache, stated: dict, no_out: bool, found: ImportResult) -> None:
    """Guesses a column map for every layout of files."""
    for group in gather.layouts(items, cache).values():
        kinds = guess.kinds(sheet for item in group for sheet in cache.sheets_of(item))
        here = {name: value for name, value in stated.items() if any(kind.called(name) for kind in kinds)}
        made = guess.guess(kinds, here)
        where = ", ".join(item.name for item in group[:3]) + (", .." if len(group) > 3 else "")
        try:
            wanted = guessed.map_of(made, kinds, {}, where)
        except LogError as error:
            if guessed.unclear(made) or no_out:
                found.guesses.append((kinds, made))
                found.notes += [] if guessed.unclear(made) else [str(error)]
            else:
                found.skipped |= {str(item.files[0]): str(error) for item in group}
            continue
        found.guesses.append((kinds, made))
        found.maps.append(wanted)
        parts = in_order([sheet for item in group for sheet in cache.sheets_of(item)]) if len(kinds) == 1 else []
        if len(parts) == len(group) and go_on(parts, next(iter(wanted.tables.values())).t.column):
            names = f"{bare(parts[0].name)} to {bare(parts[-1].name)}"
            found.notes.append(
                f"{names}: each begins where the one before ends; --one-trial makes the {len(parts)} files one trial"
            )
        found.trials += [(item.name, partial(_convert, item, cache, wanted)) for item in group]


def _in_format(sources: Sequence[Path], name: str, args: Namespace) -> ImportResult:
    """Recordings in the layout of one published data set."""
    if args.columns or args.set:
        raise LogError(
            f"{sources[0]}: is in format {name}, which needs no map; leave --columns and --set out, or say --format {TABLE}"
        )
    found = ImportResult(name if name in importers.FORMATS else "own")  # the word that loads code stays out of the data set
    tags = gather.tags_of(sources)
    for source in sources:
        if outside := gather.leading_outside(source):
            raise LogError(f"{outside[0]}: a link that leads outside {source}; put the file itself there")
        try:
            trials = importers.read(source, name, topics=args.topics)
        except LogError as error:
            if not source.is_dir() or name not in importers.FORMATS:
                raise
            trials, bad = registry.each(source, name)
            if not trials:
                raise error
            found.skipped |= bad
        front = f"{tags[source]}_" if len(sources) > 1 and source.is_dir() else ""
        found.trials += [(f"{front}{key}", partial(replace, trial)) for key, trial in trials.items()]
    named, told = gather.renamed([gather.Item(key, ()) for key, _ in found.trials])
    found.notes += told
    found.trials = [(item.name, load) for item, (_, load) in zip(named, found.trials, strict=True)]
    return found


def _line(message: str) -> str:
    """A message as one line that a terminal can show."""
    clean = "".join(c if c.isprintable() else " " for c in message)
    return clean if len(clean) <= LONGEST else clean[: LONGEST - 3] + "..."


def _mapped(item: gather.Item, topics: Path | None, skip: set[str]) -> Trial:
    """Reads a recording by its mapping of topics, without what is left out."""
    return replace(next(iter(importers.read(item.files[0], topics=topics, skip=skip).values())), name=item.name)


def _convert(item: gather.Item, cache: gather.FileCache, wanted: ColumnMap) -> Trial:
    sheets = cache.sheets_of(item)
    shift = {table: f", {entry.offset:+g} s" if entry.offset else "" for table, entry in wanted.tables.items()}
    clock = {table: f"{entry.t.column} of the file{shift[table]}" for table, entry in wanted.tables.items()}
    meta = {"source": ", ".join(file.name for file in item.files)[:200], "clock": clock, **wanted.meta}
    marker = tracked_point.stated(meta)
    made = convert(item.name, sheets, wanted, {key: value for key, value in meta.items() if key != tracked_point.KEY})
    made = made if marker is None else tracked_point.referred(made, marker)
    return replace(made, notes=(*made.notes, *offsets(made)))


def _changed(sources: Sequence[Path]) -> list[str]:
    """Differences from a data set's manifest, one line each."""
    out = []
    for source in (source for source in sources if source.is_dir() and (source / MANIFEST).is_file()):
        try:
            changes = [f"{source}: {change}" for change in Manifest.read(source).check(source)]
        except FishmjError as error:
            changes = [str(error)]
        out += [*changes[:3], *([f"and {len(changes) - 3} more"] if len(changes) > 3 else [])]
    return out


def _told(notes: dict[str, list[str]]) -> list[str]:
    """Remarks on the trials, one a line with the number of trials that have it, and the number of further ones."""
    alike: dict[str, list[tuple[str, str]]] = {}  # notes that differ in the trial's name only are one
    for name, note in ((name, note) for name, told in notes.items() for note in told if "meta.toml: missing" not in note):
        alike.setdefault(note.replace(name, "*"), []).append((name, note))
    more = {key: f" (and {len(same) - 1} more trials)" if len(same) > 1 else "" for key, same in alike.items()}
    lines = kinds_first(f"{same[0][0]}: note: {same[0][1]}{more[key]}" for key, same in alike.items())
    rest = [f"and {len(lines) - NOTES} more notes, in meta.toml of each trial"] if len(lines) > NOTES else []
    return [*map(_line, lines[:NOTES]), *rest]


def _refuse_bad(args: Namespace, found: ImportResult) -> NoReturn:
    """Raises LogError with the first recordings that could not be read, in one line."""
    reasons = kinds_first(found.skipped.values())
    more = f"; and {len(reasons) - 3} more" if len(reasons) > 3 else ""
    others = not args.skip_bad and any(name not in found.skipped for name, _ in found.trials)
    leave = "; import the others with --skip-bad" if others else ""
    raise LogError(_line("; ".join(reasons[:3])) + more + leave)


def _nothing(args: Namespace, found: ImportResult) -> NoReturn:
    if found.skipped:
        _refuse_bad(args, found)
    inside = sorted(args.source[0].iterdir()) if args.source[0].is_dir() else []
    for file in inside:
        if file.is_file() and (kind := other_files.kind_of(file)):
            raise LogError(f"{file}: {other_files.advice(file, kind)}")
    formats = "; ".join(f"{name}: {importer.about}" for name, importer in importers.FORMATS.items())
    raise LogError(
        f"{args.source[0]}: nothing to import; expected {', '.join(gather.TABLE_FILES)}, .mcap, .db3, trial "
        f"folders, or one of {formats}{''.join(f'. {note}' for note in found.notes[:3])}"
    )


# --------------------------------------------------------------------------------------------------------------- writing
def _write_map(args: Namespace, found: ImportResult) -> None:
    layouts = len(found.maps or found.guesses)
    if layouts != 1:
        one = f"{layouts} layouts of files, one map cannot describe them; import them one after the other"
        raise LogError(f"{args.source[0]}: {one if layouts else 'no files that need a map; leave --write-map out'}")
    for kinds, made in found.guesses:
        for sheet in (sheet for kind in kinds for sheet in kind.sheets):
            table_forms.refuse_several(sheet, {g.column for g in made if g.said or g.place}, skips=True)
    if found.maps:
        lines = [written(found.maps[0]), *(line for kinds, made in found.guesses for line in guessed.remarks(kinds, made))]
        todo = "read it, mend it"
    else:
        lines = [*guessed.to_complete(*found.guesses[0])]
        todo = "no column is clear, so complete its commented lines"
    write_text(args.write_map, "".join(lines))
    said = [] if found.maps else map(_line, found.notes)
    console.say(*said, f"map written to {args.write_map}: {todo}, and import with --columns {shlex.quote(str(args.write_map))}")


def _write(
    args: Namespace, found: ImportResult, meta: dict, each: dict[str, str], length: float
) -> tuple[list[dict], dict[str, list[str]], dict]:
    """Writes the trials that convert, and adds the others to `found.skipped`. Returns rows, notes, the manifest's meta."""
    rows: list[dict] = []
    notes: dict[str, list[str]] = {}
    about: dict[str, str] = {}  # filled before the manifest, which comes last
    stated: dict[str, set[str]] = {"licence": set(), "source": set()}

    def trials() -> Iterator[tuple[str, Trial]]:
        with console.Progress(len(found.trials), "import", unit="trials") as bar:
            for i, (name, load) in enumerate(found.trials):
                try:
                    said_of = {"excitation": what} if (what := each.get(name, each.get(""))) else {}
                    read = load()
                    read = read if args.marker is None else tracked_point.referred(replace(read, name=name), args.marker)
                    trial = with_notes(_physical(_with_meta(read, {**meta, **said_of}, name), length))
                    checked_meta(args.out / name, trial.meta)
                    rows.append(_row(name, trial))
                except FishmjError as error:
                    found.skipped[name] = str(error)
                    if not args.skip_bad:
                        _refuse_bad(args, found)
                    continue
                notes[name] = list(trial.notes)
                found.unsaid |= tracked_point.unsaid(trial)
                for key, values in stated.items():
                    values |= {str(value)} if (value := trial.value(key)) else set()
                yield name, trial
                if bar.elapsed > SOON:
                    bar.update(i + 1)
        about.update({"format": found.format} | {key: "; ".join(sorted(words))[:500] for key, words in stated.items() if words})

    made = trials()
    if (first := next(made, None)) is None:
        _nothing(args, found)
    try:
        write_dataset(args.out, chain([first], made), meta=about, page=found.page or None)
    except BaseException:
        shutil.rmtree(args.out, ignore_errors=True)  # it did not exist before
        raise
    return rows, notes, about


def _with_meta(trial: Trial, meta: dict, name: str) -> Trial:
    """Trial with the command line's meta data, which take precedence over those of the file."""
    stated = dict(meta)
    for key in (PLAUSIBLE, "latency"):
        if (said := stated.get(key)) and isinstance(trial.meta.get(key), dict):
            stated[key] = {**trial.meta[key], **said}
    own = {key: value for key, value in trial.meta.items() if "robot" not in stated or key not in HASHES}
    whole = {"origin": "measured", **own, **stated}
    notes = list(trial.notes)
    joints = stated.get("joints")
    has = max((len([c for c in columns if c[0] in "cj" and c[1:].isdecimal()]) for columns in trial.tables.values()), default=0)
    if joints and has and has != joints:
        notes.append(f"the robot {stated.get('robot')} has {joints} joints, the columns tell of {has}")
    return replace(trial, meta=whole, name=name, notes=tuple(_line(note) for note in notes))


def _physical(trial: Trial, length: float) -> Trial:
    """The trial without failed reads, and with notes on implausible motion.

    Raises LogError: the trial contradicts itself: a heading, a sign or a unit differs from the map.
    """
    trial, left_out = physical_checks.without_failed_reads(trial)
    found = physical_checks.examine(trial, length=length)
    if wrong := [finding.text for finding in found if finding.level == physical_checks.IMPORT]:
        raise LogError(f"{trial.name}: {'; '.join(wrong)}")
    return replace(trial, notes=tuple(_line(note) for note in (*trial.notes, *left_out, *(f.text for f in found))))


def with_notes(trial: Trial) -> Trial:
    """The trial with the reader's remarks moved into the meta data, so that they travel with it."""
    said = trial.meta.get("notes")
    before = said if isinstance(said, list) else [said] if said else []
    fresh = [note for note in trial.notes if note not in before and "meta.toml: missing" not in note]
    return replace(trial, meta={**trial.meta, "notes": [*before, *fresh]}) if fresh else trial


def _row(name: str, trial: Trial) -> dict:
    start, end = trial.span
    tables = ", ".join(f"{table} {len(columns['t'])}" for table, columns in trial.tables.items())
    return {"trial": name, "tables (rows)": tables, "seconds": round(end - start, 3), "notes": len(trial.notes)}
