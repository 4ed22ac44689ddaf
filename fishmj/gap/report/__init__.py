"""The report of `gap find`: one self-contained HTML page, and the same figures as JSON."""

from pathlib import Path

from fishmj.gap.report.report_data import ReportData, gathered, plain
from fishmj.gap.report.sections import html
from fishmj.gap.thresholds import Gates
from fishmj.gap.workflow import Inquiry
from fishmj.store import write_json, write_text

__all__ = ["ReportData", "gathered", "page", "write"]


def page(inquiry: Inquiry, gates: Gates | None = None) -> str:
    """The report as one HTML text without outside references.

    Args:
        gates: the thresholds that the search used; default, the frozen ones.
    Raises:
        MissingExtra: matplotlib is not installed.
    """
    return html(gathered(inquiry, gates))


def write(inquiry: Inquiry, folder: Path, gates: Gates | None = None) -> list[str]:
    """Write report.html and report.json; returns the names of the files."""
    folder.mkdir(parents=True, exist_ok=True)
    material = gathered(inquiry, gates)
    write_json(folder / "report.json", plain(material))
    write_text(folder / "report.html", html(material))
    return ["report.html", "report.json"]
