"""Shared by every command line: errors as exit codes, one JSON object last, tables, a progress line with the time left.

Also: parsers with one-line errors, types of options with a range, groups of commands. `EXITS` holds the meaning of the exit
codes. All output goes through `terminal`.
"""

import argparse
import errno
import json
import math
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from functools import cached_property
from importlib import import_module
from importlib.metadata import entry_points
from textwrap import dedent
from typing import Any, NamedTuple, NoReturn, TypeVar

from fishmj.base import interrupt, terminal
from fishmj.base.errors import DescriptionError, FishmjError, UnknownName, UsageError
from fishmj.base.options import DEVICE_HELP as DEVICE_HELP
from fishmj.base.options import DEVICES_HELP as DEVICES_HELP
from fishmj.base.options import SEED as SEED
from fishmj.base.options import SHOWN, shown, unlisted
from fishmj.base.options import TURN as TURN
from fishmj.base.options import Distinct as Distinct
from fishmj.base.options import Listed as Listed
from fishmj.base.options import Number as Number
from fishmj.base.options import OneOf as OneOf
from fishmj.base.options import add_settings as add_settings
from fishmj.base.options import angle as angle
from fishmj.base.options import angle_text as angle_text
from fishmj.base.options import device as device
from fishmj.base.options import devices as devices
from fishmj.base.options import flow as flow
from fishmj.base.options import name as name
from fishmj.base.options import number as number
from fishmj.base.options import numbers as numbers
from fishmj.base.options import out_file as out_file
from fishmj.base.options import out_folder as out_folder
from fishmj.base.options import path as path
from fishmj.base.options import pose as pose
from fishmj.base.options import refuse_unheeded as refuse_unheeded
from fishmj.base.options import settings_of as settings_of
from fishmj.base.options import text as text
from fishmj.base.options import whole as whole
from fishmj.base.progress_line import Progress as Progress
from fishmj.base.terminal import cell as cell
from fishmj.base.terminal import duration as duration
from fishmj.base.terminal import printable as printable
from fishmj.base.terminal import table as table

T = TypeVar("T")
OK, FAILED_CHECK, BAD_INPUT, CANNOT_TELL, FAULT = 0, 1, 2, 3, 70
HUNG_UP, INTERRUPTED, PIPE_CLOSED, TERMINATED = 129, 130, 141, 143
EXITS = {
    OK: "an answer",
    FAILED_CHECK: "a check that fails, or a result that is not complete",
    BAD_INPUT: "bad input: an option, a file, a place that cannot be written, too little memory, days of work unasked",
    CANNOT_TELL: "too short, too quiet or too different to tell",
    FAULT: "a fault of fishmj itself, with its traceback",
    HUNG_UP: "ended by SIGHUP: its terminal or connection is gone; what was finished is kept",
    INTERRUPTED: "interrupted by the user (Ctrl-C); what was finished is kept",
    PIPE_CLOSED: "the reader of the output is gone (a closed pipe); the work was finished and its files are written",
    TERMINATED: "ended by SIGTERM",
}
TRACEBACK = "FISHMJ_TRACEBACK"  # environment: 1 shows the traceback of every error
LONGEST = 1000  # characters of an error's line
# of a file system, with or without the name of a file
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EMFILE, errno.ENFILE, errno.EIO}

Main = Callable[[list[str]], int | None]


def run(main: Main, argv: Sequence[str] | None = None) -> int:
    """Calls `main(argv)` and converts every outcome to an exit code; errors are one line on stderr.

    A bad description is one line for each of its errors. With `--json` among the arguments an error is also one JSON object on
    stdout: {"error", "kind", "exit"}, and of a bad description "errors", the list.
    A command (`fishmj.base.interrupt`), interrupted or not, ends here and does not return.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    _speak_any_text()
    terminal.readers_gone.clear()
    interrupt.telling(lambda message: _interrupted(argv, message))
    try:
        code = _called(main, argv)
    except OSError:  # nothing can be said: the terminal that was closed is why it was asked to end
        if not interrupt.asked():
            raise
        code = HUNG_UP
    if code == OK and terminal.readers_gone:
        code = PIPE_CLOSED
    if interrupt.asked():
        interrupt.leave(None if code == INTERRUPTED else "")
    interrupt.finish(code)
    return code


def _called(main: Main, argv: list[str]) -> int:
    try:
        _refuse_nul(argv)
        return int(main(argv) or OK)
    except (FishmjError, argparse.ArgumentTypeError) as error:
        kind = type(error).__name__ if isinstance(error, FishmjError) else UsageError.__name__
        many = error if isinstance(error, DescriptionError) else None
        return _fail(argv, many.shown[0] if many else str(error), kind, BAD_INPUT, many=many)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else OK if stop.code is None else _fail(argv, str(stop.code), "exit", 1)
    except KeyboardInterrupt:
        return _fail(argv, "interrupted", "KeyboardInterrupt", INTERRUPTED)
    except BrokenPipeError:  # printed by a library: what this module prints goes on without its reader
        with suppress(OSError):
            terminal.silence(sys.stdout)
        return PIPE_CLOSED
    except Exception as error:  # noqa: BLE001  the last resort: a fault of ours gets its own exit code
        if interrupt.asked():  # what an interrupt breaks off is no fault
            return FAULT
        if message := _of_the_machine(error):
            return _fail(argv, message, type(error).__name__, BAD_INPUT)
        traceback.print_exc()
        return _fail(argv, f"this is a fault in fishmj, please report it: {error}", type(error).__name__, FAULT, printed=True)


def _speak_any_text() -> None:
    """Makes the streams escape characters that the terminal cannot show."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _refuse_nul(argv: Sequence[str]) -> None:
    for place, given in enumerate(argv, 1):
        if "\0" in given:
            raise UsageError(f"argument {place}, {shown(given)}: holds a NUL character; no name or number has one")


