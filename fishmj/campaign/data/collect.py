"""Run what a plan still lacks and keep it as a data set: resumable, with progress and time left, within a budget.

    found = collect(full("fish"), "data/hydro/swift", Setup(...), tanks=12)

Written in this order: the split, the segments one by one as they finish, the manifest. What is interrupted is continued by the
same call; a segment that is there, whole and made in the same way is not run again.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from fishmj import console
from fishmj.campaign.data.plan import Plan
from fishmj.campaign.data.run_segments import Finished, Setup, side_by_side
from fishmj.campaign.data.segment import Segment
from fishmj.errors import ConfigError, DatasetError, StoreError
from fishmj.hydro_fit.record import files, write_record
from fishmj.hydro_fit.segment_dataset import SEGMENTS, SPLIT, split_hashes
from fishmj.store import Manifest, read_json, sha256, write_json

SCHEMA = "fishmj.campaign/1"


class Pool(Protocol):
    """What runs segments: tanks in this process, or workers elsewhere."""

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        """Finished segments in any order; `go_on` and `waiting` as in `tank.side_by_side`."""


@dataclass(frozen=True)
class Local:
    """Tanks side by side on one device, in this process."""

    tanks: int = 1

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        return side_by_side(waiting, setup, tanks=self.tanks, go_on=go_on)


@dataclass(frozen=True)
class Collected:
    """What a call of `collect` found and did; seconds of water, wall time, bytes of the whole data set."""

    folder: Path
    segments: int
    there: int  # before the call
    run: int
    missing: int
    stopped: dict[str, str]  # why segments ended early, by id
    lost: list[str]  # of these, the ones of which nothing sound was left
    recorded_s: float
    water_s: float  # run by this call
    wall_s: float
    bytes: int

    @property
    def complete(self) -> bool:
        return self.missing == 0


def collect(
    plan: Plan,
    out: str | Path,
    setup: Setup,
    *,
    pool: Pool | None = None,
    budget: float | None = None,
    retry: bool = False,
    quiet: bool = False,
) -> Collected:
    """Bring the data set in `out` up to the plan; a data set that holds other episodes, too, keeps them.

    Args:
        budget: seconds of wall time after which it stops with what is finished. retry: run stopped segments again.

    Raises:
        ConfigError: `out` holds segments of another fish, grid or solver. DatasetError: an episode would change its split.
        OracleUnstable: a segment could not be set up. StoreError: the disk refuses.
    """
    folder, began = Path(out), time.perf_counter()
    if budget is not None and not budget > 0:
        raise ConfigError(f"collect: budget = {budget} s; expected a positive time, or none")
    left = missing(plan, folder, retry)
    about = _state_split(folder, plan, setup, adding=bool(left))
    if budget is not None:  # whatever it is cut down to is a mixture of all blocks
        left = deque(sorted(left, key=lambda segment: segment.sha256))
    there, before, done = len(plan.segments) - len(left), 0.0, 0
    total = sum(segment.water for segment in left)
    with console.Progress(max(total, 1e-9), "collect", unit="s", every=1e9 if quiet else None) as bar:

        def go_on(water: float) -> bool:
            bar.update(before + water, segments=there + done, of=len(plan.segments))
            return budget is None or time.perf_counter() - began < budget

        for finished in (pool or Local()).run(left, setup, go_on) if left else ():
            write_record(folder / SEGMENTS, finished.meta, finished.arrays)
            before, done = before + finished.segment.water, done + 1
            bar.update(before, segments=there + done, of=len(plan.segments))
    return _closed(folder, plan, about, there, done, before, time.perf_counter() - began)


def missing(plan: Plan, folder: Path, retry: bool = False) -> deque[Segment]:
    """Segments of the plan that are not in the folder whole and made as planned; with `retry` those that stopped early, too."""
    there = {segment.id: _about(folder, segment) for segment in plan.segments}
    return deque(s for s in plan.segments if (meta := there[s.id]) is None or (retry and meta.get("stopped")))


def _closed(folder: Path, plan: Plan, about: dict, there: int, run: int, water: float, wall: float) -> Collected:
    """Write the manifest and say what the data set holds."""
    kept = {s.id: meta for s in plan.segments if (meta := _about(folder, s)) is not None}
    stopped = {name: meta["stopped"] for name, meta in kept.items() if meta.get("stopped")}
    missing = len(plan.segments) - len(kept)
    notes = {
        "schema": SCHEMA,
        "origin": "synthetic",
        "licence": "Apache-2.0",
        "source": "fishmj.campaign",
        "complete": not missing,
    }
    notes |= {"label": plan.label, "seed": plan.seed, "missing": missing, **about}
    Manifest.of(folder, notes).write(folder)
    return Collected(
        folder=folder,
        segments=len(plan.segments),
        there=there,
        run=run,
        missing=missing,
        stopped=stopped,
        lost=sorted(name for name in stopped if "file" not in kept[name]),
        recorded_s=sum(meta["seconds"] for meta in kept.values() if "file" in meta),
        water_s=water,
        wall_s=wall,
        bytes=sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()),
    )


def _state_split(folder: Path, plan: Plan, setup: Setup, adding: bool) -> dict:
    """Write which episode is for what, before anything is run; returns fish, grid and solver of the data set.

    Raises:
        DatasetError: an episode would change its split. ConfigError: the folder is of another fish or grid, or segments of
            another solver would be added (a complete data set stays as it is).
    """
    path, about = folder / SPLIT, setup.about
    before = read_json(path) if path.is_file() else {"episodes": {}, "plans": [], **about}
    try:
        episodes, plans, made = dict(before["episodes"]), list(before["plans"]), {key: before[key] for key in about}
    except (TypeError, KeyError, ValueError) as error:
        raise DatasetError(f"{path}: {error!r}; expected episodes, plans, robot and grid. Take another folder") from error
    for key, value in about.items():
        if made[key] != value and (adding or key != "solver"):
            raise ConfigError(f"{folder} holds segments of another {key}: {made[key]} (now {value}). Take another folder")
    moved = [
        f"{name}: expected {episodes[name]}, got {split}"
        for name, split in plan.episodes.items()
        if episodes.get(name, split) != split
    ]
    if moved:
        raise DatasetError(f"{path}: episodes would change their split: {', '.join(moved[:5])}; take another folder")
    episodes |= plan.episodes
    row = {"label": plan.label, "seed": plan.seed, "segments": len(plan.segments), "split_sha256": plan.split_sha256}
    table = {"episodes": dict(sorted(episodes.items())), "sha256": split_hashes(episodes), **made}
    write_json(path, table | {"plans": [old for old in plans if old != row] + [row]})
    return made


def _about(folder: Path, segment: Segment) -> dict | None:
    """The description of a segment that is there and made as wanted, else nothing."""
    path, about = files(folder / SEGMENTS, segment.id)
    if not about.is_file():
        return None
    try:
        meta = read_json(about)
        made = Segment.of(meta["segment"])
    except (StoreError, TypeError, KeyError):
        return None  # damaged: run again
    if made.sha256 != segment.sha256:
        return None
    whole = "file" not in meta or path.is_file() and sha256(path) == meta["file"]["sha256"]
    return meta if whole else None
