"""`fishmj new`: answers and tables of sections become descriptions that read back; what cannot be is refused in one line.

All fish here are synthetic.
"""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from describing import FIVE, new, refused, sized
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj import cli, control
from fishmj.base import console
from fishmj.base.errors import ConfigError, DescriptionError, FishmjError
from fishmj.mjcf import geometry_of, load_robot
from fishmj.mjcf.new import __main__ as verb
from fishmj.mjcf.new.answers import QUESTIONS
from fishmj.mjcf.new.fish_toml import FishAnswers, toml_of
from fishmj.mjcf.new.shape import cut, joints_of, read_sections, typical
from fishmj.mjcf.priors import water_prior
from fishmj.mjcf.reading import robot_from_dict
from fishmj.mjcf.servos import SHELF
from fishmj.sim import Sim


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_options_make_a_description_that_reads_back_and_swims(capsys, tmp_path):
    assert new("pike", *FIVE, "--json") == console.OK
    out = capsys.readouterr().out
    told = json.loads(out.splitlines()[-1])
    robot = load_robot("pike.toml")
    assert (robot.name, len(robot.links), robot.length, robot.mass) == ("pike", 5, pytest.approx(0.6), pytest.approx(1.6))
    assert told["passed"] and told["speed"] == pytest.approx(0.3817, rel=0.01)  # at 60 s
    assert {c["verdict"] for c in told["checks"]} == {"ok"}
    assert robot.servo == load_robot("fish").servo or robot.servo == replace(load_robot("fish").servo, idle_power=1.7)
    assert (tmp_path / "pike.png").read_bytes()[:4] == b"\x89PNG"
    assert "fishmj train --preset quick --robot pike.toml" in out
    assert "--robot 'my pike.toml' --repeats 1" in verb.next_steps(Path("my pike.toml"), "pike")[3]
    text = (tmp_path / "pike.toml").read_text()
    assert "height 0.11 m: given on the command line" in text and "mass_total = 1.6 " in text
    assert "m from the nose: typical for this number of links, not measured" in text  # --links 5 says no place


def test_an_edited_description_gets_the_same_checks_and_nothing_is_written(capsys, tmp_path):
    assert new("pike", *FIVE, "--json") == console.OK
    fresh = json.loads(capsys.readouterr().out.splitlines()[-1])
    text = (tmp_path / "pike.toml").read_text()
    files = sorted(tmp_path.iterdir())
    assert new("--check", "pike.toml", "--json") == console.OK
    again = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert again["checks"] == fresh["checks"] and again["passed"] and again["description"] == "pike.toml"
    weak = re.sub(r"(\[servo\][^[]*?\ntorque\w* = )[\d.]+", r"\g<1>0.3", text)
    assert weak != text
    (tmp_path / "pike.toml").write_text(weak)
    new("--check", "pike.toml")
    row = next(line for line in capsys.readouterr().out.splitlines() if "joint torque" in line)
    assert " ok " not in row
    assert "leave them out" in refused(capsys, "pike", "--check", "pike.toml", "--yes")
    assert "no such file" in refused(capsys, "--check", "perch.toml")
    assert sorted(tmp_path.iterdir()) == files


def test_fish_that_options_describe_weigh_what_they_displace_and_lie_level():
    for links in (2, 10):
        assert new("pike", *sized(links=str(links)), "--force") == console.OK
        robot = load_robot("pike.toml")
        g = geometry_of(robot)
        assert len(robot.links) == links and 0.9 < g.width_scale < 1.1
        assert np.abs(g.mass - g.displaced).max() < 1e-5
        assert abs(np.sum(g.displaced * (g.origin + g.buoyancy))) < 1e-5  # kg m: mass and buoyancy in one place
        assert [len(robot.water[key]) for key in ("k", "cn")] == [links, links]


