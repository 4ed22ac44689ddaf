"""One segment of a campaign on disk: `<id>.npz` with the arrays and `<id>.json` with everything else, written in this order.

The JSON holds the sha256 of the arrays, so a pair is complete or absent. SI units, tank frame; T ticks of 20 ms, N links,
J = N - 1 joints. Row k is the tick from t_k - 20 ms to t_k.

    q, v     (T, 3 + J)   pose of the reference point and joint angles, and their rates, at the end of the tick
    command  (T, J)       on the bus at the start of the tick, rad
    wrench   (T, N, 3)    mean over the tick of the water's F_x, F_y [N] and M_z [N m]; M_z about the link's front joint, the
                          head's about the reference point
    raw      (T, N, 3)    the same without the momentum of the water inside the hull: the immersed boundary's own exchange
    flow     (T, N, 2)    undisturbed flow at the link's centre at the start of the tick, m/s
    power    (T,)         electrical, with electronics, mean over the tick, W; absent if no servo drives the joints
"""

from dataclasses import dataclass
from dataclasses import fields as dataclass_fields
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from fishmj.base.errors import DatasetError, StoreError
from fishmj.base.names import PATTERN
from fishmj.base.store import read_json, read_npz, sha256, write_json, write_npz
from fishmj.water.flow import Flow

SCHEMA = "fishmj.segment/1"
UNITS = {"q": "m, rad", "v": "m/s, rad/s", "command": "rad", "wrench": "N, N m", "raw": "N, N m", "flow": "m/s", "power": "W"}
PRECISE = ("q", "v")  # never in 16 bits: accelerations are their differences over a tick
HALF = 1e-3  # greatest error of a channel kept in 16 bits, over its range
KICK = 0.3  # s, of a free swim that begins at rest in a stream


@dataclass(frozen=True, eq=False)
class SegmentRecord:
    """One segment in memory, arrays in float64 as in the table above; `power` is nan if it is not known.

    meta: id, episode, block, split, segment (how it was made), robot, grid, start (q, v before row 0), tick, stopped, ...
    """

    meta: dict
    q: np.ndarray
    v: np.ndarray
    command: np.ndarray
    wrench: np.ndarray
    raw: np.ndarray
    flow: np.ndarray
    power: np.ndarray

    @property
    def id(self) -> str:
        """Id of the segment."""
        return self.meta["id"]

    @property
    def tick(self) -> float:
        """Duration of a tick, s."""
        return float(self.meta["tick"])

    @property
    def t(self) -> np.ndarray:
        """Ends of the ticks, (T,) s, counted from the start of the recorded part."""
        return (np.arange(len(self.q)) + 1) * self.tick

    @property
    def seconds(self) -> float:
        """Duration of the record, s."""
        return len(self.q) * self.tick

    @property
    def background(self) -> Flow:
        """Undisturbed flow as a whole: `background.at(x, meta["settle"] + t)`."""
        return Flow(**self.meta["segment"]["flow"])

    @property
    def before(self) -> tuple[np.ndarray, np.ndarray]:
        """q and v at the start of every tick, (T, 3 + J) each."""
        q, v = (np.asarray(self.meta["start"][name], float)[None] for name in ("q", "v"))
        return np.concatenate([q, self.q[:-1]]), np.concatenate([v, self.v[:-1]])

    @property
    def steadied(self) -> "SegmentRecord":
        """Record without its first `KICK` s, for a free fish that was released at rest in a stream.

        The fish alone has to stop all the water around it within the first tick, which carries it along: no real fish starts so.
        """
        held = self.meta.get("prescribed", {}).get("root", True)
        skip = round(KICK / self.tick)
        if held or self.meta.get("settle", 0.0) > 0.0 or self.background.speed == 0.0 or len(self.q) <= skip:
            return self
        start = {"q": self.q[skip - 1].tolist(), "v": self.v[skip - 1].tolist()}
        rows = len(self.q) - skip
        meta = self.meta | {"start": start, "settle": skip * self.tick, "rows": rows, "seconds": rows * self.tick}
        return SegmentRecord(meta, **{name: getattr(self, name)[skip:] for name in UNITS})

    @property
    def acceleration(self) -> np.ndarray:
        """Mean v' over every tick, (T, 3 + J), m/s2 and rad/s2, comparable with the mean wrenches."""
        return (self.v - self.before[1]) / self.tick


