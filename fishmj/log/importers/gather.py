"""Assigns files to trials.

The table in docs/search/logs.md, "Which files make which trial", states the rules. Hidden files and links that lead outside are
ignored. So are pictures, films, documents and programs, by name, and text without a table of numbers; data of other programs are
refused.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from fishmj.base import console, names
from fishmj.base.errors import FishmjError, LogError, UsageError
from fishmj.log.importers import delimited, guess, mcap, message_recordings, message_sheets, other_files, rosbag2, table_forms
from fishmj.log.importers.binary_tables import NPZ, PARQUET, TORCH, read_parquet, read_tables
from fishmj.log.importers.quaternion import with_headings
from fishmj.log.importers.sheet import Sheet
from fishmj.log.limits import bare, most_bytes, quoted, regular
from fishmj.log.trial import TABLES, Trial
from fishmj.log.trial_folder import FLAT_FILE, META_FILE, read_trial

SOON = 5.0  # s before progress shows
DEEP = 12  # folders in folders
MANY = 100_000  # files
TABLE_FILES = (*delimited.SUFFIXES, *PARQUET, *NPZ, *TORCH)


@dataclass(frozen=True)
class Item:
    """Source of one trial: a folder in our format, or foreign files."""

    name: str
    files: tuple[Path, ...]
    own: bool = False
    episode: int | None = None  # of a file that holds several trials


@dataclass
class FileCache:
    """Reads every file once, and caches the result as far as memory allows."""

    topics: bool = False  # a mapping of topics was given: recordings need no sheets
    columns: bool = False  # recordings are read by their columns, whatever their topics are called
    skip: frozenset[str] = frozenset()  # names of files, topics and columns that the user leaves out
    left: set[str] = field(default_factory=set)  # those of them that were found
    topics_left: dict[Path, set[str]] = field(default_factory=dict)  # those that are topics of a recording with a mapping
    skipped: dict[str, str] = field(default_factory=dict)  # file -> why it was not read
    _kept: dict[Path, list[Sheet]] = field(default_factory=dict)
    _mapped: dict[Path, bool] = field(default_factory=dict)
    _size: float = 0.0

    def sheets(self, path: Path) -> list[Sheet]:
        """The sheets of one file. Raises FishmjError: the file cannot be read."""
        if path in self._kept:
            return self._kept[path]
        found = [with_headings(sheet) for sheet in read_sheets(path)]
        self._size += sum(8.0 * len(sheet) * len(sheet.columns) for sheet in found)
        if self._size < most_bytes() / 2:
            self._kept[path] = found
        return found

    def sheets_of(self, item: Item) -> list[Sheet]:
        """The sheets of one trial."""
        return [s for file in item.files for s in self.sheets(file) if item.episode is None or s.episode == item.episode]

    def mapped(self, path: Path) -> bool:
        """Returns True for a recording with a mapping: given, beside it, or by topics that are named like tables."""
        if not is_recording(path) or self.columns:
            return False
        if self.topics or (path.is_file() and path.with_suffix(".toml").is_file()):
            return True
        if path not in self._mapped:
            found = (rosbag2 if rosbag2.sniff(path) else mcap).channels(path)
            self._mapped[path] = bool(message_recordings.named_like_tables(found, self.skip).tables)
            self.topics_left[path] = set(self.skip & found.keys()) if self._mapped[path] else set()
            self.left |= self.topics_left[path]
        return self._mapped[path]

    def leaves(self, path: Path, notes: list[str]) -> bool:
        """Returns True for a file that is left out, with a note: the user says so, or it is text without a table."""
        said = path.name in self.skip and bool(path.suffix) and path.is_file()
        if said:
            self.left.add(path.name)
        elif not delimited.is_prose(path):
            return False
        notes.append(f"{path}: left out, {'as --set says' if said else 'text without a table of numbers'}")
        return True

    def readable(self, files: Sequence[Path]) -> list[Path]:
        """Files that can be read; the reasons for the others are kept."""
        out = []
        bar = console.Progress(len(files), "read", unit="files")
        for i, file in enumerate(files):
            if bar.elapsed > SOON:
                bar.update(i)
            try:
                if not self.mapped(file):
                    self.sheets(file)
            except FishmjError as error:
                self.skipped[str(file)] = str(error)
            else:
                out.append(file)
        return out


def read_sheets(path: Path) -> list[Sheet]:
    """Sheets of one foreign file: one of a table, one a topic of a recording."""
    return [table_forms.looked_at(sheet) for sheet in _read_sheets(path)]


def _read_sheets(path: Path) -> list[Sheet]:
    if is_recording(path):
        found = (rosbag2 if rosbag2.sniff(path) else mcap).channels(path)
        return message_sheets.sheets(path, found, rosbag2.lost(path, found))
    suffix = path.suffix.lower()
    text = suffix in delimited.SUFFIXES or not suffix
    regular(path)
    if suffix not in (*PARQUET, *NPZ, *TORCH) and (kind := other_files.kind_of(path, text=text)):
        raise LogError(f"{path}: {other_files.advice(path, kind)}")
    if suffix in PARQUET:
        return read_parquet(path)
    if suffix in (*NPZ, *TORCH):
        return read_tables(path)
    if text:
        return [delimited.read(path)]
    raise LogError(
        f"{path}: files of type {quoted(suffix)} are not read; export it as CSV. Known: "
        f"{', '.join((*TABLE_FILES, *rosbag2.STORED))}"
    )


def is_recording(path: Path) -> bool:
    """Returns True for a file or folder that holds messages and no table."""
    return path.name.lower().endswith(rosbag2.STORED) or (path.is_dir() and rosbag2.sniff(path))


def is_own(folder: Path) -> bool:
    """Returns True for a trial folder in our format."""
    if not (folder / META_FILE).is_file():
        return False
    return (folder / FLAT_FILE).is_file() or any(
        (folder / f"{table}{end}").is_file() for table in TABLES for end in (".csv", ".npz")
    )


def plan(sources: Sequence[Path], cache: FileCache, *, together: bool | None = None) -> tuple[list[Item], list[str]]:
    """The trials in files and folders, and the ignored entries.

    Args:
        together: the files of one folder are one trial (True), a trial each (False), or by the rule (None).

    Raises LogError: a source is absent or given twice, or the rule does not decide.
    """
    items: list[Item] = []
    notes: list[str] = []
    for source in sources:
        if not source.exists():
            raise LogError(f"{source}: no such file or folder")
    tags = tags_of(sources)
    loose = [s for s in sources if not s.is_dir() and (len(sources) == 1 or not cache.leaves(s, notes))]
    if loose:
        items += _told_apart(_heap(loose, cache, together, name="" if len(loose) > 1 else loose[0].stem, top=True))
    folders = [source for source in sources if source.is_dir()]
    for source in folders:
        items += _walk(source, source.resolve(), cache, together, notes, tags[source], 0, alone=len(folders) == 1)
    named, told = renamed(items)
    return named, [*notes, *told]


def tags_of(sources: Sequence[Path]) -> dict[Path, str]:
    """A name for each source: its own, with as many parents in front as tell them all apart.

    Raises LogError: one is given twice.
    """
    parts = {source: [names.nearest(part) or "root" for part in source.resolve().parts] for source in sources}
    if len({source.resolve() for source in sources}) < len(sources):
        again = next(source for k, source in enumerate(sources) if source.resolve() in [s.resolve() for s in sources[:k]])
        raise LogError(f"{again}: is named twice; name each file or folder once")
    tags = {source: path[-1] for source, path in parts.items()}
    for depth in range(2, max(map(len, parts.values()), default=0) + 1):
        if len({tag.lower() for tag in tags.values()}) == len(tags):
            break
        tags = {source: "_".join(path[-depth:]) for source, path in parts.items()}
    return tags


def _told_apart(items: list[Item]) -> list[Item]:
    """Trials of single files; those with one name in several folders get the folder's name in front."""
    parents = tags_of(list(dict.fromkeys(file.parent.resolve() for item in items for file in item.files)))
    called = [(names.nearest(item.name) or "").lower() for item in items]
    twice = {name for name, count in Counter(called).items() if count > 1 and len(parents) > 1}
    front = [parents[item.files[0].parent.resolve()] if name in twice else "" for item, name in zip(items, called, strict=True)]
    return [replace(item, name=_joined(tag, item.name)) for item, tag in zip(items, front, strict=True)]