def test_a_fish_of_one_joint_keeps_its_thrust(capsys):
    """It has no wave, so its tail is beyond a wing's stall at every beat; the speed fell from 0.05 m/s to a fiftieth."""
    assert new("pike", *sized(links="2")) == console.OK
    said = re.search(r"swims ahead +\| ([\d.]+) m/s, [\d.]+ lengths/s steady at", capsys.readouterr().out)
    assert said and float(said[1]) > 0.1


def test_answers_are_asked_until_they_are_valid(monkeypatch, capsys):
    lines = iter(["pike", "six", "60 cm", "0.11", "", "0.14", "1e9", "1600g", "0.24, 0.30,0.4", "nothing", "lx-824"])
    asked = []
    at_a_terminal(monkeypatch, lambda prompt: asked.append(prompt) or next(lines))
    assert new() == console.OK
    robot = load_robot("pike.toml")
    assert len(asked) == 11 and len(QUESTIONS) == 8
    assert np.cumsum([link.length for link in robot.links]).tolist() == pytest.approx([0.24, 0.30, 0.4, 0.6])
    assert "expected 0.05 to 5 m" in asked[2] and "unknown servo 'nothing'" in asked[10]
    assert "Or state its data sheet with --stall-torque, --no-load-speed, --voltage" in asked[10]
    text = open("pike.toml").read()
    assert "length 0.6 m: asked" in text and "width 0.0726 m: default, not measured" in text
    assert "joints 0.24, 0.3, 0.4 m from the nose: asked" in text


def test_a_mass_that_the_hull_cannot_float_names_the_sizes_to_measure(capsys):
    assert new("tuna", "--length=35cm", "--mass=900g", "--links=3", "--yes") == console.BAD_INPUT
    said = capsys.readouterr().err
    assert "--mass: got '900g'" in said and "0.35 x 0.063 x 0.0416 m (length, height, width)" in said
    assert "measure the sizes that you did not give" in said


def at_a_terminal(monkeypatch, answer):
    terminal = SimpleNamespace(isatty=lambda: True)
    monkeypatch.setattr(verb, "sys", SimpleNamespace(stdin=terminal, stdout=terminal))
    monkeypatch.setattr("builtins.input", answer)


@pytest.mark.parametrize(("stop", "code"), [(EOFError, console.BAD_INPUT), (KeyboardInterrupt, console.INTERRUPTED)])
def test_a_session_that_ends_early_writes_nothing(monkeypatch, capsys, tmp_path, stop, code):
    def answer(prompt):
        if "Mass" in prompt:
            raise stop
        return ""

    at_a_terminal(monkeypatch, answer)
    assert new() == code
    assert capsys.readouterr().err.count("\n") == 1 and not list(tmp_path.iterdir())


def test_without_a_terminal_every_missing_option_is_named(capsys):
    said = refused(capsys, "pike", "--length", "0.6", "--links", "5")
    for option in ("--height", "--width", "--tail-height", "--mass", "--servo", "--yes"):
        assert option in said
    assert "--length" not in said and "--links" not in said


NUMERIC = (
    "--length --height --width --tail-height --mass --links --joints --head --side-fin --scale --width-ratio --stall-torque"
    " --no-load-speed --voltage --stall-current"
).split()


@pytest.mark.parametrize("option", NUMERIC)
@pytest.mark.parametrize("value", ["nan", "inf", "-1", "1e9", "text", "", "0.6 stone", "1" * 300])
def test_bad_numbers_are_refused_with_their_option(capsys, option, value):
    said = refused(capsys, "pike", "--yes", f"--photo={'p.png'}" if option == "--scale" else "--yes", f"{option}={value}")
    assert option.removeprefix("--") in said and len(said) < 500


