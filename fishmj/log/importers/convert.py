"""Converts sheets and a map to a checked trial: SI units, seconds, nothing resampled; omitted data are noted."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from itertools import pairwise, permutations

import numpy as np

from fishmj.base.errors import LogError, closest_name
from fishmj.log import toml
from fishmj.log.clock_alignment import in_common
from fishmj.log.importers import header, joint_switches, table_forms
from fishmj.log.importers.cells import frame_doubt
from fishmj.log.importers.column_map import ColumnMap, Stamp, TableMap, measured
from fishmj.log.importers.column_units import SI, UNITS, clocks_apart, fitting, time_unit
from fishmj.log.importers.registry import renamed, trial_of
from fishmj.log.importers.sheet import DATE, EPOCH, Sheet
from fishmj.log.limits import bare, quoted, typed
from fishmj.log.trial import Table, Trial, table_spec
from fishmj.log.trial_check import Implausible, Place, bounds_of
from fishmj.log.unread_rows import fresh_rows

DAY, HALF_DAY, HOUR, MINUTE = 86_400.0, 43_200.0, 3600.0, 60.0  # s; clocks further apart than a day are different clocks
AHEAD = 60.0  # s, between the last command and the first row of the swim
NEAR, SLACK = 10, 0.01  # steps, or part of the period of a counter that may go by while it turns
_PIECES = re.compile(r"(\d+)")
FEW = 3  # times that a clock which was set goes back; rows that are mixed do so more often
PAIRS, FAR = 0.2, 0.01  # share of rows with the stamp of the row before; rad or m that two sources are apart
STRETCHED = 1.5  # times that x and y of one camera may be scaled apart
BENT, NEVER = 1.7, 0.35  # rad: the middle of no joint; a joint is nearer to straight than that at some time
MOVES = 0.02  # rad that a joint swings
EVEN = 10  # rows on either side of a step back that tell a clock that was set
SWIM = ("cmd", "joint", "pose", "imu", "velocity", "markers")  # tables that are of one swim
STRAY = 0.01  # share of rows whose stamp may fall behind; more is no longer a stray


def convert(name: str, sheets: Sequence[Sheet], wanted: ColumnMap, meta: dict) -> Trial:
    """One trial of the tables that the map names and these sheets hold.

    Raises:
        LogError: a table or a column of the map is absent or in two files, or the values break the schema; file, line and column.
    """
    found: dict[str, tuple[Table, Place]] = {}
    absolute: dict[str, bool] = {}
    clocks: dict[str, str] = {}
    taken: set[str] = set()
    notes = [note for sheet in sheets for note in sheet.notes]
    used = {c for entry in wanted.tables.values() for c in _sources(entry)} | set(wanted.skip)
    for sheet in sheets:
        table_forms.refuse_several(sheet, used, skips=True)
    for table, entry in wanted.tables.items():
        sheet = _sheet(table, entry, sheets)
        taken.add(sheet.name)
        columns, place, told, absolute[table] = _table(table, sheet, entry)
        found[table] = (columns, place)
        clocks[table] = "date" if absolute[table] else f"{sheet.where}:{entry.t.column}"
        notes += _from_end(table, sheet, columns, entry, bounds_of(meta, name).angle)
        notes += [*(note for note in sheet.notes if note not in notes), *told]
    notes += _zero({t: found[t][0] for t, is_absolute in absolute.items() if is_absolute})
    aligned = {t: absolute[t] for t in wanted.tables if t in SWIM and "offset" not in wanted.tables[t].model_fields_set}
    if counted := [t for t, is_absolute in aligned.items() if any(aligned.values()) and not is_absolute]:
        text = f"{', '.join(counted)}: stamps without a date beside stamps with one, which are counted from their first row"
        notes.append(f"{text}: two clocks; state their offset in a map, from an event that both saw")
    for table, entry in wanted.tables.items():
        found[table][0]["t"] = found[table][0]["t"] + entry.offset
    swim = {table: columns["t"] for table, (columns, _) in found.items() if table in SWIM}
    _refuse_apart(name, swim)
    clocks = {table: clock for table, clock in clocks.items() if "offset" not in wanted.tables[table].model_fields_set}
    _refuse_short(name, swim, clocks, bounds_of(meta, name).overlap)
    for sheet in sheets:
        for table, entry in wanted.tables.items() if sheet.name not in taken else ():
            here = set(_sources(entry)) & sheet.columns.keys()
            missed = 2 * len(here) > len(set(_sources(entry))) > len(here) and entry.t.column in here
            if missed and (entry.file is None or _fits(sheet, entry.file)):
                raise LogError(f'{_absent(table, entry, [sheet])}, or give it file = "pattern" of the files that it is in')
    for sheet in sheets:
        if rest := [column for column in sheet.columns if column not in used]:
            more = f" and {len(rest) - 8} more" if len(rest) > 8 else ""
            notes.append(f"{sheet.name}: not read: {', '.join(bare(c) for c in rest[:8])}{more}")
            reasons = {header.no_place(header.parse(column)): bare(column) for column in reversed(rest)}
            notes += [f"{sheet.name}: {column}: {reason}" for reason, column in reasons.items() if reason]
    if "markers" in found and "pose" not in found:
        why = "positions without a heading are points and no pose, and no model is compared with points"
        notes.append(f"markers: {why}; map the heading, columns.yaw of [tables.pose] or --set COLUMN=pose.yaw:UNIT")
    return trial_of(name, meta, found, notes, lambda table, doubt: _advised(table, doubt, wanted.tables[table]))


def _advised(table: str, doubt: Implausible, entry: TableMap) -> str:
    """Error for an implausible value, with the line of the map that would correct it."""
    source = entry.t if doubt.column == "t" else entry.columns[doubt.column]
    place, what = ("t", "time") if doubt.column == "t" else (f"{table}.{doubt.column}", measured(table, doubt.column))
    if source.column is None:
        return f"{doubt.place}: [tables.{table}] {doubt.column} {doubt.value_and_range}. Mend its constant, in SI units"
    name, unit = quoted(source.column), source.unit or SI[what]
    scaled = f" times {source.scale:g}" if source.scale != 1 else ""
    allow = f"; if it is right, allow it with --plausible {doubt.bound}=..."
    text = f"{doubt.place}: column {name} in {unit}{scaled} as {place} {doubt.value_and_range}"
    fits = fitting(what, doubt.value, unit, doubt.span) if not scaled else []
    if not fits:
        return f"{text}. Mend its scale, zero or unit in the map{allow}"
    line = f"{place if place == 't' else f'columns.{doubt.column}'} = {toml.inline({'column': source.column, 'unit': fits[0]})}"
    units = " or ".join(f'"{unit}"' for unit in fits)
    return f"{text}. Say unit = {units}: {line} in the map, or --set {typed(source.column)}={place}:{fits[0]}{allow}"


def _sources(entry: TableMap) -> list[str]:
    columns = [c.column for c in entry.columns.values() if c.column is not None]
    return [entry.t.column, *entry.t.parts, *columns]


def _sheet(table: str, entry: TableMap, sheets: Sequence[Sheet]) -> Sheet:
    """The one sheet that holds all columns of a table. Raises LogError: none holds them all, or several do."""
    wanted = set(_sources(entry))
    fitting = [sheet for sheet in sheets if wanted <= set(sheet.columns) and (entry.file is None or _fits(sheet, entry.file))]
    if len(fitting) > 1 and (whole := _of_parts(fitting, entry)):
        return whole
    if len(fitting) > 1:
        names = ", ".join(quoted(sheet.name) for sheet in fitting[:4])
        raise LogError(
            f"{fitting[0].path.parent}: [tables.{table}]: {len(fitting)} files hold its columns ({names}); say which with "
            'file = "pattern", or import each file as a trial of its own with --trial-each'
        )
    if not fitting:
        raise LogError(_absent(table, entry, sheets))
    return fitting[0]


def in_order(sheets: Sequence[Sheet]) -> list[Sheet]:
    """Files in the order of the numbers in their names: swim_2 before swim_10."""
    return sorted(sheets, key=lambda sheet: [(int(p), "") if p.isdecimal() else (0, p) for p in _PIECES.split(sheet.name)])


def go_on(sheets: Sequence[Sheet], column: str) -> bool:
    """Returns True for consecutive files: by time, each begins at most three rows after the one before ends."""
    stamps = [sheet.columns[column][np.isfinite(sheet.columns[column])] for sheet in sheets]
    if len(stamps) < 2 or min(map(len, stamps)) < 3:
        return False
    return all(0 < b[0] - a[-1] <= 3 * float(np.median(np.diff(a))) for a, b in pairwise(stamps))


def _of_parts(sheets: Sequence[Sheet], entry: TableMap) -> Sheet | None:
    """Joins files of the same columns in the order of their numbers; None if their stamps do not continue."""
    ordered = in_order(sheets)
    first = ordered[0]
    stamps = [_seconds(sheet, entry.t)[0] for sheet in ordered]
    if any(np.nanmax(a) >= np.nanmin(b) for a, b in pairwise(stamps)) or any(
        s.columns.keys() != first.columns.keys() for s in ordered
    ):
        return None
    columns = {name: np.concatenate([sheet.columns[name] for sheet in ordered]) for name in first.columns}
    name = f"{first.name} to {ordered[-1].name}"
    whole = replace(first, path=first.path.parent, name=name, columns=columns, lines=None)
    return whole.noted(f"{name}: {len(ordered)} files of the same columns, put together in the order of their names")


def _fits(sheet: Sheet, pattern: str) -> bool:
    return fnmatchcase(sheet.name.lower(), pattern.lower()) or fnmatchcase(sheet.path.name.lower(), pattern.lower())


def _absent(table: str, entry: TableMap, sheets: Sequence[Sheet]) -> str:
    """Error text: the missing column of a table, in the file that holds most of the others, and the nearest column there."""
    wanted, remedy = _sources(entry), f"mend the map, or take [tables.{table}] out of it"
    mine = [sheet for sheet in sheets if entry.file is None or _fits(sheet, entry.file)]
    if not mine:
        where = sheets[0].path.parent if sheets else "nothing"
        return f"{where}: [tables.{table}]: no file is called {quoted(entry.file)}; {remedy}"
    sheet = max(mine, key=lambda sheet: sum(column in sheet.columns for column in wanted))
    lacking = [column for column in wanted if column not in sheet.columns]
    near = closest_name(lacking[0], sheet.columns)
    hint = f"; did you mean {quoted(near)}?" if near else ""
    has = ", ".join(bare(c) for c in list(sheet.columns)[:12])
    return f"{sheet.where}: [tables.{table}]: no column {', '.join(map(quoted, lacking[:4]))}{hint}; it has {has}; {remedy}"


def _table(table: str, sheet: Sheet, entry: TableMap) -> tuple[Table, Place, list[str], bool]:
    """(columns in SI, their places, notes, True if the stamps count from 1970)."""
    t, absolute = _seconds(sheet, entry.t)
    notes: list[str] = []
    out: Table = {"t": t}
    names = {"t": entry.t.column}
    for column, source in entry.columns.items():
        if source.column is None:
            out[column] = np.full(len(sheet), source.constant)
        else:
            out[column] = (sheet.columns[source.column] - source.zero) * source.factor
            names[column] = source.column
            if measured(table, column) != "angle" and (form := table_forms.unsigned(sheet.columns[source.column])):
                notes.append(f"{table}: column {quoted(source.column)} as {column}: {form}")  # an angle's turns are unwrapped
            if np.isnan(out[column]).all():
                what = f", such as {quoted(sheet.text[source.column])}" if source.column in sheet.text else ""
                raise LogError(
                    f"{sheet.place(0, source.column)}: column {quoted(source.column)} holds no number{what}; "
                    f"leave it out of the map, or --set {typed(source.column)}=skip"
                )
    _refuse_stretched(table, sheet, entry)
    keep = ~np.isnan(np.stack(list(out.values()))).any(axis=0)
    if not keep.any():
        raise LogError(
            f"{sheet.where}: [tables.{table}]: no row has a number in all of "
            f"{', '.join(map(quoted, names.values()))}; leave one out, or map them to tables of their own"
        )
    if not keep.all():
        notes.append(f"{table}: {int((~keep).sum())} of {len(keep)} rows of {sheet.name} left out, blank in one of its columns")
    rows = np.flatnonzero(keep)
    if len(rows) == 1 and table_spec(table).continuous:
        raise LogError(
            f"{sheet.place(int(rows[0]), entry.t.column)}: [tables.{table}]: one row only; it has no rate and moves nothing"
        )
    t, told = _unwrapped(table, sheet, t[rows], rows, entry.t, absolute)
    notes += [*told, *_other_clock(table, sheet, entry.t, rows, t)]
    order, told = _rising(table, sheet, t, rows, entry.t)
    if t[order].size < t.size:
        _refuse_pairs(table, sheet, t, order, {name: out[name][rows] for name in out if name != "t"}, names["t"])
    rows = rows[order]
    notes += told
    columns = {column: values[rows] for column, values in out.items()} | {"t": t[order]}
    fresh, told = fresh_rows(table, columns)
    rows, columns = rows[fresh], {column: values[fresh] for column, values in columns.items()}
    notes += told
    notes += _across_the_seam(table, columns)
    notes += _still(table, columns)
    if doubt := joint_switches.find(columns["t"], {name: columns[name] for name in _angles(table, columns)}):
        row, column, text = doubt
        raise LogError(f"{sheet.place(int(rows[row]), names.get(column, ''))}: [tables.{table}]: {text}")
    place = renamed(lambda row, column: sheet.place(int(rows[row]) if 0 <= row < len(rows) else -1, column), names)
    return columns, place, notes, absolute


def _refuse_stretched(table: str, sheet: Sheet, entry: TableMap) -> None:
    """Raises LogError if x and y have scales of their own, none of them plain metres, that the file's header does not state."""
    axes = [entry.columns[axis] for axis in "xy" if axis in entry.columns]
    factors = {c.column: abs(c.factor) for c in axes if c.column and (c.unit not in ("", "m") or c.scale != 1)}
    if len(factors) < 2 or max(factors.values()) <= STRETCHED * min(factors.values()):
        return
    if [(c.unit, c.scale) for c in axes] != [(sheet.units.get(name) or header.parse(name).unit, 1.0) for name in factors]:
        each = ", ".join(f"{quoted(name)} {factor:.4g} m" for name, factor in factors.items())
        message = f"{sheet.where}: [tables.{table}]: a unit of the file is in {each}; expected one scale for x and y"
        raise LogError(f"{message}. Mend unit or scale, or state both units in the file's header")


