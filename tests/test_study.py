"""`gap measured --study`: machines of the tests' own, with a term hidden and without; what cannot be told is said. Synthetic."""

import json
import tomllib

import machines
import numpy as np
import pytest

from fishmj.base import console
from fishmj.gap.measured import significance, study_build
from fishmj.gap.measured.decoy_terms import RIVALS
from fishmj.gap.measured.measured_command import TEMPLATES, main
from fishmj.gap.measured.planar_body import Hull, MeanGait, PlanarBody
from fishmj.gap.measured.study_build import built
from fishmj.gap.measured.study_logs import logs_of
from fishmj.gap.measured.study_schema import PLANTS, checked, read_study

BODY = """schema = "fishmj.study/1"
name = "boat"
plant = "body"
origin = "synthetic"
data = { folder = "logs", names = "{day}_s{setting}_{run}" }
groups = { by = ["day", "setting"] }
noise = { position = 0.01, heading = 0.005 }
prediction = { horizon = 3.0 }
baseline = { drive = "propeller", fitted = ["thrust", "torque", "drag", "yaw_drag"] }
nominal = { mass = 14.0, inertia = 1.5, thrust = 15.0, torque = 1.0, drag = 8.0, yaw_drag = 2.0 }
candidates = { only = ["steady_current", "linear_surge_drag", "linear_sway_damping", "camera_scale", "inert"] }
[columns]
t = { column = "time", unit = "ms" }
x = { column = "px", unit = "cm" }
y = { column = "py", unit = "cm" }
yaw = { column = "compass", unit = "deg", sign = -1, zero = 90 }
amplitude = "throttle"
bias = "rudder"
"""
SERVO = """schema = "fishmj.study/1"
name = "servo"
plant = "servo"
origin = "synthetic"
data = { folder = "logs", names = "{motion}_g{gain}" }
groups = { by = ["gain"] }
noise = { angle = 1.5e-3 }
baseline = { fitted = ["stall", "viscous", "armature"] }
nominal = { stall = 1.0, back_emf = 0.025, viscous = 0.02, armature = 0.002, mass = 0.5, length = 0.1, voltage = 7.4 }
candidates = { only = ["coulomb_friction", "load_friction", "servo_gain", "voltage_sag"] }
search = { rounds = 1 }
[columns]
t = { column = "time", unit = "s" }
goal = { column = "goal", unit = "deg" }
angle = { column = "angle", unit = "deg" }
duty = { column = "pwm", scale = 0.001 }
"""
COAST = """schema = "fishmj.study/1"
name = "coast"
plant = "coast"
origin = "synthetic"
data = { folder = "logs" }
groups = { by = ["file"] }
noise = { speed = 0.01 }
baseline = { fitted = ["drag"] }
nominal = { mass = 14.0, drag = 3.0 }
candidates = { only = ["linear_surge_drag", "constant_resistance", "inert"] }
search = { rounds = 1 }
[columns]
t = { column = "t", unit = "s" }
speed = { column = "v", unit = "m/s" }
"""


def study(folder, text, *replaced):
    """The file of a study, with replacements in its text."""
    for old, new in replaced:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "my.toml"
    path.write_text(text)
    return path


def ran(capsys, path, *options):
    """(exit code, figures, what stood on stderr)."""
    code = console.run(main, ["--study", str(path), "--json", *options])
    said = capsys.readouterr()
    last = said.out.strip().splitlines()[-1] if said.out.strip() else "{}"
    return code, json.loads(last), said.err


def refused(capsys, path, *words):
    """Bad input in one line (of a study: a line for each key) that holds these words, and no traceback."""
    code, figures, err = ran(capsys, path)
    assert code == console.BAD_INPUT and "Traceback" not in err, err
    lines = [line for line in err.splitlines() if line.strip()]
    assert all(word in err for word in words), err
    assert all(len(line) < 1100 and line.isprintable() for line in lines)
    return lines


def names(figures):
    return [e["name"] for e in figures["verdict"]["effects"]]