def test_every_numeric_option_is_among_those_tried():
    skipped = {"--help", "--json", "--out", "--force", "--yes", "--servo", "--sections", "--unit", "--photo", "--nose", "--check"}
    assert {o for action in verb.options()._actions for o in action.option_strings if o.startswith("--")} - skipped == set(
        NUMERIC
    )


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["a/b", "--yes"], "for example 'a_b'"),
        (["swift", "--yes"], "shipped fish"),
        (["pike", "--yes", "--height=60"], "0.018 to 0.36 m"),
        (["pike", "--yes", "--mass=0.1"], "--mass"),
        (["pike", "--yes", "--links=5", "--joints=0.3,0.4"], "not both"),
        (["pike", "--yes", "--joints=0.3,0.2"], "rise from the nose"),
        (["pike", "--yes", "--joints=0.3,0.301"], "0.012 m or more"),
        (["pike", "--yes", "--servo=lx824"], "Did you mean 'lx-824'"),
        (["pike", "--yes", "--servo=missing.toml"], "no such file"),
        (["pike", "--yes", "--stall-torque=17kgcm"], "--no-load-speed, --voltage"),
        (["pike", "--yes", "--out=pike.txt"], "ends in .toml"),
        (["pike", "--yes", "--lenght=1"], "did you mean --length?"),
        (["pike", "--yes", "--scale=0.001"], "goes with --photo"),
    ],
)
def test_what_does_not_go_together_is_refused_with_the_reason(capsys, arguments, reason):
    assert reason in refused(capsys, *arguments)


def test_a_description_that_is_there_is_kept(capsys, tmp_path):
    (tmp_path / "pike.png").write_bytes(b"mine")
    assert "--force" in refused(capsys, "pike", *FIVE)
    assert (tmp_path / "pike.png").read_bytes() == b"mine"
    assert new("pike", *FIVE, "--force") == console.OK and load_robot("pike.toml").name == "pike"


def test_a_hull_that_cannot_float_its_mass_is_marked(capsys):
    assert new("heavy", *sized(mass="3.0"), "--json") == console.OK
    said = capsys.readouterr()
    assert said.err.count("to float") == 1 and said.err.startswith("fishmj: heavy.toml [[link]] mass")
    told = json.loads(said.out.splitlines()[-1])
    check = next(c for c in told["checks"] if c["what"] == "width scale")
    assert (check["verdict"], check["advice"]) == ("look", "") and "\nwidth scale:" not in said.out


def test_a_servo_that_cannot_move_the_fish_fails_the_check(capsys):
    assert new("pike", *sized(length="2", mass="60", height="0.4", width="0.25", tail_height="0.5", servo="xl330-m288")) == 1
    assert "wrong" in capsys.readouterr().out and load_robot("pike.toml").name == "pike"


def test_the_head_has_the_share_that_was_asked_for():
    assert (
        joints_of(1.0, 2) == [0.6] and joints_of(1.0, 2, 0.5) == [0.5] and joints_of(1.0, 4) == pytest.approx([0.4, 0.54, 0.68])
    )
    for head in (0.1, 0.4, 0.8):
        for links in range(2, 11):
            assert cut(typical(1.0, 0.2, 0.1, 0.2), joints_of(1.0, links, head))[0].length == pytest.approx(head)


# tables of sections


def table(path, unit=1000.0, header="x [mm];height [mm];width [mm]", split=";"):
    rows = typical(0.535, 0.094, 0.062, 0.12).rows * unit
    path.write_text("\n".join([header, *(split.join(f"{v:.5f}" for v in row) for row in rows)]))
    return rows / unit