def _angles(table: str, columns: Iterable[str]) -> list[str]:
    """Names of the columns of joint angles, commanded or measured."""
    return [name for name in columns if table in ("cmd", "joint") and name[0] in "cj" and name[1:].isdecimal()]


def _across_the_seam(table: str, columns: Table) -> list[str]:
    """Unwraps joint angles that pass from 360 degrees to 0, or from 180 to -180, in place; a note on each."""
    notes = []
    for name in _angles(table, columns):
        angle = columns[name]
        step = np.abs(np.diff(angle))
        wraps = step > 1.5 * np.pi
        if wraps.any() and np.ptp(angle) <= 2 * np.pi + 1e-6 and not (step[~wraps] > 0.5 * np.pi).any():
            whole = np.unwrap(angle)
            columns[name] = whole - 2 * np.pi * np.round(np.median(whole) / (2 * np.pi))
            notes.append(f"{table}: {name} passes the seam of a turn {int(wraps.sum())} times; unwrapped")
    return notes


def _still(table: str, columns: Table) -> list[str]:
    """Notes on a robot that was off, or a logger that repeats its first packet."""
    moving = [column for column, values in columns.items() if column != "t" and np.ptp(values) > 0]
    if moving or len(columns["t"]) < 3 or not table_spec(table).continuous:
        return []
    return [f"{table}: nothing moves: every column is one number in all {len(columns['t'])} rows"]


