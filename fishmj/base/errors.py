"""Errors that fishmj raises on purpose. One line each: what, where, got, expected, what to do.

Only a bad robot description has several lines, one for each fault in it.
"""

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

CLOSE = 0.7  # ratio of `difflib` from which a name is taken for a slip of another


class FishmjError(Exception):
    """Base of all errors that a user can mend. They can be pickled, so that an error in another process arrives unchanged."""

    def __reduce__(self):
        return _remade, (type(self), self.args, vars(self))


def _remade(kind: type[FishmjError], args: tuple, own: dict) -> FishmjError:
    """Rebuilds an error from its pickle, for any signature of its constructor."""
    error = kind.__new__(kind, *args)
    vars(error).update(own)
    return error


class ConfigError(FishmjError, ValueError):
    """A setting is impossible or inconsistent."""


class TooMuch(ConfigError):
    """Work of days, or more memory than there is, without agreement."""


class DescriptionError(ConfigError):
    """A faulty robot description. `errors` lists every fault, a line each; the message has the first 20."""

    SHOWN = 20

    def __init__(self, errors: Sequence[str]):
        self.errors = tuple(" ".join(line.split()) for line in errors)
        more = len(self.errors) - self.SHOWN
        self.shown = self.errors[: self.SHOWN] + ((f"and {more} more error{'s' * (more > 1)}",) if more > 0 else ())
        super().__init__("\n".join(self.shown))


class UsageError(FishmjError, ValueError):
    """A command line that does not parse: an unknown option, a value out of its range, an output that cannot be written."""


class ResetNeeded(FishmjError, AssertionError):
    """An environment is stepped before its first reset, or after the end of an episode without a new reset."""


def closest_name(text: str, known: Iterable[str]) -> str:
    """The name in `known` that `text` misspells, else the only one that it abbreviates, reorders or shares a word with; or ""."""
    low, folded = text.lower(), {name.lower(): name for name in known}
    one_letter = 1 - 1 / max(len(low), 2) - 1e-9  # ratio of a short name with one wrong letter
    if close := get_close_matches(low, folded, 1, min(CLOSE, one_letter)):
        return folded[close[0]]
    words = lambda name: set(re.split(r"[^a-z0-9]+", name))
    alike = lambda name: name.startswith(low) or sorted(name) == sorted(low) or low in words(name) or name in words(low)
    found = [name for key, name in folded.items() if low and alike(key)]
    return found[0] if len(found) == 1 else ""


class UnknownName(FishmjError, KeyError):
    """A task, water, controller, effect or key that does not exist."""

    def __init__(self, kind: str, name: str, known, *, near: str = "", more: str = ""):
        known = sorted(str(k) for k in known)
        near = near or closest_name(str(name), known)
        hint = f" Did you mean {near!r}?" if near else ""
        self.message = f"unknown {kind} {name!r}.{hint} Known: {', '.join(known)}.{more}"
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message


class OwnCodeError(FishmjError, RuntimeError):
    """The user's own code is missing, fails, or breaks its interface; the message has its file and line."""


class LogError(FishmjError, ValueError):
    """A trial folder or table breaks the schema; the message is file:line:column with the fix."""


class StoreError(FishmjError, OSError):
    """A file is truncated, changed, of the wrong kind, or could not be written."""


class DatasetError(StoreError):
    """Data for a fit are missing, changed or do not belong together; lists the files, expected and got."""


class SimDiverged(FishmjError, ArithmeticError):
    """The simulation produced non-finite numbers. Carries time, term, link and the last states."""

    def __init__(self, message: str, *, time: float = float("nan"), term: str = "", link: str = "", states=None):
        super().__init__(message)
        self.time, self.term, self.link, self.states = time, term, link, states


class MissingExtra(FishmjError, ModuleNotFoundError):
    """An optional package is not installed; the message has the install line."""

    def __init__(self, package: str, extra: str, needed_for: str):
        super().__init__(f'{needed_for} needs {package}: pip install "fishmj[{extra}]"', name=package)


class InjectionError(FishmjError, RuntimeError):
    """The process-wide passive-force callback is used in a way that MuJoCo cannot serve."""


class OracleUnstable(FishmjError, ArithmeticError):
    """The flow solver cannot run with these settings, or became unstable.

    Carries the violated limit.
    """

    def __init__(self, message: str, *, limit: str = ""):
        super().__init__(message)
        self.limit = limit
