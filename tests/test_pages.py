"""The shell of every page: rows become a table, and on a phone the page stays as wide as the phone."""

import json
import re
from html import unescape

import numpy as np
import pytest
from test_replay import needs_browser, visit

from fishmj.base import pages

MEASURED = """const wide = e => [e.scrollWidth, e.clientWidth];
parent.postMessage(JSON.stringify([document.documentElement, ...document.querySelectorAll(".scroll")].map(wide)), "*");"""


def test_rows_become_a_table_that_scrolls_in_itself():
    table = pages.table([{"a": "x<y", "b": 1.23456}, {"a": "z", "b": float("nan")}, {"a": 41 * "w", "b": None}])
    assert table.startswith('<div class="scroll"><table class="left1">') and pages.table([]) == ""
    cells = ["x&lt;y", "1.235", "z", "-", 41 * "w", "-"]
    assert (
        re.findall("<t[hd](?: class=.long.)?>(.*?)</t[hd]>", table) == ["a", "b", *cells]
        and table.count('<td class="long">') == 1
    )


def test_what_is_empty_is_left_out():
    full, empty = pages.Section("full", "", ["words"]), pages.Section("empty", "about nothing", ["", pages.table([])])
    page = pages.report("title", "heading", [empty, full])
    assert "<h2>full</h2>" in page and "nothing" not in page and '<p class="about">words</p>' in page


@pytest.mark.browser
@needs_browser
def test_phone_page_scrolls_wide_tables_and_figures_but_not_the_page(tmp_path):
    import cv2

    rows = [{f"column {i}": 1000.0 * i for i in range(12)} | {"words": 30 * "long "}]
    png = cv2.imencode(".png", np.zeros((200, 1300, 3), np.uint8))[1].tobytes()
    heading = "One very long headline about a controller that holds its station in a current " + 40 * "x"
    notes = [pages.part("command", "again", "fishmj evaluate " + 90 * "y")]
    parts = [pages.table(rows), pages.figure(png, "a picture"), 60 * "z"]
    page = pages.report("a", heading, [pages.Section("A section", "about " * 30, parts)], mark="MARK", notes=notes)
    page = re.sub(r"<meta http-equiv=[^>]*>", "", page)  # the page's policy lets no script run, not even this one
    (tmp_path / "a.html").write_text(page.replace("</body>", f"<script>onload = () => {{ {MEASURED} }}</script></body>"))
    told = "onmessage = event => { document.body.dataset.probe = event.data; };"
    framed = tmp_path / "framed.html"  # a browser's own window is no narrower than 500 pixels
    framed.write_text(f'<!DOCTYPE html><script>{told}</script><body><iframe src="a.html" width="390" height="844"></iframe>')
    dom, errors = visit(framed, tmp_path / "p", "--dump-dom")
    (whole, phone), *scrolling = json.loads(unescape(re.search(r'data-probe="([^"]*)"', dom)[1]))
    assert errors == [] and whole == phone == 390
    assert len(scrolling) == 2 and all(inside > shown and shown <= 390 for inside, shown in scrolling)
