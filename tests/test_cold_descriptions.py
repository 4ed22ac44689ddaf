"""Descriptions by someone who knew the docs and not the code: each mistake is refused in words, each oddity builds and swims."""

import os
import re
from dataclasses import replace
from pathlib import Path

import bad_descriptions
import numpy as np
import pytest

from fishmj.base.calib import resolve
from fishmj.base.errors import ConfigError
from fishmj.mjcf import load_robot
from fishmj.sim import Sim

FISH = resolve("fish").read_text(encoding="utf-8")
CASES, UNUSUAL = bad_descriptions.cases(FISH), bad_descriptions.unusual(FISH)


def refusal(path: Path, shown: str = "") -> str:
    """The message of a refusal, checked: names the file in every line, no control characters, no Python."""
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    lines = str(caught.value).split("\n")
    assert all(line.isprintable() and len(line) < 700 for line in lines), lines
    assert all((shown or str(path)) in line or line.endswith(("more error", "more errors")) for line in lines), lines
    assert not any(word in str(caught.value) for word in ("sys.", "datetime", "Traceback", "0x7f", "Errno")), lines
    return str(caught.value)


@pytest.mark.parametrize("kind", CASES)
def test_a_mistake_is_refused_with_its_file_and_nothing_is_made_of_it(tmp_path, monkeypatch, kind):
    (folder := tmp_path / "empty").mkdir()
    monkeypatch.chdir(folder)
    content = CASES[kind]
    path = tmp_path / "my_fish.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    refusal(path)
    assert sorted(os.listdir(tmp_path)) == ["empty", "my_fish.toml"] and os.listdir(folder) == []
    assert not Path("/tmp/bad_descriptions_was_here").exists()


def test_what_is_no_plain_file_is_refused_and_never_waited_for(tmp_path):
    told = {
        "directory": "is a folder", "fifo": "is no plain file", "symlink_loop": "leads nowhere",
        "symlink_to_nothing": "leads nowhere", "symlink_to_an_endless_device": "is no plain file",
        "sparse_file_of_8_gb": "larger than 1 MB", "not_there": "no such file",
    }  # fmt: skip
    for kind, path in bad_descriptions.places(tmp_path).items():
        shown = "".join(c if c.isprintable() else "?" for c in str(path)[:300])
        assert told.get(kind, "") in refusal(path, shown), kind


@pytest.mark.parametrize("kind", UNUSUAL)
def test_what_is_merely_unusual_builds_and_swims(tmp_path, kind):
    path = tmp_path / "my_fish.toml"
    path.write_bytes(UNUSUAL[kind].encode())
    robot = load_robot(path)
    sim = Sim(robot)
    for _ in range(5):
        sim.step(np.full(robot.n_joints, 0.2))
    assert np.isfinite(sim.data.qpos).all() and np.isfinite(sim.data.qvel).all()


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("battery_in_the_total_only", "1.35 kg, expected the sum of the links' masses, 1.1 kg, within 1 %"),
        ("servo_torque_in_kg_cm", "; 17 kg cm is 1.667 N m"),
        ("servo_speed_in_s_per_60_deg", "; 0.2 s/60 deg is 5.236 rad/s"),
        ("damping_that_the_sheet_does_not_state", "at least 0.318 N m s/rad = torque / speed_no_load"),
        ("fin_span_in_a_mix_of_m_and_cm", "half the fish's length"),
        ("links_tail_first", "the links stand nose first"),
        ("balance_point_below_the_keel", "half its height"),
        ("fitted_water_mistyped", "did you mean 'structured'? Known: structured, fitted"),
        ("water_that_is_a_device", "got '/dev/zero', expected 'structured', 'fitted'"),
        ("spreadsheet_made_a_date_of_it", "got the date 2026-07-01"),
        ("saved_as_utf_16", "is UTF-16 text"),
        ("eighty_thousand_unknown_blocks", "and 81 more errors"),
    ],
)
def test_a_refusal_says_what_to_do(tmp_path, kind, told):
    path = tmp_path / "my_fish.toml"
    path.write_bytes(CASES[kind] if isinstance(CASES[kind], bytes) else CASES[kind].encode())
    message = refusal(path)
    assert told in message


def test_a_mistyped_key_is_one_line(tmp_path):
    path = tmp_path / "my_fish.toml"
    path.write_text(CASES["length_mistyped"])
    message = refusal(path)
    assert "\n" not in message and "lenght: got an unknown key, expected 'length'" in message


NOTED = {
    "heights_that_jump": (("[0.07, 0.052, 0.026]]", "[0.07, 0.150, 0.026]]"), "heights that meet at the hinge"),
    "plate_in_the_middle": (
        ("sections = [[0.0, 0.066,", "fin_from = 0.05\nsections = [[0.0, 0.066,"),
        "a plate on the last link only",
    ),
    "mass_rounded": (("mass_total = 1.1", "mass_total = 1.1002"), "got 1.1002 kg, expected the sum of the links' masses, 1.1 kg"),
    "late": (("camera_latency = 0.065", "camera_latency = 0.5"), "randomised fish .* theirs about it, from 0.465 to 0.535 s"),
    "quick": (("command_latency = 0.060", "command_latency = 0.01"), "randomised fish .* theirs about it, from 0 to 0.06 s"),
    "not_measured": (("camera_latency = 0.065", "camera_latency = 0"), "as if it were not measured, from 0.03 to 0.1 s"),
    "ballast_on_top": ((", 0.0, -0.0", ", 0.0, 0.0"), "mm above the axis on average, .* capsizes"),
}


@pytest.mark.parametrize("kind", NOTED)
def test_what_is_probably_a_mistake_is_said(tmp_path, kind):
    (old, new), told = NOTED[kind]
    path = tmp_path / "my_fish.toml"
    path.write_text(FISH.replace(old, new))
    assert any(re.search(told, note) for note in load_robot(path).notes)


def test_the_default_fishs_damping_is_named_where_none_is_given(tmp_path):
    path = tmp_path / "my_fish.toml"
    path.write_text(
        "\n".join(line for line in FISH.replace("torque = 1.667", "torque = 3.2").split("\n") if not line.startswith("kd"))
    )
    assert "got 0.32 N m s/rad, the default fish's, since none is given" in refusal(path)


def test_numbers_that_differ_are_shown_with_the_digits_in_which_they_do(tmp_path):
    path = tmp_path / "my_fish.toml"
    tail = 'name = "tail"\nlength = 0.18'
    path.write_text(FISH.replace(tail, tail + "0001"))
    assert "from 0 to 0.18 m, expected stations from 0 to length = 0.180001 m" in refusal(path)
    path.write_text(FISH.replace(tail, tail + "0000001"))
    assert load_robot(path).links[3].length == 0.180000001


def test_water_fitted_for_another_robot_is_refused_and_own_water_runs(tmp_path):
    path = tmp_path / "my_fish.toml"
    path.write_text(FISH.replace("[water]\n", '[water]\nmodel = "tendon_fish"\n'))
    with pytest.raises(ConfigError, match="fitted for robot 'tendon_fish'.* another body"):
        Sim(load_robot(path))
    for name in ("fish", "tendon_fish"):
        robot = load_robot(name)
        sim = Sim(replace(robot, water={**robot.water, "model": "fitted"}))
        sim.step(np.full(robot.n_joints, 0.2))
        assert np.isfinite(sim.data.qpos).all()
