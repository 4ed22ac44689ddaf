"""Forms of a laboratory's table that are read wrongly unless they are told: each is refused, asked about or noted by name."""

import lab_files
import numpy as np
import pytest

from fishmj.log import physical_checks
from fishmj.log.importers import table_forms
from fishmj.log.importers.binary_tables import read_parquet
from fishmj.log.unread_rows import lost_poses

ROWS = 400
T = 0.02 * np.arange(ROWS)


@pytest.fixture
def bring(tmp_path, capsys, monkeypatch):
    """Imports columns of numbers or texts: (exit code, stdout and stderr); the data set is tmp_path/set."""
    run = lab_files.importer(tmp_path, capsys, monkeypatch)

    def of(columns: dict, *words):
        cells = [[cell if isinstance(cell, str) else f"{cell:.6f}" for cell in column] for column in columns.values()]
        rows = [",".join(row) for row in zip(*cells, strict=True)]
        (tmp_path / "run.csv").write_text("\n".join([",".join(columns), *rows]) + "\n")
        code, out, err = run(tmp_path / "run.csv", "--yes", *words)
        return code, out + err

    return of


def swim(shift: float = 0.0) -> dict:
    """A swim at 50 Hz under a laboratory's names: s, deg, mm, V."""
    wave = {f"servo{k}_cmd_deg": 20 * np.sin(6 * T - k + shift) for k in (1, 2, 3)}
    read = {f"servo{k}_pos_deg": 20 * np.sin(6 * (T - 0.06) - k + shift) for k in (1, 2, 3)}
    place = {"x_mm": 1200 + 120 * T + 900 * shift, "y_mm": 600 + 5 * np.sin(T), "yaw_deg": 4 * np.sin(6 * T + 1.5)}
    return {"time_s": T, **wave, **read, **place, "batt_V": 7.4 - 0.001 * T}


@pytest.mark.parametrize("mixed", [True, False])
@pytest.mark.parametrize(("column", "names"), [("robot", ("A", "B")), ("fish_id", ("1", "2")), ("trial", ("a", "b"))])
def test_two_robots_or_trials_in_one_file_are_refused(column, names, mixed, bring):
    """Rows of both alternate, or those of the second follow; a column of one value is no sign of two."""
    one, two = swim(), swim(1.0)
    order = np.argsort(np.r_[T, T + 1e-6] if mixed else np.arange(2 * ROWS), kind="stable")
    both = {name: np.r_[one[name], two[name]][order] for name in one}
    told = [names[int(k >= ROWS)] for k in order]
    code, said = bring(both | {column: told})
    assert code == 2 and f"column '{column}' holds 2 values ({names[0]}, {names[1]}): several trials or robots" in said
    assert f"write a file for each, or --set {column}=skip" in said
    assert bring(one | {column: [names[0]] * ROWS})[0] == 0


