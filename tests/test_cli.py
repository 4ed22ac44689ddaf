"""The command line: exit codes, one JSON object last, progress, tables."""

import argparse
import io
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fishmj import cli
from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName, UsageError, closest_name


def json_last(text: str):
    return json.loads(text.strip().splitlines()[-1])


def test_usage_lists_the_verbs_of_this_build(capsys):
    assert cli.main(["--help"]) == 0
    listed = capsys.readouterr().out
    assert all(f"  {verb} " in listed for verb in cli.present())


def test_every_listed_verb_has_a_summary_and_a_main():
    for verb, summary in cli.present().items():
        assert 10 < len(summary) < 140, verb
        assert callable(cli.load(verb))


@pytest.mark.parametrize("verb", sorted(cli.present()))
def test_every_verb_helps(verb, capsys):
    assert cli.main([verb, "--help"]) == 0
    assert f"fishmj {verb}" in capsys.readouterr().out


def test_no_verb_is_bad_input(capsys):
    assert cli.main([]) == 2
    assert "usage" in capsys.readouterr().out


def test_an_unknown_verb_is_one_line_with_the_closest_name(capsys):
    assert cli.main(["docter", "--json"]) == 2
    out, err = capsys.readouterr()
    assert err.count("\n") == 1 and "Did you mean 'doctor'" in err
    assert json_last(out) == {"error": err.removeprefix("fishmj: ").strip(), "kind": "UnknownName", "exit": 2}


def test_the_console_script_and_the_module_are_the_same_program():
    done = subprocess.run(
        [sys.executable, "-m", "fishmj", "bench", "--list", "--json"], capture_output=True, text=True, check=True
    )
    same = subprocess.run(
        [sys.executable, "-m", "studies.benchmarks", "--list", "--json"], capture_output=True, text=True, check=True
    )
    assert done.stdout == same.stdout and json_last(done.stdout)["benchmarks"]


def stops_with(error):
    def main(argv):
        raise error

    return main


@pytest.mark.parametrize(
    ("error", "code"),
    [(ConfigError("speed = -1\nexpected at least 0"), 2), (KeyboardInterrupt(), 130), (SystemExit(3), 3), (SystemExit(None), 0)],
)
def test_errors_become_exit_codes(error, code, capsys):
    assert console.run(stops_with(error), []) == code
    assert "Traceback" not in capsys.readouterr().err


def test_a_fishmj_error_is_one_line(capsys):
    console.run(stops_with(ConfigError("speed = -1\nexpected at least 0")), [])
    assert capsys.readouterr().err == "fishmj: speed = -1 expected at least 0\n"


def test_a_fault_of_ours_shows_its_traceback_and_is_no_failed_check(capsys):
    assert console.run(stops_with(ZeroDivisionError("x")), ["--json"]) == 70
    out, err = capsys.readouterr()
    assert "Traceback" in err and json_last(out)["kind"] == "ZeroDivisionError"


@pytest.mark.parametrize(("answer", "code"), [(None, 0), (0, 0), (1, 1), (3, 3)])
def test_what_main_returns_is_the_exit_code(answer, code):
    assert console.run(lambda argv: answer, []) == code


