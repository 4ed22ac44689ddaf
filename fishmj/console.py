"""What every command line shares: errors as exit codes, one JSON object last, tables, a progress line with the time left.

Exit codes: 0 an answer, 1 a check that fails, 2 bad input, 3 too short or too quiet to tell, 70 a fault of fishmj itself,
130 interrupted by the user. This module is the only one that prints.
"""

import argparse
import json
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import IO, Any, NoReturn

from fishmj import interrupt
from fishmj.errors import FishmjError, UsageError

OK, FAILED_CHECK, BAD_INPUT, CANNOT_TELL, FAULT, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 3, 70, 130, 141

Main = Callable[[list[str]], int | None]


def run(main: Main, argv: Sequence[str] | None = None) -> int:
    """Call `main(argv)` and turn whatever happens into an exit code; errors are one line on stderr.

    With `--json` among the arguments an error is also one JSON object on stdout: {"error", "kind", "exit"}.
    A command (`fishmj.interrupt`), interrupted or not, ends here and does not return.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    interrupt.telling(lambda message: _interrupted(argv, message))
    code = _called(main, argv)
    if interrupt.asked():
        interrupt.leave(None if code == INTERRUPTED else "")
    interrupt.finish(code)
    return code


def _called(main: Main, argv: list[str]) -> int:
    try:
        return int(main(argv) or OK)
    except FishmjError as error:
        return _fail(argv, " ".join(str(error).split()), type(error).__name__, BAD_INPUT)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else OK if stop.code is None else _fail(argv, str(stop.code), "exit", 1)
    except KeyboardInterrupt:
        return _fail(argv, "interrupted", "KeyboardInterrupt", INTERRUPTED)
    except BrokenPipeError:
        sys.stdout = None  # the reader is gone: nothing to flush at exit
        return PIPE_CLOSED
    except Exception as error:  # noqa: BLE001  the last resort: a fault of ours gets its own exit code
        if interrupt.asked():  # what an interrupt breaks off is no fault
            return FAULT
        traceback.print_exc()
        return _fail(argv, f"this is a fault in fishmj, please report it: {error}", type(error).__name__, FAULT)


def _interrupted(argv: Sequence[str], message: str) -> None:
    """The last line of an interrupted command, below a progress line that stands open in a terminal."""
    if sys.stderr.isatty():
        print(file=sys.stderr)
    _fail(argv, message, "KeyboardInterrupt", interrupt.code())


def _fail(argv: Sequence[str], message: str, kind: str, code: int) -> int:
    print(f"fishmj: {message}", file=sys.stderr)
    if "--json" in argv:
        emit_json({"error": message, "kind": kind, "exit": code})
    return code


class Parser(argparse.ArgumentParser):
    """argparse whose errors are one `UsageError` line with the nearest known option or choice, in place of the usage text."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{self.prog.removeprefix('fishmj ')}: {message}; see {self.prog} --help")

    def parse_args(self, args=None, namespace=None):
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            options = [o for o in self._option_string_actions if o.startswith("--")]
            near = get_close_matches(unknown[0].partition("=")[0], options, 1, 0.6)
            self.error(f"unknown argument {' '.join(unknown)}" + (f"; did you mean {near[0]}?" if near else ""))
        return found

    def _check_value(self, action, value) -> None:
        if action.choices is not None and value not in action.choices:
            known = [str(c) for c in action.choices]
            near = get_close_matches(str(value), known, 1, 0.5)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise argparse.ArgumentError(action, f"got {value!r}.{hint} Known: {', '.join(known)}")


def parser(verb: str, summary: str, *, json: bool = True) -> Parser:
    """An argument parser for `python -m fishmj.<verb>`, with `--json` unless told otherwise."""
    made = Parser(prog=f"fishmj {verb}", description=summary, allow_abbrev=False)
    if json:
        made.add_argument("--json", action="store_true", help="print one JSON object last")
    return made


def number(low: float, high: float = math.inf, *, above: bool = False) -> Callable[[str], float]:
    """The `type=` of an option that takes a finite number from `low` (with `above`: beyond it) to `high`."""
    expected = f"a number {'above' if above else 'from'} {low:g}" + (
        f" to {high:g}" if high < math.inf else "" if above else " up"
    )

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and low <= value <= high) or (above and value == low):
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {expected}")
        return value

    return parse


def whole(low: int, high: int | None = None) -> Callable[[str], int]:
    """The `type=` of an option that takes a whole number from `low` to `high`."""
    expected = f"a whole number from {low} " + (f"to {high}" if high is not None else "up")

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {expected}") from None
        if value < low or (high is not None and value > high):
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {expected}")
        return value

    return parse


def out_file(text: str) -> Path:
    """The `type=` of an option that names a file to write: refused before the work starts where that cannot be."""
    path = Path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{path}: is a folder; name a file to write")
    _writable(path, path.parent)
    return path


def out_folder(text: str) -> Path:
    """The `type=` of an option that names a folder to write into: refused before the work starts where that cannot be."""
    path = Path(text)
    if path.exists() and not path.is_dir():
        raise argparse.ArgumentTypeError(f"{path}: is a file; name a folder to write into")
    _writable(path, path)
    return path


