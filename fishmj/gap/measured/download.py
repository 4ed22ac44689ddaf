"""Downloads one file over HTTP: resumes after an interruption, gives up after three, never returns a file with a wrong hash."""

import hashlib
import http.client
import re
import time
import urllib.error
import urllib.request
from contextlib import suppress
from pathlib import Path

from fishmj.base.errors import StoreError

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
