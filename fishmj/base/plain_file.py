"""Checks that a path is a plain file that can be read to its end. A pipe waits for a writer, a device never ends."""

import errno
import stat
from pathlib import Path

ABSENT = "no such file"
NOWHERE = "is a link that leads nowhere"
POINTER = "is a Git LFS pointer, the file itself was not downloaded; run git lfs install and git lfs pull in its repository"
POINTS = b"version https://git-lfs.github.com/spec/"
SMALL = 1024  # bytes; a pointer is shorter


def why_unreadable(path: str | Path, wanted: str = "a file") -> str:
    """Reason that `path` cannot be read as a file, in a few words that follow "PATH: "; "" if it can. Links are followed."""
    path = Path(path)
    try:
        told = path.stat()
    except FileNotFoundError:
        return NOWHERE if path.is_symlink() else ABSENT
    except (OSError, ValueError) as error:  # a link to itself, a folder that may not be entered, a null byte
        if getattr(error, "errno", None) == errno.ELOOP:
            return NOWHERE
        return f"cannot be read: {getattr(error, 'strerror', None) or error}"
    if stat.S_ISDIR(told.st_mode):
        return f"is a folder, expected {wanted}" if wanted else "is a folder"
    if not stat.S_ISREG(told.st_mode):
        return "is no plain file (a pipe or device); save it to a file first"
    return POINTER if told.st_size < SMALL and _starts_as_pointer(path) else ""


def _starts_as_pointer(path: Path) -> bool:
    """Returns True for the pointer text that Git LFS leaves in place of a large file."""
    try:
        with open(path, "rb") as file:
            return file.read(len(POINTS)) == POINTS
    except OSError:  # whoever reads it says why
        return False
