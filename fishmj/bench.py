"""Speed of engines, water and solver, one JSON line a benchmark: `fishmj/studies/bench`."""

from importlib import import_module


def main(argv: list[str]) -> int:
    """The verb `bench`."""
    return int(import_module("fishmj.studies.bench.__main__").main(argv) or 0)


if __name__ == "__main__":
    import sys

    from fishmj import console

    sys.exit(console.run(main))
