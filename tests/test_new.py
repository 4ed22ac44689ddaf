"""`fishmj new`: answers, tables of sections and photos become descriptions that read back; what cannot be is refused in one line.

All fish and pictures here are synthetic.
"""

import json
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj import cli, console, controllers
from fishmj.errors import ConfigError, DescriptionError, FishmjError
from fishmj.mjcf import geometry_of, load_robot
from fishmj.mjcf.description import Link, robot_from_dict
from fishmj.mjcf.drawing import PALETTE, colour_of, drawn_sections
from fishmj.mjcf.outline import loft
from fishmj.mjcf.priors import balanced, displaced, plate_share, water_prior
from fishmj.mjcf.servos import SHELF, gear_efficiency, servo_from_sheet, sheet_of
from fishmj.mjcf.skin import skin
from fishmj.new import __main__ as verb
from fishmj.new.answers import QUESTIONS
from fishmj.new.describe import Fish, toml_of
from fishmj.new.quantity import quantity
from fishmj.new.shape import cut, joints_of, typical
from fishmj.new.table import read_sections
from fishmj.sim import Sim

cv2 = pytest.importorskip("cv2")
SIZES = dict(length="0.6", height="0.11", width="0.07", tail_height="0.14", mass="1.6", links="5", servo="lx-824")
FIVE = [f"--{key.replace('_', '-')}={value}" for key, value in SIZES.items()]


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def new(*arguments: str) -> int:
    return console.run(verb.main, list(arguments))


def refused(capsys, *arguments: str) -> str:
    """The one line of an error that writes nothing."""
    from pathlib import Path

    before = sorted(Path().rglob("*"))
    assert new(*arguments) == console.BAD_INPUT
    said = capsys.readouterr()
    assert said.err.startswith("fishmj: ") and said.err.count("\n") == 1 and "Traceback" not in said.err
    assert sorted(Path().rglob("*")) == before
    return said.err


def test_options_make_a_description_that_reads_back_and_swims(capsys, tmp_path):
    assert new("pike", *FIVE, "--json") == console.OK
    out = capsys.readouterr().out
    told = json.loads(out.splitlines()[-1])
    robot = load_robot("pike.toml")
    assert (robot.name, len(robot.links), robot.length, robot.mass) == ("pike", 5, pytest.approx(0.6), pytest.approx(1.6))
    assert told["passed"] and told["speed"] > 0.2 and {c["verdict"] for c in told["checks"]} == {"ok"}
    assert robot.servo == load_robot("fish").servo or robot.servo == replace(load_robot("fish").servo, idle_power=1.7)
    assert (tmp_path / "pike.png").read_bytes()[:4] == b"\x89PNG"
    assert "fishmj train --preset quick --robot pike.toml" in out
    text = (tmp_path / "pike.toml").read_text()
    assert "height 0.11 m: given on the command line" in text and "mass_total = 1.6 " in text


def test_fish_that_options_describe_weigh_what_they_displace_and_lie_level():
    for links in (2, 10):
        assert new("pike", *FIVE, f"--links={links}", "--force") == console.OK
        robot = load_robot("pike.toml")
        g = geometry_of(robot)
        assert len(robot.links) == links and 0.9 < g.width_scale < 1.1
        assert np.abs(g.mass - g.displaced).max() < 1e-5
        assert abs(np.sum(g.displaced * (g.origin + g.buoyancy))) < 1e-5  # kg m: mass and buoyancy in one place
        assert [len(robot.water[key]) for key in ("k", "cn")] == [links, links]


def test_answers_are_asked_until_they_are_valid(monkeypatch, capsys):
    lines = iter(["pike", "six", "60 cm", "0.11", "", "0.14", "1e9", "1600g", "0.24, 0.30,0.4", "nothing", "lx-824"])
    asked = []
    at_a_terminal(monkeypatch, lambda prompt: asked.append(prompt) or next(lines))
    assert new() == console.OK
    robot = load_robot("pike.toml")
    assert len(asked) == 11 and len(QUESTIONS) == 8
    assert np.cumsum([link.length for link in robot.links]).tolist() == pytest.approx([0.24, 0.30, 0.4, 0.6])
    assert "expected 0.05 to 5 m" in asked[2] and "unknown servo 'nothing'" in asked[10]
    text = open("pike.toml").read()
    assert "length 0.6 m: asked" in text and "width 0.0726 m: default, not measured" in text


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
    skipped = {"--help", "--json", "--out", "--force", "--yes", "--servo", "--sections", "--unit", "--photo", "--nose"}
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
    assert new("pike", *FIVE, "--mass=3.0", "--json") == console.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert next(c for c in told["checks"] if c["what"] == "width scale")["verdict"] == "look"