@pytest.mark.parametrize("coded", [True, False])
@pytest.mark.parametrize("names", [["A", "B"], ["A", "A"], ["A", None]])
def test_names_of_robots_in_a_parquet_file_are_those_of_a_csv(names, coded, tmp_path, capsys, monkeypatch):
    import pyarrow as pa
    import pyarrow.parquet as pq

    told = pa.array([names[k >= ROWS // 2] for k in range(ROWS)])
    pq.write_table(pa.table(swim() | {"robot": told.dictionary_encode() if coded else told}), tmp_path / "run.parquet")
    run = lab_files.importer(tmp_path, capsys, monkeypatch)
    code, _, err = run(tmp_path / "run.parquet", "--yes")
    assert code == (2 if "B" in names else 0), err
    assert ("column 'robot' holds 2 values (A, B): several trials or robots in one file" in err) == ("B" in names)
    assert run(tmp_path / "run.parquet", "--yes", "--set", "robot=skip", out=tmp_path / "one")[0] == 0
    code, _, err = run(tmp_path / "run.parquet", "--write-map", tmp_path / "MAP.toml", out=None)
    assert code == (2 if "B" in names else 0) and ("several trials or robots" in err) == ("B" in names)


def test_a_robot_for_each_episode_is_one_robot_a_trial(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = swim() | {"episode_index": np.arange(ROWS) // (ROWS // 2), "robot": ["A"] * (ROWS // 2) + ["B"] * (ROWS // 2)}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    assert [sheet.apart for sheet in read_parquet(tmp_path / "a.parquet")] == [{}, {}]
    pq.write_table(pa.table(columns | {"robot": ["A", "B"] * (ROWS // 2)}), tmp_path / "b.parquet")
    assert all("holds 2 values (A, B)" in sheet.apart["robot"] for sheet in read_parquet(tmp_path / "b.parquet"))


@pytest.mark.parametrize("kind", [int, str, bytes])
def test_names_of_robots_in_an_npz_are_those_of_a_csv(kind, tmp_path, capsys, monkeypatch):
    run = lab_files.importer(tmp_path, capsys, monkeypatch)
    names = {int: np.array([1, 2]), str: np.array(["A", "B"]), bytes: np.array([b"A", b"B"])}[kind]
    told = names[np.arange(ROWS) // (ROWS // 2)]
    for name, column, code in (("two", told, 2), ("one", told[:1].repeat(ROWS), 0), ("other", told[:7], 0)):
        np.savez(tmp_path / f"{name}.npz", **swim(), fish_id=column)
        got, _, err = run(tmp_path / f"{name}.npz", "--yes", out=tmp_path / f"out_{name}")
        assert got == code and ("holds 2 values (1, 2)" in err or "holds 2 values (A, B)" in err) == (code == 2), err
    assert run(tmp_path / "two.npz", "--yes", "--set", "fish_id=skip", out=tmp_path / "skipped")[0] == 0


@pytest.mark.parametrize("none", ["", "nan", "N/A", "None"])
def test_a_blank_is_no_second_robot(none, bring):
    assert bring(swim() | {"robot": [none if k % 3 else "A" for k in range(ROWS)]})[0] == 0


def test_a_bare_id_may_number_servos(bring):
    """A row for each servo: what to write is a column for each."""
    rows = {"time_s": np.repeat(T, 3), "id": np.tile([1, 2, 3], ROWS), "position_deg": 20 * np.sin(6 * np.repeat(T, 3))}
    code, said = bring(rows)
    assert code == 2 and "several trials, robots or servos in one file; write a file for each, a column for each servo" in said


@pytest.mark.parametrize("column", ["seq", "run_time", "camera_id", "state"])
def test_other_columns_tell_no_robots_apart(column):
    assert not table_forms.several(column, [0.0, 1.0] * 200) and not table_forms.several("id", list(range(400)))


@pytest.mark.parametrize("column", ["run_state", "trial_phase", "take_off", "run_distance_m", "trial_temperature"])
def test_a_part_or_a_quantity_of_a_trial_counts_no_trials(column):
    values = [20.9 + (column == "trial_temperature") * 0.2] * 200 + [22.0] * 200
    values = [0.0] * 200 + [1.0] * 200 if column in ("run_state", "trial_phase", "take_off") else values
    assert not table_forms.several(column, values) and table_forms.several("trial", [0.0] * 200 + [1.0] * 200)


@pytest.mark.parametrize(
    ("lost", "share"), [(np.arange(ROWS) % 20 > 12, 35), (np.arange(ROWS) % 20 < 7, 35), (np.arange(ROWS) % 20 < 16, 80)]
)
def test_of_many_lost_poses_the_user_decides(lost, share, bring, tmp_path, monkeypatch):
    """The fish is out of view a third of the time, from the first row on in one of the logs; they are sought once."""
    columns = swim() | {name: np.where(lost, 0.0, swim()[name]) for name in ("x_mm", "y_mm")}
    code, said = bring(columns)
    assert code == 0 and f"{share} % of all: are two fish in one file?" in said
    made = lab_files.only(tmp_path / "set")
    assert len(made.tables["pose"]["t"]) == ROWS
    searches = []
    monkeypatch.setattr(physical_checks, "lost_poses", lambda *of: searches.append(of) or lost_poses(*of))
    found = physical_checks.examine(made)
    assert len(searches) == 1
    assert (found[0].check, found[0].level) == ("lost pose", physical_checks.USE)
    assert all(f.level != physical_checks.IMPORT for f in found), found
    assert physical_checks.without_failed_reads(made)[0] is made


@pytest.mark.parametrize(
    "lost", [np.arange(ROWS) < 5, np.arange(ROWS) < 90, np.arange(ROWS) >= 310], ids=["short", "first", "last"]
)
@pytest.mark.parametrize("columns", [("x_mm", "y_mm"), ("x_mm", "y_mm", "yaw_deg")])
def test_a_place_that_a_tracker_repeats_at_an_end_is_lost_whatever_the_heading_does(lost, columns, bring, tmp_path):
    """A compass goes on where the camera has not found the fish yet."""
    code, said = bring(swim() | {name: np.where(lost, 0.0, swim()[name]) for name in columns})
    assert code == 0 and f"pose: {lost.sum()} of 400 rows left out, the fish was lost in x {lost.sum()} times (0 first" in said
    assert "was the fish moved" not in said


def digits(seconds: np.ndarray, form: str) -> list[str]:
    """Stamps in the digits of a clock: `{h:02d}{m:02d}{s:02d}.{c:02d}` of hundredths of seconds."""
    ticks = np.round(100 * seconds).astype(int)
    return [form.format(h=k // 360000, m=k // 6000 % 60, s=k // 100 % 60, c=k % 100) for k in ticks.tolist()]


@pytest.mark.parametrize(
    "form", ["{h:02d}{m:02d}{s:02d}.{c:02d}", "20260410{h:02d}{m:02d}{s:02d}.{c:02d}", "{h:02d}{m:02d}{s:02d}{c:02d}0"]
)
def test_the_digits_of_a_clock_are_no_seconds(form, bring):
    stamps = digits(T + 43436, form)
    code, said = bring({"time": stamps, **{k: v for k, v in swim().items() if k != "time_s"}})
    assert code == 2 and "run.csv:202:time: its digits are those of a clock" in said and "12:04:00" in said


@pytest.mark.parametrize("start", [55.0, 775.0, 3595.0])
@pytest.mark.parametrize("form", ["{h:02d}{m:02d}{s:02d}.{c:02d}", "{m:d}{s:02d}.{c:02d}", "{h:d}{m:02d}{s:02d}{c:02d}0"])
def test_the_digits_of_the_first_hour_are_no_seconds(start, form, bring):
    """59 s before 100 s, where the swim goes on; a rest of 40 s after a minute looks alike in the stamps alone."""
    rest = {k: v for k, v in swim().items() if k != "time_s"}
    if start < 3600 - 8 or "h" in form:
        code, said = bring({"time": digits(T + start, form), **rest})
        assert code == 2 and "run.csv:252:time: its digits are those of a clock" in said and "if it is a rest, split" in said
    rng = np.random.default_rng(1)
    noisy = [np.round(v + rng.normal(0, 0.3, ROWS), 2) for v in rest.values()]
    stamps = np.array(digits(T + start, "{h:d}{m:02d}{s:02d}.{c:02d}"), float)
    assert table_forms.clock_digits(stamps, noisy) is not None
    swum = [np.where(T + start % 60 < 60, v, v[::-1]) for v in noisy]  # another swim after the rest
    assert table_forms.clock_digits(stamps, swum) is None


@pytest.mark.parametrize("part", [{"usec": 1e6}, {"us": 1e6}, {"msec": 1e3}, {}])
def test_the_seconds_of_a_minute_go_on_after_it(part, bring, tmp_path):
    """A log that begins at 0 may hold runs of a minute each, so it is refused."""
    for start in (0.0, 55.0):
        t = 0.2 * np.arange(ROWS) + start + 1e-9
        stamps = (
            {"sec": t % 60 // 1, **{name: np.round(size * (t % 1)) for name, size in part.items()}}
            if part
            else {"time_s": t % 60}
        )
        code, said = bring({**stamps, **without("time_s")})
        assert code == (0 if start else 2), said
        assert ("the seconds of a minute begin again 2 times; 60 s added" if start else "Seconds of a minute? Write") in said
    lab_files.near(np.ptp(lab_files.only(tmp_path / "set").tables["cmd"]["t"]), 0.2 * (ROWS - 1))


@pytest.mark.parametrize("start", [0.0, 43436.0, 120359.0, 1.76e9, 20260.0])
@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_counted_time_is_no_clock(start, unit):
    for step in (0.001, 0.01, 0.02, 0.1, 1.0):
        assert table_forms.clock_digits(np.round(unit * (start + step * np.arange(4000)), 3)) is None, step
    paused = 0.02 * np.arange(9000) + 40 * (np.arange(9000) // 3000)  # a swim of a minute, a rest of 40 s
    assert table_forms.clock_digits(paused) is None


@pytest.mark.parametrize("volts", [-1.0, -7.4])
def test_a_supply_below_zero_volts_is_refused(volts, bring):
    code, said = bring(swim() | {"batt_V": np.full(ROWS, volts)})
    assert code == 2 and "run.csv:2:batt_V" in said and f"{volts:g} V, and negative in 400 of 400 rows" in said
    assert bring(swim() | {"batt_V": np.full(ROWS, volts)}, "--set", "batt_V=skip")[0] == 0


@pytest.mark.parametrize("mark", ["-999", "9999", "-9999", "99.99e9", "65535", "-1e30"])
@pytest.mark.parametrize("column", ["servo2_pos", "servo1_cmd", "x_mm", "yaw_deg", "batt_V"])
def test_a_mark_for_no_value_is_blanked_and_named(mark, column, bring):
    columns = {name.replace("_deg", "") if "servo" in name else name: values for name, values in swim().items()}
    columns[column] = [mark if k in (50, 51, 130, 270) else f"{v:.4f}" for k, v in enumerate(columns[column])]
    code, said = bring(columns)
    assert code == 0 and f"column '{column}': {float(mark):.15g} in 4 of 400 cells" in said and "taken for blanks" in said


@pytest.mark.parametrize(("column", "others"), [("batt_V", 7.4), ("yaw_deg", 90.0), ("x_mm", -1500.0), ("servo1_pos_deg", 300.0)])
def test_minus_one_far_from_all_other_values_is_a_mark(column, others):
    values = others + swim()[column] % 1
    values[[50, 51, 130]] = -1.0
    assert table_forms._marks(values) == [-1.0]
    values[60] = -999.0
    assert set(table_forms._marks(values)) == {-999.0, -1.0}


def test_minus_one_of_a_supply_is_blanked_and_named(bring):
    code, said = bring(swim() | {"batt_V": np.where(np.arange(ROWS) % 90 == 7, -1.0, swim()["batt_V"])})
    assert code == 0 and "column 'batt_V': -1 in 5 of 400 cells, others are 7.392 to 7.4: taken for blanks" in said


@pytest.mark.parametrize("least", [0.0, 0.9, 2.0])
def test_minus_one_near_other_values_stays(least):
    """A command of full deflection, a confidence, a heading beside 0; and one of two states."""
    values = least + (98 if least == 2 else 0.1) * np.abs(np.sin(T))
    values[[50, 51]] = -1.0
    assert table_forms._marks(values) == [] and table_forms._marks(np.where(T < 4, -1.0, 200 + T)) == []
    values[60] = -999.0
    assert table_forms._marks(values) == [-999.0]


@pytest.mark.parametrize("lost", [np.arange(ROWS) % 50 == 10, np.arange(ROWS) % 10 > 3])
@pytest.mark.parametrize("every", [1, 5])
def test_a_mark_is_blanked_where_most_cells_are_blanks_or_marks(lost, every, bring, tmp_path):
    """A camera at a fifth of the rate; a fish that is out of view most of the time."""
    x = ["-999" if no else f"{v:.4f}" for no, v in zip(lost, swim()["x_mm"], strict=True)]
    code, said = bring(swim() | {"x_mm": ["" if k % every else cell for k, cell in enumerate(x)]})
    assert code == 0 and "-999 in" in said and lab_files.only(tmp_path / "set").tables["pose"]["x"].min() > 1.0


def test_marks_are_sought_in_few_passes(monkeypatch):
    """Stamps in ns that repeat look like marks one by one."""
    passes, is_mark = [], table_forms._is_mark
    monkeypatch.setattr(table_forms, "_is_mark", lambda *seen: passes.append(seen) or is_mark(*seen))
    assert table_forms._marks(np.repeat(1.76e18 + 2e7 * np.arange(1000), 2)) == [] and len(passes) <= 10


@pytest.mark.parametrize(
    "values",
    [
        np.where(np.arange(400) % 20 < 10, 0.0, 999.0),  # full scale and off
        np.arange(400.0) + 700,  # through 999
        32767 * np.sin(np.arange(400)),
        np.r_[np.linspace(800, 1000, 399), 999.0],
        1.76e9 + T,
        np.where(np.arange(400) % 20 < 12, 999.0, np.round(500 + 100 * np.sin(T))),  # a reading that stays there
    ],
)
def test_no_mark_where_other_values_are_near(values):
    assert table_forms._marks(values) == []


def without(*names: str) -> dict:
    return {name: values for name, values in swim().items() if name not in names}


def long_form() -> dict:
    names = list(without("time_s"))
    return {
        "time": np.repeat(T, len(names)),
        "topic": names * ROWS,
        "value": np.stack([swim()[name] for name in names], 1).ravel(),
    }


CLOCK = T + 43436 + 1e-6
MS = np.round(1e3 * (CLOCK % 1))
BLANK = ["" if k == 77 else f"{k:.0f}" for k in CLOCK // 60 % 60]
FORMS = {
    "clock in columns": (
        {"hour": CLOCK // 3600, "minute": CLOCK // 60 % 60, "second": np.round(CLOCK % 60, 2), **without("time_s")},
        "the clock is in several columns, 'hour', 'minute', 'second': write one column, 3600 h + 60 min + s",
    ),
    "clock in letters": (
        {"hh": CLOCK // 3600, "mm": CLOCK // 60 % 60, "ss": np.round(CLOCK % 60, 2), **without("time_s")},
        "its file has no column of time (the clock is in several columns, 'hh', 'mm', 'ss'",
    ),
    "clock with milliseconds": (
        {"hh": CLOCK // 3600, "mm": CLOCK // 60 % 60, "ss": CLOCK % 60 // 1, "ms": MS, **without("time_s")},
        "unclear: ms: the clock is in several columns, 'hh', 'mm', 'ss', 'ms': write one column, 3600 h + 60 min + s + ms / 1000",
    ),
    "clock with milliseconds in words": (
        {"min": CLOCK // 60 % 60, "sec": CLOCK % 60 // 1, "msec": MS, **without("time_s")},
        "2 column(s) unclear: sec: the clock is in several columns, 'min', 'sec', 'msec'",
    ),
    "clock with microseconds": (
        {"min": CLOCK // 60 % 60, "sec": CLOCK % 60 // 1, "usec": 1e3 * MS, **without("time_s")},
        "2 column(s) unclear: sec: the clock is in several columns, 'min', 'sec', 'usec'",
    ),
    "clock with a blank": (
        {"Minute": BLANK, "Sekunde": np.round(CLOCK % 60, 2), "latency_ms": 5 + 0 * T, **without("time_s")},
        "the clock is in several columns, 'Minute', 'Sekunde': write one column, 3600 h + 60 min + s, ",
    ),
    "long": (long_form(), "column 'topic' names the quantity of each row ('servo1_cmd_deg'"),
    "pairs": (
        {f"{name}={swim()[name][0]:.4f}": [f"{name}={v:.4f}" for v in swim()[name]] for name in swim()},
        "run.csv:1:1: cells of a name and a value",
    ),
    "globe": (
        {"lat": 48.1 + T / 1e6, "lon": 11.5 + T / 1e6, **without("x_mm", "y_mm")},
        "latitude and longitude are angles on the globe: write x and y in m about the first row",
    ),
    "steps": ({"dt": np.full(ROWS, 0.02), **without("time_s")}, "'dt' is the step from row to row; write its running sum"),
    "newest first": ({name: values[::-1] for name, values in swim().items()}, "The newest row comes first: reverse the rows"),
    "unit in cells": (
        {"x": [f"{x:.1f} mm" for x in swim()["x_mm"]], **without("x_mm")},
        "its cells are text, such as '1200.0 mm': write plain numbers and their unit, mm, in its name",
    ),
    "volts in cells": (
        {**without("batt_V"), "batt_V": [f"{v:.2f} V" for v in swim()["batt_V"]]},
        "such as '7.40 V': write plain",
    ),
    "seconds in cells": (
        {"time_s": [f"{t:.2f} s" for t in T], **without("time_s")},
        "'time_s' holds no number, such as '0.00 s'",
    ),
    "no sign": (
        {
            name.replace("_deg", "_cdeg") if name == "servo1_pos_deg" else name: np.round(100 * v) % 65536
            if name == "servo1_pos_deg"
            else v
            for name, v in swim().items()
        },
        "1 column(s) unclear: servo1_pos_cdeg: up to 65525, none from 16384 to 49152: numbers of 16 bits without their sign?",
    ),
}


def test_a_servos_counts_without_their_sign_are_told_beside_the_scale(bring):
    ticks = np.round(800 * np.sin(6 * T)) % 65536
    code, said = bring({**without("servo1_pos_deg"), "servo1_pos_ticks": ticks})
    assert code == 2 and "Subtract 65536 from the large ones; count of a servo. Say the scale" in said


def test_a_gyroscope_without_its_sign_is_noted_where_the_user_said_its_scale(bring):
    raw = {"a_raw": np.sin(T), "b_raw": np.cos(T), "c_raw": np.round(800 * np.sin(6 * T)) % 65536}
    places = {"a_raw": "imu.ax:m/s^2", "b_raw": "imu.ay:m/s^2", "c_raw": "imu.wz:deg/s*0.007"}
    code, said = bring(swim() | raw, *(word for name, place in places.items() for word in ("--set", f"{name}={place}")))
    assert code == 0 and "imu: column 'c_raw' as wz: up to 65534, none from 16384 to 49152" in said


@pytest.mark.parametrize("cell", ["a=1 b=2", "v: 1 w: 2"])
def test_a_table_with_pairs_in_a_column_is_a_table(cell, bring):
    assert bring(swim() | {"note": [cell] * ROWS})[0] == 0


def test_two_columns_of_dates_are_no_pairs(bring):
    dates = [f"2026-04-10T12:03:{t:06.3f}Z" for t in T]
    code, said = bring({"stamp": dates, "received": dates, **without("time_s")}, "--set", "received=skip")
    assert code == 0, said


@pytest.mark.parametrize("form", FORMS)
def test_another_form_is_named_with_its_remedy(form, bring):
    columns, sentence = FORMS[form]
    code, said = bring(columns)
    assert code == 2 and sentence in said, said


@pytest.mark.parametrize(("part", "size"), [("msec", 1e3), ("usec", 1e6), ("nsec", 1e9)])
def test_seconds_and_a_part_of_them_are_one_stamp(part, size, bring, tmp_path):
    whole = np.floor(T + 1e-9)
    code, said = bring({"sec": whole, part: np.round(size * (T - whole)), **without("time_s")})
    assert code == 0, said
    lab_files.near(lab_files.only(tmp_path / "set").tables["cmd"]["t"], T)
