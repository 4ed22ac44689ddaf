"""Physical checks: what no swimming robot does is found, what every robot does passes."""

from argparse import Namespace
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from turning_fish import changed, names, turning

from fishmj.base import console
from fishmj.base.calib import calib_folder
from fishmj.base.errors import LogError
from fishmj.gap.calibrate.commands import open_logs
from fishmj.gap.commands.admission import admitted, unphysical
from fishmj.gap.records.datasets import readable_trials
from fishmj.log import Trial, physical_checks, read_dataset, read_trial, unread_rows, write_dataset, write_trial
from fishmj.log.__main__ import main as log
from fishmj.log.dataset import read_bundle
from fishmj.log.trial_check import Plausible
from fishmj.mjcf.reading import load_robot

ROOT = Path(__file__).resolve().parent.parent
COUNT = np.radians(0.24)


def shipped(name: str) -> Trial:
    return read_trial(calib_folder() / "trials" / name)


def frozen(values):
    """A tracker that stops for 3 s."""
    return np.where((np.arange(len(values)) >= 200) & (np.arange(len(values)) < 350), values[200], values)


def levels(trial: Trial) -> dict[str, str]:
    return {finding.check: finding.level for finding in physical_checks.examine(trial)}


def test_shipped_calibration_trials_pass_every_check():
    found = {trial.name: names(trial) for trial in read_dataset(calib_folder() / "trials")}
    assert len(found) == 27 and not any(found.values()), found


def test_trials_of_the_flow_solver_with_hidden_effects_pass_every_check():
    for bundle in sorted((ROOT / "data" / "gap" / "lbm" / "planted").glob("*.npz"))[:6]:
        for trial in read_bundle(bundle):
            assert names(trial) == {}, (bundle.name, trial.name)


@pytest.mark.slow
def test_generated_trials_of_every_excitation_pass_every_check():
    from fishmj.gap.laboratory import generators
    from fishmj.gap.laboratory.virtual_robot import generate
    from fishmj.log import excitation

    runs = list(excitation.names())
    trials = [t for family in generators.NAMES for t in generators.generate(family, {}, runs, 5)]
    assert {t.name: names(t) for t in [*trials, *generate({}, runs, 5)] if names(t)} == {}


def test_the_turning_fish_of_these_tests_passes():
    assert names(turning()) == {}


def missed(values, every: int, reading: float, rows: int = 1):
    """Every so many rows the driver returns a number of its own."""
    out = np.array(values, float)
    for i in range(every, len(out) - rows, every):
        out[i : i + rows] = reading
    return out


@pytest.mark.parametrize("reading", [(-1 - 500) * COUNT, -500 * COUNT, (65535 - 500) * COUNT, 0.0])
@pytest.mark.parametrize("rows", [1, 2])
def test_failed_reads_are_left_out_and_counted(reading, rows):
    trial = turning()
    bad = changed(trial, "joint", j2=lambda v: missed(v, 23, reading, rows))
    mended, notes = physical_checks.without_failed_reads(bad)
    kept = np.isin(trial.tables["joint"]["t"], mended.tables["joint"]["t"])
    assert np.abs(mended.tables["joint"]["j2"] - trial.tables["joint"]["j2"][kept]).max() < 0.1
    assert kept.mean() > 0.85 and "failed reads of j2" in notes[0] and "rad/s" in notes[0]
    assert levels(bad)["failed read"] == physical_checks.USE and names(mended) == {}


def test_one_spike_that_no_servo_reaches_is_a_failed_read():
    bad = changed(turning(), "joint", j1=lambda v: np.where(np.arange(len(v)) == 100, v + 1.1, v))
    mended, notes = physical_checks.without_failed_reads(bad)
    assert len(mended.tables["joint"]["t"]) == len(bad.tables["joint"]["t"]) - 1 and "j1 1 times" in notes[0]


