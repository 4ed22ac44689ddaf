"""Data sets: a folder of trial folders with a `manifest.json` that holds the sha256 of every file."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from fishmj.errors import LogError, UnknownName
from fishmj.log import measurements
from fishmj.log.folder import META_FILE, read_trial, write_trial
from fishmj.log.trial import Trial
from fishmj.store import Manifest


@dataclass(frozen=True)
class Dataset:
    """Trials by name, read one at a time when asked for; in order of name."""

    folder: Path
    names: tuple[str, ...]
    meta: dict

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Trial]:
        return (self[name] for name in self.names)

    def __getitem__(self, name: str) -> Trial:
        if name not in self.names:
            raise UnknownName(f"trial of {self.folder}", name, self.names)
        return read_trial(self.folder / name)


def read_dataset(folder: str | Path, *, verify: bool = True) -> Dataset:
    """Open a data set; with `verify` every file is hashed against the manifest first.

    Raises:
        LogError: the folder holds no trial. StoreError: no manifest, or files missing or changed (all are listed).
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise LogError(f"{folder}: no such data set; expected a folder of trial folders with manifest.json")
    manifest = Manifest.read(folder)
    if verify:
        manifest.verify(folder)
    names = tuple(sorted(str(Path(file).parent) for file in manifest.files if Path(file).name == META_FILE))
    if not names:
        raise LogError(f"{folder}: the manifest names no {META_FILE}; it is not a data set of trials")
    return Dataset(folder, names, manifest.meta)


def write_dataset(
    folder: str | Path,
    trials: Mapping[str, Trial] | Iterable[tuple[str, Trial]],
    *,
    meta: dict | None = None,
    overwrite: bool = False,
    form: str = "auto",
    precision: str = "auto",
    page: Mapping | None = None,
) -> Path:
    """Write trials as sub-folders (an iterable is consumed one at a time) and a page of weighings (measurements.py), then the
    manifest, last and atomically."""
    folder = Path(folder)
    count = 0
    for name, trial in trials.items() if isinstance(trials, Mapping) else trials:
        if not name or Path(name).is_absolute() or ".." in Path(name).parts or name.startswith("."):
            raise LogError(f"{folder}: {name!r} cannot name a trial; use letters, digits, - and _")
        write_trial(folder / name, trial, overwrite=overwrite, form=form, precision=precision)
        count += 1
    if not count:
        raise LogError(f"{folder}: no trials to write")
    if page:
        measurements.write(folder, page)
    Manifest.of(folder, meta).write(folder)
    return folder