def _walk(
    folder: Path, root: Path, cache: FileCache, together: bool | None, notes: list[str], prefix: str, depth: int,
    alone: bool = False,
) -> list[Item]:  # fmt: skip
    """Trials below a folder. prefix: of their names, at depth 0 the folder's own; alone: of one folder names go without it."""
    here = _joined(prefix, folder.name) if depth else prefix
    whole = is_own(folder) or (rosbag2.sniff(folder) and (together is not False or (folder / rosbag2.METADATA).is_file()))
    if whole and (outside := leading_outside(folder)):
        cache.skipped[str(folder)] = f"{folder}: {bare(outside[0].name)} is a link that leads outside; put the file itself there"
        return []
    if is_own(folder):
        return [Item(here, (folder,), own=True)]
    if whole:
        beside = [p.name for p in _inside(folder, root, notes) if p.suffix.lower() in TABLE_FILES or p.is_dir()]
        if beside:
            notes.append(f"{folder}: a bag; passed over beside it: {', '.join(map(bare, beside[:6]))}; import them by themselves")
        return [Item(here, tuple(cache.readable([folder])))]
    if depth > DEEP:
        raise LogError(f"{folder}: folders in folders, {DEEP} deep; name the folder that holds the trials")
    files, folders, other = [], [], []
    for entry in _inside(folder, root, notes):
        if entry.is_dir() and not (entry.name == "meta" and (entry / "info.json").is_file()):  # of a LeRobot data set
            folders.append(entry)
        elif entry.is_dir():
            other.append(entry.name)
        elif cache.leaves(entry, notes):
            continue
        elif entry.suffix.lower() in TABLE_FILES or is_recording(entry):
            files.append(entry)
        elif (kind := other_files.kind_of(entry)) in other_files.RECORDINGS or (
            kind == "archive" and other_files.holds_tables(entry)
        ):
            cache.skipped[str(entry)] = f"{entry}: {other_files.advice(entry, kind)}"
        elif entry.name not in ("manifest.json", "measurements.toml"):
            other.append(entry.name)
    if other:
        more = f" and {len(other) - 6} more" if len(other) > 6 else ""
        notes.append(f"{folder}: passed over: {', '.join(bare(name) for name in other[:6])}{more}")
    items = _heap(files, cache, together, name=here, top=alone) if files else []
    for sub in folders:
        items += _walk(sub, root, cache, together, notes, "" if alone else here, depth + 1)
    return items


