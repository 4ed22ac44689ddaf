"""Which code made a finished stage: a stage of another model or recipe is not gone on with."""

import hashlib
from functools import cache
from pathlib import Path

QUIET = {"__main__.py", "ablation.py", "ablation_table.py", "report.py", "figures.py", "correct.py"}  # what only asks or tells


@cache
def code() -> str:
    """sha256 over everything that a fit and its figures are computed by."""
    here = Path(__file__).parents[1]
    files = [*here.glob("*.py"), *here.glob("fit/*.py"), *here.glob("ellipsoid/*.py")]
    digest = hashlib.sha256()
    for path in sorted(path for path in files if path.name not in QUIET):
        digest.update(path.read_bytes())
    return digest.hexdigest()
