"""A robot description is sound or refused as a whole: file, block, key, got, expected, what to do; nothing bad reaches MuJoCo."""

import copy
import json
import math
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from description_table import table as table_of_keys
from description_table import written as table_on_the_page

from fishmj import mjcf
from fishmj.base import console
from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import DescriptionError
from fishmj.log.toml import dumps
from fishmj.mjcf import description_schema, load_robot
from fishmj.mjcf.description import RigSpec
from fishmj.mjcf.identity import robot_sha256
from fishmj.mjcf.reading import robot_from_dict
from fishmj.mjcf.validation import examine
from fishmj.sim import Sim
from fishmj.water.hydro_model import HydroModel, robot_hash

ROOT = Path(__file__).resolve().parent.parent
NAN, INF = math.nan, math.inf
LINE = re.compile(r"^(?P<file>\S+\.toml)(?P<block> \[\[?\w+\]?\](?: \d+(?: '[^']*')?)?)?(?P<key> \S+)?: got .+, expected .+; .+$")
GONE = "the key is taken out"


def whole() -> dict:
    """fish.toml with every block and key that there is."""
    table = tomllib.loads(resolve("fish").read_text(encoding="utf-8"))
    table["water"]["suction"] = 1.0
    table["rig"] = {"bus": "lx", "baud": 115200, "servo_ids": [3, 1, 2], "signs": [1, -1, 1], "zeros_deg": [0.5, 0.0, -2.0]}
    table["rig"] |= {
        "low_voltage": 6.5,
        "paint_height": -0.01,
        "red": [[0.05, 0.06], [0.17, 0.02]],
        "yellow": [[-0.03, 0.05], [0.0, 0.06]],
    }
    table["notes"], table["origin"] = {"anything": [1, "two"]}, {"source": "a ruler"}
    table["effect"] = [{"name": "coulomb_friction", "parameters": {"torque": {"value": 0.08, "low": 0.07, "high": 0.09}}}]
    table["calibration"] = {"servo": {"source": "a folder", "kp": {"value": 8.0, "low": 7.9, "high": 8.1, "unit": "N m/rad"}}}
    table["version"] = {"number": 2, "parent": "fish", "parent_text": "fish.parent.toml", "rivals": [{"name": "tether"}]}
    return table


def put(place: tuple, value) -> dict:
    """The whole description with one value changed, added or taken out."""
    table = whole()
    inside = table
    for part in place[:-1]:
        inside = inside[part]
    if value == GONE:
        del inside[place[-1]]
    else:
        inside[place[-1]] = value
    return table


def written(folder: Path, table: dict) -> Path:
    path = folder / "my_fish.toml"
    path.write_text(dumps(table), encoding="utf-8")
    return path


def refused(source) -> tuple[str, ...]:
    """The lines of a refusal, each of the form that all have."""
    with pytest.raises(DescriptionError) as caught:
        load_robot(source)
    for line in caught.value.errors:
        assert LINE.match(line), line
        assert len(line) < 600 and line.isprintable(), line
    return caught.value.errors


def bad_values(block: str, key: str) -> list:
    """What may never stand in a key, by what it is."""
    model = description_schema.BLOCKS[block]
    info = next(info for name, info in model.model_fields.items() if key == (info.alias or name))
    what, expected = str(info.annotation), description_schema.said(block, key)[2]
    if key in ("sections", "com", "colour", "station", "k", "cn"):
        return ["text", 1.0, True, [], [NAN], [INF], ["a"], [[1.0]], [1.0] * 40, {"a": 1}]
    if "number" in expected:
        return ["1.0", True, NAN, INF, -INF, -1e9, 1e12, [1.0], {"a": 1}] + ([1.5] if what.startswith("<class 'int'") else [])
    if key == "parameters":
        return ["text", 1.0, [1.0]]
    return [1.0, True, ["text"], {"a": 1}, "line\nbreak", "x" * 3000, "a\x1b[31m"]


