"""Every name in docs/reference/glossary.md can be imported from fishmj, and no word stands there twice."""

import re
from importlib import import_module
from pathlib import Path

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "glossary.md"
ROWS = re.findall(r"^\| ([^|]+) \| [^|]+ \| `([\w.]+):(\w+)` \|[^|]*\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def there(module: str, name: str) -> bool:
    try:
        return hasattr(import_module(module), name)
    except ModuleNotFoundError:
        return False


def test_the_names_of_the_glossary_exist():
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ") and "in the code" not in line]
    assert len(ROWS) == len(rows) >= 60, "every row names module:Name in backticks"
    gone = [f"{word}: {module}:{name}" for word, module, name in ROWS if not there(f"fishmj.{module}", name)]
    assert not gone, "\n".join(["mend the third column", *gone])


def test_a_word_stands_in_the_glossary_once():
    words = [word for word, _, _ in ROWS]
    assert sorted(words) == sorted(set(words))
