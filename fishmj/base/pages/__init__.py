"""Every page: one shell, one sheet, one table, one figure (Jinja2 templates beside this file). Text of files is shown, never run.

    report(..)             a page of sections;  page(template, ..) fills another template of this folder
    table(rows)            rows of a table and
    figure(picture, ..)    a picture, as parts of a section;  part(name, ..) is any other macro of parts.html
    data(value)            JSON for a <script type="application/json">, without any < > &
    drawn(text)            for Matplotlib, whose `$` begins a formula

Templates escape everything that is not `Markup`, and leave out control characters. The text of a log, a data set, a verdict or a
description is never trusted. A page's policy lets nothing load and only the page's own scripts run.
"""

import base64
import json
from collections.abc import Iterable, Sequence
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup, escape

from fishmj import __version__
from fishmj.base import console
from fishmj.base.console import printable

FOLDER = Path(__file__).parent
LONGEST = 60  # characters of a label in a picture
WRAPPED = 40  # characters from which a cell of a table may break into lines


class Section(NamedTuple):
    """A part of a page. parts: made by `part`, or plain text, which becomes a paragraph; empty ones are left out."""

    name: str
    about: str
    parts: Sequence[str]


def escaped(text: object) -> Markup:
    """Escapes `text` as HTML: shown, never run; safe in text and in quoted attributes."""
    return escape(text if hasattr(text, "__html__") else printable(str(text)))


def data(value: Any) -> Markup:
    """JSON that cannot end its <script> element and is never read as HTML."""
    text = json.dumps(console.plain(value))  # ASCII: U+2028 is escaped too
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def drawn(text: object) -> str:
    """`text` for Matplotlib, drawn letter by letter: no formula, no control characters, shortened."""
    line = " ".join(printable(str(text)).split())
    line = line if len(line) <= LONGEST else line[: LONGEST - 3] + "..."
    return line.replace("\\$", "$").replace("$", r"\$")


def policy(scripts: Iterable[str] = ()) -> Markup:
    """The meta tag with the page's permissions: show itself and `data:` pictures, and run `scripts`, identified by their hashes.

    Nothing is fetched from anywhere, no form is sent, no frame is opened, no attribute and no javascript: address runs.
    """
    sums = " ".join(f"'sha256-{base64.b64encode(sha256(text.encode()).digest()).decode()}'" for text in scripts)
    rules = ["default-src 'none'", "style-src 'unsafe-inline'", "img-src data: blob:", "base-uri 'none'", "form-action 'none'"]
    rules += [f"script-src {sums}"] if sums else []
    return Markup(f'<meta http-equiv="Content-Security-Policy" content="{"; ".join(rules)}">')


@cache
def _templates():
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    rules = {"autoescape": True, "finalize": escaped, "undefined": StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
    made = Environment(loader=FileSystemLoader(FOLDER), **rules)
    sheet = Markup((FOLDER / "style.css").read_text(encoding="utf-8"))
    made.globals |= {"sheet": sheet, "version": __version__, "wrapped": WRAPPED}
    made.filters["cell"] = lambda value: value if hasattr(value, "__html__") else console.cell(value)
    made.filters["base64"] = lambda png: base64.b64encode(png).decode()
    return made


def page(template: str, title: str, scripts: Sequence[str] = (), **values: Any) -> str:
    """A self-contained page from a template of this folder; the policy holds the hashes of the page's own `scripts`."""
    own = [Markup(text) for text in scripts]
    return _templates().get_template(template).render(title=title, policy=policy(own), scripts=own, **values)


def report(title: str, heading: str, sections: Iterable[Section], template: str = "report.html", **more: Any) -> str:
    """A page of sections below a head: `mark` in a box, the heading, the `robot`, `notes`. All but `Markup` is plain text."""
    shown = [s._replace(parts=[part for part in s.parts if part]) for s in sections]
    given = {"mark": "", "robot": "", "notes": (), **more, "heading": heading, "sections": [s for s in shown if s.parts]}
    return page(template, title, **given)


def part(name: str, *given: Any, **options: Any) -> Markup:
    """Fills a macro of parts.html."""
    return getattr(_templates().get_template("parts.html").module, name)(*given, **options)


# (rows, left=1): rows as of `console.table`; the first `left` columns are words and stand to the left, the others numbers
table = partial(part, "table")
# (PNG bytes or an SVG element, caption, below=True): with below=False the caption is above, and is only read aloud
figure = partial(part, "figure")