@pytest.mark.slow
def test_a_boats_hidden_current_is_found_and_its_report_written(tmp_path, capsys):
    machines.boats(tmp_path / "logs", current=(0.08, -0.05))
    code, figures, _ = ran(capsys, study(tmp_path, BODY), "--out", str(tmp_path / "out"))
    found = {e["name"]: e for e in figures["verdict"]["effects"]}
    assert code == 0 and list(found) == ["steady_current"] and figures["verdict"]["answer"] in ("NAMED", "CLASS")
    current = found["steady_current"]["parameters"]
    assert current["x"]["low"] < 0.08 < current["x"]["high"] and current["y"]["low"] < -0.05 < current["y"]["high"]
    u = figures["left_out"]
    assert u["groups"] == 6 and u["ratio"] < 0.6 and u["low"] < u["ratio"] < u["high"] and u["smallest_p"] == 1 / 64
    page = (tmp_path / "out" / "report.html").read_text()
    assert "steady current" in page and "d1_setting40" in page and "Synthetic data" in page
    assert json.loads((tmp_path / "out" / "report.json").read_text())["left_out"] == u


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_boat_without_a_hidden_term_gets_no_name(tmp_path, capsys, seed):
    machines.boats(tmp_path / "logs", seed=seed)
    code, figures, _ = ran(capsys, study(tmp_path, BODY))
    assert code == 0 and figures["verdict"]["answer"] == "AGREES" and names(figures) == []


@pytest.mark.slow
def test_a_servos_hidden_friction_is_found_and_none_where_none_is(tmp_path, capsys):
    for hidden, folder in ((0.05, tmp_path / "a"), (0.0, tmp_path / "b")):
        machines.servos(folder / "logs", coulomb=hidden, noise=1.5e-3, gains=(1, 1.5, 2, 3, 4), seconds=3.0)
        code, figures, _ = ran(capsys, study(folder, SERVO))
        verdict = figures["verdict"]
        if hidden:
            value = verdict["effects"][0]["parameters"]["torque"]
            assert names(figures) == ["coulomb_friction"] and value["value"] == pytest.approx(0.05, rel=0.15), verdict
            assert code == 0 and figures["left_out"]["better"] == 5 and verdict["gates"]["p_exact"][0] == 1 / 32
        else:
            assert code == 0 and verdict["answer"] == "AGREES" and names(figures) == [], verdict


@pytest.fixture(scope="module")
def coasting(tmp_path_factory):
    """A boat whose drag has a linear part."""
    folder = tmp_path_factory.mktemp("coast")
    machines.coasts(folder / "logs", linear=1.0)
    return folder


def test_the_linear_part_of_a_coasting_boats_drag_is_found(coasting, capsys):
    code, figures, _ = ran(capsys, study(coasting, COAST))
    value = figures["verdict"]["effects"][0]["parameters"]["coefficient"]
    assert code == 0 and names(figures) == ["linear_surge_drag"] and value["low"] < 1.0 < value["high"]
    assert figures["left_out"]["better"] == 7 and figures["verdict"]["gates"]["p_exact"] == [1 / 128]


def test_a_boat_with_quadratic_drag_alone_agrees(tmp_path, capsys):
    machines.coasts(tmp_path / "logs")
    code, figures, _ = ran(capsys, study(tmp_path, COAST))
    assert code == 0 and figures["verdict"]["answer"] == "AGREES" and names(figures) == []


def test_one_group_is_refused_and_two_are_too_few(coasting, tmp_path, capsys):
    one = study(coasting, COAST, ('data = { folder = "logs" }', 'data = { folder = "logs", files = "c1.csv" }'))
    refused(capsys, one, "1 records of one group (c1)", "expected two at least", "[groups] by")
    two = study(coasting, COAST, ('data = { folder = "logs" }', 'data = { folder = "logs", files = "c[12].csv" }'))
    code, figures, _ = ran(capsys, two)
    verdict = figures["verdict"]
    assert code == console.CANNOT_TELL and verdict["answer"] == "TOO_FEW_GROUPS" and "2 groups, at least 5" in verdict["reason"]
    assert verdict["gates"]["smallest_p"] == 0.25 and figures["rounds"][0]["p_exact"] >= 0.25


