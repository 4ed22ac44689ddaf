"""The data sets that a search reads: a folder of trial folders, or a bundle."""

from pathlib import Path

from fishmj.base.errors import FishmjError, LogError, StoreError
from fishmj.base.store import sha256
from fishmj.base.store.manifest import MANIFEST
from fishmj.gap.records.records import record_of
from fishmj.log import Trial, measurements, physical_checks, trial_check
from fishmj.log.dataset import Taken, read_bundle, take
from fishmj.log.table_files import row_place
from fishmj.log.trial import readings_sha256

BUNDLE = ".npz"


def trials_in(data: Path) -> list[Trial]:
    """The readable trials of a data set, under their folders' names, or those of a bundle.

    Raises LogError, StoreError: nothing readable there.
    """
    return list(readable_trials(data).trials.values())


def readable_trials(data: Path, dt: float | None = None) -> Taken:
    """Readable trials of a data set, without rows of failed reads.

    dt: also leave out trials that cannot be compared at this step [s] of a model.

    Raises LogError, StoreError: nothing readable there.
    """
    found = _bundle(data) if data.suffix == BUNDLE else take(data)
    trials, notes, broken = {}, list(found.notes), dict(found.broken)
    for name, trial in found.trials.items():
        trials[name], left_out = physical_checks.without_failed_reads(named(name, trial))
        notes += [f"{name}: {note}" for note in left_out]
    first: dict[str, str] = {}
    for name in [name for name, trial in trials.items() if trial.value("origin") == "measured"]:
        if (other := first.setdefault(readings_sha256(trials[name]), name)) != name:
            broken[name] = f"has exactly the readings of {other}: one recording under two names"
            del trials[name]
    if dt is not None:
        for name in list(trials):
            try:
                record_of(trials[name], dt)
            except FishmjError as error:
                broken[name] = str(error)
                del trials[name]
    if not trials:
        raise LogError(f"{data}: no trial can be compared; {'; '.join(f'{n}: {why}' for n, why in list(broken.items())[:3])}")
    return found._replace(trials=trials, broken=broken, notes=tuple(notes))


def trials_named(data: Path, names: list) -> list[Trial]:
    """The trials of those names, all of them. Raises LogError: one is missing, or cannot be read."""
    found = readable_trials(data)
    for name in names:
        if name not in found.trials:
            why = found.broken.get(str(name), "no such trial")
            raise LogError(f"{data}: {str(name)[:64]!r}, a record of the stated gap: {why}")
    return [trial for name, trial in found.trials.items() if name in names]


def _bundle(data: Path) -> Taken:
    """The trials of a bundle, each checked like a folder."""
    trials, broken = {}, {}
    for trial in read_bundle(data):
        if not isinstance(trial.name, str) or not isinstance(trial.meta, dict):
            raise StoreError(f"{data}: not a bundle of trials (invalid name, or no meta data); write it again")
        try:
            trial_check.check_meta(trial.meta, f"{data}: {trial.name}")
            for name, table in trial.tables.items():
                trial_check.check_table(name, table, row_place(data / trial.name / name))
        except FishmjError as error:
            broken[trial.name] = str(error)
            continue
        trials[trial.name] = trial
    return Taken(trials, broken, (), sha256(data))


def page_in(data: Path) -> dict:
    """The page of weighings beside the trials of a data set; {} without one."""
    return {} if data.suffix == BUNDLE else measurements.read(data)


def named(name: str, trial: Trial) -> Trial:
    """The trial under its folder's name."""
    return Trial(trial.meta, trial.tables, name=name, notes=trial.notes)


def digest(data: Path) -> str:
    """sha256 of a bundle, of a folder's manifest, or of the manifest that its files would have.

    Raises LogError, StoreError: no data set there.
    """
    if data.suffix == BUNDLE or (data / MANIFEST).is_file():
        return sha256(data if data.suffix == BUNDLE else data / MANIFEST)
    return take(data).sha256