def test_a_servo_that_cannot_move_the_fish_fails_the_check(capsys):
    assert (
        new("pike", *FIVE, "--length=2", "--mass=60", "--height=0.4", "--width=0.25", "--tail-height=0.5", "--servo=xl330-m288")
        == 1
    )
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


# photos


def drawn(path, *, nose="left", tilt=0.0, noise=3.0, size=(800, 450), fish=((400, 225),), long=600.0):
    """A synthetic side view: typical fish on a background whose light falls off, blurred, with noise."""
    rows = typical(0.6, 0.11, 0.07, 0.14).rows * (long / 0.6)
    x, half = rows[:, 0] - long / 2, rows[:, 1] / 2
    points = np.stack([np.r_[x, x[::-1]], np.r_[-half, half[::-1]]], 1) * [1 if nose == "left" else -1, 1]
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    v, u = np.mgrid[0 : 1 : size[1] * 1j, 0 : 1 : size[0] * 1j]
    image = np.stack([170 + 30 * u - 25 * v, 160 - 10 * u, 120 + 20 * v], -1)
    for middle in fish:
        cv2.fillPoly(image, [np.round(points @ [[c, s], [-s, c]] + middle).astype(np.int32)], (60, 80, 200))
    rng = np.random.default_rng(0)
    image = np.clip(cv2.GaussianBlur(image, (0, 0), 1.0) + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
    cv2.imwrite(str(path), image)
    return rows * (0.6 / long)


PHOTO = ["--width=0.07", "--mass=1.6", "--links=5", "--servo=lx-824"]


@pytest.mark.parametrize(
    ("name", "view"),
    [("p.png", {}), ("p.png", {"nose": "right", "tilt": 12.0}), ("p.jpg", {"noise": 14.0, "tilt": -8.0})],
)
def test_the_outline_of_a_photo_is_the_fish_that_was_drawn(tmp_path, name, view):
    rows = drawn(tmp_path / name, **view)
    assert new("pike", f"--photo={name}", "--length=0.6", f"--nose={view.get('nose', 'left')}", *PHOTO) == console.OK
    robot = load_robot("pike.toml")
    starts = np.cumsum([0, *(link.length for link in robot.links)])
    found = np.concatenate([np.array(link.sections)[:, :2] + [a, 0] for link, a in zip(robot.links, starts, strict=False)])
    inside = (found[:, 0] > 0.015) & (found[:, 0] < 0.585)
    off = np.abs(found[:, 1] - np.interp(found[:, 0], rows[:, 0], rows[:, 1]))[inside]
    assert robot.length == pytest.approx(0.6, abs=1e-6) and off.max() < 0.006 and off.mean() < 0.0015  # m; a pixel is 1 mm
    plate = [a + link.fin_from for a, link in zip(starts, robot.links, strict=False) if link.fin_from is not None]
    assert plate[0] == pytest.approx(0.765 * 0.6, abs=0.015)
    overlay = cv2.imread("pike-outline.png")
    assert overlay.shape == (450, 800, 3) and (overlay != cv2.imread(name)).any()


def test_the_scale_of_a_photo_gives_the_length(tmp_path, capsys):
    drawn(tmp_path / "p.png")
    assert new("pike", "--photo=p.png", "--scale=1mm", *PHOTO) == console.OK
    assert load_robot("pike.toml").length == pytest.approx(0.6, rel=0.01)
    assert "mend one of them" in refused(capsys, "roach", "--photo=p.png", "--scale=2mm", "--length=0.6", *PHOTO)
    assert "no scale" in refused(capsys, "roach", "--photo=p.png", *PHOTO)


@pytest.mark.parametrize(
    ("view", "reason"),
    [
        ({"fish": ()}, "no clear outline"),
        ({"fish": (), "noise": 60.0}, "no clear outline"),
        ({"fish": ((400, 110), (400, 340))}, "two things"),
        ({"fish": ((150, 225),)}, "touches the edge"),
        ({"long": 60.0}, "covers"),
    ],
)
def test_a_photo_without_a_clear_outline_is_refused(tmp_path, capsys, view, reason):
    drawn(tmp_path / "p.png", **view)
    said = refused(capsys, "pike", "--photo=p.png", "--length=0.6", *PHOTO)
    assert "p.png: no clear outline" in said and reason in said


def huge(width, height):
    """The header of a PNG that says it is this large."""
    return (
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
        + width.to_bytes(4, "big")
        + height.to_bytes(4, "big")
        + b"\x08\x02\x00\x00\x00IDATIEND"
    )


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not a PNG or JPG"),
        (b"hello", "not a PNG or JPG"),
        (huge(100_000, 100_000), "100000 x 100000 pixels"),
        (huge(2**32 - 1, 1), "4294967295 x 1 pixels"),
        (huge(200, 200), "damaged"),
        (b"\xff\xd8\xff\xe0\x00\x04AB\xff\xc0\x00\x11\x08\xff\xff\xff\xff\x03", "65535 x 65535 pixels"),
        (b"\xff\xd8\xff\xe0\x00\x00" * 3, "not a PNG or JPG"),
    ],
)
def test_hostile_pictures_are_refused_before_they_are_decoded(tmp_path, capsys, data, reason):
    (tmp_path / "p.png").write_bytes(data)
    assert reason in refused(capsys, "pike", "--photo=p.png", "--length=0.6", *PHOTO)