def test_leave_one_out_keeps_nothing_aside(coasting, capsys):
    path = study(coasting, COAST, ("noise", "held_out = { aside = 2, folds = 3 }\nnoise"))
    _, with_aside, _ = ran(capsys, path)
    _, without, _ = ran(capsys, path, "--leave-one-out")
    assert with_aside["records"] == {"learned": 5, "kept_aside": 2} and with_aside["left_out"]["folds"] == 3
    assert without["records"] == {"learned": 7, "kept_aside": 0} and without["left_out"]["folds"] == 7


DAMAGED = [
    ("plant", ('plant = "coast"', 'plant = "ship"'), "plant: got 'ship', expected 'body', 'servo' or 'coast'"),
    ("key", ("[columns]", "[colums]"), "colums: unknown key (did you mean 'columns'?)"),
    ("key_case", ("[columns]", "[COLUMNS]"), "COLUMNS: unknown key (did you mean 'columns'?)"),
    ("unit", ('unit = "m/s"', 'unit = "parsec"'), "[columns] speed"),
    ("kind", ('unit = "m/s"', 'unit = "m"'), "which measures length, expected m/s"),
    ("no unit", (', unit = "s" }', " }"), "[columns] t: got no unit"),
    ("mass", ("mass = 14.0", "mass = -1.0"), "[nominal] mass: got -1.0"),
    ("nan", ("mass = 14.0", "mass = nan"), "[nominal] mass: got nan"),
    ("guess", ("drag = 3.0", "drag = 0.0"), "whose nominal is 0"),
    ("noise", ("speed = 0.01", "speed = 0.0"), "[noise]: got none of speed"),
    ("folds", ("noise", "held_out = { folds = 51 }\nnoise"), "[held_out] folds: got 51"),
    ("name", ('name = "coast"', 'name = "<script>alert(1)</script>"'), "name: got '<script>"),
    ("path", ('name = "coast"', 'name = "../../x"'), "name: got '../../x'"),
    ("term", ('"constant_resistance"', '"linear_surge_drga"'), "did you mean 'linear_surge_drag'?"),
    ("toml", ("mass = 14.0", "mass = 14,0"), "line 9"),
    ("both", ('folder = "logs"', 'folder = "logs", set = "tail_fish"'), "both or none of folder and set"),
    ("nowhere", ('folder = "logs"', 'folder = "lgos"'), "no such folder"),
    ("files", ('folder = "logs"', 'folder = "logs", files = "*.txt"'), "matches no file"),
    ("by", ('by = ["file"]', 'by = ["day"]'), "has no 'day'"),
    ("names", ('folder = "logs"', 'folder = "logs", names = "{day}_{run}"'), "does not fit the file 'c1'"),
    ("column", ('column = "v"', 'column = "sped"'), "no column 'sped'"),
    ("aside", ("noise", "held_out = { aside = 6 }\nnoise"), "leaves fewer than two"),
    ("where", ("noise", 'held_out = { where = { file = "c9" } }\nnoise'), "no record has 'file' = 'c9'"),
    ("many folds", ("noise", "held_out = { folds = 8 }\nnoise"), "8 of 7 groups"),
    ("one fold", ("noise", "held_out = { folds = 1 }\nnoise"), "1 leaves nothing to fit"),
    ("candidates", ('"linear_surge_drag", "constant_resistance", ', ""), "1 left, expected two"),
]


@pytest.mark.parametrize("replaced, words", [d[1:] for d in DAMAGED], ids=[d[0] for d in DAMAGED])
def test_a_damaged_study_is_one_clear_error(coasting, capsys, replaced, words):
    refused(capsys, study(coasting, COAST, replaced), words)


