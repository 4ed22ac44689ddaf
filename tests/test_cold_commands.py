"""Command lines written by someone who knew the docs and not the code: one clear line, exit 2, nothing left behind."""

import argparse
import io
import json
import os

import pytest
from bad_commands import COMMANDS, prepare, without_progress

from fishmj import cli
from fishmj.base import console


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cold")
    prepare(folder)
    return folder


def listing(folder):
    return sorted(os.path.join(root, name) for root, folders, files in os.walk(folder) for name in (*folders, *files))


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_mistyped_command_is_one_line(name, place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    monkeypatch.setattr("sys.stdin", io.StringIO())  # nobody answers
    before = listing(place)
    code = console.run(cli.dispatch, [*COMMANDS[name], "--json"])
    out, err = capsys.readouterr()
    said = without_progress(err)
    assert code == console.BAD_INPUT, (COMMANDS[name], err)
    assert said and all(line.startswith("fishmj: ") for line in said) and "Traceback" not in err, err
    assert [line for line in said if not line.startswith("fishmj: device: ")] == said[-1:], err
    assert all(line.startswith("{") for line in out.splitlines()), out
    if "--json" not in err:  # a command without it says so
        assert json.loads(out.splitlines()[-1])["exit"] == code
    assert listing(place) == before


def test_full_disk_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.TemporaryFile", lambda **_: open("/dev/full", "wb"))
    for kind in (console.out_folder, console.out_file):
        with pytest.raises(argparse.ArgumentTypeError, match="cannot be written .No space left on device.; choose another"):
            kind(str(tmp_path / "new"))
