"""`python -m fishmj.log`: bring recordings in, check data sets, state what they hold, hand them to other programs."""

import shlex
import sys
from pathlib import Path

from fishmj.base import console
from fishmj.base.console import Command
from fishmj.base.errors import FishmjError, LogError
from fishmj.base.store import Manifest
from fishmj.base.store.manifest import MANIFEST
from fishmj.log import physical_checks
from fishmj.log.dataset import mend, read_dataset
from fishmj.log.importers import gather
from fishmj.log.limits import bare
from fishmj.log.timebase import audit
from fishmj.log.trial import Trial
from fishmj.log.trial_folder import META_FILE, OF_ARM, faults, read_trial


def check(argv: list[str]) -> int:
    """The command `log check`. Exit 0: everything reads; 1: some trials or files are faulty (one line each)."""
    parser = console.parser(
        "log check",
        "Read a data set or a trial, audit its clocks, run the physical checks; one line a problem, and exit 1. Doubts, which"
        " refuse no command, are printed and pass.",
    )
    parser.add_argument("data", type=console.path, help="data set, trial folder or samples.csv")
    args = parser.parse_args(argv)
    if not args.data.exists():
        raise LogError(f"{args.data}: no such file or folder; expected a data set, a trial folder or a samples.csv")
    audits, broken = [], {}
    impossible: dict[str, list[str]] = {}
    found, changed = _trials(args.data)
    for name, path in found.items():
        try:
            trial = read_trial(path)
            audits.append(audit(trial))
        except (FishmjError, OSError) as error:
            problems = faults(path) or [str(error)]
            broken[name] = "; ".join(problems)
            for problem in problems:
                console.warn(f"{bare(name)}: {problem}")
            continue
        breaches = physical_checks.examine(trial)
        notes = [f"  doubt: {f.text}" for f in breaches if f.level == physical_checks.NOTE]
        console.say(audits[-1].text(), *ending(trial), *notes, *(f"  note: {note}" for note in trial.notes), "")
        if wrong := [f.text for f in breaches if f.level != physical_checks.NOTE]:
            impossible[name] = wrong
            for text in wrong:
                console.warn(f"{bare(name)}: {text}")
    if args.data.is_dir() and broken and not audits and not any(map(gather.is_own, found.values())):
        console.warn(f"{args.data}: no trial folder of a fish; fishmj log import makes one of other recordings; {OF_ARM}")
    for line in changed:
        console.warn(line)
    more = f", {len(impossible)} not physical" if impossible else ""
    more += f", {len(changed)} files changed or gone; {mend(args.data)}" if changed else ""
    console.say(f"{len(audits)} trials read, {len(broken)} refused{more}")
    if args.json:
        result = {"trials": [one.as_dict() for one in audits], "refused": broken, "changed": changed, "not_physical": impossible}
        console.emit_json(result)
    return console.FAILED_CHECK if broken or changed or impossible else console.OK


def ending(trial: Trial) -> list[str]:
    """Line that says how a swim of the tank host ended, by the events in its meta data; [] of another log."""
    events = trial.value("host.events")
    for event in map(str, reversed(events if isinstance(events, list) else [])):
        before, arrow, why = event.partition(" -> NEUTRAL: ")
        if arrow or event.startswith("ended: "):
            return [f"  ended by {bare(why, 120)} at {bare(before.rpartition(' ')[0])}" if arrow else f"  {bare(event, 120)}"]
    return []


def manifest(argv: list[str]) -> int:
    """The command `log manifest`. It reads every trial first, so that a manifest lists only sound trials."""
    parser = console.parser("log manifest", "Write manifest.json into a folder of trial folders, in place; each is read first.")
    parser.add_argument("folder", type=console.path, help="folder of trial folders; a manifest that is there is replaced")
    args = parser.parse_args(argv)
    if not args.folder.is_dir():
        raise LogError(f"{args.folder}: no such folder; expected a folder of trial folders")
    if gather.is_own(args.folder):
        raise LogError(f"{args.folder}: is one trial; name the folder that holds the trial folders")
    trials = sorted(
        path.parent for path in args.folder.rglob(META_FILE) if gather.is_own(path.parent) and _plain(path, args.folder)
    )
    if not trials:
        raise LogError(f"{args.folder}: no trial folder in it; for other recordings see fishmj log import")
    for trial in trials:
        read_trial(trial)
    meta = Manifest.read(args.folder).meta if (args.folder / MANIFEST).is_file() else {}
    made = Manifest.of(args.folder, meta)
    made.write(args.folder)
    console.say(f"{args.folder / MANIFEST}: {len(trials)} trials, {len(made.files)} files")
    if args.json:
        names = [path.relative_to(args.folder).as_posix() for path in trials]
        console.emit_json({"folder": args.folder, "trials": names, "files": len(made.files)})
    return console.OK


def import_recordings(argv: list[str]) -> int:
    """The command `log import`, with the reader of descriptions, which the rest of this room does not import."""
    from fishmj.log import import_command
    from fishmj.mjcf.identity import identity
    from fishmj.mjcf.reading import load_robot

    def described(source: str) -> tuple[dict, float]:
        robot = load_robot(source)
        return identity(robot), robot.length

    return import_command.main(argv, described)


def _plain(path: Path, root: Path) -> bool:
    """Returns True for a path that is neither hidden nor reached by a link from elsewhere."""
    parts = path.relative_to(root).parts
    return not any(part.startswith(".") for part in parts) and path.resolve().is_relative_to(root.resolve())


def _trials(path: Path) -> tuple[dict[str, Path], list[str]]:
    """Trials by name, and the files that differ from the manifest."""
    if path.is_dir() and (path / MANIFEST).is_file() and not (path / META_FILE).is_file():
        changed = [f"{path}: {change}" for change in Manifest.read(path).check(path)]
        return {name: path / name for name in read_dataset(path, verify=False).names}, changed
    if path.is_dir() and not gather.is_own(path) and not (path / META_FILE).is_file():
        inside = sorted(sub for sub in path.iterdir() if sub.is_dir() and not sub.name.startswith(".") and gather.is_own(sub))
        if inside:
            console.warn(f"{path}: has no {MANIFEST}; write it with fishmj log manifest {shlex.quote(str(path))}")
            return {sub.name: sub for sub in inside}, []
    return {path.name: path}, []


main = console.CommandGroup(
    "log",
    "Bring recordings in, check data sets, state what they hold, hand them to other programs.",
    {
        "import": Command(
            import_recordings,
            "recordings -> a data set of trial folders with a manifest",
            "fishmj log import commands.csv camera.csv battery.csv --out data/monday --robot swift",
        ),
        "check": Command(check, "read a data set or a trial, audit its clocks", "fishmj log check data/monday"),
        "manifest": Command(manifest, "write manifest.json into a folder of trial folders", "fishmj log manifest data/monday"),
        "export": Command(
            "fishmj.view.replay.export_command",
            "a trial or a data set -> MCAP (Foxglove), CSV or Parquet",
            "fishmj log export runs/trial_07 --to mcap --out trial_07.mcap",
        ),
    },
)


if __name__ == "__main__":
    sys.exit(console.run(main))
