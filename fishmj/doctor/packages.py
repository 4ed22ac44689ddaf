"""Core packages and extras, as required and as installed."""

import importlib.util
import re
import tomllib
from importlib import metadata
from pathlib import Path

from fishmj.doctor.finding import Finding


def requirements() -> list[str]:
    """The requirement lines of fishmj: of the installed package, else of the checkout's pyproject.toml."""
    checkout = Path(__file__).resolve().parents[2] / "pyproject.toml"
    if checkout.is_file():
        project = tomllib.loads(checkout.read_text(encoding="utf-8"))["project"]
        extras = project["optional-dependencies"].items()
        return project["dependencies"] + [f'{line}; extra == "{extra}"' for extra, lines in extras for line in lines]
    return metadata.requires("fishmj") or []


def findings(lines: list[str] | None = None) -> list[Finding]:
    """Core packages and extras against what is installed."""
    lines = requirements() if lines is None else lines
    if importlib.util.find_spec("packaging") is None:
        return _presence(lines)
    from packaging.requirements import Requirement

    out = []
    extras: dict[str, list[str]] = {}
    for line in lines:
        wanted = Requirement(line)
        extra = _extra(line)
        if extra is None:
            found = version(wanted.name)
            out.append(_core(wanted.name, str(wanted.specifier), found, found is not None and found in wanted.specifier))
        elif extra != "all":
            extras.setdefault(extra, []).extend(_lacking(wanted))
    for extra, missing in extras.items():
        text = f'{", ".join(missing)}: pip install "fishmj[{extra}]"' if missing else "installed"
        out.append(Finding("extras", extra, "no" if missing else "ok", text))
    return out


def _presence(lines: list[str]) -> list[Finding]:
    """Which core packages are there at all: without `packaging` no version can be compared."""
    out = []
    for line in lines:
        if _extra(line) is None:
            name = re.split(r"[^\w.-]", line, maxsplit=1)[0]
            found = version(name)
            text = f"{found}, not compared" if found else f'missing: pip install "{line}"'
            out.append(Finding("core", name, "note" if found else "bad", text))
    return out


def _lacking(wanted) -> list[str]:
    """What a requirement lacks here, with one level of the extras that it asks of its package (`jax[cuda13]`)."""
    from packaging.requirements import Requirement

    found = version(wanted.name)
    if found is None or not wanted.specifier.contains(found, prereleases=True):
        return [f"{wanted.name}{wanted.specifier} (found {found or 'none'})"]
    inner = [Requirement(line) for line in metadata.requires(wanted.name) or [] if _extra(line) in wanted.extras]
    return [r.name for r in inner if version(r.name) is None]


def _extra(line: str) -> str | None:
    condition = line.partition(";")[2]
    return condition.split("extra ==")[1].strip().strip("\"'()") if "extra ==" in condition else None


def _core(name: str, wanted: str, found: str | None, fits: bool) -> Finding:
    if fits:
        return Finding("core", name, "ok", str(found))
    got = f"found {found}" if found else "missing"
    return Finding("core", name, "bad", f'{got}, needs {wanted}: pip install "{name}{wanted}"')


def version(name: str) -> str | None:
    """Installed version of a distribution, or None."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
