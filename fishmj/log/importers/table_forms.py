"""Forms in which laboratories write tables and that are no plain numbers in a column each: a test and a sentence for each.

Marks for no value are blanked with a note, several robots or trials are found, and what must be written otherwise is a doubt of
its sheet (`Sheet.doubts`), of the column of time, or of the whole file.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers import header
from fishmj.log.importers.cells import BLANKS
from fishmj.log.importers.column_units import PARTS, UNITS
from fishmj.log.importers.sheet import DATE, Sheet
from fishmj.log.limits import bare, quoted, typed

SEVERAL = {"trial", "run", "take", "episode", "experiment", "repeat", "repetition"}  # words of a column that counts trials
ROBOTS = {"robot", "robots", "fish", "swimmer", "animal", "individual", "subject", "id", "name"}  # of one that tells robots apart
STATES = {"state", "status", "phase", "mode", "valid", "flag", "off"}  # of one that tells a trial's parts
SHORT = ("id", "name", "no", "nr", "number", "index")  # which may number servos, too
LABEL = {"no", "nr", "number", "index", "label"}  # words beside them
FRAME = {"child", "frame"}  # words beside the id of a message's frame, which is a text; a camera counts its frames in numbers
ROWS, MOST = 10, 32  # of a trial at least, on average; values of a column that tells robots apart, at most
INTEGERS = (32767.0, -32768.0, 65535.0, 2.0**31 - 1, -(2.0**31), 2.0**32 - 1)  # ends of numbers of 16 and 32 bits
NINES, HUGE = 999.0, 1e9  # least mark of nines; least value that is a mark where it repeats
NONE, MOST_SEEN = -1.0, 0.75  # the mark in a column of numbers beyond 1, and their share at least
MARKS, FEW = 4, 0.1  # marks of one column at most; share of its other numbers at least, beside marks below 0
FAR = 0.2  # of a mark, by which it is at least away from all other values
LOW, HIGH = 2.0**14, 3 * 2.0**14  # between them lies no number of 16 bits around 0 that was written without its sign
HALF = 2.0**15  # by which they step at 0, up and down
CLOCK = 3  # usual steps that a row may be after the one before the minute's end
SMOOTH, MOST_ON = 0.2, 0.75  # of a column's deviation, the usual bend of one that moves smoothly; share of those that go on
STEP = (("dt",), ("deltat",), ("timestep",), ("delta", "t"), ("delta", "time"), ("time", "delta"), ("time", "step"))
_PARTS = {  # of a clock: last words of their columns
    "hour": {"h", "hh", "hour", "hours", "stunde", "stunden"},
    "minute": {"m", "mm", "min", "minute", "minutes", "minuten"},
    "second": {"s", "ss", "sec", "second", "seconds", "sekunde", "sekunden"},
}
_PAIR = re.compile(r"""["']?(?<!\w)[A-Za-z_]\w*["']?\s*[=:]\s*["']?[-+]?\.?\d""")
_MARK = re.compile(r"[,;\t]")


# ------------------------------------------------------------------------------------------------------ robots and trials
@lru_cache(1024)
def may_tell_apart(column: str) -> bool:
    """Returns True for a name that says nothing but a robot, a fish or a trial, such as `fish_id`; not for `run_time`."""
    said = {word for word in header.words(column) if not word.isdecimal()}
    return bool(said & (SEVERAL | ROBOTS)) and said <= SEVERAL | ROBOTS | LABEL | FRAME


def several(column: str, values: Iterable) -> str:
    """Sentence on a column whose values (T,), numbers or texts without blanks, tell robots or trials apart; "" for one."""
    said, alone = set(header.words(column)), may_tell_apart(column)
    counted = bool(said & SEVERAL) and not said & STATES and not header.parse(column).unit
    if not counted and not alone:
        return ""
    values = list(values)
    found = list(dict.fromkeys(values))
    apart = alone and len(found) <= MOST and len(found) * ROWS <= len(values)
    apart = apart and (not said & FRAME or all(isinstance(value, str) for value in found))
    steps = sum(a != b for a, b in zip(values, values[1:], strict=False))
    whole = lambda value: isinstance(value, str) or value % 1 == 0
    if len(found) < 2 or not (apart or counted and steps * ROWS < len(values) and all(map(whole, found))):
        return ""
    shown = [bare(value) if isinstance(value, str) else f"{value:g}" for value in found[:4]]
    told = f"column {quoted(column)} holds {len(found)} values ({', '.join(shown)}{', ..' * (len(found) > 4)})"
    servos = not counted and header.words(column)[0] in SHORT
    what, each = ("trials, robots or servos", ", a column for each servo") if servos else ("trials or robots", "")
    return f"{told}: several {what} in one file; write a file for each{each}"


def told_apart(texts: Mapping[str, Iterable] | Sequence[Mapping[str, str | int]]) -> dict[str, str]:
    """Columns of texts or numbers (T,), or labels of messages, that tell robots or trials apart -> sentence; blanks do not."""
    if not isinstance(texts, Mapping):
        texts = {key: [one[key] for one in texts if key in one] for key in dict.fromkeys(chain(*texts))}
    told = {c: several(c, (v for v in values if str(v).strip().lower() not in BLANKS)) for c, values in texts.items()}
    return {column: sentence for column, sentence in told.items() if sentence}


def labels(message: Mapping, prefix: str = "") -> dict[str, str | int]:
    """Fields of a message that may name its robot, fish or frame, down to six levels -> their texts or numbers."""
    out: dict[str, str | int] = {}
    for key, value in message.items() if prefix.count(".") < 5 else ():
        path = f"{prefix}.{str(key)[:80]}".lstrip(".")
        if isinstance(value, Mapping):
            out |= labels(value, path)
        elif type(value) in (str, int) and (name := next(filter(may_tell_apart, (path, str(key)[:80])), "")):
            out[name] = value
    return out


def refuse_several(sheet: Sheet, used: Collection[str | None], skips: bool = False) -> None:
    """Raises LogError if a column that is not used tells trials or robots apart, which would be one with jumps between them.

    Args:
        skips: the user may say --set COLUMN=skip.
    """
    for column, values in sheet.columns.items():
        if column not in used and (told := sheet.apart.get(column) or several(column, values[np.isfinite(values)])):
            more = f", or --set {typed(column)}=skip to read them as one" * skips
            raise LogError(f"{sheet.where}: {told}{more}")


# --------------------------------------------------------------------------------------------------------- marks, 16 bits
def looked_at(sheet: Sheet) -> Sheet:
    """The sheet with marks for no value blanked and noted, and with doubts on columns of another form."""
    columns, notes, doubts = dict(sheet.columns), [], dict(sheet.doubts)
    for name, values in sheet.columns.items():
        marks = _marks(values)
        if marks:
            columns[name] = np.where(np.isin(values, marks), np.nan, values)
            told = ", ".join(f"{mark:.15g} in {int(np.sum(values == mark))}" for mark in marks)
            rest = columns[name][np.isfinite(columns[name])]
            others = f"others are {rest.min():.4g} to {rest.max():.4g}"
            notes.append(f"{sheet.name}: column {quoted(name)}: {told} of {len(values)} cells, {others}: taken for blanks")
        if name not in doubts and (told := unsigned(columns[name])):
            doubts[name] = told
    for column, told in _clock_parts(columns).items():
        doubts.setdefault(column, told)
    return replace(sheet, columns=columns, doubts=doubts).noted(*notes)


def _marks(values: np.ndarray) -> list[float]:
    """Numbers that stand for no value: -999, 9999, 65535 or the like, beyond all other values (T,) and far from them.

    So does -1 in a few cells of a column of larger numbers.
    """
    said = rest = values[np.isfinite(values)]
    marks: list[float] = []
    while len(rest) and len(marks) <= MARKS:
        ends = [float(end) for end in (rest.min(), rest.max()) if _is_mark(float(end), rest)]
        if not ends:
            break
        marks.append(ends[0])
        rest = rest[rest != ends[0]]
    least = FEW if max(marks, default=0.0) < 0 else 0.5  # a reading may stay at 999
    if not marks or len(marks) > MARKS or len(rest) < least * len(said) or len(np.unique(rest)) < 3:
        return []
    far = lambda mark: max(rest.min() - mark, mark - rest.max()) > max(np.ptp(rest), FAR * abs(mark))
    return marks if all(map(far, marks)) else []


def _is_mark(value: float, among: np.ndarray) -> bool:
    """Returns True if one end of some numbers (N,) looks like a mark."""
    others = among[among != value]
    if value == NONE and len(others) >= MOST_SEEN * len(among):
        return bool(np.abs(others).min() > max(abs(NONE), np.ptp(others)))
    nines = set(f"{abs(value):.12g}".partition("e")[0].replace(".", "").rstrip("0")) == {"9"}
    return value in INTEGERS or (nines and abs(value) >= NINES) or (len(among) - len(others) > 1 and abs(value) >= HUGE)


def unsigned(values: np.ndarray) -> str:
    """Sentence on numbers of 16 bits (T,) with a sign that were written without it; "" for others."""
    v = values[np.isfinite(values)]
    if not len(v) or v.min() < 0 or v.max() > 65535 or v.max() < HIGH or np.any((v > LOW) & (v < HIGH)) or v.min() > LOW:
        return ""
    if np.any(v % 1) or np.diff(v).min() > -HALF or np.diff(v).max() < HALF:  # a counter that begins again only falls
        return ""
    told = f"up to {v.max():.0f}, none from {LOW:.0f} to {HIGH:.0f}: numbers of 16 bits without their sign?"
    return f"{told} Subtract 65536 from the large ones"


# ------------------------------------------------------------------------------------------------------------------- time
def clock_digits(stamps: np.ndarray, columns: Collection[np.ndarray] = ()) -> tuple[int, str] | None:
    """(row, sentence) on stamps (T,) in the digits of a clock, HHMMSS after a date or none, with or without ms; None for others.

    At a minute's end they jump by 41, where the clock goes on by its usual step; no digits of minutes and seconds reach 60. In
    the first hour, and of MMSS, a jump from 59 to 100 may also be a rest: the other columns (T,) tell, which go on or do not.
    """
    rows = np.flatnonzero(np.isfinite(stamps))
    t = stamps[rows]
    for size in (1.0, 1e3) if len(t) >= ROWS else ():
        whole = np.floor(t / size)
        date, (hour, minute, second) = whole // 1e6, (whole // 1e4 % 100, whole // 100 % 100, whole % 100)
        month, day, year = date // 100 % 100, date % 100, date // 1e4
        on_date = np.all((month >= 1) & (month <= 12) & (day >= 1) & (day <= 31))
        dated = bool(on_date and np.all((year >= 1990) & (year < 2100)))
        short = bool(on_date and np.all((year >= 10) & (year < 100)))
        brief = bool(date.max() == 0 and whole.min() < 1e4)
        if not (dated or short or date.max() == 0):
            continue
        if hour.max() > 23 or minute.max() > 59 or second.max() > 59:
            continue
        clock = 3600 * hour + 60 * minute + second + (t / size - whole)
        turns = np.diff(minute) != 0
        step, usual = np.diff(clock), float(np.median(np.diff(clock)))
        ends = np.flatnonzero(turns & (step > 0) & (step <= max(CLOCK * usual, 1.0)) & (np.diff(t / size) >= 40))
        if (not len(ends) and not dated) or not 0 < usual < 60 or 2 * len(ends) < turns.sum():
            continue
        if brief and not _goes_on([values[rows] for values in columns], ends):
            continue
        i = int(ends[0]) if len(ends) else 0
        seen = f"{t[i + 1]:.16g} after {t[i]:.16g}" if len(ends) else f"{t[0]:.16g}"
        as_clock = f"{hour[i + 1]:02.0f}:{minute[i + 1]:02.0f}:{second[i + 1]:02.0f}"
        todo = f"write colons, such as {as_clock}, or 3600 h + 60 min + s" + "; if it is a rest, split the file there" * brief
        return int(rows[i + 1]), f"its digits are those of a clock, {seen}; expected seconds: {todo}"
    return None


def refuse_digits(sheet: Sheet, column: str) -> None:
    """Raises LogError for a column of stamps in the digits of a clock."""
    others = [values for name, values in sheet.columns.items() if name != column]
    if sheet.units.get(column) != DATE and (told := clock_digits(sheet.columns[column], others)):
        raise LogError(f"{sheet.place(told[0], column)}: {told[1]}")


def _goes_on(columns: Iterable[np.ndarray], ends: np.ndarray) -> bool:
    """Returns True if most of the columns (T,) that move smoothly do so from these rows to the next, too: no time went by."""
    on, moves = [], False
    for values in columns:
        step, bend = np.abs(np.diff(values)), np.abs(np.diff(values, 2, prepend=np.nan))
        usual = float(np.nanquantile(bend, 0.95)) if np.isfinite(bend).any() else 0.0
        if 0 < usual < SMOOTH * float(np.nanstd(values)):
            on += [*(bend[ends] <= CLOCK * usual)]
            moves |= bool(np.nanmedian(step[ends]) > np.nanmedian(step) > 0)
    return moves and float(np.mean(on)) > MOST_ON


def without_time(columns: Mapping[str, np.ndarray]) -> str:
    """Sentence on a file without a column of time; "" without a known form."""
    step = next((name for name in columns if header.parse(name).words in STEP), "")
    if step:
        return f"{quoted(step)} is the step from row to row; write its running sum, numpy.cumsum, as column t"
    return next(iter(_clock_parts(columns).values()), "")


def _clock_parts(columns: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Columns of the seconds of a minute and of parts of them, beside one of the minutes -> sentence."""
    of = {part: [c for c in columns if header.words(c)[-1:] and header.words(c)[-1] in said] for part, said in _PARTS.items()}
    for column in of["second"]:
        for minute in of["minute"]:
            rows = np.isfinite(columns[column]) & np.isfinite(columns[minute])
            s, m = columns[column][rows], columns[minute][rows]
            back = np.flatnonzero(np.diff(s) < 0)
            whole = np.all((m % 1 == 0) & (m >= 0) & (m < 60)) and np.all((s >= 0) & (s < 60))
            if whole and len(back) and np.all(np.diff(m)[back] != 0):
                unit = {c: header.parse(c).unit for c in columns if header.parse(c).words == ("time",) and not np.any(s % 1)}
                most = {c: float(np.max(np.nan_to_num(columns[c]), initial=0.0)) for c in unit}
                part = next((c for c in unit if unit[c] in PARTS and most[c] * UNITS[unit[c]][1] < 1), "")
                more = f" + {unit[part]} / {1 / UNITS[unit[part]][1]:.0f}" if part else ""
                seconds = [column, part] if part else [column]
                parts = ", ".join(quoted(c) for c in (*of["hour"][:1], minute, *seconds))
                told = f"the clock is in several columns, {parts}: write one column, 3600 h + 60 min + s{more}"
                return dict.fromkeys(seconds, told)
    return {}


# --------------------------------------------------------------------------------------------------------------- of a file
def pairs(lines: Sequence[str]) -> str:
    """Sentence on lines of text whose cells are a name and a value each, as `t=0.02, x=1.3`; "" for a table."""
    found = [line for line in lines if max(1, len(_MARK.findall(line)) / 2) < len(_PAIR.findall(line))]  # most of its cells
    if len(found) < 2 or 2 * len(found) <= len(lines):
        return ""
    return f"cells of a name and a value, {quoted(found[0][:40])}; expected a row of names, and rows of numbers below it"