def narrow(values: np.ndarray) -> np.ndarray:
    """Values (T, ...) in 16 bits if this changes no channel by more than `HALF` of its range, else in 32."""
    with np.errstate(invalid="ignore", over="ignore"):
        half = values.astype(np.float16)
        error = np.abs(half.astype(float) - values).max(0)
    return half if bool((error <= HALF * np.ptp(values, 0)).all()) else values.astype(np.float32)


def files(folder: Path, name: str) -> tuple[Path, Path]:
    """Paths of arrays and description of segment `name`."""
    return folder / f"{name}.npz", folder / f"{name}.json"


def write_record(folder: Path, meta: dict, arrays: dict[str, np.ndarray]) -> dict:
    """Keeps one segment; returns its metadata with `file`. Without arrays only the description is written, with the reason.

    Raises StoreError: the disk refuses.
    """
    path, about = files(folder, meta["id"])
    meta = {"schema": SCHEMA, "units": UNITS, **meta}
    if arrays:
        kept = {name: value.astype(np.float32) if name in PRECISE else narrow(value) for name, value in arrays.items()}
        write_npz(path, kept)
        meta["file"] = {"sha256": sha256(path), "bytes": path.stat().st_size}
    write_json(about, meta)
    return meta


def read_record(folder: Path, name: str) -> SegmentRecord:
    """Reads one segment, its arrays checked against the sha256 beside them.

    Raises DatasetError: one of the two files is missing, or they do not belong together.
    """
    path, about = files(folder, name)
    meta = described(about)
    if "file" not in meta:
        raise DatasetError(f"{about}: this segment has no arrays: {meta.get('stopped') or 'nothing was recorded'}")
    expected, got = meta["file"]["sha256"], sha256(path) if path.is_file() else None
    if got != expected:
        raise DatasetError(f"{path}: expected sha256 {expected}, got {got or 'no such file'}; collect the segment again")
    arrays = {key: value.astype(float) for key, value in read_npz(path).items()}
    arrays.setdefault("power", np.full(len(arrays.get("q", ())), np.nan))
    lacking, rows = [key for key in UNITS if key not in arrays], {key: len(value) for key, value in arrays.items()}
    if lacking or len(set(rows.values())) != 1:
        raise DatasetError(f"{path}: expected {', '.join(UNITS)} of one length; missing {lacking}, rows {rows}")
    return SegmentRecord(meta, **{key: arrays[key] for key in UNITS})


def described(about: Path) -> dict:
    """JSON of a segment. Raises DatasetError: missing, damaged, or not a segment."""
    try:
        meta = read_json(about)
    except StoreError as error:
        raise DatasetError(str(error)) from error
    try:
        _description().validate_python(meta, strict=True)
    except ValueError as error:  # pydantic's own, with one entry for each key
        first = error.errors()[0]  # type: ignore[attr-defined]
        key = ".".join(map(str, first["loc"])) or "the file"
        got = f"{first['input']!r:.60}"
        raise DatasetError(f"{about}: no description of a segment: {key}: {first['msg']}, got {got}. Collect it again") from error
    return meta


@cache
def _description():
    """Required fields of a segment's JSON for a fit; other keys are kept."""
    from pydantic import AllowInfNan, ConfigDict, Field, TypeAdapter, create_model

    number = Annotated[float, AllowInfNan(False)]
    some = ConfigDict(extra="allow")
    numbers, name = list[number], Annotated[str, Field(pattern=rf"^{PATTERN}$")]
    known = {
        f.name: (number if f.name in ("speed", "direction", "intensity") else Any, f.default) for f in dataclass_fields(Flow)
    }
    flow = create_model("flow", __config__=ConfigDict(extra="forbid"), **known)
    fields: dict[str, Any] = {
        "id": (name, ...),
        "episode": (str, ...),
        "split": (str, ...),
        "block": (str, ...),
        "tick": (Annotated[float, Field(gt=0, le=1)], ...),
        "settle": (number, 0.0),
        "stopped": (str, ""),
        "replicate_of": (str, ""),
        "start": (create_model("start", q=(numbers, ...), v=(numbers, ...)), ...),
        "segment": (create_model("segment", __config__=some, flow=(flow, ...)), ...),
        "grid": (create_model("grid", __config__=some, slip=(number, ...)), ...),
        "robot": (create_model("robot", __config__=some, name=(name, ...), joints=(int, ...)), ...),
        "prescribed": (dict[str, bool], {}),
        "file": (create_model("file", __config__=some, sha256=(str, ...)), None),
    }
    return TypeAdapter(create_model("segment_json", __config__=some, **fields))