def test_what_is_no_study_is_said(tmp_path, capsys):
    refused(capsys, tmp_path / "none.toml", "no such file")
    (tmp_path / "my.toml").write_bytes(b"\x00\xff\x00")
    refused(capsys, tmp_path / "my.toml", "UTF-8")
    (tmp_path / "my.toml").write_text("")
    assert len(refused(capsys, tmp_path / "my.toml", "schema: got nothing", "[data]: got nothing")) >= 5
    (tmp_path / "my.toml").write_text("x = " + "[" * 500 + "]" * 500)
    refused(capsys, tmp_path / "my.toml", "nested")


ROWS = [f"{0.5 * k},{2 / (1 + 0.1 * k):.3f}" for k in range(30)]
TABLES = [
    ("blank column", ["t,v", *(r.split(",")[0] + "," for r in ROWS)], "no number"),
    ("NaN column", ["t,v", *(r.split(",")[0] + ",nan" for r in ROWS)], "no number"),
    ("half blank", ["t,v", *(r if i % 2 else r.split(",")[0] + "," for i, r in enumerate(ROWS))], "lack a number"),
    ("text", ["t,v", *(r.split(",")[0] + ",fast" for r in ROWS)], "v"),
    ("no column", ["t,w", *ROWS], "no column 'v'"),
    ("two fish", ["t,v,fish", *(f"{row},{'AB'[k > 19]}" for k, row in enumerate(ROWS))], "several trials or robots in one file"),
    ("back", ["t,v", *ROWS[:20], *ROWS[5:]], "time does not rise"),
    ("huge", ["t,v", *ROWS[:5], "2.6,1e9", *ROWS[6:]], "is the unit in [columns] right?"),
    ("unit row", ["t,v", "s,cm/s", *ROWS], "is in cm/s, and [columns] speed says m/s"),
    ("short", ["t,v", *ROWS[:3]], "rows"),
    ("still", ["t,v", *(f"{0.5 * k},0.001" for k in range(30))], "motion ahead"),
    ("empty", [], "empty"),
    ("no rows", ["t,v"], "no rows"),
    ("long", ["t,v", *(f"{500 * k},{2 / (1 + 0.1 * k):.3f}" for k in range(30))], "is the unit of t right?"),
    ("binary", ["\0\1\2"], "binary"),
]


@pytest.mark.parametrize("rows, words", [t[1:] for t in TABLES], ids=[t[0] for t in TABLES])
def test_a_damaged_table_is_one_clear_error(tmp_path, capsys, rows, words):
    machines.coasts(tmp_path / "logs", runs=3)
    (tmp_path / "logs" / "c2.csv").write_text("\n".join(rows))
    assert len(refused(capsys, study(tmp_path, COAST), words, "c2.csv")) == 1


def servo_tables(folder, change):
    rng = np.random.default_rng(0)
    (folder / "logs").mkdir()
    for gain in (1, 2):
        rows = machines.servo(rng, lambda t: 0.3 * np.sin(3 * t), gain, seconds=1.0, noise=0.0)
        rows[:, 1:3] = np.degrees(rows[:, 1:3])
        rows[:, 3] *= 1000
        machines.write(folder / "logs" / f"sine_g{gain}.csv", "time,goal,angle,pwm", change(rows))


def column(i, value):
    def change(rows):
        rows[:, i] = value(rows[:, i])
        return rows

    return change


@pytest.mark.parametrize(
    "change, words",
    [
        (column(3, lambda d: 900.0 + 0 * d), "the gain cannot be determined"),  # another make: always at its largest duty
        (column(3, lambda d: 0 * d), "the duty is 0 in all logs"),
        (column(3, lambda d: -d), "turn a sign"),
        (column(1, lambda g: 1e7 + 0 * g), "is the unit in [columns] right?"),
    ],
    ids=["saturated", "no duty", "sign", "range"],
)
def test_a_servo_whose_gain_cannot_be_told_is_one_clear_error(tmp_path, capsys, change, words):
    servo_tables(tmp_path, change)
    assert len(refused(capsys, study(tmp_path, SERVO), words)) == 1


