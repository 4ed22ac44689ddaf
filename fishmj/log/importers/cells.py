"""Cells of a text table: numbers, dates and times of day in the notation of any country, and blanks.

A cell may have two readings: `1,234` is 1.234 with a decimal comma and 1234 with a comma between thousands; `3/4/2026` is in
March or in April. Both are returned; the rest of the column, else of the file, decides (`decided`).
"""

import math
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from fishmj.log.limits import quoted

BLANKS = {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "#nv", "<na>", "nat"}
DAY = 86_400.0  # s
TIME_CODE = re.compile(r"\d{1,2}:\d{2}:\d{2}[:;]\d{2}", re.ASCII)  # of a video: hours, minutes, seconds, frames
FRAMES = 0.75  # of a second that frames reach as decimals: 60 of 100, 240 or 480 of 1000
_SPACED = re.compile(r"[+-]?\d{1,3}(?P<mark>['\u2019\x92\u00a0\u2009\u202f ])\d{3}(?:(?P=mark)\d{3})*(?:[.,]\d*)?", re.ASCII)
_MARKS = re.compile(r"['\u2019\x92\u00a0\u2009\u202f ]")
_MINUS = re.compile(r"\A[\u2212\u2013\x96](?=[\d.,])|(?<=[eE])\u2212")  # minus sign, en dash, and that of Windows-1252
_EXPONENT = r"(?:[eEdD][+-]?\d+)?"
_PLAIN = {
    r"\.": re.compile(rf"[+-]?(?:\d+\.?\d*|\.\d+){_EXPONENT}", re.ASCII),
    ",": re.compile(rf"[+-]?(?:\d+(?:,\d+)?|,\d+){_EXPONENT}", re.ASCII),
}
_GROUPED = {
    (point, group): re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:{group}\d{{3}})+(?:{point}\d*)?", re.ASCII)
    for point, group in ((r"\.", ","), (",", r"\."))
}
_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2}):(?P<s>\d{2}(?:[.,]\d+|:\d{3})?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_TIME_OF_DAY = re.compile(_CLOCK, re.ASCII)
_LONG = {"sec": 1.0, "min": 60.0, "hr": 3600.0, "day": DAY, "days": DAY}  # s; how MATLAB writes a duration
_DURATION = re.compile(rf"([+-]?\d+(?:\.\d+)?) ({'|'.join(_LONG)})", re.ASCII)
_MINUTES = re.compile(r"(\d{1,2}):(\d{2}[.,]\d+)", re.ASCII)
_DATE = re.compile(rf"(\d{{1,4}})([./-])(\d{{1,2}}|[A-Za-z\u00e4]{{3,4}}\.?)\2(\d{{2}}|\d{{4}})[ T,]\s*{_CLOCK}")
_MONTHS = {"jan": 1, "feb": 2, "mar": 3, "m\u00e4r": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9}
_MONTHS |= {"oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12}


class CellReading(NamedTuple):
    """Values of a cell, a decimal point or the day first, and a comma or the month first; NaN for an impossible one."""

    first: float
    second: float
    grouped: bool = False  # it has marks between its thousands
    date: bool = False

    @property
    def two(self) -> bool:
        """Returns True if the second value exists and differs from the first."""
        return not math.isnan(self.second) and self.second != self.first


def is_number(text: str) -> bool:
    """Returns True if a cell is a number in any style."""
    return number(text.strip()) is not None


def is_value(text: str) -> bool:
    """Returns True if a cell is a number, a date or a time of day."""
    return read(text.strip()) is not None


def read(text: str) -> CellReading | None:
    """The number, duration [s], date or time of day of a cell without blanks around it; None for text."""
    if found := _DURATION.fullmatch(text):
        seconds = float(found[1]) * _LONG[found[2]]
        return CellReading(seconds, seconds)
    return number(text) or (_stamp(text) if ":" in text and len(text) <= 40 else None)


def number(text: str) -> CellReading | None:
    """The number of a cell; None for text."""
    text = _MINUS.sub("-", text)
    spaced = bool(_SPACED.fullmatch(text))
    text = _MARKS.sub("", text) if spaced else text
    (first, one), (second, two) = _value(text, r"\.", ","), _value(text, ",", r"\.")
    if math.isnan(first) and math.isnan(second):
        return None
    return CellReading(first, second, spaced or one or two)


def _value(text: str, point: str, group: str) -> tuple[float, bool]:
    """(value in one style, NaN if the cell does not fit it; True if it has marks between thousands)."""
    grouped = bool(_GROUPED[point, group].fullmatch(text))
    if not grouped and not _PLAIN[point].fullmatch(text):
        return math.nan, False
    text = text.replace(group[-1], "") if grouped else text
    return float(text.replace(point[-1], ".").replace("D", "e").replace("d", "e")), grouped


def _stamp(text: str) -> CellReading | None:
    """Seconds since 1970 of a date and time (UTC if no zone is given), or seconds of the day for a time of day."""
    if clock := _TIME_OF_DAY.fullmatch(text):
        seconds = _of_day(clock)
        return CellReading(seconds, seconds, date=True)
    if short := _MINUTES.fullmatch(text):
        seconds = 60.0 * int(short[1]) + float(short[2].replace(",", "."))
        return CellReading(seconds, seconds, date=True)
    if found := _DATE.fullmatch(text):
        a, mark, b, c = found[1], found[2], found[3], found[4]
        if len(a) == 4:
            first = second = _since_1970(a, b, c, found)
        elif mark == "." or not b.isdecimal():
            first = second = _since_1970(c, b, a, found)
        else:
            first, second = _since_1970(c, b, a, found), _since_1970(c, a, b, found)
        return None if math.isnan(first) and math.isnan(second) else CellReading(first, second, date=True)
    try:
        moment = datetime.fromisoformat(text.replace(",", "."))
        seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except (OverflowError, ValueError):
        return None
    return CellReading(seconds, seconds, date=True)


def _of_day(clock: re.Match) -> float:
    whole, mark, ms = clock["s"].rpartition(":")
    seconds = float(whole) + 1e-3 * int(ms) if mark else float(ms.replace(",", "."))
    hours = int(clock["h"])
    if clock["half"]:
        hours = hours % 12 + (12 if clock["half"][0] in "pP" else 0)
    return 3600.0 * hours + 60.0 * int(clock["m"]) + seconds


def _since_1970(year: str, month: str, day: str, clock: re.Match) -> float:
    number = int(month) if month.isdecimal() else _MONTHS.get(month[:3].lower(), 0)
    try:
        moment = datetime(int(year) + (2000 if len(year) == 2 else 0), number, int(day), tzinfo=UTC)
        return moment.timestamp() + _of_day(clock)
    except (OverflowError, ValueError):
        return math.nan


def decided(
    first: Mapping[str, np.ndarray], second: Mapping[str, np.ndarray], dates: Mapping[str, object]
) -> tuple[dict[str, np.ndarray], dict[str, int], list[str]]:
    """Chooses one reading for each column.

    Args:
        first, second: column -> (T,), as in `CellReading`; dates: the columns that hold dates.

    Returns:
        The columns; column -> its first row with two readings, if nothing decides between them; notes.
    """
    only = {
        name: tuple(np.isfinite(a) & np.isnan(b) for a, b in ((first[name], second[name]), (second[name], first[name])))
        for name in first
    }
    file = tuple(any(mine[k].any() for name, mine in only.items() if name not in dates) for k in (0, 1))
    out, open_, notes = {}, {}, []
    grouped = commas = False
    for name, a in first.items():
        b = second[name]
        both = np.isfinite(a) & np.isfinite(b) & (a != b)
        out[name] = np.where(np.isnan(a), b, a)
        own = tuple(bool(mask.any()) for mask in only[name])
        commas |= name not in dates and own[1]
        if not both.any():
            continue
        if name in dates:
            pick = 0 if own == (True, False) else 1 if own == (False, True) else _calmer(a, b)
            if pick is None:
                notes.append(f"column {quoted(name)}: day and month are not told apart; the date of the first row may be another")
        else:
            pick = next((said.index(True) for said in (own, file) if sum(said) == 1), -1)
            larger = np.abs(a) > np.abs(b) if pick == 0 else np.abs(b) > np.abs(a)  # without its marks a number is larger
            grouped |= pick >= 0 and bool((both & larger).any())
            commas |= pick == 1 and bool((both & ~larger).any())
        if pick == -1:
            open_[name] = int(np.flatnonzero(both)[0])
        out[name] = np.where(both, b, out[name]) if pick == 1 else out[name]
    notes += ["marks between thousands left out"] if grouped else []
    return out, open_, notes + (["decimal commas read as points"] if commas else [])


def _calmer(day_first: np.ndarray, month_first: np.ndarray) -> int | None:
    """The reading of dates in which no step exceeds a day: 0 or 1, None if both give the same day, -1 if neither decides."""
    longest = [float(np.max(np.abs(np.diff(v[np.isfinite(v)])), initial=0.0)) for v in (day_first, month_first)]
    calm = [value < DAY for value in longest]
    return None if all(calm) else calm.index(True) if any(calm) else -1


def frame_doubt(seconds: np.ndarray) -> str:
    """Doubt about times of day (T,) whose decimals count the frames of a video, as `10:00:05.29`; "" for decimal seconds.

    Decimal seconds of even steps come to one step before the next second in every second; frames never do.
    """
    t = seconds[np.isfinite(seconds)]
    digits = next((n for n in (2, 3) if np.all(np.abs(10**n * t - np.round(10**n * t)) < 0.01)), 0)
    whole, part = np.divmod(np.round(10**digits * t), 10**digits)
    turns = np.diff(whole)
    steps = np.diff(part)[turns == 0]
    if len(t) < 10 or not digits or not len(steps) or not turns.any() or 2 * np.sum(turns == 1) < np.sum(turns != 0):
        return ""
    step, most = float(np.median(steps)), float(part.max())
    if step <= 0 or most + step > FRAMES * 10**digits:
        return ""
    span = f".{part.min():0{digits}.0f} to .{most:0{digits}.0f}"
    return (
        f"its decimals count from {span} and begin again each second: frames of a video? Write seconds, s + frame / frames a"
        ' second; if they are decimals of a second, say unit = "date" in a map'
    )


def may_lack_zeros(values: np.ndarray) -> bool:
    """Returns True for a column that falls at times and has no fraction below 0.1, as `1.8` for 1.008."""
    v = values[np.isfinite(values)]
    part = np.round(v % 1, 6)
    return bool(
        np.any(np.diff(v) < 0) and np.any(np.abs(10 * part - np.round(10 * part)) > 1e-4) and np.all((part == 0) | (part >= 0.1))
    )


def unpadded(texts: Sequence[str]) -> str:
    """The first fraction that lacks zeros, as of printf("%d.%d", s, ms), and its cure; "" unless with zeros the column rises."""
    cut = [found for text in texts if (found := re.fullmatch(r"(.*\d)[.,](\d+)", text, re.ASCII))]
    whole = [read(found[1]) for found in cut]
    digits = max((len(found[2]) for found in cut), default=0)
    short = [found for found in cut if len(found[2]) < digits and int(found[2])]
    if len(cut) < len(texts) or not all(whole) or not short:
        return ""
    t = [cell.first + int(found[2]) / 10**digits for cell, found in zip(whole, cut, strict=True) if cell]
    told = f"{quoted(short[0][0])} for {quoted(f'{short[0][1]}.{short[0][2]:0>{digits}}')}"
    return f"fractions of a second look unpadded ({told}): write them with zeros" if np.all(np.diff(t) > -1e-6) else ""


def may_hide_thousands(values: np.ndarray) -> bool:
    """Returns True for a column in which `1.020` may follow `980`: whole numbers beside numbers of three decimals beyond 1."""
    v = values[np.isfinite(values)]
    broken = v[v != np.round(v)]
    whole = v[v == np.round(v)]
    decimals = np.abs(1e3 * broken - np.round(1e3 * broken)) < 1e-6
    return bool(len(broken) and len(whole) and np.abs(broken).min() > 1 and np.abs(whole).max() > 99 and decimals.all())


def hidden_thousands(texts: Sequence[str]) -> int:
    """First row whose point separates thousands, judged by the jumps that this removes; -1 if there is none."""
    both = [number(text) or CellReading(math.nan, math.nan) for text in texts]
    first = np.array([cell.first for cell in both])
    second = np.array([cell.second if cell.two else cell.first for cell in both])
    marked = first != second
    if any("." in text and not mark for text, mark in zip(texts, marked, strict=True)) or not marked.any():
        return -1
    jumps = [float(np.max(np.abs(np.diff(v[np.isfinite(v)])), initial=0.0)) for v in (first, second)]
    return int(np.argmax(marked)) if jumps[1] < 0.2 * jumps[0] else -1