def _of_the_machine(error: Exception) -> str:
    """Message for an error of the file system, of memory or of the installation; empty for every other error."""
    if isinstance(error, OSError) and (error.filename is not None or error.errno in _FULL):
        where = f"{shown(str(error.filename), 200)}: " if error.filename is not None else ""
        files = (frame.f_code.co_filename for frame, _ in traceback.walk_tb(error.__traceback__))
        if any("/warp/_src/" in file for file in files):
            remedy = "Warp keeps its machine code there; set WARP_CACHE_PATH to a folder that can be written"
        else:
            remedy = "choose another file or folder, or make room"
        return f"{where}{error.strerror or error}; {remedy}"
    sentence = str(error)
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in sentence or "out of memory" in sentence.lower():
        details = shown(sentence.partition("\n")[0], 200) if sentence else "no details"
        return f"not enough memory ({details}); ask for less at once, or take a larger machine"
    if isinstance(error, ModuleNotFoundError) and error.name and error.name.partition(".")[0] != "fishmj":
        return f"the Python {sys.executable} has no module {error.name}; install fishmj into it as its README says"
    return ""


def _interrupted(argv: Sequence[str], message: str) -> None:
    """The last line of an interrupted command, below a progress line that stands open in a terminal."""
    if sys.stderr.isatty():
        terminal.put("", sys.stderr)
    _fail(argv, message, "KeyboardInterrupt", interrupt.code())


def _fail(
    argv: Sequence[str], message: str, kind: str, code: int, *, printed: bool = False, many: DescriptionError | None = None
) -> int:
    """Prints the error on stderr (one line; for a bad description one line for each error), and as JSON if that was asked for."""
    if os.environ.get(TRACEBACK) == "1" and not printed and sys.exc_info()[0] is not None:
        traceback.print_exc()
    message = _one_line(message)
    for line in map(_one_line, many.shown) if many else (message,):
        terminal.put(f"fishmj: {line}", sys.stderr)
    if "--json" in argv:
        emit_json({"error": message, "kind": kind, "exit": code} | ({"errors": list(many.errors)} if many else {}))
    return code


