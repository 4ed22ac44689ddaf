"""Text from files on pages and pictures: nothing of it runs, fetches or breaks a drawing.

    escaped(text)          for HTML text and quoted attributes, control characters gone
    data(value)            JSON for a <script type="application/json">, without any < > &
    drawn(text)            for Matplotlib, whose `$` begins a formula
    document(..)           a whole page under a policy that lets nothing load and only the page's own scripts run
    as_html(table)         a table of `console.table`

A log, a data set, a verdict or a description is somebody else's text wherever it came from.
"""

import base64
import html
import json
import re
from collections.abc import Iterable
from hashlib import sha256
from typing import Any

from fishmj.console import plain, printable

LONGEST = 60  # characters of a label in a picture


def escaped(text: object) -> str:
    """`text` as HTML: what it says is shown, never run; safe in text and in quoted attributes."""
    return html.escape(printable(str(text)), quote=True)


def data(value: Any) -> str:
    """JSON that cannot end the <script> it stands in, and that no reader takes for HTML."""
    text = json.dumps(plain(value))  # ASCII: U+2028 is escaped too
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def drawn(text: object) -> str:
    """`text` as Matplotlib draws it letter by letter: no formula, no control characters, not endless."""
    line = " ".join(printable(str(text)).split())
    line = line if len(line) <= LONGEST else line[: LONGEST - 3] + "..."
    return line.replace("\\$", "$").replace("$", r"\$")


def policy(scripts: Iterable[str] = ()) -> str:
    """The meta tag that says what a page may do: show itself, its data: pictures, and run `scripts`, told by their sums.

    Nothing is fetched from anywhere, no form is sent, no frame is opened, no attribute and no javascript: address runs.
    """
    sums = " ".join(f"'sha256-{base64.b64encode(sha256(text.encode()).digest()).decode()}'" for text in scripts)
    rules = ["default-src 'none'", "style-src 'unsafe-inline'", "img-src data: blob:", "base-uri 'none'", "form-action 'none'"]
    rules += [f"script-src {sums}"] if sums else []
    return f'<meta http-equiv="Content-Security-Policy" content="{"; ".join(rules)}">'


def document(title: str, body: str, style: str) -> str:
    """A self-contained page without scripts; `title` is plain text, `body` HTML, `style` CSS of our own."""
    head = f'<meta charset="utf-8">{policy()}<meta name="viewport" content="width=device-width">'
    head += f"<title>{escaped(title)}</title><style>{style}</style>"
    return f'<!doctype html><html lang="en"><head>{head}</head><body>\n{body}\n</body></html>\n'


def picture(png: bytes, caption: str) -> str:
    """A PNG inside the page; `caption` is plain text."""
    return f'<img alt="{escaped(caption)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def as_html(table: str) -> str:
    """A Markdown table of `console.table` as HTML."""
    rows = [[c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in table.splitlines()]
    cells = lambda row, tag: "".join(f"<{tag}>{escaped(c.replace(chr(92) + '|', '|'))}</{tag}>" for c in row)
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows[2:])
    return f"<table><thead><tr>{cells(rows[0], 'th')}</tr></thead><tbody>{body}</tbody></table>"
