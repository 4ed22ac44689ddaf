"""The swimming speeds that a search tells, of swims made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.gap.localise.swimming_speed import speeds_text, steady_speeds

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
