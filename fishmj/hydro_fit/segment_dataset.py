"""A data set of segments, checked before it is used for a fit.

    data = open_dataset("data/hydro/laptop")
    for record in data.records("train"): ...            `records` yields `SegmentRecord`s, in order of id
    data.records("test")                                refused: only the check opens it, with open_dataset(folder, test=True)

A data set is a folder:  `segments/<id>.npz, .json`,  `split.json` (the split of every episode, written before the first segment
was run) and `manifest.json` (sha256 of every file). Segments of one episode share its split, also at other slip ratios. A data
set with only the segments of `INSTALLED`, as in an installed fishmj, can be used for judging only.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from fishmj.base.errors import ConfigError, DatasetError, StoreError
from fishmj.base.store import Manifest, json_sha256, left_out, read_json, sha256
from fishmj.base.store.manifest import MANIFEST, SOURCES
from fishmj.hydro_fit.record import SCHEMA, UNITS, SegmentRecord, described, read_record
from fishmj.mjcf.description import Robot

SEGMENTS, SPLIT = "segments", "split.json"
SPLITS = ("train", "val", "test")
INSTALLED = tuple(f"{SEGMENTS}/test-*_{end}" for end in ("s1*", "s0.json", "s0.npz"))  # as pyproject.toml has the wheel
PREVIEW = "-preview"  # of the name of a data set that is solved for a first look, and of a model beside a better one
SHOWN = 12  # files that a message lists by name


@dataclass(frozen=True)
class SegmentDataset:
    """An opened data set. `about`: metadata of every segment by id, test ones without their arrays.

    whole: all segments are there.
    """

    folder: Path
    about: dict[str, dict]
    split_sha256: dict[str, str]  # by split, of its episodes; see `split_hashes`
    meta: dict
    test: bool = False
    whole: bool = True

    @property
    def sha256(self) -> str:
        """sha256 of the manifest, which identifies the data set."""
        return sha256(self.folder / MANIFEST)

    @property
    def robot(self) -> dict:
        """Name, joints and sha256 of the description; one for all segments."""
        return next(iter(self.about.values()))["robot"]

    @property
    def preview(self) -> bool:
        """Returns True if it was solved in a preview's box, or is a part of its plan."""
        cut = ", first " in str(self.meta.get("label", ""))
        return bool(cut or self.meta.get("missing", 0) or self.meta.get("grid", {}).get("preview", False))

    def names(self, split: str, *, block: str | None = None, slip: float | None = None) -> list[str]:
        """Ids of the segments with arrays.

        Raises DatasetError: the test part, in a data set that was not opened for the check; a part that is not installed; an
        unknown split.
        """
        if split not in SPLITS:
            raise DatasetError(f"{self.folder}: split {split!r}; expected one of {', '.join(SPLITS)}")
        if split != "test" and not self.whole:
            raise DatasetError(f"{self.folder}: the {split} part is not installed, only {SOURCES}; name it with --data")
        if split == "test" and not self.test:
            raise DatasetError(
                f"{self.folder}: the test part is closed; only the check opens it: open_dataset(folder, test=True)"
            )
        return [
            name
            for name, meta in self.about.items()
            if meta["split"] == split
            and "file" in meta
            and (block is None or meta["block"] == block)
            and (slip is None or abs(meta["grid"]["slip"] - slip) < 1e-9)
        ]

    def records(self, split: str, *, slip: float | None = None) -> Iterator[SegmentRecord]:
        """The segments of one split, read one at a time; arguments and errors as in `names`."""
        return (read_record(self.folder / SEGMENTS, name).steadied for name in self.names(split, slip=slip))

    def __getitem__(self, name: str) -> SegmentRecord:
        """Reads one segment by id; errors as in `names`."""
        if name not in self.about or name not in self.names(self.about[name]["split"]):
            raise DatasetError(f"{self.folder}: no segment {name!r} with arrays")
        return read_record(self.folder / SEGMENTS, name).steadied

    def other_water(self, grid: Mapping[str, Any]) -> str:
        """Text about box and boundary of the segments where they are not those of `grid`, of the rest of a fit; else ""."""
        edge = lambda grid: grid.get("boundary", "plain")
        words = lambda grid: str(grid.get("domain")) + (f" with boundary {edge(grid)}" if edge(grid) != "plain" else "")
        mine = {words(meta["grid"]) for meta in self.about.values()} - {words(grid)}
        where = f"{self.folder} was solved in {', '.join(sorted(mine))}, the rest in {words(grid)}"
        return f"{where}: two waters in one fit" if mine else ""

    def lost(self) -> dict[str, str]:
        """Reasons of segments that stopped early or hold nothing, by id."""
        return {name: meta["stopped"] for name, meta in self.about.items() if meta.get("stopped")}


def fingerprint(robot: Robot) -> str:
    """sha256 of the body, servos and timing, which matter to the solver; without colours and coefficients of simpler waters."""
    table = asdict(robot)
    links = [{key: value for key, value in link.items() if key != "colour"} for link in table["links"]]
    body = {key: table[key] for key in ("servo", "fins", "timing", "density_water")} | {"links": links}
    body |= {"hull": robot.hull} if robot.hull != "turbulent" else {}
    return json_sha256(body)


