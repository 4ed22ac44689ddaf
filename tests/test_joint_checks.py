"""Physical checks of joints against their commands."""

import numpy as np
from turning_fish import changed, names, turning

from fishmj.log import physical_checks


def test_exchanged_joints_follow_the_command_of_the_other():
    trial = turning()
    one, two = (trial.tables["joint"][name] for name in ("j1", "j2"))
    assert "j1 follows c2 and j2 follows c1" in names(changed(trial, "joint", j1=lambda v: two, j2=lambda v: one))["joint order"]


def test_angles_of_links_against_the_tank_or_the_head_are_refused():
    """Against the tank they follow the heading, against the head the sums of the commands; a turning fish's joints do neither."""
    fish = turning()
    joint, pose = fish.tables["joint"], fish.tables["pose"]
    summed = np.cumsum([joint[f"j{k}"] for k in (1, 2, 3)], axis=0)
    given = lambda angles: changed(fish, "joint", **{f"j{k + 1}": lambda _, k=k: angles[k] for k in range(3)})
    found = physical_checks.examine(given(summed + np.interp(joint["t"], pose["t"], pose["yaw"])), ["joint frame"])
    assert [(one.level, "j1, j2, j3 turn with the heading by" in one.text) for one in found] == [(physical_checks.IMPORT, True)]
    assert "j2 moves by 1.6" in names(given(summed))["joint scale"]  # one gait of one frequency: doubted by its size alone
    t = joint["t"]
    chirps = 0.2 * np.array([np.sin(2 * np.pi * (0.5 + (0.05 + 0.02 * k) * t) * t - k) for k in range(3)])
    fish = changed(fish, "cmd", **{f"c{k + 1}": lambda _, k=k: chirps[k] for k in range(3)})
    late = 0.95 * np.stack([np.interp(t - 0.06, t, chirp) for chirp in chirps])
    given = lambda angles: changed(fish, "joint", **{f"j{k + 1}": lambda _, k=k: angles[k] for k in range(3)})
    found = physical_checks.examine(given(np.cumsum(late, 0)), ["joint frame"])
    assert [one.level for one in found] == [physical_checks.IMPORT] and "j2, j3 follow the sums of the commands" in found[0].text
    assert not physical_checks.examine(given(late), ["joint frame", "joint scale"])


def test_joints_that_follow_their_commands_by_one_part_are_noted():
    """Commands in [-1, 1] were read as rad; one joint that follows by less than the others has a weak servo."""
    parts = lambda *by: changed(turning(), "joint", **{f"j{k + 1}": lambda v, part=part: part * v for k, part in enumerate(by)})
    found = physical_checks.examine(parts(0.6, 0.6, 0.6), ["joint scale"])
    assert [one.level for one in found] == 3 * [physical_checks.NOTE] and "share of full deflection" in found[0].text
    assert "allow it with gain" in found[0].text
    assert len(physical_checks.examine(parts(0.35, 0.45, 0.6), ["joint scale"])) == 3  # each joint with a range of its own
    for by in ((0.6, 0.8, 0.6), (0.8, 0.8, 0.8)):
        assert not physical_checks.examine(parts(*by), ["joint scale"]), by
    assert "against the head" in names(parts(1, 1.5, 1))["joint scale"]