@pytest.mark.parametrize(
    ("unit", "header", "split", "options"),
    [
        (1000.0, "x [mm];height [mm];width [mm]", ";", []),
        (100.0, "x,height,width", ",", ["--unit", "cm"]),
        (1.0, "Height,X,width_m", ",", []),
    ],
)
def test_a_table_of_sections_is_cut_at_the_joints(tmp_path, unit, header, split, options):
    rows = table(tmp_path / "t.csv", unit, header, split)
    if header.startswith("Height"):
        lines = (tmp_path / "t.csv").read_text().splitlines()
        swapped = [",".join([(c := line.split(","))[1], c[0], c[2]]) for line in lines[1:]]
        (tmp_path / "t.csv").write_text("\n".join([lines[0], *swapped]))
    arguments = ["--joints=0.215,0.285,0.355", "--mass=1.1", "--servo=lx-824"]
    assert new("pike", "--sections=t.csv", *options, *arguments) == console.OK
    robot = load_robot("pike.toml")
    assert [link.length for link in robot.links] == pytest.approx([0.215, 0.07, 0.07, 0.18])
    starts = np.cumsum([0, *(link.length for link in robot.links)])
    for link, start in zip(robot.links, starts, strict=False):
        s, h, w = np.array(link.sections).T
        assert np.allclose(h, np.interp(start + s, rows[:, 0], rows[:, 1]), atol=2e-5)
        assert np.allclose(w, np.interp(start + s, rows[:, 0], rows[:, 2]), atol=2e-5)
    assert starts[3] + robot.links[3].fin_from == pytest.approx(0.765 * 0.535, abs=1e-4)  # where the outline is lowest
    assert robot.water["k"] == [0.9, 0.9, 0.9, 0.8] and robot.water["cn"] == [1.2, 1.2, 1.2, 2.0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", ":1: no column x, height, width"),
        ("x,height\n0,1\n", "no column width"),
        ("x,height,width\n0,0.1,0.1\n0.2,0.1,0.1\n", "2 rows"),
        ("x,height,width\n0,0.1,0.1\n0.2,0.1,0.1\n0.1,0.1,0.1\n", ":4: x = 0.1 m: x must begin with 0"),
        ("x,height,width\n0.1,0.1,0.1\n0.2,0.1,0.1\n0.3,0.1,0.1\n", ":2: x = 0.1 m"),
        ("x,height,width\n0,0.1,0.1\n0.2,nan,0.1\n0.3,0.1,0.1\n", ":3: height = 'nan'"),
        ("x,height,width\n0,0.1,0.1\n0.2,0.1\n0.3,0.1,0.1\n", ":3: width = ''"),
        ("x,height,width\n0,0.1,0.1\n0.2,-1,0.1\n0.3,0.1,0.1\n", ":3: height = '-1'"),
        ("x,height,width\n0,0.1,0.1\n200,0.1,0.1\n300,0.1,0.1\n", "--unit mm"),
        ("x,height,width\n0,0.1,0.1\n0.2,5,0.1\n0.3,0.1,0.1\n", "the same unit"),
        ("x [furlong],height,width\n0,1,1\n", "unit 'furlong'"),
        ('x,height,width\n0,"0.1,0.1\n0.2,0.1,0.1\n', "not a CSV table"),
    ],
)
def test_a_bad_table_is_refused_with_its_line(tmp_path, capsys, text, reason):
    (tmp_path / "t.csv").write_text(text)
    said = refused(capsys, "pike", "--yes", "--sections=t.csv")
    assert "t.csv" in said and reason in said


def test_files_that_are_no_tables_are_refused(tmp_path, capsys):
    (tmp_path / "t.csv").write_bytes(b"\xff\xfe\x00\x01")
    assert "not a text file" in refused(capsys, "pike", "--yes", "--sections=t.csv")
    assert "cannot be read" in refused(capsys, "pike", "--yes", "--sections=absent.csv")
    (tmp_path / "t.csv").write_bytes(b"x" * 1_100_000)
    assert "at most" in refused(capsys, "pike", "--yes", "--sections=t.csv")


def test_a_file_name_stays_a_comment(tmp_path):
    """A name with a line break would otherwise write into the description."""
    name = 'a\nname = "evil"\n.csv'
    table(tmp_path / name)
    assert new("pike", f"--sections={name}", "--mass=1.1", "--links=4", "--servo=lx-824") == console.OK
    assert load_robot("pike.toml").name == "pike" and "table of sections a_name_evil_.csv" in (tmp_path / "pike.toml").read_text()


