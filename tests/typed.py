"""What the tests of own code share: a file of the user's own, and a command that is refused in one line."""

from pathlib import Path

from fishmj.base import console

EXAMPLE = str(Path(__file__).resolve().parent.parent / "examples" / "own_code.py")


def write(folder: Path, text: str, name: str = "mine.py") -> str:
    """A file of the user's own; its path."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def refused(main, argv, capsys) -> str:
    """The one line of a command that ends with exit code 2."""
    assert console.run(main, argv) == console.BAD_INPUT
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fishmj: ")]
    assert len(said) == 1
    return said[0]