def test_steps_of_a_servo_are_no_failed_reads():
    """A square wave at 7 rad/s, 10 rows a second: corners stand out, and are real."""
    t = np.arange(0, 20, 0.1)
    q = np.interp(t % 2.0, [0.0, 0.1, 1.0, 1.1, 2.0], [-0.35, 0.35, 0.35, -0.35, -0.35])
    trial = Trial({"origin": "measured"}, {"joint": {"t": t, "j1": np.round(q / COUNT) * COUNT}}, name="square")
    assert physical_checks.without_failed_reads(trial)[1] == [] and names(trial) == {}


@pytest.mark.parametrize(
    ("change", "check", "level", "said"),
    [
        (("pose", {"yaw": lambda v: np.pi / 2 - v}), "heading", "import", "sign = -1 and a zero of 90 deg"),
        (("pose", {"yaw": lambda v: -v}), "heading", "import", "sign = -1 and a zero of 0 deg"),
        (("pose", {"yaw": lambda v: v + np.pi / 2}), "heading", "import", "a zero that is 90 deg more"),
        (("pose", {"yaw": lambda v: v + np.pi}), "heading", "import", "a zero that is"),
        (("pose", {"yaw": np.degrees}), "heading", "import", 'unit = "deg"'),
        (("pose", {"yaw": lambda v: np.degrees(v - v.mean())}), "heading", "import", "yaw turns at"),
        (("pose", {"yaw": lambda v: v / 2 / np.pi % 1}), "heading", "import", "is in turns. In the map give columns.yaw unit ="),
        (("pose", {"yaw": lambda v: (v / np.pi + 1) % 2 - 1}), "heading", "import", 'unit = "rev" and scale = 0.5'),
        (("pose", {"x": lambda v: np.where(np.arange(len(v)) > 300, v + 0.25, v)}), "lost pose", "use", "x jumps by 0.25 m"),
        (("pose", {"x": lambda v: 100 * v, "y": lambda v: 100 * v}), "lost pose", "use", "the fish moves at 19.9 m/s"),
        (("pose", {"yaw": lambda v: -v, "y": lambda v: -v}), "handedness", "use", "picture is mirrored"),
        (("joint", {"j2": lambda v: -v}), "joint sign", "import", "columns.j2"),
        (("joint", {"j3": lambda v: 0 * v + 0.01}), "standing still", "use", "j3 stands still"),
        (("joint", {"j1": lambda v: np.where(np.arange(len(v)) > 300, v + 2 * np.pi, v)}), "joint speed", "import", "unwrap"),
        (("joint", {"j2": lambda v: np.where(np.arange(len(v)) % 20 == 7, np.roll(v, 1), v)}), "stale reading", "note", "j2"),
        (("joint", {"j2": lambda v: np.where(np.arange(len(v)) > 300, v[300], v)}), "standing still", "use", "lose its power"),
        (("joint", {"j2": lambda v: 3 * v}), "joint scale", "use", "j2 moves by 2.8"),
        (("cmd", {"c2": lambda v: 11.4 * v}), "joint scale", "use", "j2 moves by 0.083"),
        (("pose", dict.fromkeys(("x", "y", "yaw"), frozen)), "stale reading", "use", "repeat their values for 2.98 s, first at"),
        (("joint", {"j1": lambda v: np.where(np.arange(len(v)) % 2, 1.05 * np.roll(v, -9), v)}), "two sources", "import", "j1"),
        (("pose", {"x": lambda v: np.where(np.arange(len(v)) % 2, v + 0.3, v)}), "two sources", "import", "x alternates"),
        (("pose", {"yaw": lambda v: 0 * v + 0.4}), "heading", "use", "heading of the camera"),
        (("pose", {"yaw": lambda v: np.where(np.arange(len(v)) > 300, v + np.pi, v)}), "lost pose", "use", "tail for the head"),
    ],
)
def test_what_no_swimming_robot_does_is_told_with_its_remedy(change, check, level, said):
    table, columns = change
    bad = changed(turning(rate=0.4), table, **columns)
    assert levels(bad).get(check) == level and said in names(bad)[check], names(bad)


