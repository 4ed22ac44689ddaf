"""The hull of a fish as one outline from nose to tail, typical or from a table, and the links that joints cut it into.

Metres from the nose. A table is a CSV file with the columns x, height and width, from nose to tail.
"""

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.names import nearest
from fishmj.base.plain_file import why_unreadable
from fishmj.mjcf.description import Link
from fishmj.mjcf.drawing import PALETTE
from fishmj.mjcf.new.quantity import KINDS
from fishmj.mjcf.priors import displaced

HEAD, TAIL = 0.40, 0.68  # shares of the length at which the head ends and the tail begins, as in the default fish
ALONE = 0.60  # share of a head with no body behind it
ROOM, LAST = 0.06, 0.97  # between joints behind a long head; where the last joint may be at most
DEEPEST = 0.22  # share of the length at which the body is highest
LINKS = (2, 10)  # of a fish that this verb makes
SHORTEST = 0.02  # of a link, over the fish
# share of the length, height over the greatest, width over the greatest; behind the nose, from the default fish
BODY = ((0.262, 1.0, 1.0), (0.331, 0.936, 0.903), (0.402, 0.83, 0.774), (0.533, 0.702, 0.58), (0.664, 0.553, 0.419))
ROOT, ROOT_H, ROOT_W = 0.765, 0.383, 0.226  # where the tail fin begins
FIN = ((0.843, 0.6, 0.113), (0.94, 1.0, 0.065), (1.0, 1.0, 0.016))  # share of the way from root height to fin height; width
SIDE = (0.19, 0.33)  # front and rear edge of the side fins
COLUMNS = ("x", "height", "width")
LARGEST = 1_000_000  # bytes
ROWS = (3, 500)
SIZE = (0.02, 10.0)  # m, of the whole fish
THINNEST = 1e-5  # m, of a section
UNITS = KINDS["length"].units


@dataclass(frozen=True)
class Outline:
    """Sections of a whole fish, nose first."""

    rows: np.ndarray  # (S, 3) station, height, width, m
    fin_at: float | None  # behind it the fish is a plate, m
    source: str  # where heights and widths come from, for the comments of the description

    @property
    def length(self) -> float:
        """Nose to tail, m."""
        return float(self.rows[-1, 0])

    @property
    def body(self) -> tuple[float, float]:
        """Greatest height and width in front of the tail fin, m."""
        body = self.rows if self.fin_at is None else self.rows[self.rows[:, 0] <= self.fin_at]
        high, wide = body[:, 1:].max(0)
        return float(high), float(wide)

    def at(self, x) -> np.ndarray:
        """Rows (.., 3) at stations x [m], linear in between."""
        x = np.asarray(x, float)
        return np.stack([x, *(np.interp(x, self.rows[:, 0], self.rows[:, k]) for k in (1, 2))], -1)

    @property
    def displaced(self) -> float:
        """Mass of fresh water that the hull displaces, kg."""
        return float(displaced(cut(self, [])).sum())


def typical(length: float, height: float, width: float, tail_height: float) -> Outline:
    """A fish of these sizes [m] with the proportions of the default fish, an elliptical nose and a tail fin that is a plate."""
    rows = [(x * length, h * height, w * width) for x, h, w in (*nose(), *BODY)]
    root = min(ROOT_H * height, 0.9 * tail_height)
    rows.append((ROOT * length, root, ROOT_W * width))
    rows += [(x * length, root + share * (tail_height - root), w * width) for x, share, w in FIN]
    return Outline(np.array(rows), ROOT * length, "typical proportions")


def nose() -> list[tuple[float, float, float]]:
    """Rows of an elliptical nose up to the deepest station: d (1 - cos a), sin a, sin a; a small first section, not a point."""
    angles = np.radians(np.arange(15, 91, 15))
    return [(0.0, 0.1, 0.1), *((DEEPEST * (1 - np.cos(a)), float(np.sin(a)), float(np.sin(a))) for a in angles)]


def typical_width(x: np.ndarray) -> np.ndarray:
    """Width over the greatest width of the default fish, at shares x (..) of the length."""
    rows = np.array([*nose(), *BODY, (ROOT, ROOT_H, ROOT_W), *FIN])
    return np.interp(x, rows[:, 0], rows[:, 2])


def root_of_fin(x: np.ndarray, height: np.ndarray) -> float | None:
    """Station at which the tail fin begins: the lowest of the rear half, if the outline rises by a sixth behind it; else None."""
    rear = (x > 0.5 * x[-1]) & (x < 0.97 * x[-1])
    if not rear.any():
        return None
    i = int(np.flatnonzero(rear)[np.argmin(height[rear])])
    return float(x[i]) if height[i:].max() > 7 / 6 * height[i] else None


def joints_of(length: float, links: int, head: float | None = None) -> list[float]:
    """Stations (links - 1,) of the joints, m: the head, bodies of one length, a tail of a third or of the remaining length.

    Args:
        head: its share of the length; by default 0.4, and 0.6 for a fish with only a head and a tail.
    """
    if links == 2:
        return [(ALONE if head is None else head) * length]
    first = HEAD if head is None else head
    last = max(TAIL, min(first + ROOM * (links - 2), LAST))
    return [float(x) for x in np.linspace(first, last, links - 1) * length]


