"""Every command behaves: found, listed, with an example; each option has a text, its default, a range; bad input is one line."""

import argparse
import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from fishmj import cli
from fishmj.base import console
from fishmj.base.errors import ConfigError

ROOT = Path(__file__).resolve().parent.parent
GROUPS = {verb: main for verb in cli.present() if isinstance(main := cli.load(verb), console.CommandGroup)}
NUMBERS = (console.Number, console.Listed)
ELSEWHERE: tuple[str, ...] = ()


class Stop(Exception):
    """Carries the parser that a command was about to use."""


def parser_of(main) -> console.Parser:
    """The parser of a command: the one whose `parse_args` it calls first."""

    def caught(self, args=None, namespace=None):
        raise Stop(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console.Parser, "parse_args", caught)
        with pytest.raises(Stop) as stop:
            main([])
    return stop.value.args[0]


def leaves() -> dict[str, console.Parser]:
    """`gap find` -> its parser, of every command there is."""
    found = {}
    for verb in cli.present():
        if verb in GROUPS:
            found |= {f"{verb} {name}": parser_of(GROUPS[verb].load(name)) for name in GROUPS[verb].commands}
        else:
            found[verb] = parser_of(cli.load(verb))
    return found


LEAVES = leaves()
OURS = {name: parser for name, parser in LEAVES.items() if not name.startswith(ELSEWHERE)}
OPTIONS = [(name, action) for name, parser in LEAVES.items() for action in parser._actions if action.dest != "help"]


def takes_number(action: argparse.Action) -> bool:
    """Whether an option is a number or a list of numbers, by its type or its default."""
    kind, default = action.type, action.default
    item = kind.item if isinstance(kind, console.Listed) else kind
    first = default[0] if isinstance(default, list) and default else default
    return isinstance(item, console.Number) or item in (int, float) or (isinstance(first, int | float) and first is not False)


NUMERIC = [(name, a) for name, a in OPTIONS if name in OURS and a.option_strings and a.nargs != 0 and takes_number(a)]