@pytest.mark.parametrize("late", [0, 3])
def test_an_echo_of_the_commands_is_no_measurement_of_the_joints(late):
    trial = turning()
    sent = trial.tables["cmd"]
    echo = changed(trial, "joint", j2=lambda v: np.r_[np.zeros(late), sent["c2"][: len(v) - late]])
    assert levels(echo) == {"stale reading": physical_checks.NOTE} and "j2: equal to the command" in names(echo)["stale reading"]
    assert names(replace(echo, meta={**echo.meta, "plausible": {"stale": 1.0}})) == {}


def test_a_heading_that_never_changes_in_a_swim_is_doubted():
    blank = changed(shipped("swim_gait_1"), "pose", yaw=lambda v: 0 * v + 0.1)
    assert levels(blank)["heading"] == physical_checks.NOTE and "is the heading not measured?" in names(blank)["heading"]


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        ({"x": 0.0, "y": 0.0, "yaw": 0.0}, slice(200, 210)),  # a tag that is not seen is at the origin
        ({"x": -1.0, "y": -1.0, "yaw": -0.017}, slice(200, 290)),  # longer than a second, one pose all along
        ({"x": 9.0}, slice(300, 302)),
        ({"x": 0.0, "y": 0.0, "yaw": 0.0}, slice(0, 60)),  # until it is seen first
        ({"yaw": None}, slice(400, 430)),  # head and tail taken for each other
    ],
)
def test_rows_in_which_the_fish_was_lost_are_left_out(columns, rows):
    trial = changed(turning(), "pose", x=lambda v: v + 2.0, y=lambda v: v + 1.5)
    pose = {name: np.array(v) for name, v in trial.tables["pose"].items()}
    for name, value in columns.items():
        pose[name][rows] = pose[name][rows] + np.pi if value is None else value
    mended, notes = physical_checks.without_failed_reads(replace(trial, tables={**trial.tables, "pose": pose}))
    kept = np.delete(np.arange(len(pose["t"])), rows)
    assert all(np.array_equal(mended.tables["pose"][name], trial.tables["pose"][name][kept]) for name in pose), notes
    assert "the fish was lost" in notes[0] and names(mended) == {}


@pytest.mark.parametrize("rows", [slice(200, 203), slice(200, 212), slice(200, 290)])
def test_a_heading_that_a_tracker_filled_in_is_left_out(rows):
    """Near the fish's own heading, too, and while its x and y go on; a heading in whole degrees stands as long."""
    trial = turning()
    yaw = np.array(trial.tables["pose"]["yaw"])
    yaw[rows] = yaw[rows].mean() - 0.6
    mended, notes = physical_checks.without_failed_reads(changed(trial, "pose", yaw=lambda v: yaw))
    kept = np.delete(np.arange(len(yaw)), rows)
    assert np.array_equal(mended.tables["pose"]["yaw"], trial.tables["pose"]["yaw"][kept])
    assert f"the fish was lost in yaw {len(yaw) - len(kept)} times" in notes[0]
    coarse = changed(trial, "pose", yaw=lambda v: np.radians(np.round(np.degrees(v))))
    assert physical_checks.without_failed_reads(coarse) == (coarse, [])