def _from_end(table: str, sheet: Sheet, columns: Table, entry: TableMap, most: float) -> list[str]:
    """Notes on joints that are never straight, as the counts of a servo are without their zero.

    Args:
        most: largest plausible angle of a joint [rad].

    Raises LogError: the middle is further from straight than a robot's joint bends.
    """
    notes = []
    for name in _angles(table, entry.columns):
        source = entry.columns[name]
        if source.column is None:
            continue
        low, middle, high = (float(q) for q in np.quantile(columns[name], (0.001, 0.5, 0.999)))
        near, far = min(abs(low), abs(high)), abs(middle)
        swings = MOVES < high - low < near  # about a middle that is further than it swings
        if low * high <= 0 or near < NEVER and not swings or source.zero or max(-low, high) > most:
            continue
        text = (
            f"column {quoted(source.column)} as {table}.{name} is {low:.3g} to {high:.3g} rad, never straight: counted from the "
            "servo's end? Say in a map zero = the reading of the straight joint"
        )
        if far > BENT and most <= np.pi:
            raise LogError(f"{sheet.place(0, source.column)}: {text}; if it is right, allow it with --plausible angle=4")
        notes.append(f"{table}: {text}")
    return notes


def _seconds(sheet: Sheet, stamp: Stamp) -> tuple[np.ndarray, bool]:
    """Stamps in s, and True if they count from 1970."""
    raw = sheet.columns[stamp.column]
    dated = stamp.unit == DATE or sheet.units.get(stamp.column) == DATE
    if dated and stamp.unit != DATE and (doubt := frame_doubt(raw)):
        raise LogError(f"{sheet.place(0, stamp.column)}: {doubt}")
    if not dated:
        table_forms.refuse_digits(sheet, stamp.column)
    t = raw * (1.0 if dated else stamp.factor)
    for column, size in stamp.parts.items():
        t = t + size * sheet.columns[column]
    finite = t[np.isfinite(t)]
    if not len(finite):
        raise LogError(f"{sheet.place(0, stamp.column)}: column {quoted(stamp.column)} of time stamps holds no number")
    return t, dated or abs(float(finite[0])) > EPOCH