def leading_outside(folder: Path) -> list[Path]:
    """Links in a folder that lead out of it."""
    if not folder.is_dir():
        return []
    root = folder.resolve()
    return [entry for entry in sorted(folder.rglob("*")) if entry.is_symlink() and not _within(entry, root)]


def _within(link: Path, root: Path) -> bool:
    try:
        return link.resolve(strict=True).is_relative_to(root)
    except (OSError, RuntimeError):
        return False


def _inside(folder: Path, root: Path, notes: list[str]) -> Iterator[Path]:
    """Entries of a folder in order of name, without hidden ones and links that lead outside."""
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise LogError(f"{folder}: cannot be read: {error.strerror or error}") from error
    if len(entries) > MANY:
        raise LogError(f"{folder}: {len(entries)} entries; at most {MANY} are looked at. Name the folder that holds the trials")
    for entry in entries:
        if entry.name.startswith("."):
            continue
        if entry.is_symlink():
            inside = _within(entry, root)
            if not inside or entry.is_dir():
                notes.append(f"{entry}: a link that leads {'to a folder' if inside else 'outside'}; passed over")
                continue
        yield entry


def _heap(files: Sequence[Path], cache: FileCache, together: bool | None, *, name: str, top: bool) -> list[Item]:
    """The trials of the files of one folder."""
    good = cache.readable(files)
    if not good:
        return []
    recordings = [file for file in good if is_recording(file)]
    tables = [file for file in good if not is_recording(file)]
    if together and recordings:
        return [Item(name or good[0].parent.resolve().name, tuple(good))]
    out = [Item(_joined("" if top else name, file.stem), (file,)) for file in recordings]
    if not tables:
        return out
    if len(tables) == 1 and not (together and len(files) > 1):
        only = Item(name if not top and len(files) == 1 else _joined("" if top else name, tables[0].stem), (tables[0],))
        return [*out, *_by_episode(only, cache)]
    different = len(guess.kinds(sheet for file in tables for sheet in cache.sheets(file)))
    if together if together is not None else _is_one(tables, different):
        return [*out, Item(name or tables[0].parent.resolve().name or "trial", tuple(tables))]
    each = (Item(_joined("" if top else name, file.stem), (file,)) for file in tables)
    return [*out, *(part for item in each for part in _by_episode(item, cache))]


