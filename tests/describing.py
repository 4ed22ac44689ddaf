"""`fishmj new` as a user calls it, for the tests of descriptions."""

from pathlib import Path

from fishmj.base import console
from fishmj.mjcf.new import __main__ as verb

SIZES = dict(length="0.6", height="0.11", width="0.07", tail_height="0.14", mass="1.6", links="5", servo="lx-824")


def sized(**own: str) -> list[str]:
    """The options of a fish of SIZES, some of its own."""
    return [f"--{key.replace('_', '-')}={value}" for key, value in (SIZES | own).items()]


FIVE = sized()


def new(*arguments: str) -> int:
    return console.run(verb.main, list(arguments))


def refused(capsys, *arguments: str) -> str:
    """The one line of an error that writes nothing."""
    before = sorted(Path().rglob("*"))
    assert new(*arguments) == console.BAD_INPUT
    said = capsys.readouterr()
    assert said.err.startswith("fishmj: ") and said.err.count("\n") == 1 and "Traceback" not in said.err
    assert sorted(Path().rglob("*")) == before
    return said.err