def told(code_of) -> tuple[int, str, str]:
    """(exit code, standard output, standard error) of a call."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = code_of()
    return code, out.getvalue(), err.getvalue()


def refused(argv: list[str], parser: console.Parser | None = None) -> str:
    """The one line with which a bad command ends; exit code 2, nothing on standard output, no file made.

    With its parser, at hand already, the command itself is not called.
    """
    before = sorted(os.listdir())
    whole = lambda: cli.main(argv)
    parsed = lambda: console.run(lambda given: parser.parse_args(given) and 0, argv[len(parser.prog.split()) - 1 :])
    code, out, err = told(parsed if parser else whole)
    assert (code, out) == (console.BAD_INPUT, ""), (argv, code, out, err)
    assert err.startswith("fishmj: ") and err.count("\n") == 1 and len(err) < 1100 and "Traceback" not in err, err
    assert sorted(os.listdir()) == before, "nothing is made"
    return err


def needed(parser: console.Parser, but: argparse.Action | None = None) -> list[str]:
    """Arguments that a command cannot go without, so that what is wrong is the option under test."""
    words = []
    for action in parser._actions:
        if action.required and action.option_strings and action is not but:
            fitting = {"board": "9x6", "square": "0.02"}.get(action.dest, "x")
            words += [action.option_strings[-1], str(next(iter(action.choices))) if action.choices else fitting]
        elif not action.option_strings and action.nargs in (None, "+"):
            words += [str(next(iter(action.choices))) if action.choices else "x"]
    return words


@pytest.fixture(autouse=True)
def somewhere(tmp_path, monkeypatch):
    """A folder that holds something, so that what is made, or removed, shows."""
    (tmp_path / "kept.txt").write_text("")
    monkeypatch.chdir(tmp_path)


# --------------------------------------------------------------------------------------------------------- finding commands
def test_every_room_with_a_main_is_a_verb():
    rooms = {path.parent.name for path in (ROOT / "fishmj").glob("*/__main__.py")}
    assert rooms < set(cli.VERBS)
    assert all((ROOT / f"{module.replace('.', '/')}.py").is_file() for module in cli.VERBS.values())


def test_exit_codes_are_the_same_in_the_help_and_on_the_commands_page():
    rows = [f"| {code} | {meaning} |" for code, meaning in console.EXITS.items()]
    page = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    assert [row for row in rows if row not in page] == []
    assert all(f"{code:>3}  {meaning}" in cli.usage() for code, meaning in console.EXITS.items())
    assert {value for name, value in vars(console).items() if name.isupper() and type(value) is int and name in CODES} == set(
        console.EXITS
    )


CODES = ("OK", "FAILED_CHECK", "BAD_INPUT", "CANNOT_TELL", "FAULT", "HUNG_UP", "INTERRUPTED", "PIPE_CLOSED", "TERMINATED")


@pytest.mark.parametrize("verb", sorted(GROUPS))
def test_a_group_lists_its_commands_with_an_example_each(verb):
    bare = GROUPS[verb].bare
    for argv in ([verb, "--help"], [verb, "-h"]):
        got, out, err = told(lambda argv=argv: cli.main(argv))
        assert (got, err) == (0, "") and f"usage: fishmj {verb} {'[COMMAND]' if bare else 'COMMAND'} " in out
        for name, command in GROUPS[verb].commands.items():
            assert f"  {name} " in out and command.summary in out and command.example in out
    first = next(iter(GROUPS[verb].commands))
    assert f"Did you mean '{first}'" in refused([verb, first + "x"])
    if bare:
        assert bare in GROUPS[verb].commands and f"{verb} {bare}: unknown argument --nosuch" in refused([verb, "--nosuch"])
    else:
        assert "expected a command before '--out'" in refused([verb, "--out", "x"])
        nothing = refused([verb])
        assert all(name in nothing for name in GROUPS[verb].commands) and f"see fishmj {verb} --help" in nothing


def test_command_group_runs_its_default_command_if_none_is_given():
    called = []
    commands = {name: console.Command(lambda argv, name=name: called.append((name, argv)), name, name) for name in ("all", "fit")}
    group = console.CommandGroup("x", "x", commands, bare="all")
    for argv in ([], ["--out", "y"], ["fit", "--out", "y"], ["all", "z"]):
        group(argv)
    assert called == [("all", []), ("all", ["--out", "y"]), ("fit", ["--out", "y"]), ("all", ["z"])]
    assert "Did you mean 'fit'" in told(lambda: console.run(group, ["fti"]))[2]
    assert "Without a command: all." in group.usage()


@pytest.mark.parametrize("name", sorted(LEAVES))
def test_a_command_has_an_example_that_parses(name):
    text = LEAVES[name].format_help()
    lines = [line.strip() for line in text.partition("example")[2].splitlines()]
    examples = [re.split(r"\s{2,}", line)[0] for line in lines if line.startswith(f"fishmj {name}")]
    assert examples, text
    for example in examples:
        argv = shlex.split(example.removesuffix(" ..."))[1 + len(name.split()) :]
        with contextlib.suppress(SystemExit):
            LEAVES[name].parse_args(argv)


def test_examples_of_a_docstring_end_the_help():
    prose, examples = console.split_examples("`x`: a.\n\n    fishmj x 1   one\n             of two\n    fishmj x 2\n\nAfter.\n")
    assert prose == "`x`: a.\n\nAfter.\n"
    assert examples == "examples:\n  fishmj x 1   one\n           of two\n  fishmj x 2"
    assert console.split_examples("`fishmj x`: a.\n\n    y = 2") == ("`fishmj x`: a.\n\n    y = 2", "")


@pytest.mark.parametrize("name", sorted(f"{verb} {name}" for verb in GROUPS for name in GROUPS[verb].commands))
def test_help_ends_with_all_examples_of_the_module(name):
    verb, _, command = name.partition(" ")
    run = GROUPS[verb].commands[command].run
    _, examples = console.split_examples(sys.modules[run].__doc__ or "") if isinstance(run, str) else ("", "")
    assert LEAVES[name].format_help().rstrip().endswith(examples)


@pytest.mark.parametrize("name", sorted(LEAVES))
def test_help_is_exit_0_and_an_unknown_option_one_line(name):
    code, out, err = told(lambda: cli.main([*name.split(), "--help"]))
    assert (code, err) == (0, "") and out.startswith(f"usage: fishmj {name}")
    said = refused([*name.split(), *needed(LEAVES[name]), "--jsn"])
    assert "--jsn" in said and "did you mean --json?" in said


# ------------------------------------------------------------------------------------------------------------------ options
def label(row) -> str:
    return f"{row[0]} {'/'.join(row[1].option_strings) or row[1].dest}"


@pytest.mark.parametrize("row", [row for row in OPTIONS if row[0] in OURS], ids=label)
def test_an_option_has_a_text_and_shows_its_default(row):
    name, action = row
    assert action.help and len(action.help) > 3
    if action.nargs == 0:
        return
    shown = console.Help("x")._get_help_string(action)
    assert action.required or not action.option_strings or "default" in shown.lower() or "needed" in shown, shown
    assert not isinstance(action.type, type), f"{action.type}: take number, whole, text, path, out_file, out_folder"


@pytest.mark.parametrize("row", NUMERIC, ids=label)
def test_a_number_has_a_range_and_its_default_lies_in_it(row):
    _, action = row
    item = action.type.item if isinstance(action.type, console.Listed) else action.type
    assert isinstance(item, console.Number), "take console.number or console.whole"
    assert item.high < float("inf"), "the most that makes sense"
    values = action.default if isinstance(action.default, list) else [action.default]
    if isinstance(action.default, str):
        values = action.type(action.default)
        values = values if isinstance(values, list) else [values]
    assert all(value is None or item(str(value)) == value for value in values)


@pytest.mark.parametrize("row", NUMERIC, ids=label)
def test_what_is_no_number_of_the_range_is_one_line(row):
    name, action = row
    for bad in ("nan", "inf", "-inf", "-1e99", "1e99", "abc", "", " ", "1,", "9" * 5000, "0x10", "1 2"):
        values = [bad] * (action.nargs if isinstance(action.nargs, int) else 1)
        argv = [*name.split(), *needed(LEAVES[name], action), action.option_strings[-1], *values]
        said = refused(argv, None if bad == "nan" else LEAVES[name])
        assert action.option_strings[-1] in said and ("expected" in said), said


TEXTS = {console.text, console.path, console.name, console.out_file, console.out_folder, console.device, console.devices}


@pytest.mark.parametrize("row", [r for r in OPTIONS if r[0] in OURS and r[1].type in TEXTS and r[1].option_strings], ids=label)
def test_an_empty_name_is_refused(row):
    name, action = row
    for empty in ("", "  "):
        said = refused([*name.split(), *needed(LEAVES[name], action), action.option_strings[-1], empty], LEAVES[name])
        assert action.option_strings[-1] in said


@pytest.mark.parametrize(
    "row", [r for r in OPTIONS if r[0] in OURS and r[1].type in (console.out_file, console.out_folder)], ids=label
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(row):
    name, action = row
    Path("file").write_text("")
    words = [*name.split(), *needed(LEAVES[name], action)]
    wrong = ["file/below", "n" * 300, "/proc/none/below" if action.type is None else "file/a/b"]
    wrong.append("file" if action.type is console.out_folder else ".")
    for bad in wrong:
        refused([*words, action.option_strings[0], bad], LEAVES[name])


@pytest.mark.parametrize("row", [r for r in OPTIONS if r[1].choices and r[1].option_strings], ids=label)
def test_a_choice_gets_its_nearest_name(row):
    name, action = row
    right = str(next(iter(action.choices)))
    if len(right) > 3:
        said = refused([*name.split(), *needed(LEAVES[name], action), action.option_strings[-1], right + "x"], LEAVES[name])
        assert "Did you mean" in said and "Known: " in said


@pytest.mark.parametrize("row", [r for r in OPTIONS if isinstance(r[1].type, console.Listed) and r[0] in OURS], ids=label)
def test_a_list_has_no_value_twice_and_none_missing(row):
    name, action = row
    words = [*name.split(), *needed(LEAVES[name], action), action.option_strings[-1]]
    refused([*words, ","], LEAVES[name])
    refused([*words, ",".join("1" * 2000)], LEAVES[name])
    if action.type.distinct:
        known = getattr(action.type.item, "known", ("1",))
        assert "twice" in refused([*words, f"{known[0]},{known[0]}"], LEAVES[name])


# ---------------------------------------------------------------------------------------------------------------- bad lines
BAD = """
replay none --at nan | --at
evaluate pd --repeats 1000000000 | --repeats
evaluate pd --speeds 1e9 | --speeds
evaluate pd --speeds nan | --speeds
evaluate pd --speeds "" | --speeds
evaluate pd --speeds 0.1,0.1 | twice
evaluate pd --los 0,,45 | --los
evaluate pd pd | twice
evaluate pd --los -45,315 | -45 and 315 are the same
evaluate pd –speeds 0.2 | typographic dash; did you mean --speeds
evaluate pd —speed=0.2 | did you mean --speeds
evaluate pd −−speeds 0.2 | did you mean --speeds
replay none --out a.html --out b.html | --out: is given twice
evaluate pd --seed 1 --seed=2 | --seed: is given twice
evaluate pd --water hony | Known
evaluate pd --plots | --out
evaluate pd --robot fsh | Did you mean 'fish'
evaluate drit | Did you mean 'drift'
evaluate pd --speeds 0,0.01,0.02,0.03,0.04 --repeats 1000 --duration 600 --los 0,1,2,3,4,5,6,7,8,9,10 | GB of memory
train --reward wG=nan | expected
train --reward wG | expected
train --reward wGG=1 | Did you mean 'wG'
train --reward wG=1 wG=2 | twice
train --steps -1 | --steps
train --steps 1e12 | --steps
train --seeds a,b | --seeds
train --seeds 0,0 | twice
train --hidden 0 | --hidden
train --hidden 64,x | --hidden
train --hide taget | Did you mean 'target'
train --preset quik | Did you mean 'quick'
train --randomise-effects , | --randomise-effects
train --preset quick --out . --force | no training run
play --speed nan | --speed
play --controller drit | Did you mean 'drift'
play --host 192.0.2.1 | cannot listen
bench engine_plana --quick | Did you mean 'engine_planar'
bench engine_planar engine_planar | twice
effects comand_latency | Did you mean 'command_latency'
calibrate servo --data none | none
calibrate slip --ratios 0,2 | --ratios
calibrate mass --data none | none
calibrate check --robots 0 | --robots
calibrate score --data none | none
hydro_fit fit --slip 2 | --slip
hydro_fit fit --swims -5 | --swims
hydro_fit fit --name a/b | --name
hydro_fit fit --data none | none
hydro_fit check --fish none.toml | none.toml
hydro_fit ablation --seeds x | --seeds
hydro_fit collect --scale 0 | --scale
hydro_fit collect --tanks 0 | --tanks
hydro_fit collect --preview --fresh-test 1 | two plans
hydro_fit collect --device cdua | Did you mean 'cuda'
hydro_fit hybrid --seconds 1 | --seconds
hydro_fit correct | POLICY
hydro_fit correct pd --rounds 0 | --rounds
hydro_fit rank --trials 73 | --trials
hydro_fit rank --again 4 | --again
lbm_oracle cases poisseuille | Did you mean 'poiseuille'
lbm_oracle converge fsh | unknown argument fsh
lbm_oracle converge fish --what dragg | Did you mean 'drag'
lbm_oracle converge fish --grids 0.02 0.02 | twice
lbm_oracle speeds --frequencies 0 | --frequencies
lbm_oracle speeds --slips 1 1 | twice
lbm_oracle swim --preset latop | Did you mean 'laptop'
lbm_oracle swim --kernel 5 | --kernel
lbm_oracle swim --slice top | mid
lbm_oracle swim --slice nan | mid
lbm_oracle swim --pose 0 0 | --pose
lbm_oracle swim --pose 0 0 nan | --pose
lbm_oracle swim --out . | --overwrite
lbm_oracle forcemap --speeds 0 | --speeds
lbm_oracle forcemap --angles 10 10 | twice
lbm_oracle drift --n 0 | --n
lbm_oracle drift --water honey | Known
campaign hidden --sets 0 | --sets
campaign hidden --effects nosuch --dry-run | nosuch
campaign hidden_trials --water secnd | Did you mean 'second'
gap plant | --out
gap plant --out a | EFFECT
gap plant none --flow 1 | SPEED,DIRECTION
gap plant none --flow nan,0 | --flow
gap plant none --generator foil --medium air --out a | --medium and --flow are not for
gap plant coulomb_friction=nan --out a --truth b | finite
gap plant nosuch --out a --truth b | nosuch
gap plant none --excitations nosuch --out a --truth b | nosuch
gap plant none --out a --truth a/b | inside
log check none | none
log chek none | Did you mean 'check'
gap fnd logs | Did you mean 'find'
demo --seed -1 | --seed
demo --smoke --out /dev/null | is a file
doctor extra | unknown argument extra
nosuch | Known
"" | Known
"""
LINES = [tuple(part.strip() for part in line.rsplit("|", 1)) for line in BAD.strip().splitlines()]


@pytest.mark.parametrize(("line", "said"), LINES)
def test_a_bad_command_is_one_clear_line(line, said):
    argv = shlex.split(line)
    err = refused(argv)
    assert said in err, err
    code, out, _ = told(lambda: cli.main([*argv, "--json"]))
    if code == console.BAD_INPUT and "unknown argument --json" not in _:
        last = json.loads(out.strip().splitlines()[-1])
        assert last["exit"] == 2 and last["error"] and last["kind"]


TEXTS_OF_ALL_KINDS = ("a\0b", "\x1b[31mred", "é" * 3000, "a" * 5000, "..", "/", "~nobody/x", "-x", "--", "\udcff", "a\nb", "?*")
TAKE_A_NAME = ("replay", "log check", "evaluate", "effects", "hydro_fit correct", "bench", "", "gap", "lbm_oracle cases")


@pytest.mark.parametrize("bad", TEXTS_OF_ALL_KINDS, ids=range(len(TEXTS_OF_ALL_KINDS)))
@pytest.mark.parametrize("line", TAKE_A_NAME)
def test_any_text_for_a_name_is_one_line(bad, line):
    if bad == "--" and line in ("bench", "effects", "lbm_oracle cases"):
        pytest.skip("no name is needed: all of them")
    if bad in ("..", "/") and line == "log check":
        pytest.skip("a folder that can be checked, and fails")
    refused([*line.split(), bad])


@pytest.mark.parametrize("option", ["--robot", "--water", "--out"])
@pytest.mark.parametrize("bad", ["a\0b", "b" * 5000, "é" * 300, "\udcff/x.toml", "x.toml", ".", "/"])
def test_any_text_for_a_file_is_one_line_or_is_taken(option, bad):
    if option == "--out" and bad in ("x.toml", ".", "/", "\udcff/x.toml"):
        pytest.skip("a place to write")
    refused(["evaluate", "drift", option, bad, "--duration", "1", "--repeats", "1"])


# ------------------------------------------------------------------------------------------------- what the machine refuses
def failing(error):
    def main(argv):
        raise error

    return main


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PermissionError(13, "Permission denied", "/etc/shadow"), "'/etc/shadow': Permission denied"),
        (OSError(36, "File name too long", "n" * 5000), "File name too long"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (MemoryError(), "not enough memory"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes"), "not enough memory"),
        (ModuleNotFoundError("No module named 'numpy'", name="numpy"), f"{sys.executable} has no module numpy"),
        (argparse.ArgumentTypeError("out: is a file"), "out: is a file"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
def test_what_the_machine_refuses_is_one_line_and_no_fault_of_ours(error, said):
    code, out, err = told(lambda: console.run(failing(error), ["--json"]))
    assert code == console.BAD_INPUT and said in err and err.count("\n") == 1 and len(err) < 1100
    assert json.loads(out)["exit"] == 2


def test_an_error_of_the_system_without_a_file_stays_a_fault():
    code, _, err = told(lambda: console.run(failing(OSError(111, "Connection refused")), []))
    assert code == console.FAULT and "Traceback" in err


def test_the_environment_asks_for_the_traceback_of_an_error(monkeypatch):
    monkeypatch.setenv(console.TRACEBACK, "1")
    code, _, err = told(lambda: console.run(failing(ConfigError("no")), []))
    assert code == console.BAD_INPUT and "Traceback" in err and err.endswith("fishmj: no\n")


def test_a_name_that_the_terminal_cannot_show_is_escaped():
    """Bytes of a name that are no text (lone surrogates) are escaped in warnings and errors; `say` leaves them out."""
    code = (
        "import sys; from fishmj.base.console import run, say, warn;"
        "sys.exit(run(lambda argv: say('swim é') or warn(argv[0]), ['\\udcff é']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env={**os.environ, "PYTHONIOENCODING": "ascii"}
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "swim \\xe9\n", "fishmj: \\udcff \\xe9\n")


def test_the_module_and_the_script_refuse_alike():
    for program in (["-m", "fishmj", "effects"], ["-m", "fishmj.effects"]):
        done = subprocess.run(
            [sys.executable, *program, "--jsn", "--json"], capture_output=True, text=True, check=False, cwd=ROOT
        )
        assert done.returncode == 2 and json.loads(done.stdout)["kind"] == "UsageError" and done.stderr.count("\n") == 1


# -------------------------------------------------------------------------------------------------------- types of options
def test_a_path_may_begin_with_a_tilde(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert console.path("~/a b é") == tmp_path / "a b é" == console.out_file("~/a b é")
    assert console.text("~/x.toml") == str(tmp_path / "x.toml") and console.text("fish") == "fish"


def test_a_path_with_a_leading_dash_goes_after_two():
    parser = console.parser("x", "x")
    parser.add_argument("place", type=console.path)
    assert parser.parse_args(["--", "-odd"]).place == Path("-odd")


def test_a_negative_number_in_any_spelling_is_a_value():
    parser = console.parser("x", "x")
    parser.add_argument("--turn", type=console.number(-5, 5))
    assert [parser.parse_args(["--turn", text]).turn for text in ("-1", "-1e-3", "-.5", "-2.")] == [-1, -1e-3, -0.5, -2]
    for text in ("-1e99", "-inf", "-nan"):
        with pytest.raises(console.UsageError, match="expected a number from -5 to 5"):
            parser.parse_args(["--turn", text])


def test_a_default_of_zero_or_of_a_list_is_shown():
    parser = console.parser("x", "x")
    parser.add_argument("--seed", type=console.SEED, default=0, help="of 100 % of the draws".replace("%", "%%"))
    parser.add_argument("--sizes", type=console.number(0, 9), nargs="+", default=[1.0, 2.5], help="in m")
    parser.add_argument("--own", type=console.number(0, 9), help="default the robot's")
    text = " ".join(parser.format_help().split())
    assert "of 100 % of the draws (default: 0)" in text and "in m (default: 1.0 2.5)" in text and text.count("default") == 3
