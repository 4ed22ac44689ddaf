"""`gap fetch NAME`: a public data set from its source, at a pinned commit, every file checked.

    fetch("tail_fish", "data/tail_fish")

`public/<name>.toml` pins the repository, the commit, and sha256 and size of every file. A file gets its name only
after its hash was right. Existing right files are not downloaded again, and a broken download resumes. The manifest comes last,
so a folder with a manifest is complete.
"""

import hashlib
import http.client
import io
import re
import time
import urllib.error
import urllib.request
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from fishmj.base import console
from fishmj.base.calib import read_toml
from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.base.store import Manifest, sha256, write_bytes
from fishmj.base.store.manifest import MANIFEST

SOURCE = "https://raw.githubusercontent.com"
FOLDER = Path(__file__).resolve().parent / "public"
ARCHIVE_LIMIT = 200 * 2**20  # bytes; the largest archive here is a few MB
Say = Callable[[str], None]


@dataclass(frozen=True)
class Pin:
    """One file: its place here, size and hash. source: its path in the repository's folder; "": the same."""

    path: str
    sha256: str
    bytes: int
    source: str = ""


@dataclass(frozen=True)
class PublicSet:
    """A public data set: single files of `folder`, or members of one `archive`."""

    name: str
    about: str
    repository: str
    commit: str
    licence: str
    files: tuple[Pin, ...]
    licence_file: Pin
    licence_commit: str
    folder: str = ""
    archive: str = ""
    note: str = ""

    def url(self, base: str, path: str, commit: str = "") -> str:
        """Address of a file of the repository at a commit."""
        return f"{base.rstrip('/')}/{self.repository}/{commit or self.commit}/{quote(path)}"


@dataclass(frozen=True)
class FetchResult:
    """Result of a fetch."""

    name: str
    folder: Path
    files: int
    downloaded: int  # bytes
    kept: int  # files that were there already
    notes: tuple[str, ...]


