"""`python -m fishmj.log`: bring recordings in, and check data sets."""

import sys
from dataclasses import replace
from pathlib import Path

from fishmj import console
from fishmj.console import Command
from fishmj.errors import LogError
from fishmj.log import importers
from fishmj.log.dataset import read_dataset, write_dataset
from fishmj.log.folder import META_FILE, read_trial
from fishmj.log.timebase import audit
from fishmj.log.trial import Trial
from fishmj.store.manifest import MANIFEST


def bring_in(argv: list[str]) -> int:
    """Import, write, and say what came in."""
    bring = console.parser("log import", "Foreign recordings -> a data set of trial folders with a manifest.")
    bring.add_argument("source", type=Path, help="file or folder")
    bring.add_argument("--out", type=Path, required=True, help="the data set to write; must not exist")
    bring.add_argument("--format", choices=sorted(importers.FORMATS), help="found out when not said")
    bring.add_argument("--topics", type=Path, help="MCAP: the TOML that says which topic is which table")
    args = bring.parse_args(argv)
    if args.out.exists():
        raise LogError(f"{args.out}: exists; choose another name for the data set, or remove it first")
    name = args.format or importers.sniff(args.source)
    trials = importers.read(args.source, name, topics=args.topics)
    meta = {"format": name, **{key: said for key in ("licence", "source") if (said := _said(trials, key))}}
    write_dataset(args.out, ((key, with_notes(trial)) for key, trial in trials.items()), meta=meta)
    rows = [_row(key, trial) for key, trial in trials.items()]
    console.say(console.table(rows), "", f"{len(trials)} trials ({name}) written to {args.out}")
    if args.json:
        notes = {key: list(trial.notes) for key, trial in trials.items()}
        console.emit_json({"format": name, "out": str(args.out), "meta": meta, "trials": rows, "notes": notes})
    return console.OK


def inspect(argv: list[str]) -> int:
    """Exit 0: everything reads; 1: some trials break the schema (all are listed)."""
    look = console.parser("log check", "Read a data set or a trial, audit its clocks; exit 1 where a trial breaks the schema.")
    look.add_argument("data", type=console.path, help="data set, trial folder or samples.csv")
    args = look.parse_args(argv)
    if not args.data.exists():
        raise LogError(f"{args.data}: no such file or folder; expected a data set, a trial folder or a samples.csv")
    audits, broken = [], {}
    for name, load in _trials(args.data).items():
        try:
            trial = load()
        except LogError as error:
            broken[name] = str(error)
            continue
        audits.append(audit(trial))
        console.say(audits[-1].text(), *(f"  note: {note}" for note in trial.notes), "")
    for name, message in broken.items():
        console.warn(f"{name}: {message}")
    console.say(f"{len(audits)} trials read, {len(broken)} refused")
    if args.json:
        console.emit_json({"trials": [one.as_dict() for one in audits], "refused": broken})
    return console.FAILED_CHECK if broken else console.OK


def with_notes(trial: Trial) -> Trial:
    """The reader's remarks moved into the meta data, so that they travel with the trial."""
    said = trial.meta.get("notes")
    before = said if isinstance(said, list) else [said] if said else []
    return replace(trial, meta={**trial.meta, "notes": [*before, *trial.notes]}) if trial.notes else trial


def _trials(path: Path) -> dict:
    """Name -> function that reads the trial."""
    if path.is_dir() and (path / MANIFEST).is_file() and not (path / META_FILE).is_file():
        data = read_dataset(path)
        return {name: lambda name=name: data[name] for name in data.names}
    return {path.name: lambda: read_trial(path)}


def _said(trials: dict[str, Trial], key: str) -> str:
    return "; ".join(sorted({str(trial.value(key)) for trial in trials.values() if trial.value(key)}))


def _row(name: str, trial: Trial) -> dict:
    start, end = trial.span
    tables = ", ".join(f"{table} {len(columns['t'])}" for table, columns in trial.tables.items())
    return {"trial": name, "tables (rows)": tables, "seconds": round(end - start, 3), "notes": len(trial.notes)}


main = console.Group(
    "log",
    "Bring recordings in, and check data sets.",
    {
        "import": Command(
            bring_in, "foreign recordings -> a data set of trial folders with a manifest", "fishmj log import SRC --out DATASET"
        ),
        "check": Command(inspect, "read a data set or a trial, audit its clocks", "fishmj log check DATASET"),
    },
)


if __name__ == "__main__":
    sys.exit(console.run(main))
