"""Text that wants to run, and a look at pages that it reached. For tests of whatever shows text of files."""

import os
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

from fishmj.base import pages

PAYLOADS = (
    "<script>window.pwned=1</script>",
    '"><img src=x onerror="window.pwned=1">',
    "' onmouseover='window.pwned=1' x='",
    "</script><script>window.pwned=1</script>",
    "</title><svg onload=window.pwned=1>",
    "{{7*7}} ${7*7} @DATA@ @PLAYER@",
    "<a href=javascript:window.pwned=1>javascript:window.pwned=1</a>",
    r"$\undefined$ $x^{",
    "\x1b[2J\x1b]0;owned\x07\x9b31m\u202etxt\r",
    "| a | b |",
)
EVIL = " ".join(PAYLOADS)


class Look(HTMLParser):
    """Counts what could run or load on a page."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.scripts, self.trouble, self.policy, self.words = [], [], "", []
        self._inside = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag == "script":
            self.scripts.append(given.get("type", "text/javascript"))
        if tag in ("script", "style", "title"):
            self._inside = tag
        if tag == "meta" and given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"]
        if tag in ("iframe", "object", "embed", "form", "base", "link", "a"):
            self.trouble.append(f"<{tag}>")
        for name, value in attrs:
            value = (value or "").strip().lower()
            if name.startswith("on") or value.startswith(("javascript:", "vbscript:")):
                self.trouble.append(f"{tag} {name}={value[:40]}")
            if name in ("src", "href", "xlink:href") and not value.startswith(("data:image/png;base64,", "#")):
                self.trouble.append(f"{tag} {name}={value[:40]}")

    def handle_endtag(self, tag):
        self._inside = "" if tag == self._inside else self._inside

    def handle_data(self, data):
        if self._inside not in ("script", "style"):
            self.words.append(data)


def check(page: str, *, scripts: tuple[str, ...] = (), shown: str = "window.pwned=1") -> Look:
    """A page on which hostile text is shown, and nothing of it is anything but text."""
    found = Look(page)
    assert found.trouble == [] and found.scripts == list(scripts), (found.trouble, found.scripts)
    assert "default-src 'none'" in found.policy and "unsafe-eval" not in found.policy
    assert "script-src" in found.policy or not scripts
    assert "'unsafe-inline'" not in found.policy.partition("script-src")[2]
    assert not set(page) & {"\x1b", "\x07", "\x9b", "\u202e"}, "no control characters"
    if shown:
        assert shown in " ".join(found.words), "it is shown, as text"
    return found


def browser() -> str | None:
    """A headless browser, or None."""
    names = (os.environ.get("FISHMJ_BROWSER", ""), "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    return next((found for name in names if name and (found := shutil.which(name))), None)


def visited(page: Path, profile: Path) -> tuple[str, list[str]]:
    """The document as a browser has it after two seconds, and what was said in its console."""
    quiet = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-sync"
    drawing = "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --enable-logging=stderr --dump-dom"
    command = [browser(), *quiet.split(), *drawing.split(), f"--user-data-dir={profile}", "--virtual-time-budget=2000"]
    done = subprocess.run([*command, page.as_uri()], capture_output=True, text=True, timeout=600, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


WATCH = "document.addEventListener('DOMContentLoaded',()=>setTimeout(()=>document.body.dataset.pwned=String(window.pwned),500))"
needs_browser = pytest.mark.skipif(browser() is None, reason="no chromium or chrome found; set FISHMJ_BROWSER to one")


def runs_nothing(text: str, folder: Path, guards: tuple[bool, ...] = (True, False)) -> str:
    """Open a page in a browser, with the page's policy and without it, where escaping alone must do; the last document."""
    dom = ""
    for guarded in guards:
        allowed = pages.policy([WATCH, *re.findall(r"<script>(.*?)</script>", text, re.DOTALL)]) if guarded else ""
        seen = re.sub(r"<meta http-equiv=[^>]*>", lambda _, allowed=allowed: allowed, text)
        page = folder / f"seen{guarded}.html"
        page.write_text(seen.replace("<title>", f"<script>{WATCH}</script><title>", 1), encoding="utf-8")
        dom, errors = visited(page, folder / f"profile{guarded}")
        assert 'data-pwned="undefined"' in dom, errors
        assert not [line for line in errors if "Security" in line or "Uncaught" in line], errors
    return dom
