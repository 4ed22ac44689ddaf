"""Is a path a plain file that can be read to its end? A pipe waits for a writer, a device never ends."""

import stat
from pathlib import Path


def trouble(path: str | Path) -> str:
    """Why `path` cannot be read as a file, in a few words that follow "PATH: "; "" where it can. Links are followed."""
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return "is a link that leads nowhere" if path.is_symlink() else "no such file"
    except (OSError, ValueError) as error:  # a link to itself, a folder that may not be entered, a null byte
        return f"cannot be read: {getattr(error, 'strerror', None) or error}"
    if stat.S_ISDIR(mode):
        return "is a folder, expected a file"
    return "" if stat.S_ISREG(mode) else "is no plain file (a pipe or device); save it to a file first"