def singles() -> list:
    """(place, value) for every key of every block, and every key misspelled or taken out where it must be there."""
    cases = []
    for block in description_schema.BLOCKS:
        if block == "version":
            continue
        at = (block, 0) if block in description_schema.LISTS else (block,)
        for key in description_schema.keys(block):
            cases += [((*at, key), value) for value in bad_values(block, key)]
            cases.append(((*at, f"{key}x"), 1.0))
        cases.append(((*at, "zzz"), 1.0))
        for name, info in description_schema.BLOCKS[block].model_fields.items():
            if info.is_required():
                cases.append(((*at, info.alias or name), GONE))
    cases += [((block,), value) for block in description_schema.BLOCKS for value in (3, "text", True, [1, 2])]
    cases += [((f"{block}{block[-1]}",), {"a": 1}) for block in description_schema.BLOCKS]
    cases += [(("schema",), v) for v in ("fish/9", "fishmj.fish/2", 1, True, "")] + [
        (("title",), v) for v in (1, "a\x00", "x" * 201)
    ]
    names = [
        "",
        "../x",
        "a b",
        "x" * 65,
        "<b>hi</b>",
        "__import__('os')",
        "-rf",
        ".",
        "..",
        "\u202e",
        "a\n",
        3,
        "x" * 10_000,
        "$(ls)",
        "é",
    ]
    cases += [(place, v) for place in (("name",), ("link", 1, "name"), ("fin", 0, "name")) for v in names]
    cases += [(("link",), GONE), (("foo",), {"a": 1}), (("kp",), 8.0), (("masss",), 1.0), (("version", "parent_text"), "../../x")]
    cases += [(("version", "number"), v) for v in (0, "2", 1.5, True)]
    return cases


RELATIONS = [
    (("link", 0, "sections"), [[0.0, 0.05, 0.05], [0.2, 0.05, 0.05]], "stations"),
    (("link", 0, "sections"), [[0.01, 0.05, 0.05], [0.215, 0.05, 0.05]], "stations"),
    (("link", 0, "sections"), [[0.0, 0.05, 0.05], [0.1, 0.05, 0.05], [0.1, 0.05, 0.05], [0.215, 0.05, 0.05]], "rise"),
    (("link", 0, "sections"), [[0.0, 0.05, 0.05], [0.15, 0.05, 0.05], [0.1, 0.05, 0.05], [0.215, 0.05, 0.05]], "rise"),
    (("link", 0, "sections"), [[0.0, 0.0, 0.0], [0.215, 0.05, 0.05]], "height 0 in row 1"),
    (("link", 0, "sections"), [[0.0, 20.0, 20.0], [0.215, 20.0, 20.0]], "height 20 in row 1"),
    (("link", 0, "com"), [0.1, 0.01, 0.0], "y = 0"),
    (("link", 0, "com"), [0.9, 0.0, 0.0], "from the link's own front"),
    (("link", 3, "fin_from"), 0.3, "a station of the link"),
    (("link", 1, "name"), "head", "must differ"),
    (("link", 1, "name"), "world", "does not use"),
    (("link", 1, "name"), "side_left", "does not use"),
    (("link", 0, "mass"), 744.0, "sum of the links' masses"),
    (("body", "mass_total"), 1.2, "sum of the links' masses"),
    (("fin", 0, "link"), "haed", "did you mean 'head'"),
    (("fin", 0, "station"), [0.178, 0.10], "front edge, rear edge"),
    (("fin", 0, "station"), [0.10, 0.30], "within the link's"),
    (("servo", "kd"), 0.2, r"torque / speed_no_load = 0\.3184"),
    (("servo", "torque"), 3.0, "raise kd to 0.573"),
    (("servo", "range"), 1.0, "both range and range_deg"),
    (("servo", "resolution_deg"), 30.0, None),
    (("servo", "kp"), 1e-3, "1 % of the torque"),
    (("timing", "bus_dt"), 0.021, "nearest valid bus_dt: 0.02 s"),
    (("timing", "control_dt"), 0.21, "nearest valid control_dt: 0.2 s"),
    (("rig", "servo_ids"), [1, 2], "3, one a joint"),
    (("rig", "servo_ids"), [1, 2, 2], "each number once"),
    (("rig", "signs"), [1, -1], "3, one a joint"),
    (("rig", "signs"), [1, -1, 0], "each 1 or -1"),
    (("rig", "zeros_deg"), [0.0, 190.0, 0.0], "each from -180 to 180"),
    (("rig", "zeros_deg"), [0.0, 70.0, 0.0], "mount its horn nearer to the middle"),
    (("rig", "zeros"), [0.0, 90.0, 0.0], "in degrees go into zeros_deg"),
    (("rig", "bus"), "can", "'lx', 'dynamixel-x' or 'dynamixel-ax'"),
    (("rig", "baud"), 57601, "a baud rate"),
    (("rig", "red"), [[-0.1, 0.05], [0.2, 0.04]], "red before yellow"),
    (("rig", "red"), GONE, "both red and yellow"),
    (("rig", "red"), [[0.2, 0.05], [0.1, 0.04]], "x rising"),
    (("water", "k"), [0.9, 0.9], "one number a link, 4"),
    (("water", "lift_b"), 0.1, "at least 0.5"),
    (("water", "stall_angle"), 0.6, "both stall_angle and stall_angle_deg"),
    (("water", "stall_angle_deg"), 0.61, "stall_angle_deg: got 0.61 deg.* write stall_angle = 0.61 if it is in rad"),
]


