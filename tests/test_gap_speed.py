"""The swimming speeds that a search tells, of swims made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base.calib import resolve
from fishmj.gap.commands.find import speed_error_of
from fishmj.gap.localise.swimming_speed import speed_of, speeds_text, steady_speeds
from fishmj.gap.verdict import Verdict
from fishmj.gap.workflow import require_calibrated_speed

T = np.linspace(0.0, 10.0, 301)


def swim(name: str, speed, push=(0.0, 0.0, 0.0), flow=(0.0, 0.0), poses=True):
    """A record heading 30 deg at `speed` (K,) or a number, with a head that wags at 1 Hz."""
    way = np.cumsum(np.broadcast_to(speed, T.shape)) * (T[1] - T[0])
    x, y = way * np.cos(np.pi / 6), way * np.sin(np.pi / 6) + 0.01 * np.sin(2 * np.pi * T)
    pose = SimpleNamespace(t=T, values=np.stack([x, y, 0 * x], 1)) if poses else None
    return SimpleNamespace(name=name, pose=pose, push=np.array(push), flow=flow)


def test_speeds_are_those_of_steady_swims_only():
    fast = {"pose": swim("", 0.25).pose.values[None]}
    lost = swim("gait_2", 0.19)
    lost.pose.values[200:210] = np.nan
    records = [
        swim("gait", 0.19), lost, swim("coast", np.linspace(0.4, 0.0, 301)), swim("idle", 0.0),
        swim("towed", 0.2, push=(0.2, 0, 0)),
        swim("current", 0.2, flow=(0.1, 0.0)), swim("bench", 0.2, poses=False),
    ]  # fmt: skip
    found = steady_speeds(records, [fast] * len(records))
    assert list(found) == ["gait", "gait_2"]
    assert np.ravel(list(found.values())) == pytest.approx([0.19, 0.25] * 2, abs=0.004)
    text = speeds_text({"gait": (0.191, 0.254)})
    assert text == "swimming speed: 0.191 m/s measured, 0.254 m/s by the present model (mean of 1 steady swim)"
    assert speeds_text(found).endswith("(mean of 2 steady swims)") and speeds_text({}) == ""
    assert steady_speeds([SimpleNamespace(name="arm")], [{}]) == {}  # a robot in MJCF


def turn(radius: float, speed: float):
    """A record on a circle."""
    way = speed * T / radius
    pose = SimpleNamespace(t=T, values=np.stack([radius * np.cos(way), radius * np.sin(way), way], 1))
    return SimpleNamespace(name="turn", pose=pose, push=np.zeros(3), flow=(0.0, 0.0))


@pytest.mark.parametrize("radius", [0.4, 1.0, 1e3])
def test_turning_swim_is_as_fast_as_a_straight_one(radius):
    record = turn(radius, 0.2)
    assert speed_of(T, record.pose.values[:, :2]) == pytest.approx(0.2, rel=0.02)
    assert steady_speeds([record], [{"pose": record.pose.values[None]}])["turn"] == pytest.approx((0.2, 0.2), rel=0.02)


def inquiry(measured: list[float], error: float | None):
    """A search of swims at these speeds, which the model swims at 0.2 m/s."""
    records = [swim(f"gait_{i}", v) for i, v in enumerate(measured)]
    model = SimpleNamespace(predict=lambda records, row: [{"pose": swim("", 0.2).pose.values[None]} for _ in records])
    found = SimpleNamespace(base=SimpleNamespace(row=None))
    return SimpleNamespace(speed_error=error, records=records, found=found, evidence=SimpleNamespace(model=model))


@pytest.mark.parametrize(
    "measured, error, answer",
    [
        ([0.166, 0.168, 0.165], 0.03, "UNEXPLAINED"),  # 17 % slower
        ([0.24, 0.242, 0.2], 0.03, "UNEXPLAINED"),  # faster, in two of three
        ([0.166, 0.199, 0.201], 0.03, "AGREES"),  # in one of three
        ([0.166, 0.24, 0.2], 0.03, "AGREES"),  # not all to one side
        ([0.19, 0.191, 0.189], 0.03, "AGREES"),  # 5 %, within three times 3 %
        ([0.166, 0.168, 0.165], None, "AGREES"),  # not calibrated
        ([], 0.03, "AGREES"),
    ],
)
def test_calibrated_robot_of_another_speed_does_not_agree(measured, error, answer):
    found = require_calibrated_speed(Verdict("AGREES", reason="as healthy robots"), inquiry(measured, error))
    assert found.answer == answer
    if answer == "UNEXPLAINED":
        assert f"steady swims by more than {300 * error:.0f} %" in found.reason and "3 % on average" in found.reason
    assert require_calibrated_speed(Verdict("NAMED"), inquiry(measured, error)).answer == "NAMED"


def test_search_reads_the_speed_error_of_a_calibration(tmp_path):
    path = tmp_path / "mine.toml"
    text = resolve("fish", robot=True).read_text(encoding="utf-8")
    block = '\n[calibration.water]\nsource = "logs"\nspeed_error = { value = 0.031, low = 0.002, high = 0.08, unit = "share" }\n'
    path.write_text(text)
    assert speed_error_of(str(path)) is None
    path.write_text(text + block)
    assert speed_error_of(str(path)) == 0.031
    path.write_text(text + block.replace("0.031", '"much"'))
    assert speed_error_of(str(path)) is None
