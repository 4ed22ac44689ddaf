"""Every bad log and every hostile file: one line and no traceback, nothing written beside what was asked for, sources unchanged.

The cases and what is expected of them were written from the documentation, before anybody looked whether it is so.
"""

import io
import os
import stat
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from bad_logs import ANGLES, BAD, CHECK, IMPORT, LAB, YAW, T, X, Y, jumped, lines
from hostile_logs import HOSTILE, NEEDS_LOGS, SCRIPTS, SECRETS

from fishmj import cli
from fishmj.base import console
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import read_npz, write_npz
from fishmj.gap.calibrate import calibrated_model
from fishmj.gap.calibrate.parameter_fit import ParameterEstimate
from fishmj.log.timebase import lag_between

CASES = {**BAD, **HOSTILE}
EXITS = {"refused": (2, 3), "noted": (0, 1)}
OUTPUTS = ("--out", "--report")


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
    try:
        code = console.run(cli.dispatch, argv)
    except SystemExit as left:
        code = int(left.code or 0)
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
    t = np.arange(0, 30, 0.02)
    wave = lambda s: np.sin(2 * np.pi * (0.5 + 0.03 * s) * s)[:, None]
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


def test_a_byte_of_a_log_counts_as_the_eight_that_it_becomes(tmp_path, monkeypatch):
    """10,000 bytes of int8 are 80,000 as float64; a reader that keeps int8 may have them."""
    path = write_npz(tmp_path / "pose.npz", {"t": np.zeros(10_000, np.int8)})
    monkeypatch.setenv("FISHMJ_MAX_UNPACKED", "50000")
    assert read_npz(path)["t"].shape == (10_000,)
    with pytest.raises(StoreError, match="80000 bytes as float64 .* FISHMJ_MAX_UNPACKED="):
        read_npz(path, widened=True)


def imported(folder: Path, header: str, columns, monkeypatch, capsys) -> tuple[int, str]:
    """(exit code, what was said) of an import."""
    lines(folder / "run.csv", header, columns)
    monkeypatch.chdir(folder)
    code = console.run(cli.dispatch, IMPORT)
    said = capsys.readouterr()
    return code, said.out + said.err


def test_one_stray_fix_is_said_and_not_refused(tmp_path, monkeypatch, capsys):
    """A camera that takes a reflex for the fish in one picture; beside it, a place that stays is another unit."""
    x = X.copy()
    x[60] += 3.0
    code, said = imported(tmp_path, "t,x,y,yaw", [T, x, Y, YAW], monkeypatch, capsys)
    assert code == 0 and "pose: 1 of 200 rows left out, the fish was lost in x 1 times" in said


@pytest.mark.parametrize("small", [0.2, 0.001])
def test_a_joint_that_moves_less_than_the_others_is_no_mistake(small, tmp_path, monkeypatch, capsys):
    """A stiff head: 6 deg beside 30 deg; and one that is held."""
    angles = ANGLES * np.array([small, 1, 1])
    code, said = imported(tmp_path, "time_ms,servo1,servo2,servo3", [T * 1e3, *angles.T], monkeypatch, capsys)
    assert code == 0, said


@pytest.mark.parametrize("factor", [0.5, 0.1, 0.03, 0.0])
def test_a_gait_that_gets_smaller_is_no_change_of_unit(factor, tmp_path, monkeypatch, capsys):
    angles = ANGLES * np.where(T < 2, 1.0, factor)[:, None]
    code, said = imported(tmp_path, "time_ms,servo1_deg,servo2_deg,servo3_deg", [T * 1e3, *angles.T], monkeypatch, capsys)
    assert code == 0, said


def test_an_import_shows_twenty_notes_and_counts_the_rest(tmp_path, monkeypatch, capsys):
    """25 swims of a robot that was off, each of another length."""
    for k in range(25):
        lines(tmp_path / "lab" / f"swim{k}.csv", "t,c1,c2,c3", [T[k:], *[np.full(len(T) - k, 0.1)] * 3])
    monkeypatch.chdir(tmp_path)
    assert console.run(cli.dispatch, [*LAB, "--trial-each"]) == 0
    said = capsys.readouterr().out
    assert said.count("nothing moves") == 20 and "and 5 more notes" in said


def test_many_remarks_of_one_kind_hide_no_other(tmp_path, monkeypatch, capsys):
    for k in range(25):
        lines(tmp_path / "lab" / f"swim{k}.csv", "t,c1,c2,c3", [T[k:], *[np.full(len(T) - k, 0.1)] * 3])
    lines(tmp_path / "lab" / "tuesday.csv", "t,c1,c2,c3,mood", [T, *np.radians(ANGLES).T, T])
    monkeypatch.chdir(tmp_path)
    assert console.run(cli.dispatch, [*LAB, "--trial-each"]) == 0
    said = capsys.readouterr().out
    assert "not read: mood" in said and "nothing moves" in said
    for k in range(5):
        (tmp_path / "lab" / f"swim{k}.csv").write_text("t,c1,c2,c3\n0,1,2,3\n1,2\n1,2\n")
    (tmp_path / "lab" / "tuesday.csv").write_text("")
    assert console.run(cli.dispatch, ["two" if word == "data" else word for word in LAB] + ["--trial-each"]) == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "tuesday.csv: the file is empty" in said and said.count("2 values in a row") == 2 and "; and 3 more" in said


def test_a_fish_that_is_refused_leaves_the_file_as_it_was(tmp_path):
    """The model is read back before it takes the place of the old one, with the effects in it."""
    out = tmp_path / "fish.toml"
    out.write_text(calibrated_model.start(Path("nowhere"), "fish"), encoding="utf-8")
    before = out.read_bytes()
    far = ParameterEstimate("yaw_inertia", "kg m2", -1e5, -1e5, -1e5, 1.0, "repeats")
    with pytest.raises(ConfigError, match="fish.toml .*outside the bounds") as caught:
        calibrated_model.write(out, calibrated_model.start(out, "fish"), "mass", {}, {"yaw_inertia.inertia": far}, tmp_path)
    assert out.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == ["fish.toml"]
    assert f"{out}" in str(caught.value)
