"""Folder of the measured data, named by FISHMJ_MEASURED."""

import os
import shlex
from pathlib import Path

from fishmj.base.errors import LogError
from fishmj.log import Trial, importers

VARIABLE = "FISHMJ_MEASURED"


def trials(name: str) -> dict[str, Trial]:
    """The trials of one set by name. Raises LogError if the variable is not set or the set is not there."""
    root = os.environ.get(VARIABLE, "")
    if not root:
        raise LogError(
            f"{VARIABLE} is not set; it must name the folder of the measured data. Get a set with"
            f" fishmj gap fetch {name} --out DIR/{name} and set {VARIABLE}=DIR"
        )
    folder = Path(root) / name
    if not folder.is_dir():
        raise LogError(
            f"{folder}: no such folder ({VARIABLE}={root}); get it with fishmj gap fetch {name} --out {shlex.quote(str(folder))}"
        )
    return importers.read(folder)