@pytest.mark.parametrize("name", ["p.png", "p.jpg"])
@pytest.mark.parametrize("share", [0.3, 0.9, 0.9999])
def test_truncated_pictures_are_refused(tmp_path, capsys, name, share):
    drawn(tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data)) - 1])
    assert "truncated" in refused(capsys, "pike", f"--photo={name}", "--length=0.6", *PHOTO)


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
        fish = Fish(
            name="pike", outline=outline, mass=1.0, joints=[0.1] * (links - 1), sheet=SHELF["lx-824"], side_span=0.0, origin={}
        )
        text = toml_of(replace(load_robot("fish"), links=made, fins=(), water=water_prior(made)), fish)
        back = robot_from_dict(tomllib.loads(text.replace("mass_total = ", "# ")), "t.toml")
    except ConfigError as error:
        assert "\n" not in str(error) or isinstance(error, DescriptionError)
        return
    assert [link.sections for link in back.links] == [link.sections for link in made]
    assert all((np.diff([row[0] for row in link.sections]) > 0).all() for link in back.links)


# servos


def test_the_default_servo_comes_out_of_its_data_sheet():
    sheet = sheet_of("lx-824")
    assert servo_from_sheet(sheet.stall_torque, sheet.no_load_speed, sheet.voltage) == load_robot("fish").servo


@settings(max_examples=50, deadline=None)
@given(torque=st.floats(0.02, 50.0), speed=st.floats(0.5, 30.0), voltage=st.floats(3.0, 48.0))
def test_a_servo_of_any_sheet_is_a_motor(torque, speed, voltage):
    s = servo_from_sheet(torque, speed, voltage)
    assert s.kv >= 0 and s.kb == pytest.approx(torque / speed, rel=2e-3)
    assert s.constant**2 / s.resistance == pytest.approx(s.kb, rel=0.01)
    assert np.degrees(s.torque / s.kp) == pytest.approx(12.0, rel=0.06)


def test_sheets_whose_figures_contradict_each_other_are_refused():
    for sheet in SHELF.values():
        if sheet.stall_current is not None:
            assert 0.3 < gear_efficiency(sheet.stall_torque, sheet.no_load_speed, sheet.voltage, sheet.stall_current) < 1.0
    with pytest.raises(ConfigError, match="kg cm or N m"):
        servo_from_sheet(17.0, 5.236, 7.4, stall_current=3.0)  # kg cm taken for N m
    with pytest.raises(ConfigError, match="contradict"):
        servo_from_sheet(0.017, 5.236, 7.4, stall_current=3.0)
    with pytest.raises(ConfigError, match="voltage = nan"):
        servo_from_sheet(1.7, 5.236, float("nan"))


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


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("torque", "17kg·cm", 1.6671), ("torque", "1.2 N m", 1.2), ("torque", "100 oz-in", 0.70616), ("rate", "50 rpm", 5.23599),
        ("rate", "0.2 s/60°", 5.23599), ("length", "60 CM", 0.6), ("mass", "1300g", 1.3), ("current", "900 mA", 0.9),
    ],
)  # fmt: skip
def test_units_of_rulers_and_data_sheets_are_read(kind, text, value):
    assert quantity(kind, 0.0, 100.0)(text) == pytest.approx(value, rel=1e-4)


# priors


