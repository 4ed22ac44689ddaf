"""One line of the doctor's report."""

from typing import NamedTuple


class Finding(NamedTuple):
    """One line of the report. `state`: ok, note (works, know this), no (an option that is absent), bad (must be mended)."""

    section: str
    name: str
    state: str
    text: str
