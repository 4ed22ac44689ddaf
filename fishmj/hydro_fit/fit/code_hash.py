"""Which code made a finished stage: a stage of another model or recipe is not gone on with."""

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[2]
ROOMS = ("dynamics", "water", "hydro_fit", "hydro_fit/fit")
QUIET = {"__main__.py", "report.py", "fit_figures.py", "online_correction.py"}  # what only asks or tells


@cache
def code(*more: str) -> str:
    """sha256 over everything that a fit and its figures are computed by, and over the rooms `more`."""
    files = [path for room in (*ROOMS, *more) for path in sorted((PACKAGE / room).glob("*.py")) if path.name not in QUIET]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