def test_a_servo_without_a_duty_needs_its_gain(tmp_path, capsys):
    servo_tables(tmp_path, lambda rows: rows)
    bare = ('duty = { column = "pwm", scale = 0.001 }\n', "")
    refused(capsys, study(tmp_path, SERVO, bare), "has no duty")
    ready = built(read_study(study(tmp_path, SERVO, bare, ("stall = 1.0", "stall = 1.0, gain = 2.0, duty = 0.9"))))
    assert ready.learn[0].commands[0, 3:].tolist() == [2.0, 0.9]
    told = built(read_study(study(tmp_path, SERVO)))
    assert [r.commands[0, 3] for r in told.learn] == pytest.approx([1.0, 2.0], rel=1e-3)


def test_the_servo_is_cut_into_runs_that_start_where_it_was(tmp_path):
    servo_tables(tmp_path, lambda rows: rows)
    ready = built(read_study(study(tmp_path, SERVO, ("search", "prediction = { horizon = 0.25 }\nsearch"))))
    runs = [r for r in ready.learn if r.group == "gain2"]
    assert [r.name for r in runs] == [f"sine_g2 {k}" for k in (1, 2, 3)] and all(r.joint.t[0] == 0 for r in runs)
    row = ready.plant.null.copy()
    row[:3] = 0.8 / 1.0, 0.03 / 0.02, 0.003 / 0.002  # what the machine is
    assert ready.error(ready.learn, row) < (2e-3) ** 2


HOSTILE = '"><img src=x onerror=alert(1)>'


def test_hostile_names_reach_no_page_and_no_path(coasting, tmp_path, capsys):
    logs = tmp_path / "logs"
    logs.mkdir()
    for i, path in enumerate(sorted((coasting / "logs").iterdir())[:5]):
        (logs / f"{HOSTILE[:12]}{i}\u202e$x_.csv").write_text(path.read_text())
    about = ('plant = "coast"', f"plant = \"coast\"\nabout = '{HOSTILE}'")
    code, figures, _ = ran(capsys, study(tmp_path, COAST, about), "--out", str(tmp_path / "out"))
    page = (tmp_path / "out" / "report.html").read_text()
    assert code == 0 and "<img" not in page and "\u202e" not in page and "&lt;img" in page
    assert all(g.isprintable() for g in figures["groups"]) and len(figures["groups"]) == 5
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["report.html", "report.json"]


def test_a_hostile_template_of_names_is_refused(coasting, tmp_path, capsys):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / ("_" * 200 + ".csv")).write_text((coasting / "logs" / "c1.csv").read_text())
    many = "".join(f"{{p{k}}}_" for k in range(30)) + "x"
    refused(capsys, study(tmp_path, COAST, ('folder = "logs"', f'folder = "logs", names = "{many}"')), "does not fit the file")


def test_links_out_of_the_folder_are_not_followed(coasting, tmp_path, capsys):
    machines.coasts(tmp_path / "logs", runs=2)
    (tmp_path / "logs" / "far.csv").symlink_to(coasting / "logs" / "c1.csv")
    assert [log.name for log in logs_of(read_study(study(tmp_path, COAST)))] == ["c1", "c2"]