@pytest.mark.parametrize("block", sorted({str(place[0]) for place, _ in singles()}))
def test_invalid_description_value_is_refused_with_place_got_and_expected(tmp_path, block):
    for place, value in (case for case in singles() if case[0][0] == block):
        (line, *_) = refused(written(tmp_path, put(place, value)))
        assert all(part in line for part in place if not isinstance(part, int)), (place, value, line)
        if len(place) == 3:
            assert f"[[{block}]] {place[1] + 1}" in line, (place, value, line)


@pytest.mark.parametrize(("place", "value", "told"), [r for r in RELATIONS if r[2]], ids=lambda v: str(v)[:40])
def test_keys_that_do_not_fit_together_are_refused(tmp_path, place, value, told):
    lines = refused(written(tmp_path, put(place, value)))
    assert re.search(told, " ".join(lines)), lines


def test_there_are_more_than_a_hundred_generated_bad_descriptions():
    assert len(singles()) > 400


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("range_deg", 1.0472, r"range_deg: got 1\.0472 deg.* range = 1\.0472 if it is in rad"),
        ("range_deg", 0.1, r"range_deg: got 0\.1 deg"),
        ("range", 60.0, r"range: got 60.*60 deg is 1\.047 rad"),
        (
            "speed_no_load",
            300.0,
            r"speed_no_load: got 300.*, expected a number from 0\.01 to 100 rad/s;.* 300 deg/s is 5\.236 .*300 rpm is 31\.42 ",
        ),
    ],
)
def test_an_angle_of_the_servo_in_the_other_unit_is_told_so(key, value, told):
    table = whole()
    table["servo"] = {k: v for k, v in table["servo"].items() if not key.startswith(k.removesuffix("_deg"))} | {key: value}
    lines, _ = examine(table, "x.toml")
    assert len(lines) == 1 and re.search(told, lines[0]) and "kp" not in lines[0], lines


def test_a_gain_is_not_blamed_for_a_range_or_a_resolution():
    for key, small in (("range", 0.01), ("resolution", 0.3)):
        table = whole()
        table["servo"].pop(f"{key}_deg")
        table["servo"][key] = small
        assert f"[servo] {key}: got {small:g} rad (" in notes(table) and "[servo] kp" not in notes(table)


@pytest.mark.parametrize("word", ["masss", "legnth", "colur"])
def test_a_misspelled_key_is_told_its_nearest(tmp_path, word):
    near = {"masss": "mass", "legnth": "length", "colur": "colour"}[word]
    assert f"{word}: got an unknown key, expected '{near}'" in " ".join(refused(written(tmp_path, put(("link", 1, word), 1.0))))


def test_a_misspelled_block_is_told_its_nearest_and_where_notes_go(tmp_path):
    (line,) = refused(written(tmp_path, put(("servoo",), {"kp": 9.0})))
    assert "[servoo]: got an unknown block, expected [servo]" in line and "[notes]" in line


def test_a_key_under_the_wrong_block_is_told_its_own(tmp_path):
    (line,) = refused(written(tmp_path, put(("link", 3, "density_water"), 1000.0)))
    assert "[[link]] 4 'tail' density_water" in line and "it belongs under [body]" in line