def test_a_reader_that_leaves_early_is_no_error():
    code = "from fishmj.base.console import run, say\n"
    code += "raise SystemExit(run(lambda a: [say('x' * 99) for _ in range(20000)] and 0, []))"
    done = subprocess.run(
        ["bash", "-c", '"$0" -c "$1" | head -1; exit ${PIPESTATUS[0]}', sys.executable, code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 141 and done.stderr == ""


def test_json_is_strict_whatever_is_in_it(capsys):
    value = {"a": np.float32(1.5), "b": np.array([1.0, np.nan, np.inf]), 3: (np.int64(2), True, None), "p": Path("a")}
    console.emit_json(value)
    assert json_last(capsys.readouterr().out) == {"a": 1.5, "b": [1.0, None, None], "3": [2, True, None], "p": "a"}


def test_a_table_is_markdown_with_numbers_to_the_right():
    text = console.table([{"name": "pd", "rmse": 0.123456, "n": 72}, {"name": "pn", "rmse": math.nan, "n": 7}])
    assert text.splitlines() == [
        "| name |   rmse |   n |",
        "|------|-------:|----:|",
        "| pd   | 0.1235 |  72 |",
        "| pn   |      - |   7 |",
    ]


@pytest.mark.parametrize(
    ("seconds", "text"), [(7.24, "7.2 s"), (59.94, "59.9 s"), (185, "3 min 05 s"), (7800, "2 h 10 min"), (math.inf, "?")]
)
def test_durations_read_well(seconds, text):
    assert console.duration(seconds) == text


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_time_left_forgets_a_slow_start():
    clock = Clock()
    bar = console.Progress(1000, "train", "steps", stream=Screen(), clock=clock)
    clock.now += 60  # compilation
    bar.update(0)
    for done in range(10, 510, 10):
        clock.now += 1
        bar.update(done)
    assert bar.rate == pytest.approx(10)
    assert bar.left == pytest.approx(50)


def test_first_progress_after_a_compilation_tells_no_time_left():
    clock = Clock()
    bar = console.Progress(1536, "null runs", "runs", stream=Screen(), clock=clock)
    bar.update(0)
    clock.now += 40.0  # the simulator is compiled
    bar.update(1)
    assert "? left" in bar.line() and "at most" not in bar.line()
    for done in range(2, 22):
        clock.now += 0.2
        bar.update(done)
    assert bar.left == pytest.approx((1536 - 21) * 0.2) and "5 min 03 s left" in bar.line() and "at most" not in bar.line()


def test_work_that_may_end_early_has_an_upper_bound_to_its_end():
    clock = Clock()
    bar = console.Progress(5, "search", "rounds", stream=Screen(), clock=clock, at_most=True)
    assert "at most" not in bar.line() and "? left" in bar.line()
    for done in (1, 2, 3):
        clock.now += 10.0
        bar.update(done)
        assert ("? left" if done == 1 else f"at most {console.duration(10.0 * (5 - done))} left") in bar.line()


def test_the_time_left_is_unknown_before_anything_is_done():
    bar = console.Progress(10, "train", clock=Clock(), stream=Screen())
    assert bar.left == math.inf and "? left" in bar.line()


def test_a_screen_gets_one_line_that_is_rewritten():
    clock, screen = Clock(), Screen()
    with console.Progress(4, "train", "steps", stream=screen, clock=clock) as bar:
        for done in (1, 2, 3, 4):
            clock.now += 1
            bar.update(done, reward=0.5)
    text = screen.getvalue()
    assert text.count("\n") == 1 and text.count("\r") == 4
    assert "100 %" in text and "reward 0.5" in text and "took 4.0 s" in text


def test_progress_counts_its_time_from_a_restart():
    clock = Clock()
    bar = console.Progress(10, "train", stream=(screen := Screen()), clock=clock)
    bar.stage("compiling the fish")
    clock.now += 20
    bar.restart()
    clock.now += 4
    bar.update(10)
    assert "took 4.0 s" in screen.getvalue()


def test_warnings_of_candidates_stand_behind_the_progress_once_each(capsys):
    with console.warnings_behind():
        for _ in range(3):
            console.warn("a beat is too fast")
        assert not capsys.readouterr().err
    assert capsys.readouterr().err == "fishmj: a beat is too fast\n"
    console.warn("now")
    assert capsys.readouterr().err == "fishmj: now\n"


def test_progress_never_goes_back():
    clock = Clock()
    bar = console.Progress(100, "judge", "s", stream=Screen(), clock=clock)
    for done in (10, 30, 20, 40):
        clock.now += 1
        bar.update(done)
        assert bar.rate >= 0 and ("? left" in bar.line()) is (done == 10)
    assert " 40 %" in bar.line()


def test_a_file_gets_few_lines_without_carriage_returns():
    clock, file = Clock(), io.StringIO()
    with console.Progress(1000, "train", "steps", stream=file, clock=clock) as bar:
        for done in range(1, 1001):
            clock.now += 0.1
            bar.update(done)
    lines = file.getvalue().splitlines()
    assert "\r" not in file.getvalue() and 5 <= len(lines) <= 9 and "100 %" in lines[-1]


def test_distinct_option_is_refused_twice_and_append_option_is_collected():
    parser = console.parser("x", "x")
    parser.add_argument("--out", nargs="+", action=console.Distinct)
    parser.add_argument("--with", action="append")
    for _ in range(2):  # a parser may be used again
        assert parser.parse_args(["--json", "--json", "--with", "a", "--with", "b", "--out", "c", "d"]).out == ["c", "d"]
    with pytest.raises(UsageError, match="--out: is given twice"):
        parser.parse_args(["--out", "c", "--out", "d"])


def test_help_before_a_name_is_the_help_of_that_name(capsys):
    asked = (["help", "train"], ["help", "gap", "find"], ["help", "hydro_fit"], ["gap", "help", "find"])
    for words, name in zip(asked, ("train", "gap find", "hydro_fit", "gap find"), strict=True):
        assert cli.main(words) == 0
        assert capsys.readouterr().out.startswith(f"usage: fishmj {name} ")
    assert cli.main(["help", "trian"]) == 2 and "Did you mean 'train'" in capsys.readouterr().err


def test_a_text_that_begins_with_a_dash_is_no_option():
    parser = console.parser("x", "x")
    parser.add_argument("--title")
    assert parser.parse_args(["--title", "\u2013 a note \u2013"]).title == "\u2013 a note \u2013"


def test_unknown_robot_suggests_the_toml_file_of_that_name_in_the_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "minnow.toml").write_text("")
    assert cli.main(["evaluate", "pd", "--robot", "minnow"]) == 2 and "did you mean minnow.toml?" in capsys.readouterr().err


def groups(main, words):
    """(words, the group) of every command group below a verb."""
    if isinstance(main, console.CommandGroup):
        yield words, main
        for name in main.commands:
            yield from groups(main.load(name), f"{words} {name}")


def test_the_help_of_every_group_lists_its_commands_with_a_line_each(capsys):
    """Also of one that runs a command where none is named, as `hydro_fit` does."""
    found = [pair for verb in cli.present() for pair in groups(cli.load(verb), verb)]
    assert {"hydro_fit", "gap", "lbm_oracle", "campaign", "log", "calibrate"} <= {words for words, _ in found}
    for words, group in found:
        for asked in ("--help", "-h", "help"):
            assert cli.main([*words.split(), asked]) == 0
            lines = capsys.readouterr().out.splitlines()
            for name, command in group.commands.items():
                told = [line for line in lines if line.split(f"  {name} ", 1)[0] == "" and line.endswith(command.summary)]
                assert len(told) == 1 and len(command.summary) > 10, (words, name, told)
        assert not group.bare or f"Without a command: {group.bare}." in lines


def test_closed_pipe_ends_no_work(tmp_path):
    """The reader of both streams leaves after a line; the file is written, and 141 says that nobody read the rest."""
    code = (
        "import sys; from pathlib import Path; from fishmj.base import console\n"
        "def main(argv):\n"
        "    with console.Progress(2, 'work', stream=sys.stderr, every=0) as bar:\n"
        "        for _ in range(20000): console.say('x' * 99); console.warn('y'); bar.update(1)\n"
        "    console.emit_json({'a': 1}); Path(argv[0]).write_text('whole')\n"
        "    return int(argv[1])\n"
        "raise SystemExit(console.run(main))"
    )
    for answer, expected in ((0, 141), (1, 1)):
        line = '"$0" -c "$1" "$2" $3 2>&1 | head -1; exit ${PIPESTATUS[0]}'
        out = tmp_path / str(answer)
        done = subprocess.run(["bash", "-c", line, sys.executable, code, out, str(answer)], capture_output=True, check=False)
        assert (done.returncode, out.read_text(), done.stderr) == (expected, "whole", b"")


@pytest.mark.parametrize(
    "given, near",
    {
        "trian": "train", "Evaluate": "evaluate", "heading": "heading_marker_offset", "nonsense": "", "": "",
        "friction": "", "evaluation": "evaluate", "tarin": "train", "eval": "evaluate", "sensor": "joint_sensor_delay",
    }.items(),
)  # fmt: skip
def test_only_a_close_name_is_suggested(given, near):
    known = ["train", "evaluate", "heading_marker_offset", "joint_sensor_delay", "coulomb_friction", "viscous_friction"]
    assert closest_name(given, known) == near
    told, listed = str(UnknownName("thing", given, known)), console.OneOf(known)
    assert ("Did you mean" in told) == bool(near) and "joint_sensor_delay" in told
    if given not in known:
        with pytest.raises(argparse.ArgumentTypeError) as refused:
            listed(given)
        assert ("Did you mean" in str(refused.value)) == bool(near)
