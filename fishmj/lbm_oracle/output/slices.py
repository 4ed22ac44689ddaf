"""A horizontal slice of the water at one instant, as one small file, and a folder of them from one run.

    FOLDER/fields.json            description of the run: schema, grid, height, flow, robot
    FOLDER/slices/00012.npz       one `Slice`; velocity and vorticity as float16, 11 significant bits
    FOLDER/vorticity/00012.png    the same as a picture
    FOLDER/volume/00012.vti       the whole box for ParaView (see `volume`)
    FOLDER/fish/00012.vtp         the fish in it
    FOLDER/volume.pvd             opens both as one film

NumPy only: drawing slices does not load the solver.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import read_json, read_npz, write_npz

SCHEMA = "fishmj.fields/1"
INDEX = "fields.json"
STRONG = 8.0  # 1/s, ends of the pictures' colour scale: eddies shed at 1 Hz reach it, the swirl beside them does not


class Slice(NamedTuple):
    """Nodes (nx,) by (ny,) at height z, world frame, SI units."""

    t: float  # s since the run began
    z: float  # m
    x: np.ndarray  # (nx,) m
    y: np.ndarray  # (ny,) m
    u: np.ndarray  # (nx, ny) m/s along x
    v: np.ndarray  # (nx, ny) m/s along y
    omega_z: np.ndarray  # (nx, ny) 1/s, counter-clockwise seen from above
    outline: list[np.ndarray]  # closed lines round the fish from above, (P, 2) m

    @property
    def speed(self) -> np.ndarray:
        """Magnitude of the horizontal velocity, (nx, ny) m/s."""
        return np.hypot(self.u, self.v)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south, north edge of the outermost cells, m."""
        half = 0.5 * float(self.x[1] - self.x[0])
        return float(self.x[0]) - half, float(self.x[-1]) + half, float(self.y[0]) - half, float(self.y[-1]) + half


def write_slice(path: str | Path, one: Slice) -> Path:
    """Writes a slice atomically; fields are stored as float16, rows of NaN separate the lines of the outline."""
    gap = np.full((1, 2), np.nan)
    rim = np.concatenate([part for link in one.outline for part in (link, gap)]) if one.outline else np.zeros((0, 2))
    fields = {name: np.asarray(getattr(one, name), np.float16) for name in ("u", "v", "omega_z")}
    place = {name: np.asarray(getattr(one, name), np.float32) for name in ("x", "y")}
    return write_npz(path, {"t": np.array(one.t), "z": np.array(one.z), **place, **fields, "outline": rim.astype(np.float32)})


def read_slice(path: str | Path) -> Slice:
    """Reads a slice; fields come back as float32. Raises StoreError: missing, damaged, or not a slice."""
    held = read_npz(path)
    lacking = [name for name in Slice._fields if name not in held]
    if lacking:
        raise StoreError(f"{path}: no slice of the flow solver: it lacks {', '.join(lacking)}; they are written by swim --fields")
    x, y, rim = held["x"], held["y"], held["outline"]
    if held["omega_z"].shape != (len(x), len(y)) or min(len(x), len(y)) < 2:
        raise StoreError(f"{path}: omega_z has shape {held['omega_z'].shape}, x and y have {len(x)} and {len(y)} nodes")
    ends = np.flatnonzero(np.isnan(rim[:, 0]))
    links = [part for part in np.split(rim, ends) if len(part) > 1]
    u, v, omega = (held[name].astype(np.float32) for name in ("u", "v", "omega_z"))
    return Slice(float(held["t"]), float(held["z"]), x, y, u, v, omega, [link[np.isfinite(link[:, 0])] for link in links])


def slices_in(folder: str | Path) -> list[Path]:
    """Slices of a run in the order of time. Raises ConfigError: the folder holds none, or none of this schema."""
    folder = Path(folder)
    if not (folder / INDEX).is_file():
        raise ConfigError(f"{folder}: no {INDEX}; expected a folder written by `fishmj lbm_oracle swim --fields FOLDER`")
    schema = read_json(folder / INDEX).get("schema")
    if schema != SCHEMA:
        raise ConfigError(f"{folder / INDEX}: schema {schema!r}; expected {SCHEMA!r}")
    found = sorted((folder / "slices").glob("[0-9]*.npz"))
    if not found:
        raise ConfigError(f"{folder}: no slices; the run ended before its first one")
    return found


def height(text: str) -> float | None:
    """Height in m, or None for `mid`. Raises ArgumentTypeError: neither."""
    if text == "mid":
        return None
    try:
        return console.number(-10, 10)(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}, or mid: a height in m (0 is mid-depth, up positive)") from error


def add_fields(parser: argparse.ArgumentParser, *, folder: bool = True) -> None:
    """Adds the options that `swim` and `forcemap` share: --fields (with a folder or without), --slice, --volume."""
    if folder:
        fields = "vorticity slices (npz, PNG) while it runs, for `fishmj replay`; by default none"
        parser.add_argument("--fields", type=console.out_folder, metavar="FOLDER", help=fields)
    parser.add_argument("--slice", type=height, default=None, metavar="mid|Z", help="height of the slice, m (default: mid-depth)")
    parser.add_argument("--volume", action="store_true", help="with --fields: the whole box, too, as VTK files for ParaView")