@settings(max_examples=40, deadline=None)
@given(
    rows=st.lists(st.tuples(*[st.floats(1e-9, 0.2)] * 3), min_size=1, max_size=12),
    links=st.integers(2, 10),
    shift=st.floats(-0.05, 0.05),
)
def test_whatever_a_table_holds_is_a_description_or_one_error(tmp_path_factory, rows, links, shift):
    """Random steps, heights and widths; the links read back with stations that rise, or the table is refused."""
    folder = tmp_path_factory.mktemp("table")
    x = np.cumsum([0.0, *(row[0] for row in rows)])
    lines = [f"{a!r},{h!r},{w!r}" for a, (_, h, w) in zip(x.tolist(), [rows[0], *rows], strict=True)]
    (folder / "t.csv").write_text("\n".join(["x,height,width", *lines]))
    try:
        outline = read_sections(folder / "t.csv")
        made = cut(outline, [a + shift for a in joints_of(outline.length, links)])
        fish = FishAnswers(
            name="pike", outline=outline, mass=1.0, joints=[0.1] * (links - 1), sheet=SHELF["lx-824"], side_span=0.0, origin={}
        )
        text = toml_of(replace(load_robot("fish"), links=made, fins=(), water=water_prior(made)), fish)
        back = robot_from_dict(tomllib.loads(text.replace("mass_total = ", "# ")), "t.toml")
    except ConfigError as error:
        assert "\n" not in str(error) or isinstance(error, DescriptionError)
        return
    assert [link.sections for link in back.links] == [link.sections for link in made]
    assert all((np.diff([row[0] for row in link.sections]) > 0).all() for link in back.links)


def test_a_data_sheet_gives_the_servo_by_options_and_by_file(tmp_path, capsys):
    sheet = ["--stall-torque=20 kg cm", "--no-load-speed=0.16s/60deg", "--voltage=7.4V", "--stall-current=3A"]
    rest = [a for a in FIVE if not a.startswith("--servo")]
    assert new("pike", *rest, *sheet) == console.OK
    (tmp_path / "s.toml").write_text(
        'name = "strong"\nstall_torque = "20 kg cm"\nno_load_speed = "0.16 s/60deg"\nvoltage = 7.4\nstall_current = 3\n'
    )
    assert new("roach", *rest, "--servo=s.toml") == console.OK
    a, b = load_robot("pike.toml").servo, load_robot("roach.toml").servo
    assert a == b and a.torque == 1.961 and a.speed_no_load == 6.545
    (tmp_path / "s.toml").write_text('stall_torque = "20 stone"\nno_load_speed = "0.16 s/60deg"\nvoltage = 7.4\n')
    assert "s.toml: stall_torque: got '20 stone'" in refused(capsys, "tench", *rest, "--servo=s.toml")
    bare = ["--stall-torque=5.2", *sheet[1:]]
    assert "got '5.2', expected 0.005 to 300 N m, with its unit (units: nm," in refused(capsys, "tench", *rest, *bare)


def test_the_torque_at_the_joint_is_told_from_the_drive_and_from_the_stall_torque(capsys):
    assert new("pike", *(a for a in FIVE if not a.startswith("--servo")), "--servo=xw540-t260", "--json") == console.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (told["stall_torque"], told["voltage"]) == (9.5, 12.0)
    assert 0 < told["torque"] < 0.2 * told["drive"], "a slow servo's drive is mostly back-EMF, which the joint does not hold"
    row = next(c for c in told["checks"] if c["what"] == "joint torque as it swims")
    assert re.fullmatch(r"0\.\d+ N m, drive \d+ % of 9\.5 N m stall at 12 V", row["found"]), row


# a fish of five links elsewhere


def test_controllers_serve_five_links_and_what_cannot_says_so():
    assert new("pike", *FIVE) == console.OK
    robot = load_robot("pike.toml")
    for name in control.NAMES:
        brain = control.make(name, robot)
        brain.reset(1)
        getattr(brain, "set_flow", lambda flow: None)(np.zeros((1, 2)))
        assert brain(np.full((1, 13), 0.1)).shape == (1, 10, 4)
    with pytest.raises(FishmjError, match="pike has 4 joints"):
        Sim(robot).step(np.zeros(3))


def test_the_verb_is_found_by_the_command_line():
    assert "new" in cli.present()