def _unwrapped(
    table: str, sheet: Sheet, t: np.ndarray, rows: np.ndarray, stamp: Stamp, absolute: bool
) -> tuple[np.ndarray, list[str]]:
    """Stamps without the wraps of a time of day or of a counter of 16, 31 or 32 bits, and a note if there were some."""
    step = np.diff(t)
    back = np.flatnonzero(step < 0)
    if not len(back):
        return t, []
    of_day = absolute and abs(t[0]) <= DAY
    turns = {"a time of day passes midnight": DAY}
    if t[0] > 1.0 > t[back + 1].max():  # each run of a logger begins alike
        turns |= {"the seconds of a minute begin again": MINUTE}
    if of_day:
        turns |= {"a time of day without AM or PM passes twelve": HALF_DAY, "a time of day passes the hour": HOUR}
    clocks = {unit: UNITS[unit][1] for unit in ("us", "ms") if stamp.scale == 1.0}  # frames are counted in no us
    for unit, factor in (clocks | {"its unit": stamp.factor}).items():
        turns |= {f"a counter of {bits} bits of {unit} begins again": 2.0**bits * factor for bits in (16, 31, 32)}
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    for told, period in turns.items():
        over = step[back] + period  # what went by from the row before to the turn and on
        allowed = SLACK * period if of_day else max(NEAR * usual, min(1.0, SLACK * period))
        if np.ptp(t) < period and 2 * usual < period and ((over > 0) & (over <= allowed)).all():
            place = sheet.place(int(rows[back[0] + 1]), stamp.column)
            times = f" {len(back)} times" if len(back) > 1 else ""
            note = f"{table}: {place}: {told}{times}; {period:.15g} s added from there on"
            return t + period * np.concatenate([[0], np.cumsum(step < 0)]), [note]
    return t, []