def _one_line(text: str) -> str:
    """One line that a terminal can show; the middle of a very long one is left out."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(text.split()))
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


class Help(argparse.RawDescriptionHelpFormatter):
    """Help texts with the default of each option behind them."""

    def _get_help_string(self, action) -> str:
        text, default = action.help or "", action.default
        said = "default" in text or default is None or default is False or default is argparse.SUPPRESS
        if said or not (action.option_strings or action.nargs):
            return text
        if isinstance(default, list | tuple):
            default = " ".join(map(str, default))
        shown_default = str(default).replace("%", "%%")
        return f"{text} (default: {shown_default})" if shown_default else text


_DASHED = re.compile(r"[\u2010-\u2015\u2212\ufe58\uff0d][\u2010-\u2015\u2212\ufe58\uff0d-]*([^\W\d_][^=]*)")


def offers(option: str) -> bool:
    """Returns True if the running command has this option, `--anyway`: advice names no other. A program has none."""
    return option in _AT_HAND[0]


class Parser(argparse.ArgumentParser):
    """argparse whose errors are one `UsageError` line with the nearest known option or choice, in place of the usage text.

    The help shows every default, and below it the examples of the parser, of its description or of its `CommandGroup`.
    """

    def __init__(self, *args, **options):
        super().__init__(*args, **{"formatter_class": Help, "allow_abbrev": False} | options)
        number = r"(\d+\.?\d*|\.\d+)(e[-+]?\d+)?(deg)?"  # the first of a list, too, may be negative
        self._negative_number_matcher = re.compile(rf"^-{number}(,-?{number})*$|^-(inf|infinity|nan)$", re.IGNORECASE)

    def error(self, message: str) -> NoReturn:
        """Raises UsageError with the command's name and a pointer to its help."""
        raise UsageError(f"{self.prog.removeprefix('fishmj ')}: {message}; see {self.prog} --help")

    def format_help(self) -> str:
        """Help text, with the examples of the parser or of its `CommandGroup` below it."""
        self.epilog = self.epilog or _EXAMPLES.get(self.prog)
        return super().format_help()

    def parse_args(self, args=None, namespace=None):
        """Parses the arguments; an unknown one raises UsageError with the nearest known option."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            near = self._nearest(unknown[0].partition("=")[0])
            given = " ".join(text if len(text) <= SHOWN else text[:SHOWN] + "..." for text in unknown[:5])
            self.error(f"unknown argument {given}" + (f"; did you mean {near}?" if near else ""))
        return found

    def parse_known_args(self, args=None, namespace=None):
        """Parses the known arguments, after refusing options that begin with a typographic dash."""
        args = list(sys.argv[1:] if args is None else args)
        self._refuse_typographic_dashes(args)
        self._given: set[argparse.Action] = set()
        _AT_HAND[0] = self._option_string_actions
        return super().parse_known_args(args, namespace)

    def _refuse_typographic_dashes(self, words: Sequence[str]) -> None:
        """Raises UsageError for an option with a typographic dash in place of two hyphens, as copied from a formatted text."""
        for word in words:
            found = _DASHED.match(word)
            if found and (near := self._nearest("--" + found[1])):
                self.error(f"{shown(word)} begins with a typographic dash; did you mean {near}?")

    def _nearest(self, option: str) -> str:
        """Nearest known option, or ""."""
        options = [o for o in self._option_string_actions if o.startswith("--")]
        return next(iter(get_close_matches(option, options, 1, 0.6)), "")

    def _get_values(self, action, arg_strings):
        """Raises an error if an option is given twice, unless it takes no value or collects its values.

        Called for each occurrence.
        """
        if action.option_strings and action.nargs != 0 and not isinstance(action, argparse._AppendAction):
            if action in self._given:
                raise argparse.ArgumentError(action, "is given twice; give it once")
            self._given.add(action)
        return super()._get_values(action, arg_strings)

    def _check_value(self, action, value) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, unlisted(str(value), [str(c) for c in action.choices]))


def parser(verb: str, summary: str, *, json: bool = True, examples: str | None = None) -> Parser:
    """An argument parser for `python -m fishmj.<verb>`, with `--json` unless told otherwise.

    examples: below the help; by default those of the summary, which may be a docstring.
    """
    prose, found = split_examples(summary)
    made = Parser(prog=f"fishmj {verb}", description=prose, epilog=examples or found or None)
    if json:
        made.add_argument("--json", action="store_true", help="print one JSON object last")
    return made


def split_examples(docstring: str) -> tuple[str, str]:
    """(prose, examples) of a docstring: paragraphs of commands are its examples, for the end of a help."""
    prose, lines = [], []
    for part in docstring.split("\n\n"):
        found = dedent(part).strip().replace("python -m fishmj.", "fishmj ").splitlines()
        if all(line.startswith(("fishmj ", " ")) for line in found):
            lines += found
        else:
            prose.append(part)
    return "\n\n".join(prose), "\n  ".join(["examples:", *lines]) if lines else ""


HELP = ("-h", "--help", "help")  # before a command too: `help find` is `find --help`


VERBS = "fishmj.verbs"  # group of the entry points of verbs and commands


def more_verbs() -> str:
    """Hint at the verbs of the studies, as the end of an error; "" if an installed package adds some."""
    return "" if entry_points(group=VERBS) else " The studies of a clone add more: pip install -e studies"


class Command(NamedTuple):
    """One command of a group: a module with `main(argv)` by its name, or the function itself."""

    run: str | Main
    summary: str
    example: str


_AT_HAND: list[Mapping[str, argparse.Action]] = [{}]  # options of the command that is running
_EXAMPLES: dict[str, str] = {}  # program -> examples below the help of a command that a group offers


class CommandGroup:
    """The commands of a verb, as its `main`.

    `--help` lists them. An unknown command raises an error with the nearest name; a missing one is a usage error. A name may be
    two words (`converge fish`). Only the command that is called is imported. `bare` names the command that runs when none is
    given, with the options that are there. Installed packages add commands by entry points in the group `fishmj.verbs`, whose
    name is the verb and whose value is a {name: Command}.
    """

    def __init__(self, verb: str, summary: str, commands: Mapping[str, Command], bare: str = ""):
        self.verb, self.summary, self.own, self.bare = verb, summary, dict(commands), bare

    @cached_property
    def commands(self) -> dict[str, Command]:
        """Commands of fishmj, then those that installed packages add. A command of fishmj itself runs without this look-up."""
        added = (point.load() for point in entry_points(group=VERBS, name=self.verb))
        return self.own | {key: command for table in added for key, command in table.items() if key not in self.own}

    def __call__(self, argv: list[str]) -> int | None:
        if argv and argv[0] in HELP:
            if argv[1:]:
                return self([*argv[1:], "--help"])
            say(self.usage())
            return OK
        if self.bare and (not argv or argv[0].startswith("-")):
            return self.load(self.bare)(argv)
        if not argv:
            raise UsageError(f"{self.verb}: expected a command: {', '.join(self.commands)}; see fishmj {self.verb} --help")
        words = 1 if argv[0] in self.own or " ".join(argv[:2]) not in self.commands else 2
        name = " ".join(argv[:words])
        if name.startswith("-"):
            raise UsageError(f"{self.verb}: expected a command before {shown(name)}. Known: {', '.join(self.commands)}")
        return self.load(name)(argv[words:])

    def load(self, name: str) -> Main:
        """Imports a command and returns its function. Raises UnknownName: no command of this name."""
        command = self.own.get(name) or self.commands.get(name)
        if command is None:
            short = name if len(name) <= SHOWN else name[:SHOWN] + "..."
            raise UnknownName(f"{self.verb} command", short, self.commands, more=more_verbs())
        run, _, example = command
        _EXAMPLES[f"fishmj {self.verb} {name}"] = f"examples:\n  {example}"
        if not isinstance(run, str):
            return run
        module = import_module(run)
        if examples := split_examples(module.__doc__ or "")[1]:
            _EXAMPLES[f"fishmj {self.verb} {name}"] = examples
        return module.main

    def usage(self) -> str:
        """Every command with one line, and its example below."""
        wide = max(map(len, self.commands))
        rows = [(f"  {name:<{wide}}  {c.summary}", f"  {'':<{wide}}  {c.example}") for name, c in self.commands.items()]
        command = "[COMMAND]" if self.bare else "COMMAND"
        head = f"usage: fishmj {self.verb} {command} [options]     fishmj {self.verb} COMMAND --help"
        rows += [("", f"Without a command: {self.bare}.")] if self.bare else []
        return "\n".join([head, "", self.summary, "", *(line for row in rows for line in row)])


def say(*lines: str) -> None:
    """Prints lines for a human, at once; control characters are left out."""
    for line in lines:
        terminal.put(printable(line), sys.stdout)


def warn(message: str) -> None:
    """Prints one line on stderr that does not stop the command, or keeps it for the end of `warnings_behind`."""
    if not _HELD:
        terminal.put(f"fishmj: {_one_line(message)}", sys.stderr)
    elif message not in _HELD[-1]:
        _HELD[-1].append(message)


def after_answer(what: str, work: Callable[[], T], otherwise: T) -> T:
    """Result of work that follows an answer, such as advice, a page or a plot; `otherwise` if it raises.

    The answer is complete and written by then, so an error of this work is a warning and costs nothing else.
    """
    try:
        return work()
    except Exception as error:  # noqa: BLE001 - whatever it is, the answer stands
        if os.environ.get(TRACEBACK):
            traceback.print_exc()
        reason = f"{type(error).__name__}: {error}" if not isinstance(error, FishmjError) else str(error)
        warn(f"the answer is complete, but {what} failed: {reason}; {TRACEBACK}=1 shows the traceback")
        return otherwise


@contextmanager
def warnings_behind() -> Iterator[None]:
    """Context whose warnings, such as those of many candidates, are printed behind it, each once."""
    _HELD.append([])
    try:
        yield
    finally:
        for message in _HELD.pop():
            warn(message)


_WARNED: set[object] = set()
_HELD: list[list[str]] = []  # warnings of open `warnings_behind`, innermost last


def warn_once(message: str, key: object = None) -> None:
    """Warns once in a process of what `key` stands for; by default of this message."""
    key = message if key is None else key
    if key not in _WARNED:
        _WARNED.add(key)
        warn(message)


def confirmed(question: str) -> bool:
    """Asks a yes-or-no question on the terminal. Returns False without a terminal and for any answer but yes."""
    if not all(bool(getattr(stream, "isatty", lambda: False)()) for stream in (sys.stdin, sys.stderr)):
        return False
    terminal.put(f"{question} [y/N] ", sys.stderr, end="")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def emit_json(value: Any) -> None:
    """Prints one JSON value on one line. Arrays become lists, paths text, and NaN and infinity null."""
    terminal.put(json.dumps(plain(value), allow_nan=False), sys.stdout)


def plain(value: Any) -> Any:
    """Converts a value to JSON's own types. Needs no NumPy, so that `doctor` runs where it is missing."""
    if hasattr(value, "tolist"):  # NumPy and JAX, scalars too
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    return str(value)
