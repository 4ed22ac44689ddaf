"""Loads the user's own code, named as `package.module:Name`, `./my_file.py:Name`, or an installed entry point.

    controller = load("controller", "./my_fish.py:MyController", known=NAMES)

Loading code runs it. So only a word from the command line or an argument of a Python call may come here. Text from a file
(descriptions, logs, data sets, policy headers, verdicts, settings of a run) is only compared with what was loaded already
(`loaded`), and otherwise refused.
"""

import importlib
import importlib.util
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Iterable
from hashlib import sha256
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from fishmj.base.errors import OwnCodeError, UnknownName, closest_name
from fishmj.base.names import is_name, nearest

KINDS = ("controller", "task", "effect", "algorithm", "importer", "case")
_REFERENCE = re.compile(r"(?P<module>[^:]+\.py|[A-Za-z_]\w*(\.[A-Za-z_]\w*)*):(?P<name>[A-Za-z_]\w*(\.[A-Za-z_]\w*)*)\Z")
_HOME = Path(__file__).resolve().parents[1]
_LOADED: dict[str, dict[str, Any]] = {kind: {} for kind in KINDS}


def group(kind: str) -> str:
    """The entry-point group of a kind: `fishmj.controllers`, .."""
    return f"fishmj.{kind}s"


def is_reference(text: str) -> bool:
    """Returns True if `text` has the form `package.module:Name` or `path/to/file.py:Name`."""
    return _REFERENCE.match(text) is not None


def listed(kind: str) -> list[str]:
    """Names of the installed entry points of a kind; imports none of them."""
    return sorted({point.name for point in entry_points(group=group(kind)) if is_name(point.name)})


def loaded(kind: str) -> dict[str, Any]:
    """Objects loaded so far in this process, by the text that the user gave. This runs no code."""
    return dict(_LOADED[kind])


def load(kind: str, text: str, known: Iterable[str] = ()) -> Any:
    """Loads the object that the user named on the command line or in a call.

    Args:
        kind: one of KINDS. known: names of fishmj's own, for the message.

    Raises:
        UnknownName: neither a reference nor an installed entry point. OwnCodeError: no such module or name, or its import fails;
            names file and line.
    """
    text = str(text)
    if text not in _LOADED[kind]:
        match = _REFERENCE.match(text)
        if match is None:
            points = {point.name: point for point in entry_points(group=group(kind)) if is_name(point.name)}
            if text not in points and (":" in text or text.endswith(".py")):
                raise OwnCodeError(f"{kind} {text}: expected package.module:Name or path/to/file.py:Name")
            if text not in points:
                raise UnknownName(kind, text, (*known, *points))
            match = _REFERENCE.match(points[text].value)
            if match is None:
                raise OwnCodeError(f"{kind} {text}: the entry point {points[text].value!r} is no module:Name; mend its package")
        what = f"{kind} {text}"
        _LOADED[kind][text] = _attribute(_module(match["module"], what), match["name"], what)
    return _LOADED[kind][text]


def name_of(text: str) -> str:
    """Name of the user's own code in reports, logs and file names: the reference with other characters replaced."""
    module, _, name = text.partition(":")
    return nearest(f"{Path(module).stem if module.endswith('.py') else module}.{name}" if name else text) or "own"


def source_sha256(thing: Any) -> str:
    """sha256 of the file that defines an object (or its class), "" if there is none: it tells stored results apart."""
    try:
        file = inspect.getsourcefile(thing if inspect.isclass(thing) or inspect.isroutine(thing) else type(thing))
    except TypeError:
        return ""
    return sha256(Path(file).read_bytes()).hexdigest() if file and Path(file).is_file() else ""


def call(what: str, function: Callable, *arguments: Any, **named: Any) -> Any:
    """Calls `function(..)` of the user's own code; an exception in it becomes one line with file and line.

    Raises OwnCodeError: the function raised. Errors of fishmj itself pass.
    """
    try:
        return function(*arguments, **named)
    except (Exception, SystemExit) as error:
        raise fault(what, error) from error


def fault(what: str, error: BaseException) -> OwnCodeError:
    """Error of the user's code as one line: place, message, and how to see the whole traceback."""
    if isinstance(error, OwnCodeError):
        return error
    return OwnCodeError(f"{what}: {_place(error)}{_said(error)}; FISHMJ_TRACEBACK=1 shows the whole traceback")


def takes(what: str, function: Any, shape: str, count: int) -> None:
    """Checks that `function` can be called with `count` positional arguments, without calling it.

    Args:
        what: for the message. shape: the call as it should read, "reward(xp, step)".

    Raises OwnCodeError: it cannot be called like this, or is not callable.
    """
    if not callable(function):
        raise OwnCodeError(f"{what}: has no {shape}; add it (docs/simulate/your_own_code.md)")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # written in C: nothing to look at
        return
    try:
        signature.bind(*range(count))
    except TypeError as error:
        raise OwnCodeError(f"{what}: expected {shape}, got {shape.partition('(')[0]}{signature}: {error}") from error


def _module(name: str, what: str) -> ModuleType:
    """Imports a module by dotted name (also from the working folder) or by file."""
    try:
        return _from_file(Path(name), what) if name.endswith(".py") else _by_name(name, what)
    except OwnCodeError:
        raise
    except (Exception, SystemExit) as error:
        raise fault(f"{what}: the import fails", error) from error


def _by_name(name: str, what: str) -> ModuleType:
    here = str(Path.cwd())
    top = name.partition(".")[0]
    if importlib.util.find_spec(top) is None and here not in sys.path:
        sys.path.append(here)  # last: what is installed comes first
        importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise  # the module is there; what it imports is not
        raise OwnCodeError(
            f"{what}: no module {error.name!r} in Python's path or in {here}; install it, go to its folder, or give the file as "
            "path/to/file.py:Name"
        ) from error


def _from_file(path: Path, what: str) -> ModuleType:
    if not path.is_file():
        raise OwnCodeError(f"{what}: {path}: no such file")
    path = path.resolve()
    name = f"_own_{nearest(path.stem)}_{sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # so that it finds the files beside it
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise OwnCodeError(f"{what}: {path}: Python cannot import it")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _attribute(module: ModuleType, name: str, what: str) -> Any:
    found: Any = module
    for part in name.split("."):
        if not hasattr(found, part):
            public = [a for a in dir(found) if not a.startswith("_")]
            near = closest_name(part, public)
            hint = f"; did you mean {near!r}?" if near else f"; it has {', '.join(public[:8]) or 'nothing'}"
            raise OwnCodeError(f"{what}: {getattr(module, '__file__', module.__name__)} has no {part!r}{hint}")
        found = getattr(found, part)
    return found


def _place(error: BaseException) -> str:
    """`file:line: ` of the innermost line that is neither ours nor Python's import machinery."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}: "
    frames = traceback.extract_tb(error.__traceback__)
    theirs = [f for f in frames if not f.filename.startswith("<") and _HOME not in Path(f.filename).resolve().parents]
    own = [f for f in theirs if "site-packages" not in f.filename and not f.filename.startswith(sys.base_prefix)]
    last = (own or theirs or list(frames))[-1:]
    return f"{last[0].filename}:{last[0].lineno}: " if last else ""


def _said(error: BaseException) -> str:
    text = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__
