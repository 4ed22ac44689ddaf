"""CSV exports of Motive (OptiTrack): one line of settings, rows of types, names, ids, quantities and axes, then the frames.

Motive's Y axis points up by default. The motion shows if that was changed: a fish turns about the upward axis.
With Y up the plane's axes are x = X, y = -Z, with Z up x = X, y = Y. The heading is that of the rigid body's own x axis.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers.column_units import unit_of
from fishmj.log.importers.sheet import Sheet
from fishmj.log.limits import quoted

CLEAR = 4.0  # times that one axis is turned about more, or moved along less, than the next
STILL = 1e-4  # mean square of a quaternion's part; less is no turn
_PLACE, _TURN = ("Position X", "Position Y", "Position Z"), ("Rotation X", "Rotation Y", "Rotation Z", "Rotation W")


def settings(first: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Pairs of the first line; empty if the file is no export of Motive."""
    if not first or first[0] != "Format Version" or "Take Name" not in first:
        return ()
    return tuple(zip(first[::2], first[1::2], strict=False))


def names(path, line: int, rows: Sequence[Sequence[str]]) -> list[str]:
    """Column names `body Position X`, ..: object, quantity and axis; `rows` are those between settings and frames.

    Raises LogError: the rows of titles are missing.
    """
    rows = [row for row in rows if any(row)]
    types = next((k for k, row in enumerate(rows) if any("Rigid Body" in c or "Marker" in c or "Bone" in c for c in row[2:])), -1)
    if types < 0 or len(rows) < types + 4 or "Frame" not in rows[-1][:1]:
        raise LogError(
            f"{path}:{line}:1: a Motive export without its rows of types, names, quantities and axes; export it again "
            "with Header Information"
        )
    width = len(rows[-1])
    cell = lambda row, k: row[k] if k < len(row) else ""
    out = list(rows[-1][:2])
    for k in range(2, width):
        out.append(" ".join(filter(None, (cell(rows[types + 1], k), cell(rows[-2], k), cell(rows[-1], k)))))
    return out


def in_plane(sheet: Sheet, told: Sequence[tuple[str, str]]) -> Sheet:
    """Sheet with x, y [and yaw] of every body and marker in the horizontal plane in place of its columns in space.

    Raises LogError: rotations are no quaternions, or the motion does not show the upward axis.
    """
    said = dict(told)
    columns = sheet.columns
    places = [n.removesuffix(_PLACE[0]) for n in columns if n.endswith(_PLACE[0])]
    turned = [body for body in places if all(body + part in columns for part in _TURN)]
    rotations = [body for body in places if body + _TURN[0] in columns]
    if rotations != turned:
        raise LogError(
            f"{sheet.where}: a Motive export with Rotation Type {quoted(said.get('Rotation Type', 'not said'))}; export "
            "it again with Quaternion"
        )
    up = _up(sheet, places, turned)
    unit = unit_of(said.get("Length Units", ""))
    if not unit:
        raise LogError(f"{sheet.where}: a Motive export in {quoted(said.get('Length Units', 'no unit'))}; expected Length Units")
    used = {body + part for body in places for part in (*_PLACE, *_TURN)}
    out = {name: values for name, values in columns.items() if name not in used}
    for body in places:
        across = -columns[body + "Position Z"] if up == "Y" else columns[body + "Position Y"]
        out |= {f"{body}x [{unit}]": columns[body + "Position X"], f"{body}y [{unit}]": across}
        if body in turned:
            x, y, z, w = (columns[body + part] for part in _TURN)
            side = -2 * (x * z - w * y) if up == "Y" else 2 * (x * y + w * z)
            out[f"{body}yaw [rad]"] = np.arctan2(side, 1 - 2 * (y * y + z * z))
    plane = "x = X, y = -Z" if up == "Y" else "x = X, y = Y"
    note = f"{sheet.name}: a Motive export with {up} up: {plane}, yaw of the body's own x axis; heights and tilts left out"
    text = {name: cell for name, cell in sheet.text.items() if name in out}
    return replace(sheet, columns=out, text=text).noted(note)


def _up(sheet: Sheet, places: Sequence[str], turned: Sequence[str]) -> str:
    """The upward axis, Y or Z."""
    spread = np.zeros(3)
    turn = np.zeros(3)
    for body in places:
        spread += [_spread(sheet.columns[body + part]) for part in _PLACE]
    for body in turned:
        q = np.stack([sheet.columns[body + part] for part in _TURN])
        q = q[:, np.isfinite(q).all(axis=0)]
        if q.shape[1]:
            (a, b, c, d), (x, y, z, w) = q[:, :1], q  # relative to the first: q * conj(first)
            turn += [
                np.mean(v**2)
                for v in (d * x - a * w - y * c + z * b, d * y - b * w - z * a + x * c, d * z - c * w - x * b + y * a)
            ]
    vote = "Y"  # Motive's own, where nothing moves
    if turn.max() > max(STILL, CLEAR * np.sort(turn)[1]):
        vote = "XYZ"[int(np.argmax(turn))]
    elif CLEAR * spread.min() < np.sort(spread)[1]:
        vote = "XYZ"[int(np.argmin(spread))]
    if vote == "X":
        raise LogError(
            f"{sheet.where}: a Motive export in which X points up, by its motion; expected Y or Z: export x, y and heading in "
            "the plane as a table of their own"
        )
    return vote


def _spread(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.quantile(values, 0.95) - np.quantile(values, 0.05)) if len(values) else 0.0