def names() -> list[str]:
    """The sets that can be fetched."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def public_set(name: str) -> PublicSet:
    """The pinned description of one set; `UnknownName` lists the others."""
    if name not in names():
        raise UnknownName("public data set", name, names())
    spec = read_toml(FOLDER / f"{name}.toml")
    files = tuple(Pin(path, entry["sha256"], entry["bytes"], entry.get("source", "")) for path, entry in spec["files"].items())
    licence = spec["licence_file"]
    return PublicSet(
        name=name,
        files=files,
        licence_file=Pin(licence["path"], licence["sha256"], licence["bytes"]),
        licence_commit=licence.get("commit", spec["commit"]),
        **{key: spec[key] for key in ("about", "repository", "commit", "licence")},
        **{key: spec[key] for key in ("folder", "archive", "note") if key in spec},
    )


def fetch(name: str, out: str | Path, base_url: str | None = None, *, say: Say | None = None) -> FetchResult:
    """Downloads the set `name` into the folder `out`; a repeated call resumes.

    Args:
        base_url: another server with the same paths (a mirror); the public source if None.
        say: receives a line now and then.

    Raises:
        UnknownName: no such set. ConfigError: `out` is a file, or holds another set. StoreError: the server lacks a file, the
        connection broke three times, or a hash is wrong; the right files stay.
    """
    wanted, out = public_set(name), Path(out)
    base = base_url or SOURCE
    if not base.startswith(("https://", "http://")):
        raise ConfigError(f"base_url = {base!r}; expected an address that begins with https:// or http://")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out}: is a file; choose a folder for the data set")
    _refuse_other(wanted, out)
    missing = [pin for pin in wanted.files if not _right(out / pin.path, pin)]
    notes = [wanted.note] if wanted.note else []
    tell = say or (lambda line: None)
    received = 0
    if missing and wanted.archive:
        received = _unpack(wanted, base, out, missing, tell)
    elif missing:
        for i, pin in enumerate(missing, start=1):
            tell(f"{name}: {i} of {len(missing)}: {pin.path} ({pin.bytes} bytes)")
            place = "/".join(part for part in (wanted.folder, pin.source or pin.path) if part)
            data = download(wanted.url(base, place), out, f"{name}-{pin.sha256[:16]}", pin.sha256, pin.bytes)
            write_bytes(out / pin.path, data)
            received += len(data)
    notes += _licence(wanted, base, out)
    meta = {"name": name, "source": f"github.com/{wanted.repository}", "commit": wanted.commit, "licence": wanted.licence}
    keep = {pin.path: pin.sha256 for pin in (*wanted.files, wanted.licence_file) if (out / pin.path).is_file()}
    Manifest(dict(sorted(keep.items())), meta).write(out)
    return FetchResult(name, out, len(wanted.files), received, len(wanted.files) - len(missing), tuple(notes))


def _right(path: Path, pin: Pin) -> bool:
    return path.is_file() and path.stat().st_size == pin.bytes and sha256(path) == pin.sha256


def _refuse_other(wanted: PublicSet, out: Path) -> None:
    if (out / MANIFEST).is_file():
        found_name = Manifest.read(out).meta.get("name")
        if found_name != wanted.name:
            raise ConfigError(f"{out}: holds {found_name or 'another data set'}, not {wanted.name}; choose another folder")


def _unpack(wanted: PublicSet, base: str, out: Path, missing: list[Pin], tell: Say) -> int:
    """Downloads the archive and puts its pinned members in place. Members are found by the end of their path."""
    url = wanted.url(base, wanted.archive)
    tell(f"{wanted.name}: {wanted.archive}")
    raw = download(url, out, f"{wanted.name}-archive", None, ARCHIVE_LIMIT)
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            inside = {PurePosixPath(info.filename).parts: info for info in archive.infolist() if not info.is_dir()}
            for pin in missing:
                write_bytes(out / pin.path, _member(url, archive, inside, pin))
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise StoreError(f"{url}: not a sound zip archive ({error}); run again later, or get it by hand") from error
    return len(raw)


def _member(url: str, archive: zipfile.ZipFile, inside: dict[tuple[str, ...], zipfile.ZipInfo], pin: Pin) -> bytes:
    tail = PurePosixPath(pin.path).parts
    found = [info for parts, info in inside.items() if parts[-len(tail) :] == tail and info.file_size == pin.bytes]
    for info in found:
        data = archive.read(info)
        if hashlib.sha256(data).hexdigest() == pin.sha256:
            return data
    text = f"{len(found)} of its size, none with sha256 {pin.sha256}" if found else f"none of {pin.bytes} bytes"
    raise StoreError(f"{url}: member {pin.path}: {text}; the source has changed since it was pinned")


def _licence(wanted: PublicSet, base: str, out: Path) -> list[str]:
    """Writes the licence beside the data; returns a note if the repository moved it, since the data must not depend on it."""
    pin = wanted.licence_file
    if _right(out / pin.path, pin):
        return []
    url = wanted.url(base, pin.path, wanted.licence_commit)
    try:
        write_bytes(out / pin.path, download(url, out, f"{wanted.name}-licence", pin.sha256, pin.bytes))
    except Missing:
        return [f"{url}: not there; the data is under {wanted.licence}, see github.com/{wanted.repository}"]
    return []


def main(argv: list[str]) -> int:
    """The command `gap fetch NAME [--out FOLDER] [--base-url URL] [--json]`. Returns the exit code."""
    parser = console.parser("gap fetch", "Download a public data set from its source and check every file.")
    parser.add_argument("name", help=", ".join(names()))
    parser.add_argument("--out", type=console.out_folder, help="folder to write (default ./NAME)")
    parser.add_argument("--base-url", metavar="URL", help="a mirror with the same paths (default the public source)")
    args = parser.parse_args(argv)
    got = fetch(args.name, args.out or Path(args.name), args.base_url, say=console.say)
    console.say(f"{got.files} files in {got.folder}: {got.downloaded} bytes downloaded, {got.kept} files were there", *got.notes)
    if args.json:
        result = {"downloaded": got.downloaded, "kept": got.kept, "notes": got.notes}
        console.emit_json({"name": got.name, "folder": str(got.folder), "files": got.files, **result})
    return console.OK


# ------------------------------------------------------------------------------------------------------------- one file over HTTP
TRIES = 3
TIMEOUT = 30.0  # s without a byte
BLOCK = 1 << 16
PAUSE = 0.2  # s before the second try, doubled for the third


class Missing(StoreError):
    """The server answers that there is no such file."""


def download(url: str, folder: Path, key: str, sha256: str | None, limit: int) -> bytes:
    """The body behind `url`.

    The received part is kept in `folder/.<key>.part`, so that a later call resumes, even in another process.

    Args:
        key: name of the part file. sha256: of the body (None: the caller checks).
        limit: bytes; the exact size with a hash, else the largest that is accepted.

    Raises Missing: 404 or 410; StoreError: refused, broken off `TRIES` times, too long, or the wrong hash.
    """
    part = Path(folder) / f".{key}.part"
    part.parent.mkdir(parents=True, exist_ok=True)
    trouble = ""
    for attempt in range(TRIES):
        if attempt:
            time.sleep(PAUSE * 2 ** (attempt - 1))
        resumed = part.stat().st_size if part.is_file() else 0
        try:
            _receive(url, part, limit)
        except urllib.error.HTTPError as error:
            if error.code in (404, 410):
                raise Missing(
                    f"{url}: the server says {error.code} {error.reason}: no such file; has the source moved?"
                ) from error
            if error.code == 416:  # the part is as long as the file, or longer
                part.unlink(missing_ok=True)
            elif error.code < 500 and error.code != 429:
                raise StoreError(f"{url}: the server says {error.code} {error.reason}") from error
            trouble = f"the server says {error.code} {error.reason}"
            continue
        except StoreError:
            raise
        except (urllib.error.URLError, http.client.HTTPException, OSError) as error:
            trouble = f"{type(error).__name__}: {getattr(error, 'reason', error)}"
            continue
        body = part.read_bytes()
        got = hashlib.sha256(body).hexdigest()
        part.unlink(missing_ok=True)
        if sha256 is None or got == sha256:
            return body
        trouble = f"expected sha256 {sha256}, got {got} ({len(body)} bytes)"
        if not resumed:  # a complete download with a wrong hash is the server's file; a resumed one may mix two versions
            raise StoreError(f"{url}: {trouble}; the file was changed at its source or on the way, and is not used")
    size = part.stat().st_size if part.is_file() else 0
    raise StoreError(f"{url}: {trouble}; {TRIES} tries; {size} bytes are kept, and the same command resumes")


def _receive(url: str, part: Path, limit: int) -> None:
    """Appends the missing bytes to `part`; raises `IncompleteRead` if the body ends early."""
    have = part.stat().st_size if part.is_file() else 0
    request = urllib.request.Request(url, headers={"User-Agent": "fishmj"})
    if have:
        request.add_header("Range", f"bytes={have}-")
    with urllib.request.urlopen(request, timeout=TIMEOUT) as answer:
        span = re.fullmatch(r"bytes (\d+)-(\d+)/(\d+|\*)", answer.headers.get("Content-Range", ""))
        going_on = answer.status == 206 and span is not None and int(span[1]) == have
        if not going_on:
            have = 0
        expected = answer.headers.get("Content-Length")
        total = have + int(expected) if expected and expected.isdecimal() else None
        if total is not None and total > limit:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            raise StoreError(
                f"{url}: {total} bytes, expected at most {limit}; the file was changed at its source, and is not used"
            )
        with open(part, "ab" if going_on else "wb", buffering=0) as file:  # what arrived survives a kill
            while block := answer.read1(BLOCK):
                have += len(block)
                if have > limit:
                    break
                file.write(block)
    if have > limit:
        part.unlink(missing_ok=True)
        raise StoreError(f"{url}: more than {limit} bytes; the file was changed at its source, and is not used")
    if total is not None and have < total:
        raise http.client.IncompleteRead(b"", total - have)