def same_fish(about: Mapping[str, Any], robot: Robot, where: Path) -> None:
    """Raises ConfigError if segments are of another fish. about: their table `robot`, where older ones have no sha256."""
    if (made := about.get("sha256", "")) and made != fingerprint(robot):
        raise ConfigError(
            f"{where} holds segments of another fish, {about.get('name')!r} with another body, servo or timing than this"
            f" {robot.name!r}; give the description a name of its own, or another folder with --data"
        )


def open_dataset(folder: str | Path, *, test: bool = False) -> SegmentDataset:
    """Opens a data set after checking every file of it; `test` also opens the test part, for the check command only.

    Raises DatasetError: files missing, changed or not in the manifest; schemas, units, solvers, robots or grids mixed; an episode
    in the wrong split. Lists the files, the expected and the found.
    """
    folder = Path(folder)
    manifest, whole = _manifest(folder)
    episodes = _split(folder)
    ids = sorted(Path(name).stem for name in manifest.files if name.startswith(f"{SEGMENTS}/") and name.endswith(".json"))
    if not ids:
        raise DatasetError(f"{folder}: the manifest names no segment; expected {SEGMENTS}/<id>.json")
    about = {name: described(folder / SEGMENTS / f"{name}.json") for name in ids}
    _belong_together(folder, about)
    wrong = [
        f"{SEGMENTS}/{name}.json: split expected {episodes.get(meta['episode'])!r}, got {meta['split']!r}"
        for name, meta in about.items()
        if episodes.get(meta["episode"]) != meta["split"]
    ]
    _refuse(folder, "not where split.json puts them", wrong)
    return SegmentDataset(folder, about, split_hashes(episodes), manifest.meta, test, whole)


def split_hashes(episodes: dict[str, str]) -> dict[str, str]:
    """sha256 of the sorted episode names of each split."""
    parts = {split: sorted(name for name, where in episodes.items() if where == split) for split in SPLITS}
    return {split: json_sha256(names) for split, names in parts.items()}


def open_each(folders: Iterable[str | Path]) -> list[SegmentDataset]:
    """Opens several data sets for one fit. Raises DatasetError: as `open_dataset`, or one of them twice."""
    found: dict[str, SegmentDataset] = {}
    for data in map(open_dataset, folders):
        if (twin := found.setdefault(data.sha256, data)) is not data:
            raise DatasetError(f"{data.folder}: the same data set as {twin.folder}; its swims would count twice: name it once")
    return [*found.values()]


def _manifest(folder: Path) -> tuple[Manifest, bool]:
    """Manifest after checking every file, and True if that is all of the data set."""
    try:
        manifest = Manifest.read(folder)
    except StoreError as error:
        again = "a campaign that was interrupted has none: collect again into the same folder"
        if not folder.is_dir():
            again = f"{'it is a file' if folder.exists() else 'there is no such folder'}: name another, or collect again"
        raise DatasetError(f"{folder}: no data set: {error}; {again}{left_out(folder)}") from error
    rest = [n for n in manifest.files if n.startswith(SEGMENTS) and not any(fnmatch(n, pattern) for pattern in INSTALLED)]
    whole = not rest or any((folder / name).is_file() for name in rest)
    if not whole:
        manifest = replace(manifest, files={name: told for name, told in manifest.files.items() if name not in set(rest)})
    wrong = [str(change) for change in manifest.check(folder)]
    found = Manifest.of(folder).files
    wrong += [f"{name}: expected no such file (not in {MANIFEST}), got one" for name in found if name not in manifest.files]
    _refuse(folder, "missing, changed or not in the manifest", wrong)
    return manifest, whole


def _split(folder: Path) -> dict[str, str]:
    try:
        table = read_json(folder / SPLIT)
        episodes = dict(table["episodes"])
        stated = dict(table["sha256"])
    except (StoreError, TypeError, KeyError, ValueError) as error:
        raise DatasetError(f"{folder / SPLIT}: {error!r}; expected episodes and sha256, written by the campaign") from error
    if stated != split_hashes(episodes):
        raise DatasetError(
            f"{folder / SPLIT}: expected sha256 {stated}, got {split_hashes(episodes)}: the split was changed by hand"
        )
    return episodes


def _belong_together(folder: Path, about: dict[str, dict]) -> None:
    """Checks for one schema, set of units, solver, robot and grid; slip ratios may differ, and a repeat may have a finer step."""
    kinds: dict[str, tuple[str, ...]] = {"schema": (), "units": (), "solver": ()}
    kinds |= {"robot": ("name", "joints", "sha256"), "grid": ("domain", "dx", "dt")}
    known = {"schema": SCHEMA, "units": UNITS}
    wrong = []
    for what, keys in kinds.items():
        some = {name: meta for name, meta in about.items() if not (what == "grid" and meta.get("replicate_of"))}
        made = {name: _some(meta, what, keys) if keys else meta.get(what) for name, meta in some.items()}
        expected = known.get(what, next(iter(made.values()), None))
        wrong += [f"{SEGMENTS}/{n}.json: {what} expected {expected}, got {got}" for n, got in made.items() if got != expected]
    _refuse(folder, "of another kind than the rest", wrong)


def _some(meta: dict, what: str, keys: tuple[str, ...]) -> dict:
    return {key: meta.get(what, {}).get(key) for key in keys}


def _refuse(folder: Path, what: str, wrong: list[str]) -> None:
    if not wrong:
        return
    more = f"\n  and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
    lines = "\n  ".join(wrong[:SHOWN])
    raise DatasetError(f"{folder}: {len(wrong)} files {what}:\n  {lines}{more}\n  restore them, or collect them again")