@pytest.mark.parametrize("plant", PLANTS)
def test_the_template_of_a_plant_is_a_study_and_is_not_written_over(plant, tmp_path, capsys):
    path = tmp_path / "new.toml"
    assert console.run(main, ["--new", str(path), "--plant", plant]) == 0
    assert read_study(path).given.plant == plant and path.read_text() == (TEMPLATES / f"{plant}.toml").read_text()
    optional = {"held_out", "candidates", "prediction", "search"} - ({"prediction"} if plant == "body" else set())
    checked({k: v for k, v in tomllib.loads(path.read_text()).items() if k not in optional}, "x", tmp_path)
    assert console.run(main, ["--new", str(path), "--plant", plant]) == console.BAD_INPUT
    assert "exists; name another file" in capsys.readouterr().err


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["tail_fish", "--study", "x.toml"],
        ["--new", "x.toml"],
        ["--study", "x.toml", "--plant", "body"],
        ["usv_coastdown", "--seed", "1"],
    ],
)
def test_the_command_line_refuses_what_it_cannot_mean(argv, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert console.run(main, argv) == console.BAD_INPUT
    err = capsys.readouterr().err
    assert "gap measured" in err and "Traceback" not in err


def test_the_exact_test_says_no_less_than_its_groups_allow():
    for n in (2, 4, 5, 9):
        better = np.arange(1.0, n + 1)
        assert significance.exact_p(2 * better, better) == significance.smallest_p(n) == 0.5**n
    mixed = np.array([1.0, 1.0, -1.0, -1.0])
    assert significance.exact_p(2 + mixed, np.full(4, 2.0)) == pytest.approx(11 / 16)  # sums of at least 0: 6 + 4 + 1 of 16
    assert significance.exact_p(np.ones(1), np.zeros(1)) == 1.0
    assert significance.smallest_p(significance.LEAST_GROUPS) <= significance.LEVEL < significance.smallest_p(4)


def test_the_jackknife_covers_a_mean_as_often_as_it_says():
    rng, held = np.random.default_rng(0), 0
    for _ in range(400):
        x = rng.normal(3.0, 1.0, 8)
        low, high = significance.jackknife(np.array([np.delete(x, i).mean() for i in range(8)]), x.mean())
        held += low < 3.0 < high
    assert 0.86 <= held / 400 <= 0.94


def test_sizes_follow_mass_and_length_by_their_units():
    cases = {"N s2/m2": (1, -1), "N s/m": (1, 0), "N m s": (1, 2), "kg": (1, 0), "kg m2": (1, 2), "m/s": (0, 1)}
    cases |= {
        "1": (0, 0),
        "rad": (0, 0),
        "rad/s": (0, 0),
        "N/m": (1, 0),
        "1/m2": (0, -2),
        "N m s/rad": (1, 2),
        "N s3/m3": (1, -2),
    }
    assert {unit: study_build.dimensions(unit) for unit in cases} == cases
    twice = study_build.sized(RIVALS, 2.0, 4.0)
    assert twice[1].parameters[0].high == RIVALS[1].parameters[0].high * 2 / 4 and study_build.sized(RIVALS, 1.0) == list(RIVALS)


def test_runs_with_commands_of_their_own_are_those_with_one_command_each():
    hull = Hull(14.0, 1.5, 0, 0, 0, thrust=20.0, torque=1.2, drag=6.0, sway_drag=0, yaw_drag=1.5)
    plant = PlanarBody(hull, (), RIVALS[-1:], drive="twin")
    commands = np.random.default_rng(0).uniform(-1, 1, (3, 100, 2))
    starts = np.tile([0.0, 0, 0.3, 0.2, 0, 0], (3, 1))
    together = MeanGait("a", "a", 0.02, commands, starts, 2.0, None)
    alone = [MeanGait("a", "a", 0.02, c, starts[:1], 2.0, None) for c in commands]
    ends = plant.ends([together, *alone], plant.null)
    assert np.array_equal(ends[0][0], np.concatenate([e[0] for e in ends[1:]])) and np.ptp(ends[0][0, :, 0]) > 0.01


def test_the_noise_of_the_sensors_is_what_agreement_is(tmp_path):
    """The floor, from the nominal body, against the error that the true body leaves in the records."""
    machines.boats(tmp_path / "logs", days=2, runs=1, seed=5)
    ready = built(read_study(study(tmp_path, BODY)))
    b = machines.BOAT
    row = ready.plant.null.copy()
    row[:4] = b["thrust"] / 15, b["torque"] / 1.0, b["drag"] / 8, b["yaw_drag"] / 2
    assert 0.6 < ready.error(ready.learn, row) / ready.floor < 1.5


def test_a_path_is_not_told_across_a_gap(tmp_path):
    machines.boats(tmp_path / "logs", days=1, settings=(0.4, 0.7))
    whole = built(read_study(study(tmp_path, BODY)))
    path = tmp_path / "logs" / "d1_s40_1.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:100], *lines[130:]]))
    holed = built(read_study(study(tmp_path, BODY)))
    runs = lambda s: len(next(r for r in s.learn if r.group == "d1_setting40").starts)
    assert 0 < runs(holed) < runs(whole)
