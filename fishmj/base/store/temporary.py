"""Temporary files and folders beside their target, and removal of those that a killed process left there.

A name is `.TARGET.HOST-PID-RANDOM.tmp`. The first temporary file that a process makes in a folder removes those of ended
processes of this machine. Data that were moved aside (`.old.tmp`) go back to their place if it is empty.
"""

import os
import platform
import re
import shutil
from contextlib import suppress
from pathlib import Path
from uuid import uuid4
from zlib import crc32

HOST = f"{crc32(platform.node().encode()):08x}"
_NAME = re.compile(rf"\.(?P<target>.+)\.{HOST}-(?P<pid>\d+)-[0-9a-f]{{8}}(?P<old>\.old)?\.tmp(\.\w+)?")
_clean: set[tuple[int, Path]] = set()  # (process, folder) that was looked through


def temporary_beside(place: Path, ending: str = "") -> Path:
    """Unused name for a temporary file or folder in the folder of `place`.

    Args:
        ending: of the name, `.mp4` for a library that needs it, or `.old` for data moved aside.
    """
    if (mark := (os.getpid(), place.parent)) not in _clean:
        _clean.add(mark)
        remove_abandoned(place.parent)
    old = ending if ending == ".old" else ""
    return place.with_name(f".{place.name}.{HOST}-{os.getpid()}-{uuid4().hex[:8]}{old}.tmp{ending if not old else ''}")


def remove_abandoned(folder: Path) -> None:
    """Removes the temporary files of ended processes of this machine from a folder; ignores those that cannot be removed."""
    try:
        names = os.listdir(folder)
    except OSError:
        return
    for name in names:
        found = _NAME.fullmatch(name)
        if found is None or _is_alive(int(found["pid"])):
            continue
        path, target = folder / name, folder / found["target"]
        with suppress(OSError):
            if found["old"] and not os.path.lexists(target):
                os.rename(path, target)
            elif path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # somebody else's
        return True
    return True