def _by_episode(item: Item, cache: FileCache) -> list[Item]:
    """The item, or one for each episode in its file."""
    episodes = [sheet.episode for sheet in cache.sheets(item.files[0]) if sheet.episode is not None]
    if len(episodes) < 2:
        return [item]
    return [replace(item, name=f"{item.name}_episode_{episode}", episode=episode) for episode in episodes]


def _is_one(tables: Sequence[Path], different: int) -> bool:
    """Applies the rule: all columns different, one trial; all the same, a trial each."""
    if different == len(tables):
        return True
    if different == 1:
        return False
    raise LogError(
        f"{tables[0].parent}: {len(tables)} files with {different} sets of columns "
        f"({', '.join(bare(p.name) for p in tables[:4])}, ..): "
        "are they one trial or many? Say --one-trial or --trial-each, or put the files of each trial into a folder of its own"
    )


def _joined(prefix: str, name: str) -> str:
    return f"{prefix}_{name}" if prefix else name


def renamed(items: Sequence[Item]) -> tuple[list[Item], list[str]]:
    """Items with unique names that may stand in a path; a note on each name that was taken already."""
    taken: set[str] = set()
    out, notes = [], []
    for item in items:
        base = names.nearest(item.name) or "trial"
        name, n = base, 1
        while name.lower() in taken:
            n += 1
            name = f"{base[:58]}_{n}"
        if n > 1:
            notes.append(
                f"{item.files[0] if item.files else item.name}: its trial is called {name}, another one has the name {base}"
            )
        taken.add(name.lower())
        out.append(replace(item, name=name))
    return out, notes


def read_own(folder: Path, called: dict[Path, str]) -> Trial:
    """Reads a trial of our own format. `replicate_of` gets the name that this import gives the other trial. called: by folder."""
    trial = read_trial(folder)
    first = called.get(folder.resolve().parent / str(trial.value("replicate_of") or ""))
    return replace(trial, meta={**trial.meta, "replicate_of": first}) if first else trial


def excitations(texts: Sequence[str]) -> dict[str, str]:
    """Names of experiments by trial, "" for every other trial, from `NAME` and `TRIAL=NAME`.

    Raises ConfigError: a name that may not stand in a path; UsageError: two names for one trial, or for all.
    """
    found: dict[str, str] = {}
    for text in texts:
        trial, mark, name = text.rpartition("=")
        if mark and not trial:
            raise UsageError(f"log import: --excitation {text[:80]}: no trial before the =; expected NAME or TRIAL=NAME")
        if trial in found:
            which = f"of trial {trial}" if trial else "of all trials"
            raise UsageError(f"log import: --excitation {which} is said twice: {found[trial]} and {name}; say it once")
        found[trial] = names.checked(name, "excitation", "--excitation")
    return found


def layouts(items: Sequence[Item], cache: FileCache) -> dict[tuple, list[Item]]:
    """Foreign items, grouped by the kinds of their files."""
    out: dict[tuple, list[Item]] = {}
    for item in items:
        if item.own or not item.files:
            continue
        made = guess.kinds(cache.sheets_of(item))
        out.setdefault(tuple(sorted(repr(guess.flavour(kind.sheets[0])) for kind in made)), []).append(item)
    return out