def test_held_camera_values_are_read_once_with_a_note(tmp_path):
    trial = shipped("water_square_1")
    held = changed(
        trial, "pose", **{name: lambda v: v[np.arange(len(v)) // 5 * 5] for name in trial.tables["pose"] if name != "t"}
    )
    write_trial(tmp_path / "set" / "water_square_1", held)
    found = readable_trials(tmp_path / "set")
    pose = found.trials["water_square_1"].tables["pose"]
    assert np.array_equal(pose["t"], trial.tables["pose"]["t"][::5]) and np.array_equal(
        pose["yaw"], trial.tables["pose"]["yaw"][::5]
    )
    assert any("pose: each value stands in 5 rows: 10 Hz written at 50 Hz; its first row is kept" in n for n in found.notes)


def test_noise_quick_turns_and_fixes_that_hold_are_no_lost_poses():
    trial, draw = turning(rate=2.5), np.random.default_rng(3)
    noisy = changed(trial, "pose", x=lambda v: v + 0.01 * draw.normal(size=len(v)), yaw=lambda v: np.angle(np.exp(1j * v)))
    held = changed(trial, "pose", **{name: lambda v: v[np.arange(len(v)) // 50 * 50] for name in ("x", "y", "yaw")})
    for good in (trial, noisy, held):
        assert physical_checks.without_failed_reads(good) == (good, [])


@pytest.mark.parametrize("fast", [25 / 30, 30 / 25])
def test_frames_counted_at_another_rate_show_in_a_steady_beat(fast):
    trial = shipped("swim_gait_1")
    other = changed(trial, "pose", t=lambda t: t / fast)
    assert levels(other) == {"handedness": physical_checks.USE} and levels(trial) == {}
    assert f"frames a second right? Its stamps times {fast:.2g}" in names(other)["handedness"]


@pytest.mark.parametrize("name", ["swim_gait_1", "water_square_1", "swim_gait_slow_2"])
def test_a_mirrored_camera_shows_in_straight_swims(name):
    mirrored = changed(shipped(name), "pose", y=lambda v: -v, yaw=lambda v: -v)
    assert levels(mirrored) == {"handedness": physical_checks.USE} and "half a beat late" in names(mirrored)["handedness"]
    without = replace(mirrored, tables={k: v for k, v in mirrored.tables.items() if k != "joint"})
    assert levels(without) == {"handedness": physical_checks.USE}, "commands alone tell it as well"


def rejoined(trial: Trial, order: tuple[int, ...], sign: tuple[int, ...] = (1, 1, 1)) -> Trial:
    """A trial whose columns of joints, commanded and measured, are exchanged or count the other way."""
    at = {n: trial.tables[n] for n in ("cmd", "joint")}
    new = {n: {"t": c["t"], **{f"{n[0]}{k + 1}": sign[k] * c[f"{n[0]}{o}"] for k, o in enumerate(order)}} for n, c in at.items()}
    return replace(trial, tables={**trial.tables, **new})


@pytest.mark.parametrize("trial", [turning(), shipped("swim_gait_1"), shipped("swim_gait_slow_2")])
def test_a_wave_that_runs_to_the_head_of_a_fish_that_swims_ahead_shows(trial):
    tail_first = names(rejoined(trial, (3, 2, 1)))["wave"]
    assert "its wave runs to the head (j2 5" in tail_first and "deg before j1" in tail_first
    assert levels(rejoined(trial, (3, 2, 1))) == levels(rejoined(trial, (1, 2, 3), (1, -1, 1))) == {"wave": physical_checks.USE}
    for part in (rejoined(trial, (2, 1, 3)), rejoined(trial, (1, 2, 3), (1, 1, -1))):
        assert levels(part) == {"wave": physical_checks.NOTE}, "between two of the joints it runs to the tail"


def test_one_joint_a_short_log_or_joints_in_step_tell_no_wave():
    back = rejoined(turning(), (3, 2, 1))
    short = {n: {c: v[:125] for c, v in columns.items()} for n, columns in back.tables.items()}
    one = {**back.tables, "cmd": {"t": back.tables["cmd"]["t"], "c1": back.tables["cmd"]["c1"]}}
    one["joint"] = {"t": back.tables["joint"]["t"], "j1": back.tables["joint"]["j1"]}
    step = changed(back, "joint", **{f"j{k}": lambda v: back.tables["joint"]["j1"] for k in (1, 2, 3)})
    held = changed(back, "joint", j2=lambda v: 0 * v)  # the two others still tell it
    assert "j3 114 deg before j1" in names(replace(held, tables={n: c for n, c in held.tables.items() if n != "cmd"}))["wave"]
    for trial in (replace(back, tables=short), replace(back, tables=one), step):
        assert "wave" not in names(trial)
    assert names(replace(back, meta={**back.meta, "plausible": {"wave": 1.1}})) == {}


@pytest.mark.parametrize("joints", [0, 1, 3])
def test_a_heading_turned_round_shows_in_a_turn_with_side_slip(joints):
    trial = turning(rate=0.6)
    keep = {n: {c: v for c, v in trial.tables[n].items() if c == "t" or int(c[1:]) <= joints} for n in ("cmd", "joint")}
    bent = {n: {c: v + 0.5 * (c != "t") for c, v in columns.items()} for n, columns in keep.items()}
    slipping = replace(trial, tables={**(bent if joints else {}), "pose": trial.tables["pose"]})
    slipping = changed(slipping, "pose", yaw=lambda v: v + 0.55)
    assert names(slipping) == {}
    reversed_ = changed(slipping, "pose", yaw=lambda v: v + np.pi)
    assert levels(reversed_)["heading"] == "import" and "the heading is offset" in names(reversed_)["heading"]
    assert "where a current carries the fish, state it as flow" in names(reversed_)["heading"]


def test_a_straight_swim_beside_its_heading_is_noted_not_refused():
    off = changed(turning(rate=0.0), "pose", yaw=lambda v: v + np.pi / 2)
    assert levels(off)["heading"] == physical_checks.NOTE and "or a current carries it" in names(off)["heading"]


def test_a_stream_that_is_said_to_be_unknown_decides_nothing_about_the_heading():
    """A fish that holds its place in a stream moves over ground to any side of its heading."""
    wanders = changed(turning(), "pose", yaw=lambda v: 0 * v + 0.4)
    of = lambda known: replace(wanders, meta={**wanders.meta, "flow": {"speed": 0.0, "direction": 0.0, "known": known}})
    assert "is it the heading" in names(of(True))["heading"] and "heading" in names(wanders)
    assert "heading" not in names(of(False))


def test_a_held_or_resting_fish_is_no_stopped_tracker():
    resting = changed(turning(), "cmd", **{f"c{i}": lambda v: np.where(np.arange(len(v)) < 250, v[0], v) for i in (1, 2, 3)})
    still = dict.fromkeys(("x", "y", "yaw"), lambda v: np.where(np.arange(len(v)) < 250, v[0], v))
    resting = changed(replace(resting, tables={k: v for k, v in resting.tables.items() if k != "joint"}), "pose", **still)
    held = changed(turning(), "pose", **dict.fromkeys(("x", "y", "yaw"), lambda v: 0 * v + 1))
    assert "stale reading" not in names(resting) | names(held)


def test_a_fish_that_lies_still_tells_nothing():
    still = changed(turning(), "pose", x=lambda v: 0 * v, y=lambda v: 0 * v, yaw=lambda v: 0 * v)
    assert names(still) == {}
    drifting = changed(turning(), "joint", **{f"j{k}": lambda v: 0 * v for k in (1, 2, 3)})
    drifting = changed(drifting, "cmd", **{f"c{k}": lambda v: 0 * v for k in (1, 2, 3)})
    assert "handedness" not in names(changed(drifting, "pose", y=lambda v: -v, yaw=lambda v: -v))


def test_odd_tables_and_meta_data_are_no_fault_of_the_checks():
    """One row, a pause of years, meta data of another kind: nothing to tell, and nothing raised."""
    short = {name: {c: v[:1] for c, v in table.items()} for name, table in turning().tables.items()}
    meta = {"origin": "measured", "push": "yes", "flow": {"speed": "fast", "direction": None}}
    assert names(Trial(meta, short)) == {} and names(Trial(meta, {})) == {}
    late = turning()
    away = {n: {**c, "t": np.where(np.arange(len(c["t"])) > 300, c["t"] + 9e8, c["t"])} for n, c in late.tables.items()}
    assert "handedness" not in names(replace(late, tables=away))
    mixed = replace(turning(), tables={**turning().tables, "joint": {c: v[:1] for c, v in turning().tables["joint"].items()}})
    assert names(mixed) == {}


def test_a_trial_relaxes_a_check_by_its_bound():
    bad = changed(turning(), "pose", yaw=lambda v: np.pi / 2 - v)
    assert "heading" not in names(replace(bad, meta={**bad.meta, "plausible": {"course": 4.0}}))
    assert {check.bound for check in physical_checks.CHECKS} <= {f.name for f in fields(Plausible)}


def test_the_guide_lists_every_check_with_its_bound():
    guide = (ROOT / "docs" / "search" / "logs.md").read_text(encoding="utf-8")
    for check in physical_checks.CHECKS:
        assert any(line.startswith(f"| {check.name} |") and f"`{check.bound}`" in line for line in guide.splitlines()), check.name


def test_a_recording_under_two_names_is_compared_once(tmp_path):
    measured = replace(turning(), meta={"origin": "measured", "robot": "swift"})
    found = readable_trials(saved(tmp_path / "data", measured, replace(measured, name="copy")))
    (left,) = found.broken.values()
    assert len(found.trials) == 1 and "exactly the readings of" in left


# The four doors.


def saved(folder: Path, *trials: Trial) -> Path:
    return write_dataset(folder, {trial.name: trial for trial in trials})


def mirrored(trial: Trial) -> Trial:
    return changed(trial, "pose", y=lambda v: -v, yaw=lambda v: -v)


def test_log_check_says_each_breach_and_exits_1(tmp_path, capsys):
    data = saved(tmp_path / "data", mirrored(turning()), replace(turning(), name="good"))
    assert console.run(log, ["check", str(data)]) == console.FAILED_CHECK
    said = capsys.readouterr()
    assert "turning: pose: the head swings with the tail" in said.err and "good: pose" not in said.err
    assert "1 not physical" in said.out


def test_an_import_refuses_a_compass_heading_and_says_the_maps_line(tmp_path, capsys):
    trial = turning()
    p = trial.tables["pose"]
    rows = np.column_stack([p["t"], p["x"], p["y"], (90 - np.degrees(p["yaw"])) % 360])
    np.savetxt(tmp_path / "rov.csv", rows, delimiter=",", header="time_s,x_m,y_m,yaw_deg", comments="", fmt="%.5f")
    rest = ["--out", str(tmp_path / "set"), "--columns", str(tmp_path / "map.toml")]
    lines = '[tables.pose]\nt = { column = "time_s", unit = "s" }\ncolumns.x = "x_m"\ncolumns.y = "y_m"\n'
    (tmp_path / "map.toml").write_text(lines + 'columns.yaw = { column = "yaw_deg", unit = "deg" }\n')
    assert console.run(log, ["import", str(tmp_path / "rov.csv"), *rest]) == console.BAD_INPUT
    assert "columns.yaw sign = -1 and a zero of 90 deg" in capsys.readouterr().err
    (tmp_path / "map.toml").write_text(lines + 'columns.yaw = { column = "yaw_deg", unit = "deg", sign = -1, zero = 90 }\n')
    assert console.run(log, ["import", str(tmp_path / "rov.csv"), *rest]) == console.OK
    yaw = read_trial(tmp_path / "set" / "rov").tables["pose"]["yaw"]
    assert np.abs(np.angle(np.exp(1j * (yaw - p["yaw"])))).max() < 1e-3


def test_failed_reads_beyond_half_a_turn_are_not_mistaken_for_degrees(tmp_path):
    bad = changed(turning(), "joint", j2=lambda v: missed(v, 50, 3.0))
    folder = write_trial(tmp_path / "trial", bad, form="csv")
    text = (folder / "joint.csv").read_text().replace(",3.0,", ",274.5,").replace(",3,", ",274.5,")
    (folder / "joint.csv").write_text(text)
    with pytest.raises(LogError, match=r"is 274.5 rad in single rows; .* rows to leave out, failed reads of j2"):
        read_trial(folder)


def test_a_search_refuses_a_mirrored_camera_in_one_line_before_any_run(tmp_path):
    data = saved(tmp_path / "data", *(replace(mirrored(shipped(n)), name=n) for n in ("swim_gait_1", "swim_gait_slow_1")))
    with pytest.raises(LogError, match=r"trial swim_gait_1: .*mirrored.*and 1 more trials: swim_gait_slow_1.*--anyway") as told:
        admitted(data, load_robot("fish"), "fish", agreed=False)
    assert "\n" not in str(told.value)
    assert len(admitted(data, load_robot("fish"), "fish", agreed=False, anyway=True)[0].trials) == 2


def test_a_search_leaves_failed_reads_out_with_a_note(tmp_path):
    bad = changed(shipped("swim_gait_1"), "joint", j2=lambda v: missed(v, 25, -2.098))
    data = saved(tmp_path / "data", replace(bad, name="a"), replace(shipped("swim_gait_2"), name="b"))
    given, notes = admitted(data, load_robot("fish"), "fish", agreed=False)
    assert len(given.trials["a"].tables["joint"]["t"]) < len(bad.tables["joint"]["t"])
    assert any(note.startswith("a: joint:") and "failed reads of j2" in note for note in notes)
    assert unphysical(given.trials.values()) == ([], [])


def test_doubts_about_a_log_are_printed_and_refuse_no_comparison(tmp_path, capsys):
    doubted = changed(shipped("swim_gait_1"), "pose", yaw=lambda v: v + np.pi)
    certain = mirrored(shipped("swim_gait_2"))
    (breach,), (doubt,) = unphysical([doubted, certain])
    assert "swim_gait_1: pose: the fish moves 180 deg off" in doubt and "swim_gait_2: pose: the head swings" in breach
    data = saved(tmp_path / "data", replace(doubted, name="a"), replace(shipped("swim_gait_2"), name="b"))
    _, notes = admitted(data, load_robot("fish"), "fish", agreed=False)
    assert any("trial a: pose: the fish moves 180 deg off" in note for note in notes)
    assert "or a current carries it" in capsys.readouterr().err
    logs = open_logs(Namespace(data=data, model="fish", same_robot=False), load_robot("fish"))
    assert "or a current carries it" in capsys.readouterr().err and any("trial a: pose" in note for note in logs.notes)


@pytest.mark.parametrize("low", [0.0, -np.pi / 2])
@pytest.mark.parametrize("rate", [0.0, 0.4])
def test_a_heading_folded_into_half_a_turn_is_an_axis(low, rate):
    """It lost its rows as those of a fish that was out of sight, or was called a tail taken for the head."""
    swims = changed(turning(20.0, rate), "pose", yaw=lambda v: v - 2.0 + low)
    assert not len(unread_rows.folds(swims.tables["pose"]))
    axis = changed(swims, "pose", yaw=lambda v: low + (v - low) % np.pi)
    assert physical_checks.without_failed_reads(axis)[1] == []
    assert levels(axis)["heading"] == physical_checks.IMPORT and "it is an axis, folded into 180 deg" in names(axis)["heading"]
    assert "lost pose" not in names(axis)


def test_a_heading_that_turns_back_at_half_a_turn_is_told():
    """Headings by an arc cosine or an arc sine cover half a turn only."""
    for fold, edges in ((np.arccos, np.cos), "at 0 and 180 deg"), ((np.arcsin, np.sin), "at -90 and 90 deg"):
        bad = changed(turning(30.0, 0.3), "pose", yaw=lambda v, f=fold: f[0](f[1](v)))
        assert (
            levels(bad)["heading"] == physical_checks.IMPORT
            and f"turns back where the course goes on, {edges}" in names(bad)["heading"]
        )


def test_a_tail_taken_for_the_head_is_no_folded_heading():
    t = turning().tables["pose"]["t"]
    flipped = changed(turning(), "pose", yaw=lambda v: np.where(t > 6.0, v - np.pi, v))
    assert "did the tracker take the tail for the head" in names(flipped)["lost pose"] and "heading" not in names(flipped)


def test_poses_that_repeat_for_less_than_half_a_second_are_counted():
    swim, t = turning(), turning().tables["pose"]["t"]
    for frame in (
        np.floor(0.8 * np.arange(len(t)) + 1e-9) / 0.8,
        np.where(np.arange(len(t)) % 100 < 15, np.arange(len(t)) // 100 * 100, np.arange(len(t))),
    ):
        shown = np.ceil(frame - 1e-9).astype(int)
        held = changed(swim, "pose", x=lambda v, k=shown: v[k], y=lambda v, k=shown: v[k], yaw=lambda v, k=shown: v[k])
        said = names(held)["stale reading"]
        assert (
            f"{int(np.sum(np.diff(shown) == 0))} of {len(t)} rows repeat the pose of the row before, while the joints move"
            in said
        )
        assert levels(held)["stale reading"] == physical_checks.NOTE
        assert names(replace(held, meta={**held.meta, "plausible": {"stale": 1.0}})) == {}
    rests = {k: {c: (v if c == "t" else v[:1] + 0 * v) for c, v in table.items()} for k, table in swim.tables.items()}
    assert names(replace(swim, tables=rests)) == {}


@pytest.mark.parametrize("every", [2, 5, 60])
def test_poses_on_straight_lines_between_others_are_counted(every):
    """Frames that were filled in, or resampled to the rows of the log; at 60 rows a line only once."""
    swim, rng = turning(), np.random.default_rng(1)
    rows = np.arange(len(swim.tables["pose"]["t"]))
    kept = rows[::every] if every < 60 else np.r_[rows[:200], rows[260:]]
    noisy = {c: (lambda v, s=s: v + rng.normal(0, s, len(v))) for c, s in (("x", 5e-4), ("y", 5e-4), ("yaw", 3e-3))}
    seen = changed(swim, "pose", **noisy)
    filled = changed(seen, "pose", **{c: lambda v: np.round(np.interp(rows, kept, v[kept]), 6) for c in noisy})
    assert names(seen) == {}
    said, least = names(filled)["stale reading"], len(rows) - len(kept) - every
    assert least <= int(said.split()[1]) <= least + 2 * every and "on straight lines between others" in said
    assert levels(filled)["stale reading"] == physical_checks.NOTE
    assert names(replace(filled, meta={**filled.meta, "plausible": {"stale": 1.0}})) == {}


@pytest.mark.parametrize(("seed", "noise"), [(0, 1e-4), (1, 3e-4)])
def test_a_fish_at_rest_in_a_pose_rounded_to_1_mm_lies_on_no_straight_lines(seed, noise):
    """Its joints move, it drifts: neighbours differ by 0 or 1 mm. Filled rows of a swim are found, rounded to 0.1 mm."""
    swim, rng, rows, kept = turning(), np.random.default_rng(seed), np.arange(600), np.arange(0, 600, 5)
    t, blur = swim.tables["pose"]["t"], lambda size: rng.normal(0, size, 600)
    x, y = 1e-4 * (rows + 1) + 0.003 * np.sin(4 * np.pi * t) + blur(noise), 0.003 * np.sin(2 * np.pi * t - 0.7) + blur(noise)
    seen = {"x": x, "y": y, "yaw": 0.015 * np.sin(2 * np.pi * t)}
    assert names(changed(swim, "pose", **{c: lambda _, v=v: np.round(v / 1e-3) * 1e-3 for c, v in seen.items()})) == {}
    filled = {c: lambda v: np.round(np.interp(rows, kept, (v + blur(5e-3))[kept]), 4) for c in seen}
    assert "on straight lines between others" in names(changed(swim, "pose", **filled))["stale reading"]
