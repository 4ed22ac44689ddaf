"""Identity of this fishmj: commit, versions and a source hash, for the files that it writes and for kept results."""

import hashlib
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

from fishmj import __version__
from fishmj.base.calib import calib_folder

HERE = Path(__file__).resolve().parents[1]


@cache
def package_sha256() -> str:
    """Hex digest of the source of this package and its constants."""
    digest = hashlib.sha256()
    for path in [*sorted(HERE.rglob("*.py")), *sorted(calib_folder().glob("*.toml"))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def commit() -> str:
    """Commit of the checkout, with `-dirty` if files differ from it; `fishmj 1.2` for an installed package."""
    asked = (("ls-files", "--error-unmatch", HERE.name), ("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"))
    try:
        # the first call checks that the surrounding repository is ours: an environment may lie inside any other
        said = [subprocess.run(["git", *words], cwd=HERE.parent, capture_output=True, text=True, timeout=5) for words in asked]
    except (OSError, subprocess.TimeoutExpired):
        said = []
    if len(said) == len(asked) and all(one.returncode == 0 for one in said):
        return said[-1].stdout.strip()
    return f"fishmj {__version__}"


def made_by(*packages: str) -> dict:
    """The keys `versions` and `commit` of the meta data of a trial that fishmj makes, with the versions of `packages`."""
    versions = {name: version(name) or "not installed" for name in packages}
    return {"versions": {"fishmj": __version__, **versions}, "commit": commit()}


def version(package: str) -> str | None:
    """Installed version of a distribution, or None."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