def _writable(path: Path, folder: Path) -> None:
    """Whether a file can be made in `folder`, which may not exist yet; writes nothing."""
    try:
        there = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    except OSError as error:  # a name too long, or one that the file system cannot hold
        raise argparse.ArgumentTypeError(f"{str(path)[:80]}: {error.strerror}; choose another name") from error
    if not there.is_dir():
        raise argparse.ArgumentTypeError(f"{path}: {there} is a file, so nothing can be written below it; choose another place")
    if not os.access(there, os.W_OK | os.X_OK):
        raise argparse.ArgumentTypeError(f"{path}: {there} cannot be written by this user; choose another place")


def say(*lines: str) -> None:
    """Print lines for a human, at once."""
    for line in lines:
        print(line, flush=True)


def warn(message: str) -> None:
    """Print one line on stderr that does not stop the command."""
    print(f"fishmj: {message}", file=sys.stderr, flush=True)


def emit_json(value: Any) -> None:
    """Print one JSON value on one line. Arrays become lists, paths text, and NaN and infinity null."""
    print(json.dumps(plain(value), allow_nan=False), flush=True)


def plain(value: Any) -> Any:
    """The value in JSON's own types; needs no NumPy, so that `doctor` can speak where it is missing."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # NumPy and JAX, scalars too
        return plain(value.tolist())
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    return str(value)


def table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None) -> str:
    """Rows as a Markdown table that also reads well in a terminal: numbers to the right, floats to 4 digits, NaN as `-`."""
    names = list(columns if columns is not None else rows[0] if rows else [])
    cells = [[_cell(row.get(name)) for name in names] for row in rows]
    wide = [max([len(name), 3, *(len(row[i]) for row in cells)]) for i, name in enumerate(names)]
    right = [bool(rows) and all(_is_number(row.get(name)) for row in rows) for name in names]

    def line(values: Sequence[str]) -> str:
        return "| " + " | ".join(v.rjust(w) if r else v.ljust(w) for v, w, r in zip(values, wide, right, strict=True)) + " |"

    rule = "|" + "|".join("-" * (w + 1) + (":" if r else "-") for w, r in zip(wide, right, strict=True)) + "|"
    return "\n".join([line(names), rule, *map(line, cells)])


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def duration(seconds: float) -> str:
    """`7.2 s`, `3 min 05 s`, `2 h 10 min`."""
    if not math.isfinite(seconds):
        return "?"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


class Progress:
    """A line with a bar, the rate and the time left; on a file or pipe a plain line now and then.

        with Progress(1_000_000, "train", unit="steps") as bar:
            bar.update(done, reward=0.4)

    The time left comes from the last `memory` seconds of progress, so that a slow start (compilation) is forgotten.
    """

    def __init__(
        self,
        total: float,
        label: str,
        unit: str = "",
        *,
        stream: IO[str] | None = None,
        clock: Callable[[], float] = time.monotonic,
        every: float | None = None,
        memory: float = 30.0,
    ):
        self.total, self.label, self.unit = total, label, unit
        self._stream = sys.stderr if stream is None else stream
        self._live = bool(getattr(self._stream, "isatty", lambda: False)())
        self._every = every if every is not None else 0.2 if self._live else 15.0  # s between two lines
        self._clock, self._memory = clock, memory
        self._start = clock()
        self._shown = -math.inf
        self._seen = [(self._start, 0.0)]  # (time [s], done), the last `memory` seconds
        self._named = False  # a stage without a rate is under way
        self._width = 0

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, kind, error, trace) -> None:
        if self._live and self._width:
            print(file=self._stream, flush=True)

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._start

    @property
    def rate(self) -> float:
        """Units a second over the remembered time; 0 before the first update."""
        (t0, d0), (t1, d1) = self._seen[0], self._seen[-1]
        return (d1 - d0) / (t1 - t0) if t1 > t0 else 0.0

    @property
    def left(self) -> float:
        """Seconds left at the present rate; infinite before the first update."""
        return max(self.total - self._seen[-1][1], 0.0) / self.rate if self.rate > 0 else math.inf

    def update(self, done: float, **fields: Any) -> None:
        """Report `done` of `total` and any named figures; prints only when it is time to."""
        now = self._clock()
        if self._named:
            self._named, self._seen, self._shown = False, [], -math.inf
        self._seen.append((now, done))
        while len(self._seen) > 2 and now - self._seen[1][0] > self._memory:
            self._seen.pop(0)
        if done < self.total and now - self._shown < self._every:
            return
        self._shown = now
        self._show(self.line(**fields))

    def stage(self, text: str) -> None:
        """Name at once what the rate does not count, such as `compiling ...`; with the next update the time left begins anew."""
        self._named = True
        self._show(f"{self.label}: {text}")

    def _show(self, line: str) -> None:
        if self._live:
            print("\r" + line.ljust(self._width), end="", file=self._stream, flush=True)
            self._width = len(line)
        else:
            print(line, file=self._stream, flush=True)

    def line(self, **fields: Any) -> str:
        """The text of the line as it stands."""
        done = self._seen[-1][1]
        part = min(done / self.total, 1.0) if self.total else 1.0
        ahead = f"{duration(self.left)} left" if part < 1 else f"took {duration(self.elapsed)}"
        figures = "".join(f"  {name} {_cell(value)}" for name, value in fields.items())
        return (
            f"{self.label} [{'#' * int(20 * part):<20}] {100 * part:3.0f} %  {_short(self.rate)} {self.unit}/s  {ahead}{figures}"
        )


def _short(number: float) -> str:
    for scale, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(number) >= scale:
            return f"{number / scale:.3g}{letter}"
    return f"{number:.3g}"
