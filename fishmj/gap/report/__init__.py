"""The report of `gap find`: one self-contained HTML page, and the same figures as JSON."""

from pathlib import Path

from fishmj.base.store import write_json, write_text
from fishmj.gap.report.report_data import ReportData, gather, plain
from fishmj.gap.report.sections import html
from fishmj.gap.workflow import Inquiry

__all__ = ["ReportData", "gather", "page", "write"]


def page(inquiry: Inquiry) -> str:
    """The report as one HTML text without outside references."""
    return html(gather(inquiry))


def write(inquiry: Inquiry, folder: Path) -> list[str]:
    """Writes report.html and report.json; returns the names of the files."""
    folder.mkdir(parents=True, exist_ok=True)
    material = gather(inquiry)
    write_json(folder / "report.json", plain(material))
    write_text(folder / "report.html", html(material))
    return ["report.html", "report.json"]
