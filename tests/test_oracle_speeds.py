"""Free swims over frequency, slip ratio and depth: what was swum is kept, and the fish swims forwards."""

import json
from collections import deque

import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.immersed.markers import PLAIN
from fishmj.lbm_oracle.run import finished_rows
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.finished_rows import FinishedRows
from fishmj.lbm_oracle.run.spread import never_stop
from studies.grid_studies import converge_fish, real_fish, speeds

TINY = Domain(name="tiny", shape=(48, 36, 24), dx=0.02, dt=0.004, sponge=4)
CALL = ["--preset", "laptop", "--frequencies", "2", "--beats", "0.6", "--device", "cpu", "--json"]


@pytest.mark.slow
def test_a_sweep_goes_on_where_it_stopped_and_refuses_another_set_up(tmp_path, monkeypatch, capsys):
    swum, real = [], speeds.start_swim
    monkeypatch.setattr(speeds, "start_swim", lambda key, **setup: swum.append(key) or real(key, **setup))
    call = [*CALL, "--out", str(tmp_path)]
    assert speeds.main([*call, "--slips", "1"]) == console.OK
    assert speeds.main([*call, "--slips", "0.98", "1"]) == console.OK
    assert swum == [(2.0, 30.0, 60.0, 1.0, 0.6), (2.0, 30.0, 60.0, 0.98, 0.6)]
    assert (tmp_path / "speeds.png").stat().st_size > 1000
    setup = {"domain": "laptop", "dx": 0.02, "dt": 0.004, "beats": 0.6}
    rows = FinishedRows(tmp_path / "speeds.csv", speeds.COLUMNS, len(speeds.KEYS), setup, "speeds").rows
    assert len(rows) == 2 and all(row["status"] == "ok" and row["speed_m_s"] > 0 for row in rows.values())
    with pytest.raises(ConfigError, match="Take another --out"):
        speeds.main(["0.4" if word == "0.6" else word for word in call])


def test_what_cannot_be_swum_is_refused():
    with pytest.raises(ConfigError, match="slip ratios in 0..1"):
        speeds.swim_keys([1.0], [30.0], [60.0], [1.2], [0.6])
    with pytest.raises(ConfigError, match="amplitudes to 90 deg"):
        speeds.swim_keys([1.0], [0.0], [60.0], [1.0], [0.6])


def swim_row(key: tuple, box: Domain, robot: str = "fish", beats: float = 0.4) -> dict:
    """Row of a short swim."""
    work = speeds.on_device(deque([key]), "cpu", never_stop, tanks=1, box=box, beats=beats, robot=robot, sharpness=PLAIN)
    ((_, row),) = work
    return row


def test_gaits_side_by_side_swim_as_each_does_alone():
    keys = [(2.0, 30.0, 60.0, 1.0, 0.48), (2.5, 40.0, 30.0, 0.98, 0.36)]
    setup = {"box": TINY, "beats": 0.4, "robot": "fish", "sharpness": PLAIN}
    both = dict(speeds.on_device(deque(keys), "cpu", never_stop, tanks=2, **setup))
    assert both == {key: swim_row(key, TINY) for key in keys} and both[keys[0]]["power_W"] != both[keys[1]]["power_W"]


MINNOW = """
schema = "fishmj.fish/1"
name = "minnow"
link = [
  { name = "head", length = 0.22, mass = 0.727, sections = [[0, 0.02, 0.015], [0.08, 0.09, 0.06], [0.22, 0.08, 0.05]] },
  { name = "body", length = 0.12, mass = 0.259, sections = [[0, 0.08, 0.05], [0.12, 0.05, 0.025]] },
  { name = "tail", length = 0.16, mass = 0.064, sections = [[0, 0.05, 0.025], [0.08, 0.03, 0.006], [0.16, 0.12, 0.002]] },
]
servo = { kp = 8.0, kd = 0.32, torque = 1.667, speed_no_load = 5.236 }
timing = { command_latency = 0.05, camera_latency = 0.065 }
"""
STUDIES = {
    "speeds": (speeds, ["--preset", "laptop", "--frequencies", "1", "--slips", "1"]),
    "converge fish": (converge_fish, ["--domain", "laptop", "--grids", "0.02", "--parts", "1", "--slips", "1", "--what", "drag"]),
    "real_fish": (real_fish, ["--domain", "laptop", "--beats", "5", "--swims", "1", "--slips", "0.96", "0.98", "0.99"]),
}
ROWS = {
    "converge fish": {"value": 0.1, "sem": 0.01, "seconds": 1.0, "status": "ok", "wall_s": 1.0},
    "speeds": {"speed_m_s": 0.1, "aside_deg": 0.0, "yaw_amplitude_deg": 1.0, "power_W": 1.0, "refined_ticks": 0, "status": "ok"},
    "real_fish": {"speed_m_s": 0.1, "gain_a_beat": 0.0, "status": "ok"},
}


@pytest.fixture
def minnow(tmp_path):
    """Path of a fish of two joints."""
    (tmp_path / "minnow.toml").write_text(MINNOW, encoding="utf-8")
    return str(tmp_path / "minnow.toml")


@pytest.mark.parametrize("name", STUDIES)
def test_study_swims_another_robot_and_keeps_its_rows_apart(name, minnow, tmp_path, monkeypatch, capsys):
    module, argv = STUDIES[name]
    sent = []

    def done(work, keys, devices, go_on=None):
        sent.append(work)
        for key in keys:
            swim, *slip = key if name == "real_fish" else (key,)
            yield (swim.beat, *slip) if slip else key, ROWS[name]

    monkeypatch.setattr(finished_rows, "spread", done)
    call = [*argv, "--device", "cpu", "--json", "--out", str(tmp_path / "out")]
    assert module.main([*call, "--robot", minnow]) == console.OK
    given = sent[0].keywords
    assert given["stage"].robot == minnow if name == "real_fish" else given["robot"] == minnow
    said, answer = capsys.readouterr(), {}
    answer = json.loads(said.out.splitlines()[-1])
    assert "slip" not in answer and "minnow" in said.err + said.out
    with pytest.raises(ConfigError, match="another set-up"):
        module.main(call)


def test_parts_of_a_study_drive_all_joints_of_their_robot(minnow):
    box = TINY
    row = swim_row((2.0, 30.0, 60.0, 1.0, 0.48), box, minnow)
    assert row["status"] == "ok" and row["power_W"] > 0
    options = {"robot": minnow, "slip": 1.0, "device": "cpu", "sharpness": PLAIN}
    assert converge_fish.cruise(box, 0.1, options).status == "ok"
    plan = converge_fish.AveragingTimes(settle=0.04, seconds=0.2, length=0.5)
    assert converge_fish.force_when_held("yaw", box, plan, options).value != 0


def test_real_fish_refuses_a_robot_with_other_joints_than_were_filmed(tmp_path):
    with pytest.raises(ConfigError, match="swift has 3 joints; the swims were filmed of tendon_fish with 2"):
        real_fish.main(["--robot", "fish", "--domain", "laptop", "--beats", "5", "--out", str(tmp_path / "a")])
