"""Headings of unit quaternions: four columns x, y, z, w of one prefix become one heading [rad], in any file.

Their names tell which of the four is w. The heading is that of the body's x axis in the frame's xy plane:
yaw = atan2(2 (w z + x y), 1 - 2 (y^2 + z^2)).
"""

import re
from dataclasses import replace

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers.header import words
from fishmj.log.importers.sheet import Sheet
from fishmj.log.limits import listed

NORM = 0.02  # the norm may be off by this much: two decimals in a text file
UPRIGHT = 0.7  # cosine between the body's z axis and the frame's, below which its heading says little
ROTATION = set("q quat quaternion orientation orient rotation rot attitude".split())  # words for a quaternion
_LAST, _FIRST = re.compile(r"(.*?)(w)()", re.IGNORECASE | re.DOTALL), re.compile(r"()(w)([\W_].+)", re.IGNORECASE | re.DOTALL)
_NUMBERED = re.compile(r"(.*?)\[?([0-4])\]?", re.DOTALL)


def with_headings(sheet: Sheet) -> Sheet:
    """Sheet with a column `<prefix>yaw` [rad] in place of each quaternion's four; rows without a rotation are blank.

    Raises LogError: four numbered columns form a quaternion with an unknown place of w; or a norm is not 1.
    """
    for column in list(sheet.columns):
        for pattern in (_LAST, _FIRST):
            if found := pattern.fullmatch(column):
                before, w, after = found.groups()
                parts = [f"{before}{axis if w == 'w' else axis.upper()}{after}" for axis in "xyzw"]
                if all(part in sheet.columns for part in parts) and (
                    not ROTATION.isdisjoint(words(before + after)) or _is_unit(sheet, parts)
                ):
                    sheet = _replaced(sheet, parts, f"{before}{'_' if before[-1:].isalnum() else ''}yaw{after}")
    _refuse_numbered(sheet)
    return sheet


def heading(q: np.ndarray, where: str) -> tuple[np.ndarray, str]:
    """Headings [rad] of quaternions (T, 4) in the order x, y, z, w, NaN if all four are 0 or one is blank; and a doubt or "".

    Raises LogError: a norm is neither 0 nor 1.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.sqrt(np.sum(q**2, axis=1))
        wrong = np.flatnonzero((norm > 0) & (np.abs(norm - 1) > NORM))
    if len(wrong):
        raise LogError(
            f"{where}: the quaternion of row {wrong[0] + 1} has the norm {norm[wrong[0]]:.4g}, and so {len(wrong)} of {len(q)}; "
            "expected 1: is it a rotation? Rename its columns if it is none"
        )
    x, y, z, w = q.T
    yaw = np.where(norm > 0, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), np.nan)
    upright = np.abs(1 - 2 * (x * x + y * y))[np.isfinite(yaw)]
    if len(upright) and float(np.median(upright)) < UPRIGHT:
        tilt = np.degrees(np.arccos(float(np.median(upright))))
        return (yaw, f"its quaternion tilts the body by {tilt:.0f} deg from the z axis: is another axis up, or is w first?")
    return yaw, ""


def _is_unit(sheet: Sheet, parts: list[str]) -> bool:
    """Returns True if there are complete rows and all of them have the norm 1."""
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.sqrt(sum(sheet.columns[part] ** 2 for part in parts))
    norm = norm[np.isfinite(norm)]
    return len(norm) > 0 and bool((np.abs(norm - 1) <= NORM).all())


def _replaced(sheet: Sheet, parts: list[str], name: str) -> Sheet:
    q = np.stack([sheet.columns[part] for part in parts], 1)
    yaw, doubt = heading(q, f"{sheet.where}: {listed(parts)}")
    notes, unset = sheet.notes, int((q == 0).all(axis=1).sum())
    if unset:
        rows = f"in {unset} of {len(q)} rows"
        notes = (*notes, f"{sheet.name}: {listed(parts)} are all 0 {rows}: an orientation that was not set, no heading")
    columns = {}
    for column, values in sheet.columns.items():
        if column == parts[0] and unset < len(q):
            columns[name] = sheet.columns.get(name, yaw)  # a heading beside its quaternion stays
        if column not in (*parts, name):
            columns[column] = values
    units = {column: unit for column, unit in {name: "rad", **sheet.units}.items() if column in columns}
    return replace(sheet, columns=columns, units=units, notes=notes, doubts=sheet.doubts | ({name: doubt} if doubt else {}))


def _refuse_numbered(sheet: Sheet) -> None:
    """Refuses `q0..q3`: w is the first of them in some programs and the last in others."""
    groups: dict[str, list[str]] = {}
    for column in sheet.columns:
        if found := _NUMBERED.fullmatch(column):
            groups.setdefault(found[1], []).append(column)
    for prefix, columns in groups.items():
        if len(columns) == 4 and not ROTATION.isdisjoint(words(prefix)):
            if _is_unit(sheet, columns):
                raise LogError(
                    f"{sheet.where}: {listed(columns)} are a quaternion, and their names do not say which is w, the first or the "
                    "last; rename them to qx, qy, qz, qw in the order that the recording program states"
                )
