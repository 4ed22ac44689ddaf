"""The tutorials of docs/, from their first command to their last, in an empty folder.

What a reader runs for minutes is made shorter by options that the help of the command lists, `SHORTER`; nothing else differs.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
TUTORIALS = ("search", "train", "simulate", "solver", "tank")
JUDGED = "--los 0,180 --duration 20"
SHORTER = {
    "fishmj train": "--steps 8e3 --envs 64",
    "fishmj evaluate": JUDGED,
    "fishmj gap find": "--null-runs 24 --most 1",
    "fishmj lbm_oracle swim": "--seconds 0.2",
    "fishmj deploy swim": "--seconds 8",
}
FAULT = "--fault"  # of a robot: it ends a swim with exit code 1


def blocks(name: str) -> list[tuple[str, str]]:
    """(language, text) of the fenced blocks of a page."""
    return re.findall(r"^```(sh|python)\n(.*?)^```", (DOCS / name / "tutorial.md").read_text(encoding="utf-8"), re.M | re.S)


def shorter(command: str) -> list[str]:
    """The arguments of a command line, with those of `SHORTER` in place of its own of the same name."""
    words = shlex.split(command)
    for line, options in SHORTER.items():
        if command.startswith(line):
            more = options.split()
            for option in more[::2]:
                if option in words:
                    del words[words.index(option) : words.index(option) + 2]
            words += more
    return words[1:]


def run(arguments: list[str], folder: Path, code: int = 0) -> str:
    """Output of a process of this Python; it must end with the exit code `code`."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, f"{shlex.join(arguments)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_runs_from_end_to_end(name, tmp_path):
    told = ""
    for language, text in blocks(name):
        if language == "python":
            told += run(["-c", text], tmp_path)
        else:
            for command in text.splitlines():
                assert command.startswith("fishmj ")
                told += run(["-m", "fishmj", *shorter(command)], tmp_path, code=int(FAULT in command))
    for words in EXPECTED[name]:
        assert words in told, words


EXPECTED = {  # what the page quotes and what does not hang on how long it ran
    "search": (
        "NAMED: explains records that it has not seen, and nothing else does",
        "NAMED coulomb_friction {'torque': 0.10",
        "frictionloss=",
        "| report/fish.v2.toml |",
    ),
    "train": ("all that fishmj needs is here", "| controller | arrival", "first.html"),
    "simulate": ("| swims ahead                   | 0.251 m/s", "1.0 Hz: 0.250 m/s", "2.0 Hz: 0.454 m/s", "solved.html"),
    "solver": ("1 of 1 checks hold", "force history: ", "C_D = 1.73", "swim.html"),
    "tank": (
        "ended by FINISHED; 0.",
        " m RMS from the target",
        "; log in runs/first",
        "ended by POSE_LOST; 0.",
        "; log in runs/blind",
        "SWIMMING -> NEUTRAL: POSE_LOST",
        "first.html",
    ),
}


@pytest.mark.parametrize("name", TUTORIALS)
def test_what_a_tutorial_is_expected_to_say_stands_in_it(name):
    page = (DOCS / name / "tutorial.md").read_text(encoding="utf-8")
    assert [words for words in EXPECTED[name] if words not in page] == []


def test_options_in_place_of_others():
    assert (
        shorter("fishmj train --preset quick --steps 4e6 --out a") == "train --preset quick --out a --steps 8e3 --envs 64".split()
    )
    assert shorter("fishmj replay a") == ["replay", "a"]


def test_every_tutorial_is_run():
    assert {path.parent.name for path in DOCS.glob("*/tutorial.md")} == set(TUTORIALS)