def cut(outline: Outline, joints: list[float]) -> tuple[Link, ...]:
    """Links between the joints [m from the nose], without masses yet (1 kg each).

    Raises ConfigError: joints do not rise, lie outside the fish or leave a link shorter than a fiftieth of it.
    """
    total = round(outline.length, 6)
    edges = [0.0, *(round(x, 5) for x in joints), total]
    for front, rear in zip(edges[:-1], edges[1:], strict=True):
        if rear - front < SHORTEST * total - 1e-9:
            raise ConfigError(
                f"new: joints at {', '.join(f'{x:g}' for x in joints)} m from the nose: they must rise, lie inside the fish of"
                f" {total:g} m, and leave every link {SHORTEST * total:.3g} m or more"
            )
    names = ["head", *(f"body{i}" for i in range(1, len(edges) - 2)), "tail"][: len(edges) - 1]
    made = []
    for i, (front, rear) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        length = round(rear - front, 6)
        inside = outline.rows[(outline.rows[:, 0] > front + 1e-4 * total) & (outline.rows[:, 0] < rear - 1e-4 * total), 0]
        inside = inside[np.diff(inside, prepend=front) > 1e-4 * total]  # rounded stations must still rise
        rows = outline.at(np.concatenate([[front], inside, [rear]]))
        stations = [0.0, *(round(float(x) - front, 6) for x in inside), length]
        sections = tuple((s, round(float(h), 6), round(float(w), 6)) for s, (_, h, w) in zip(stations, rows, strict=True))
        plate = None if outline.fin_at is None or outline.fin_at >= rear - 1e-9 else max(round(outline.fin_at - front, 6), 0.0)
        colour = PALETTE[i % len(PALETTE)]
        made.append(Link(name=names[i], length=length, mass=1.0, sections=sections, fin_from=plate, colour=colour))
    return tuple(made)


def read_sections(path: Path, unit: str | None = None) -> Outline:
    """Reads an outline from a CSV file.

    Args:
        unit: of all columns, m, cm, mm or in, unless the header states it (`x [mm]`, `x_mm`, `x (mm)`). Metres by default.

    Raises ConfigError: with file and line: not a table, a column is missing, a cell is no number, x does not rise from 0, a
    section is not positive, the fish is implausibly small or large.
    """
    text = _text(path)
    first = text.splitlines()[0] if text.strip() else ""
    split = max(",;\t", key=first.count)
    try:
        lines = [row for row in csv.reader(text.splitlines(), delimiter=split, strict=True)]
    except csv.Error as error:
        raise ConfigError(f"{path}: not a CSV table: {error}; expected the columns {', '.join(COLUMNS)}") from error
    columns = _columns(path, lines[0] if lines else [], unit)
    rows = np.array([_row(path, n, row, columns) for n, row in enumerate(lines[1:], 2) if any(cell.strip() for cell in row)])
    if not ROWS[0] <= len(rows) <= ROWS[1]:
        raise ConfigError(f"{path}: {len(rows)} rows of sections; expected {ROWS[0]} to {ROWS[1]} below the header")
    x = rows[:, 0]
    if x[0] != 0 or (np.diff(x) <= 0).any():
        bad = 2 if x[0] != 0 else 3 + int(np.flatnonzero(np.diff(x) <= 0)[0])
        raise ConfigError(f"{path}:{bad}: x = {x[bad - 2]:g} m: x must begin with 0, the nose, and rise towards the tail")
    if not SIZE[0] <= x[-1] <= SIZE[1]:
        raise ConfigError(
            f"{path}: the last x is {x[-1]:g} m; expected a fish of {SIZE[0]:g} to {SIZE[1]:g} m: name the unit, --unit mm"
        )
    if rows[:, 1:].max() > x[-1]:
        raise ConfigError(
            f"{path}: a section of {rows[:, 1:].max():g} m in a fish of {x[-1]:g} m; are all columns in the same unit?"
        )
    return Outline(rows, root_of_fin(x, rows[:, 1]), f"table of sections {nearest(path.name)}")


def _text(path: Path) -> str:
    if (wrong := why_unreadable(path, "a table of sections")).startswith("is "):
        raise ConfigError(f"{path}: {wrong}")
    try:
        if path.stat().st_size > LARGEST:
            raise ConfigError(f"{path}: {path.stat().st_size} bytes; a table of sections has at most {LARGEST}")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a text file ({error.reason} at byte {error.start}); expected a CSV table") from error


def _columns(path: Path, header: list[str], unit: str | None) -> list[tuple[int, float, str]]:
    """(index in the row, factor to m, name) of x, height, width."""
    found = {}
    for i, cell in enumerate(header):
        parts = re.split(r"[\s\[\]()_/]+", cell.strip().lower())
        if parts[0] in COLUMNS:
            said = next((p for p in parts[1:] if p), unit or "m")
            if said not in UNITS:
                raise ConfigError(f"{path}:1: column {cell.strip()!r}: unit {said!r} is not one of {', '.join(UNITS)}")
            found[parts[0]] = (i, UNITS[said], parts[0])
    missing = [name for name in COLUMNS if name not in found]
    if missing:
        shown = ", ".join(cell.strip() for cell in header)[:80]
        raise ConfigError(f"{path}:1: no column {', '.join(missing)}; got {shown!r}, expected a first line x,height,width")
    return [found[name] for name in COLUMNS]


def _row(path: Path, line: int, row: list[str], columns: list[tuple[int, float, str]]) -> list[float]:
    values = []
    for i, factor, name in columns:
        cell = row[i].strip() if i < len(row) else ""
        try:
            value = float(cell) * factor
        except ValueError:
            value = math.nan
        least = 0.0 if name == "x" else THINNEST
        if not math.isfinite(value) or value < least:
            raise ConfigError(f"{path}:{line}: {name} = {cell[:40]!r}; expected a number of {least:g} m or more")
        values.append(value)
    return values