@pytest.mark.parametrize("name", ["fish", "tendon_fish"])
def test_the_prior_by_shape_is_what_the_shipped_descriptions_say(name):
    robot = load_robot(name)
    assert water_prior(robot.links) == robot.water


def test_a_link_is_a_plate_by_its_rear_when_it_turns():
    body = Link(name="b", length=0.1, mass=1.0, sections=((0.0, 0.06, 0.04), (0.1, 0.06, 0.04)))
    assert plate_share(body) == 0.0 and plate_share(replace(body, fin_from=0.0)) == pytest.approx(1.0)
    rear, front = (
        replace(body, fin_from=0.05),
        replace(body, sections=((0.0, 0.06, 0.001), (0.05, 0.06, 0.04), (0.1, 0.06, 0.04))),
    )
    assert plate_share(rear) == pytest.approx(0.875, abs=1e-3)  # 1 - (1/2)^3
    assert plate_share(rear, turns=False) == pytest.approx(0.5, abs=1e-3) and plate_share(front) < 0.1
    flat = [plate_share(replace(body, sections=((0.0, 0.06, w), (0.1, 0.06, w)))) for w in (0.03, 0.015, 0.008, 0.005, 0.001)]
    assert (np.diff(flat) >= 0).all() and flat[0] == 0 and flat[-1] == pytest.approx(1)


def test_balanced_masses_are_those_of_the_default_fish():
    robot = load_robot("fish")
    links = balanced(robot.links, robot.mass)
    assert [link.mass for link in links] == pytest.approx([link.mass for link in robot.links], abs=2e-4)
    assert [link.com[0] for link in links] == pytest.approx([link.com[0] for link in robot.links], abs=1e-5)
    with pytest.raises(ConfigError, match="positive mass"):
        balanced(robot.links, float("nan"))


@settings(max_examples=25, deadline=None)
@given(links=st.integers(2, 10), mass=st.floats(0.01, 300.0), high=st.floats(0.05, 0.5), wide=st.floats(0.05, 0.5))
def test_balanced_masses_add_up_and_sit_where_the_water_was(links, mass, high, wide):
    raw = cut(typical(1.0, high, wide, 0.3), joints_of(1.0, links))
    made = balanced(raw, mass)
    assert sum(link.mass for link in made) == pytest.approx(mass, abs=1e-9)
    assert [link.mass for link in made] == pytest.approx(mass * displaced(raw) / displaced(raw).sum(), abs=1e-5)


# pictures of links


def test_links_without_a_colour_have_one_each():
    robot = load_robot("fish")
    bare = replace(robot, links=tuple(replace(link, colour=None) for link in robot.links))
    assert [colour_of(bare, i) for i in range(4)] == list(PALETTE[:4])
    assert colour_of(robot, 0) == robot.links[0].colour
    assert len(np.unique(skin(bare, details=False).colour.round(1), axis=0)) > 4


def test_a_blunt_nose_is_drawn_round_and_nothing_else_changes():
    robot = load_robot("tendon_fish")
    rows = drawn_sections(robot, 0)
    assert rows[0, 1] < 0.2 * rows[:, 1].max() and rows[-1].tolist() == list(robot.links[0].sections[-1])
    front = rows[rows[:, 0] < 0.029]
    ellipse = np.sqrt(1 - (1 - front[1:, 0] / 0.03) ** 2)
    assert front[1:, 1] == pytest.approx(ellipse * 0.1, rel=1e-6)
    assert np.array_equal(drawn_sections(robot, 1), robot.links[1].sections)
    sharp = load_robot("fish")
    assert np.array_equal(drawn_sections(sharp, 0), sharp.links[0].sections)
    vertices, _ = loft(robot, geometry_of(robot), 0)
    tip = vertices[vertices[:, 0] > geometry_of(robot).span[0, 1] - 1e-9]
    assert np.ptp(tip[:, 2]) < 0.02  # m; the described wall is 0.06 high


# a fish of five links elsewhere


def test_what_cannot_serve_five_links_says_so():
    assert new("pike", *FIVE) == console.OK
    robot = load_robot("pike.toml")
    for name in ("pd", "pi", "dob", "adrc-c1"):
        with pytest.raises(ConfigError, match="for 3 joints, pike has 4"):
            controllers.make(name, robot)
    with pytest.raises(FishmjError, match="pike has 4 joints"):
        Sim(robot).step(np.zeros(3))


def test_the_verb_is_found_by_the_command_line():
    assert "new" in cli.present()
