"""Every bad log and every hostile file: one line instead of a traceback, nothing written beside what was asked for, no source changed.

The cases and what is expected of them were written from the documentation, before anybody looked whether it is so.
"""

import io
import os
import stat
import time
from hashlib import sha256
from pathlib import Path

import pytest
from bad_logs import BAD, CHECK, jumped
from hostile_logs import HOSTILE, NEEDS_LOGS, SCRIPTS, SECRETS

from fishmj import cli, console

CASES = {**BAD, **HOSTILE}
EXITS = {"refused": (2, 3), "noted": (0, 1)}
OUTPUTS = ("--out", "--report")
LONGEST = 20.0  # s of CPU, of a hang


def state(folder: Path) -> dict[str, str]:
    """What lies in a folder, links not followed."""
    found = {}
    for path in sorted(folder.rglob("*")):
        mode = path.lstat().st_mode
        name = path.relative_to(folder).as_posix()
        if stat.S_ISLNK(mode):
            found[name] = f"-> {os.readlink(path)}"
        else:
            found[name] = sha256(path.read_bytes()).hexdigest() if stat.S_ISREG(mode) else f"kind {stat.S_IFMT(mode):o}"
    return found


def run(make, argv: list[str], tmp_path: Path, monkeypatch, capsys) -> tuple[int, str, str, list[str]]:
    """(exit code, stdout, stderr, names that are new in the folder); the sources are as they were, and so is what lies above."""
    folder = tmp_path / "inside" / "here"
    folder.mkdir(parents=True)
    make(folder)
    before = state(tmp_path)
    monkeypatch.chdir(folder)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    monkeypatch.delenv("FISHMJ_TRACEBACK", raising=False)
    start = time.process_time()
    try:
        code = console.run(cli.dispatch, argv)
    except SystemExit as left:
        code = int(left.code or 0)
    assert time.process_time() - start < LONGEST
    said = capsys.readouterr()
    after = state(tmp_path)
    assert {name: after.get(name) for name in before} == before
    fresh = [name.removeprefix("inside/here/") for name in after if name not in before]
    return code, said.out, said.err, fresh


@pytest.mark.parametrize("case", CASES)
def test_a_bad_or_hostile_log_is_one_line_and_costs_nothing(case, tmp_path, monkeypatch, capsys):
    if case in NEEDS_LOGS:
        pytest.importorskip("pyarrow")
        pytest.importorskip("zstandard")
    make, argv, expected = CASES[case]
    code, out, err, fresh = run(make, argv, tmp_path, monkeypatch, capsys)
    assert "Traceback" not in err
    assert "a fault in fishmj" not in err
    assert code in EXITS[expected], (code, err)
    for secret in SECRETS:
        assert secret not in out + err
    outputs = [argv[i + 1] for i, word in enumerate(argv[:-1]) if word in OUTPUTS] if expected == "noted" else []
    assert [name for name in fresh if not any(name == o or name.startswith(f"{o}/") for o in outputs)] == []
    if expected == "refused":
        assert err.count("\n") >= 1 and all(len(line) < 1500 for line in err.splitlines())
    for name in fresh:
        if name.endswith(".html"):
            page = Path(name).read_text(encoding="utf-8")
            assert not any(script in page for script in SCRIPTS)


SAID = {
    "metres_then_centimetres": "run.csv:102:",
    "degrees_and_radians": "one in rad, one in deg",
    "degrees_then_radians": "degrees and radians? Split the file",
    "clock_jumps_ahead": "a gap of 3600.02 s after t = 1.980 s",
    "next_day": "a gap of 86400 s after t = 1.980 s (trial/cmd.csv:102:1)",
    "clock_of_1970": "trial/cmd.csv:102:1: time jumps by 1.76e+09 s",
    "named_ms_holds_s": "rows a second",
    "dead_servo": "j3: holds no number",
    "one_row": "one row only",
    "nothing_moves": "nothing moves: every column is one number",
    "weighed_in_grams": "are these g?",
    "npz_below_limit": "FISHMJ_MAX_UNPACKED=",
    "verdict_pipe": "verdict.json: is no plain file (a pipe or device)",
    "toml_deep": "meta.toml:6:1: line 6: a key of more than 64 parts",
    "trial_of_links": "pose.csv: a link that leads outside",
}


@pytest.mark.parametrize("case", SAID)
def test_the_line_says_what_is_wrong_and_where(case, tmp_path, monkeypatch, capsys):
    make, argv, _ = CASES[case]
    _, out, err, _ = run(make, argv, tmp_path, monkeypatch, capsys)
    assert SAID[case] in out + err


@pytest.mark.parametrize("seconds", [86400.0, 1.76e9])
def test_a_replay_of_a_log_with_a_long_pause_names_its_row(seconds, tmp_path, monkeypatch, capsys):
    argv = ["replay", "trial", "--out", "page.html"]
    code, _, err, fresh = run(lambda folder: jumped(folder, seconds), argv, tmp_path, monkeypatch, capsys)
    assert code == 2 and fresh == []
    assert "(row 101): split the trial there" in err or "trial/cmd.csv:102:1: time jumps" in err


def test_a_lag_is_the_same_with_a_day_between_the_halves():
    """What the logger slept is cut from both clocks by the same amount."""
    import numpy as np

    from fishmj.log.lag import lag_between

    t = np.arange(0, 30, 0.02)
    wave = lambda s: np.sin(2 * np.pi * (0.5 + 0.03 * s) * s)[:, None]  # noqa: E731
    late = t + 86400.0 * (t >= 15)
    whole = lag_between(("cmd", t, wave(t)), ("joint", t, wave(t - 0.06)))
    slept = lag_between(("cmd", late, wave(t)), ("joint", late, wave(t - 0.06)))
    assert abs(whole.lag - 0.06) < 0.003 and abs(slept.lag - 0.06) < 0.003


def test_a_trial_with_a_pipe_for_its_meta_says_so(tmp_path, monkeypatch, capsys):
    def make(folder: Path) -> None:
        BAD["next_day"][0](folder)
        (folder / "trial" / "meta.toml").unlink()
        os.mkfifo(folder / "trial" / "meta.toml")

    code, _, err, _ = run(make, CHECK, tmp_path, monkeypatch, capsys)
    assert code == 1 and "meta.toml: is no plain file" in err
