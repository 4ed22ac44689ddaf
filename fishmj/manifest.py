"""A folder's `manifest.json`: size and sha256 of every file in it, so that a changed or missing one is named.

`python -m fishmj.manifest FOLDER` checks a folder (exit 1 on a difference); with `--write` it states what is there now.
"""

import hashlib
import json
from pathlib import Path

from fishmj import console
from fishmj.errors import StoreError

NAME = "manifest.json"
SCHEMA = "fishmj.manifest/1"


def sha256(path: str | Path) -> str:
    """Hex digest of one file."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe(folder: str | Path) -> dict:
    """The manifest that the folder should have now; names are relative, with forward slashes, sorted."""
    folder = Path(folder)
    names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file() and p.name != NAME)
    files = {name: {"bytes": (folder / name).stat().st_size, "sha256": sha256(folder / name)} for name in names}
    return {"schema": SCHEMA, "files": files}


def write(folder: str | Path) -> Path:
    """State what the folder holds now."""
    path = Path(folder) / NAME
    path.write_text(json.dumps(describe(folder), indent=2) + "\n", encoding="utf-8")
    return path


def read(folder: str | Path) -> dict:
    """The manifest as stored.

    Raises:
        StoreError: there is none, or it is not one.
    """
    path = Path(folder) / NAME
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise StoreError(f"{path}: no such file; write it with: python -m fishmj.manifest {folder} --write") from error
    except ValueError as error:
        raise StoreError(f"{path}: not JSON: {error}") from error
    if not isinstance(stored, dict) or stored.get("schema") != SCHEMA or not isinstance(stored.get("files"), dict):
        raise StoreError(f"{path}: expected an object with schema {SCHEMA!r} and files; write it again with --write")
    return stored


def differences(folder: str | Path) -> list[str]:
    """What does not match, one line each; empty when all is as stated."""
    stated, found = read(folder)["files"], describe(folder)["files"]
    lines = [f"{name}: missing" for name in stated if name not in found]
    lines += [f"{name}: not in the manifest" for name in found if name not in stated]
    for name in stated.keys() & found.keys():
        if stated[name] != found[name]:
            lines.append(f"{name}: sha256 {found[name]['sha256'][:12]}, the manifest says {str(stated[name].get('sha256'))[:12]}")
    return sorted(lines)


def check(folder: str | Path) -> None:
    """Raise StoreError naming every file that is not as the manifest states."""
    if lines := differences(folder):
        raise StoreError(
            f"{Path(folder)}: {'; '.join(lines)}; restore the files, or accept them: python -m fishmj.manifest --write"
        )


def main(argv: list[str]) -> int:
    parser = console.parser("manifest", "Check or write a folder's manifest of sha256 sums.")
    parser.add_argument("folder", nargs="?", default="data/calib", help="default: data/calib")
    parser.add_argument("--write", action="store_true", help="state what is there now")
    args = parser.parse_args(argv)
    if not Path(args.folder).is_dir():
        raise StoreError(f"{args.folder}: no such folder")
    if args.write:
        write(args.folder)
    lines = differences(args.folder)
    console.say(*lines or [f"{args.folder}: {len(read(args.folder)['files'])} files as stated"])
    if args.json:
        console.emit_json({"folder": args.folder, "differences": lines})
    return console.FAILED_CHECK if lines else console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
