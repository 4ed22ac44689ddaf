"""What comes with fishmj: `data/` of a checkout, or `_data` of an installed package, which holds what verbs open on their own."""

from pathlib import Path

from fishmj.calib import OWN, ROOTS

SOURCES = "in a checkout or the source distribution (sdist)"


def shipped(path: str | Path) -> Path:
    """A path such as `data/gap/lbm/nulls`: in the working directory, else what came with fishmj, else as it was given."""
    path = Path(path)
    below = path.parts[1:] if path.parts[:1] == ("data",) and not path.exists() else ()
    return next((root.joinpath(*below) for root in ROOTS if below and root.joinpath(*below).exists()), path)


def left_out(path: str | Path) -> str:
    """Where to get what lies below `data/` in the sources alone: words that end an error; "" in a checkout, or of other paths."""
    if OWN in ROOTS or Path(path).parts[:1] != ("data",):
        return ""
    return f"; fishmj's own data/ is whole {SOURCES} only"
