"""Build what is published, and check it: `dist/` then holds the wheel, the source distribution and SHA256SUMS. Uploads nothing.

The version is the first one of CHANGELOG.md. The source distribution must build the same wheel, file by file, as this checkout.
"""

import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

from wheel import ROOT, look_inside, run, use

DIST = ROOT / "dist"
HEAD = re.compile(r"^## +\[?v?(\d[\w.]*)", re.MULTILINE)


def version() -> str:
    """Of pyproject.toml; stops when it is not the head of the changelog."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    changes = ROOT / "CHANGELOG.md"
    if not changes.is_file():
        raise SystemExit(f"{changes}: no such file; a release needs one whose first version is `## {stated}`")
    head = HEAD.search(changes.read_text(encoding="utf-8"))
    if head is None or head[1] != stated:
        raise SystemExit(f"{changes}: its first version is {head and head[1]}, pyproject.toml says {stated}; expected the same")
    return stated


def contents(wheel: Path) -> dict[str, int]:
    """CRC of every file of a wheel."""
    return {info.filename: info.CRC for info in zipfile.ZipFile(wheel).infolist()}


def main() -> None:
    number = version()
    if changed := subprocess.run(["git", "status", "--short"], cwd=ROOT, capture_output=True, text=True, check=True).stdout:
        raise SystemExit(f"not what is committed, commit or remove it first:\n{changed}")
    shutil.rmtree(DIST, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="fishmj-release-") as folder:
        there = Path(folder)
        run("tools", sys.executable, "-m", "venv", str(there / "tools"), cwd=there)
        python = str(there / "tools" / "bin" / "python")
        run("install", python, "-m", "pip", "--quiet", "--disable-pip-version-check", "install", "build", "twine", cwd=there)
        build = (python, "-m", "build", str(ROOT))
        run("wheel and sdist", *build, "--wheel", "--sdist", "--outdir", str(DIST), cwd=there)
        run("wheel of the sdist", *build, "--outdir", str(there / "again"), cwd=there)  # the sdist, and from it the wheel
        wheel, sdist = DIST / f"fishmj-{number}-py3-none-any.whl", DIST / f"fishmj-{number}.tar.gz"
        if differ := dict(contents(wheel).items() ^ contents(there / "again" / wheel.name).items()):
            raise SystemExit(f"{sdist.name} builds another wheel: {len(differ)} files differ: {', '.join(sorted(differ)[:10])}")
        run("metadata", python, "-m", "twine", "check", "--strict", str(wheel), str(sdist), cwd=there)
        look_inside(wheel)
        use(wheel, there)
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in (sdist, wheel)]
    (DIST / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    print("".join(sums), end="")


if __name__ == "__main__":
    main()