def _other_clock(table: str, sheet: Sheet, stamp: Stamp, rows: np.ndarray, t: np.ndarray) -> list[str]:
    """Notes on a count of frames, as stamps t (T,) s, from which another column of time departs by more than two frames."""
    notes = []
    for column in (c for c in sheet.columns if stamp.scale != 1.0 and c != stamp.column):
        name, values = header.parse(column), sheet.columns[column][rows]
        unit = sheet.units.get(column) or name.unit or time_unit(values)[0]
        apart = clocks_apart(t, values, ("s", unit)) if unit and header.role(name, set()).places == ("t",) else 0.0
        if apart and apart > 2 * float(np.median(np.diff(t))):
            why = f"parts by {apart:.2g} s from {quoted(column)}: frames that were dropped and not counted, or another rate?"
            notes.append(f"{table}: {quoted(stamp.column)} times {stamp.factor:g} s {why}")
    return notes


def _rising(table: str, sheet: Sheet, t: np.ndarray, rows: np.ndarray, stamp: Stamp) -> tuple[np.ndarray, list[str]]:
    """Keeps the rows with rising stamps. Single strays and repeats are left out with a note; more are an error."""
    if len(t) < 2 or (np.diff(t) > 0).all():
        return np.arange(len(t)), []
    stray, behind = strays(t)
    first = int(np.flatnonzero(behind)[0])
    step = "stands still" if t[first] == t[first - 1] else "goes back"
    text = f"{sheet.place(int(rows[first]), stamp.column)}: time {step}: {t[first]:.15g} s after {t[first - 1]:.15g} s"
    repeats = int(np.sum(np.diff(t) == 0))
    if repeats == int(behind.sum()) and repeats <= 0.5 * len(t):  # stamps coarser than the rate, or rows sent twice
        return np.flatnonzero(~behind), [f"{table}: {text}; {repeats} of {len(t)} rows with the stamp of the row before left out"]
    if stray.sum() > max(1, STRAY * len(t)) or len(t) - stray.sum() < 2:
        often = int(np.sum(np.diff(t) < 0))
        if doubt := sheet.doubts.get(stamp.column):
            advice = f"Mend the file: {doubt}"
        elif repeats > 0.5 * len(t):
            advice = "The stamps are coarser than the rate; name another column of time"
        elif often == len(t) - 1:
            advice = "The newest row comes first: reverse the rows"
        elif 0 <= t.min() < 1.0 and MINUTE - 1.0 < t.max() < MINUTE:
            advice = "Seconds of a minute? Write one column, 60 min + s. If the logger began again, split the file there"
        elif often <= FEW:
            advice = "The clock was set or the logger began again: split the file there, or name another column of time"
        else:
            advice = "Sort the rows by time, or name another column of time"
        raise LogError(f"{text}; {int(stray.sum())} of {len(t)} rows are out of order. {advice}")
    if back := _set_back(t, np.stack([values[rows] for values in sheet.columns.values()], axis=1)):
        what = "the clock was set back" if stamp.scale == 1.0 else "the count of frames began again, back"
        raise LogError(f"{text}; {what} by {back:.3g} s. Split the file there, or name another column of time")
    return np.flatnonzero(~stray), [f"{table}: {text}; {int(stray.sum())} such row(s) left out"]