def test_another_schema_is_one_line_whatever_else_is_wrong(tmp_path):
    table = put(("schema",), "fishmj.water/1") | {"foo": {}, "link": []}
    (line,) = refused(written(tmp_path, table))
    assert "got 'fishmj.water/1', expected 'fishmj.fish/1'" in line and "--water" in line
    assert "fish/9" in refused(written(tmp_path, put(("schema",), "fish/9")))[0]


def many(folder: Path) -> Path:
    table = whole()
    for link in table["link"]:
        link |= {"mass": NAN, "length": -1.0, "colour": 3, "masss": 1.0, "com": "x", "fin_from": True}
    return written(folder, table)


def test_all_errors_of_a_file_come_at_once_and_the_rest_is_counted(tmp_path):
    with pytest.raises(DescriptionError) as caught:
        load_robot(many(tmp_path))
    assert len(caught.value.errors) == 24 and len(str(caught.value).splitlines()) == 21
    assert str(caught.value).endswith("and 4 more errors")
    assert copy.deepcopy(caught.value).errors == caught.value.errors  # a worker's error comes home whole


def test_the_command_line_shows_one_line_an_error_and_the_json_all_of_them(tmp_path, capsys):
    path = many(tmp_path)
    code = console.run(lambda argv: load_robot(path) and 0, ["--json"])
    out = capsys.readouterr()
    lines = out.err.splitlines()
    assert code == 2 and len(lines) == 21 and all(line.startswith(f"fishmj: {path} ") for line in lines[:20])
    found = json.loads(out.out)
    assert found["kind"] == "DescriptionError" and len(found["errors"]) == 24 and found["exit"] == 2


