"""Is a path a plain file that can be read to its end? A pipe waits for a writer, a device never ends."""

import errno
import stat
from pathlib import Path

ABSENT = "no such file"
NOWHERE = "is a link that leads nowhere"


def trouble(path: str | Path, wanted: str = "a file") -> str:
    """Why `path` cannot be read as a file, in a few words that follow "PATH: "; "" where it can. Links are followed."""
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return NOWHERE if path.is_symlink() else ABSENT
    except (OSError, ValueError) as error:  # a link to itself, a folder that may not be entered, a null byte
        if getattr(error, "errno", None) == errno.ELOOP:
            return NOWHERE
        return f"cannot be read: {getattr(error, 'strerror', None) or error}"
    if stat.S_ISDIR(mode):
        return f"is a folder, expected {wanted}" if wanted else "is a folder"
    return "" if stat.S_ISREG(mode) else "is no plain file (a pipe or device); save it to a file first"