def strays(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T,) bool: the fewest rows without which the stamps rise, ahead of the others or behind them; and those behind."""
    ahead = np.r_[t[:-1] >= np.minimum.accumulate(t[::-1])[::-1][1:], False]  # later than a row that follows
    behind = np.r_[False, t[1:] <= np.maximum.accumulate(t)[:-1]]
    return (ahead if ahead.sum() < behind.sum() else behind), behind


def _set_back(t: np.ndarray, values: np.ndarray) -> float:
    """Seconds by which a clock is set back, or a count of frames begins again; 0 where rows only come out of order, as strays do.

    Even stamps show it on both sides of the step. Others, as where frames were dropped or the step is near an end, show it by
    two or more rows (of other values (T, C): not sent twice) that go through stamps which were there, and on from the last.
    """
    rising = np.diff(t)[np.diff(t) > 0]
    usual = float(np.median(rising)) if len(rising) else 0.0
    for first in np.flatnonzero(np.diff(t) < 0) + 1:
        around = t[max(first - EVEN, 0) : first + EVEN]
        if len(around) == 2 * EVEN:
            step = float(np.median(np.diff(around)))
            own = around - step * np.arange(2 * EVEN)
            back = float(np.median(own[:EVEN]) - np.median(own[EVEN:]))
            if max(np.ptp(own[:EVEN]), np.ptp(own[EVEN:])) < 0.5 * step < step < back:
                return back
        end = first + int(np.argmax(np.append(t[first:], np.inf) > t[first - 1]))
        before = np.flatnonzero((t[:first] >= t[first]) & (t[:first] <= t[end - 1]))
        on = end == len(t) or t[end] - t[end - 1] <= NEAR * usual
        if on and end - first > 1 and len(before) > 1 and not _sent_twice(values[before], values[first:end]):
            return float(t[first - 1] - t[first]) + usual
    return 0.0


def _sent_twice(early: np.ndarray, late: np.ndarray) -> bool:
    """Returns True if rows (n, C) repeat rows before them."""
    return len(early) == len(late) and np.array_equal(early, late, equal_nan=True)


def _refuse_pairs(table: str, sheet: Sheet, t: np.ndarray, order: np.ndarray, columns: Table, stamp: str) -> None:
    """Raises LogError for rows that share a stamp and differ by more than the kept rows do between stamps: two sources."""
    again = np.flatnonzero(np.diff(t) == 0) + 1
    if len(again) < PAIRS * len(t) or len(order) < 20:
        return
    for name, values in columns.items():
        apart, step = (float(np.median(np.abs(d))) for d in (values[again] - values[again - 1], np.diff(values[order])))
        if apart > max(3 * step, FAR):
            raise LogError(
                f"{sheet.where}: [tables.{table}]: {len(again)} of {len(t)} rows have the stamp of the row before "
                f"({quoted(stamp)}) and another {name}, {apart:.2g} away in the median, while it changes by {step:.2g} between "
                "stamps: two fish, two joints, or commands among measurements? Expected one row a stamp: keep the rows of one, "
                "or give each its own columns"
            )


def _refuse_apart(name: str, stamps: Table) -> None:
    """Raises LogError for tables of one swim without a common instant; commands may be sent a minute ahead of it."""
    for (early, before), (late, after) in permutations(stamps.items(), 2):
        if after[0] - before[-1] > (AHEAD if early == "cmd" else 0.0):
            apart = float(after[0] - before[0])
            hours = f" ({round(apart / HOUR)} h apart: two time zones?)" if apart > 0.9 * HOUR else ""
            raise LogError(
                f"{name}: {early} ends at {before[-1]:.6g} s, {late} begins at {after[0]:.6g} s: they have no instant in common"
                f"{hours}. State the offset in a map, [tables.{late}] offset = {-apart:.6g}, with which both begin at"
                " once; it removes a true delay too, so mend it by an event that both saw; or import one of them alone"
            )


def _refuse_short(name: str, stamps: Table, clocks: dict[str, str], least: float) -> None:
    """Raises LogError for tables on two clocks that share little of the longer one: other units, or other recordings.

    Few commands may be followed by a long rest. clocks: of the tables whose offset no map states.
    """
    for short, long in permutations((table for table in stamps if table in clocks), 2):
        one, two = stamps[short], stamps[long]
        both, share = in_common(one, two)
        few = short == "cmd" and len(one) < 2 * EVEN
        if clocks[short] != clocks[long] and 0 <= share < least and np.ptp(one) <= np.ptp(two) and not few:
            raise LogError(
                f"{name}: {short} spans {np.ptp(one):.6g} s, {long} {np.ptp(two):.6g} s, of which they share {both:.3g} s,"
                f" {100 * share:.2g} % of the longer; expected at least {100 * least:g} %: are the clocks in two units, or are"
                f" these two recordings? Mend the unit, take the right file or cut the longer one; if it is right, say offset ="
                f" 0 in the map's [tables.{short}], or --plausible overlap={max(0.5 * share, 1e-6):.1g}"
            )


def _zero(tables: dict[str, Table]) -> list[str]:
    """Shifts stamps that count from 1970 to the earliest of them, in place; a clock more than a day away gets its own zero."""
    if not tables:
        return []
    starts = {name: float(table["t"][0]) for name, table in tables.items()}
    notes: list[str] = []
    last = max(starts.values())
    for name, start in starts.items():
        day = DAY * round((last - start) / DAY) if abs(start) <= DAY else 0.0  # a time of day is of the day next to the others
        if day:
            tables[name]["t"], starts[name] = tables[name]["t"] + day, start + day
            date = f"are taken for those of {datetime.fromtimestamp(day, UTC):%Y-%m-%d}"
            notes.append(
                f"{name}: its times of day {date if last > EPOCH else 'begin after midnight, others before; 24 h added'}"
            )
    near = {name: start for name, start in starts.items() if max(starts.values()) - start < DAY}
    zero = min(near.values())
    for name, table in tables.items():
        own = zero if name in near else starts[name]
        if name not in near:
            notes.append(f"{name}: its clock is {(zero - own) / DAY:.1f} days away from the others; it starts at its own zero")
        table["t"] = table["t"] - own
    return [f"{', '.join(near)}: stamps are a date or count from 1970; t = 0 is {zero:.6f} s after 1970", *notes]