def test_a_bad_description_ends_a_command_without_a_traceback(tmp_path):
    path = written(tmp_path, put(("servo", "kd"), 0.1))
    argv = [sys.executable, "-m", "fishmj.view.play", "--robot", str(path), "--headless-seconds", "1"]
    done = subprocess.run(argv, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and "[servo] kd: got 0.1" in done.stderr


# what is left out, and what is unlikely, is said


def notes(table: dict) -> str:
    return "\n".join(robot_from_dict(table, "x.toml").notes)


def test_shipped_descriptions_have_no_notes():
    assert load_robot("fish").notes == load_robot("tendon_fish").notes == ()


UNLIKELY = [
    (("link", 0, "mass"), 0.4, "widths are scaled by 0.69"),
    (("body", "density_water"), 1300.0, "density_water: got 1300"),
    (("servo", "voltage"), 74.0, "not of one motor"),
    (("servo", "speed_no_load"), 50.0, r"speed_no_load: got 50 rad/s, .*50 rpm is 5\.236 rad/s"),
    (("servo", "kp"), 0.2, "a fifth of its torque"),
    (("servo", "kp"), 900.0, "chatter"),
    (("timing", "command_latency"), 0.5, "expected 0.02 to 0.12 s"),
    (("link", 3, "com"), [-0.01, 0.0, 0.0], "from the front"),
    (("schema",), GONE, "no schema"),
    (("servo",), GONE, r"\[servo\]: not given.*kp = 8.*torque = 1.667"),
    (("servo", "torque"), GONE, r"\[servo\]: not given.*: torque = 1.667 \("),
    (("timing",), GONE, r"\[timing\]: not given.*physics_dt = 0.004"),
    (("water",), GONE, r"\[water\]: not given.*k = \[.*ke = .*docs/simulate/water.md"),
    (("water", "cf"), GONE, r"\[water\]: not given, estimated from the shape: cf = "),
]


@pytest.mark.parametrize(
    ("place", "value", "told"),
    UNLIKELY,
    ids=[f"{p[-1]}_{v if isinstance(v, int | float | str) else i}"[:30] for i, (p, v, _) in enumerate(UNLIKELY)],
)
def test_what_is_unlikely_or_left_out_is_read_and_said(place, value, told):
    table = put(place, value)
    if place[0] == "link":
        table["body"].pop("mass_total")
    assert re.search(told, notes(table)), notes(table)


@pytest.mark.parametrize(("off", "doubted"), [(2e-6, False), (8e-5, False), (2e-4, True)])
def test_rounded_sum_of_masses_is_no_doubt(off, doubted):
    """A program that writes six decimals of the total rounds it."""
    mass = sum(link["mass"] for link in whole()["link"])
    assert ("mass_total" in notes(put(("body", "mass_total"), mass * (1 + off)))) == doubted


def scaled(by: float) -> dict:
    table = whole()
    table["body"].pop("mass_total")
    for link in table["link"]:
        link["length"], link["mass"] = link["length"] * by, link["mass"] * by**3
        link["sections"] = [[v * by for v in row] for row in link["sections"]]
        link["com"] = [v * by for v in link["com"]]
    table["link"][3]["fin_from"] *= by
    table["fin"][0]["station"] = [v * by for v in table["fin"][0]["station"]]
    return table


def test_six_metre_fish_gets_a_note_and_140_metre_fish_is_refused():
    assert "length: got 6.42 m in all" in notes(scaled(12.0))
    with pytest.raises(DescriptionError, match="length: got"):
        robot_from_dict(scaled(262.0), "x.toml")


def test_a_mass_in_grams_is_refused_with_the_water_that_the_hull_displaces():
    table = whole()
    table["body"].pop("mass_total")
    for link in table["link"]:
        link["mass"] *= 1000
    with pytest.raises(DescriptionError, match="1100 kg in all for a hull that displaces 1.09 kg.*units"):
        robot_from_dict(table, "x.toml")


def test_the_factor_on_the_widths_is_the_geometrys():
    from fishmj.mjcf.relations import width_scale

    for name in ("fish", "tendon_fish"):
        assert width_scale(read_toml(resolve(name))) == pytest.approx(mjcf.geometry_of(load_robot(name)).width_scale, rel=1e-4)


def test_a_note_reaches_the_user_once(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(console, "_WARNED", set())
    path = written(tmp_path, put(("water",), GONE))
    for _ in range(3):
        load_robot(path)
    assert capsys.readouterr().err.count("[water]: not given") == 1


def test_a_fish_without_water_swims_in_its_prior(tmp_path):
    robot = load_robot(written(tmp_path, put(("water",), GONE)))
    pose = Sim(robot).run(lambda t: 0.5 * np.sin(6 * t - np.arange(3)), 0.5).table("truth")["x"]
    assert "model" not in robot.water and len(robot.water["k"]) == 4 and np.isfinite(pose).all()


def test_notes_of_the_user_may_hold_anything(tmp_path):
    table = whole() | {
        "notes": {"a": {"b": [1, NAN, "x" * 5000, {"c": "\u202e"}]}},
        "measured": {"mass": "heavy", "t": [[1], [2, 3]]},
    }
    assert load_robot(written(tmp_path, table)).name == "swift"
    assert load_robot(written(tmp_path, table | {"notes": "bought in June"})).name == "swift"


# what is shipped, and what our own commands write, reads as before


SHIPPED = {
    "fish": (4, 1.1, 0.535, 0.32, "ebdca231fa6e44d11798135f354d6d8e622d6fc95761bd3544532944f9ae20db"),
    "tendon_fish": (3, 1.43, 0.55, 0.6, None),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_description_loads_the_robot_its_waters_were_fitted_to(name):
    robot, (n, mass, length, kd, digest) = load_robot(name), SHIPPED[name]
    assert (len(robot.links), robot.mass, robot.length, robot.servo.kd) == pytest.approx((n, mass, length, kd))
    expected = digest or HydroModel.load("tendon_fish").robot_sha256
    assert robot_hash(robot) == expected == HydroModel.load(robot.name).robot_sha256


def test_every_kind_of_block_together_is_the_same_fish():
    robot, shipped = robot_from_dict(whole(), "x.toml"), load_robot("fish")
    assert robot.rig.signs == (1, -1, 1) and robot.rig.zeros == pytest.approx(np.radians((0.5, 0.0, -2.0)))
    assert (robot.servo_ids, robot.low_voltage, robot.rig.red[0]) == ((3, 1, 2), 6.5, (0.05, 0.06))
    alike = replace(robot, effects=(), water=shipped.water)
    assert robot_sha256(alike) == robot_sha256(shipped) and robot_hash(alike) == robot_hash(
        shipped
    )  # another plug, the same fish
    assert replace(alike, rig=shipped.rig) == shipped and robot.effects[0].name == "coulomb_friction"


@pytest.mark.parametrize(
    ("volts", "low"), [(7.4, 6.4), (8.4, 6.4), (6.0, 5.19), (5.0, 4.32), (11.1, 9.6), (12.0, 9.6), (14.8, 12.8), (3.7, 3.2)]
)
def test_a_low_battery_is_that_of_its_cells(volts, low):
    """3.2 V a LiPo cell where the servos' voltage is one of cells of 3.7 to 4.2 V, else 86 % of it."""
    shipped = load_robot("fish")
    robot = replace(shipped, servo=replace(shipped.servo, voltage=volts))
    assert robot.low_voltage == pytest.approx(low) and robot.servo_ids == (1, 2, 3)
    assert replace(robot, rig=RigSpec(low_voltage=3.3)).low_voltage == 3.3


def test_a_servo_number_that_the_bus_has_not_is_refused():
    table = put(("rig", "servo_ids"), [1, 2, 253])
    assert robot_from_dict(table, "fish.toml").servo_ids == (1, 2, 253)
    table["rig"] |= {"bus": "dynamixel-x", "baud": 1000000}
    with pytest.raises(DescriptionError, match="0 to 252 on dynamixel-x"):
        robot_from_dict(table, "fish.toml")


@pytest.mark.parametrize(("low", "told"), [(6.4, True), (5.0, True), (2.4, True), (4.9, False), (2.5, False)])
def test_a_low_voltage_that_the_servos_never_have_is_told(low, told):
    shipped = load_robot("fish")
    ratio = 5.0 / shipped.servo.voltage
    servo = replace(
        shipped.servo, voltage=5.0, constant=shipped.servo.constant * ratio, resistance=shipped.servo.resistance * ratio**2
    )
    notes = load_robot(replace(shipped, servo=servo, rig=RigSpec(low_voltage=low))).notes
    assert any("[rig] low_voltage" in note and "[servo] voltage" in note for note in notes) is told


@pytest.mark.parametrize("water", ["swift", "swift-noslip", "tendon_fish"])
def test_a_robot_in_a_fitted_water_is_sound(water):
    from fishmj.engines import in_water

    robot = in_water(load_robot("tendon_fish" if "tendon" in water else "fish"), water)
    assert load_robot(robot) is robot and robot.notes == ()


def test_what_calibrate_writes_reads(tmp_path):
    from fishmj.gap.calibrate import calibrated_model as model
    from fishmj.gap.calibrate.parameter_fit import ParameterEstimate

    found = {"kp": ParameterEstimate("kp", "N m/rad", 8.1, 8.0, 8.2, 0.05, "repeats")}
    friction = {"coulomb_friction.torque": ParameterEstimate("torque", "N m", 0.08, 0.07, 0.09, 0.005, "repeats")}
    out = tmp_path / "fish.calibrated.toml"
    text = model.put(model.start(out, "fish"), "servo", {"kp": 8.1})
    model.write(out, text, "servo", found, friction, tmp_path)
    assert load_robot(out).servo.kp == 8.1 and load_robot(out).effects[0].name == "coulomb_friction"
    assert read_toml(out)["calibration"]["servo"]["kp"]["value"] == 8.1


def test_every_toml_that_ships_is_within_the_bounds_of_the_reader():
    for path in sorted((ROOT / "data").rglob("*.toml")):
        assert read_toml(path), path


# the page


def test_the_table_of_keys_on_the_page_is_that_of_the_models():
    assert table_on_the_page() == table_of_keys(), "run: python tests/description_table.py"


def test_angles_have_the_same_bounds_in_degrees_and_in_radians(tmp_path):
    for block, key, value in (("servo", "resolution_deg", 30.0), ("water", "stall_width_deg", 0.5)):
        robot = load_robot(written(tmp_path, put((block, key), value)))
        assert load_robot(replace(robot, notes=())).servo == robot.servo


def test_every_key_says_what_it_is_and_what_is_expected():
    for block in description_schema.BLOCKS:
        for key in description_schema.keys(block):
            what, _, expected = description_schema.said(block, key)
            assert what and expected, (block, key)


def test_pydantic_waits_for_the_first_description():
    look = "print('pydantic' in sys.modules)"
    code = f"import sys, fishmj, fishmj.mjcf; {look}; fishmj.mjcf.load_robot(); {look}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == ["False", "True"]
