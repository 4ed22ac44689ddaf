"""The site: `make docs` builds it into build/docs, warnings are errors."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

project = "fishmj"
author = copyright = "the authors of fishmj"
release = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M)[1]

extensions = ["myst_parser"]
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3  # links to #headings, checked
nitpicky = True
highlight_language = "none"  # of blocks that name no language: commands and formulas

html_theme = "furo"
html_title = "fishmj"
html_static_path = ["_static"]
html_css_files = ["fishmj.css"]
html_copy_source = False
html_show_sphinx = False
html_last_updated_fmt = None
