"""The plan of a campaign: what it holds, how episodes are drawn and split, and that a new block moves none of the old ones."""

import json

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.hydro_fit.campaign.data import plan
from fishmj.hydro_fit.campaign.data.segment import drive, ticks_of
from fishmj.hydro_fit.fit import gauss_newton
from fishmj.mjcf import load_robot
from fishmj.water.flow import BOXES

FISH, SECOND = load_robot("fish"), load_robot("tendon_fish")
FULL = plan.full(FISH)


def test_a_plan_is_the_same_every_time_and_another_seed_draws_others():
    assert plan.full(FISH).segments == FULL.segments
    others = {json.dumps(s.drive) + str(s.flow) for s in plan.full(FISH, seed=1).segments if s.block == "gait"}
    assert not others & {json.dumps(s.drive) + str(s.flow) for s in FULL.segments if s.block == "gait"}


def test_a_part_of_the_campaign_consists_of_the_same_episodes():
    whole = {segment.id: segment for segment in FULL.segments}
    part = plan.full(FISH, scale=0.25).segments
    assert 50 < len(part) < 0.5 * len(whole)
    assert all(whole[segment.id] == segment for segment in part)


def test_campaign_episode_is_in_one_split_for_all_slip_ratios_and_repeats():
    where = {}
    for segment in FULL.segments:
        where.setdefault(segment.episode, set()).add(segment.split)
    assert {len(splits) for splits in where.values()} == {1}
    assert {s.split for s in FULL.segments} == {"train", "val", "test"}
    assert all(s.split == "test" for s in FULL.segments if s.replicate_of)
    assert len({s.id for s in FULL.segments}) == len(FULL.segments)


def test_the_campaign_is_as_large_as_designed():
    assert 6500 < FULL.water < 7500, "seconds of water"
    seconds = {row["block"]: row for row in FULL.rows()}
    assert seconds["all"]["test_s"] >= 300 and seconds["all"]["val_s"] >= 200
    train = [s for s in FULL.segments if s.split != "test"]
    default = sum(s.seconds for s in train if s.slip == plan.DEFAULT_SLIP)
    for slip in plan.OTHER_SLIPS:
        assert 0.2 < sum(s.seconds for s in train if s.slip == slip) / default < 0.3


def test_a_held_fish_that_flaps_is_judged_by_more_than_one_record():
    """Thrust: at least six held-out episodes at the default slip, repeats of one, and held chirps and gaits to fit."""
    held = [s for s in FULL.segments if drive(s, FISH).root is not None and s.block in gauss_newton.FLAPPING]
    count = lambda split: sum(s.split == split and s.slip == plan.DEFAULT_SLIP and not s.replicate_of for s in held)
    assert count("test") >= 6 and count("train") >= 12 and count("val") >= 1
    assert sum(bool(s.replicate_of) for s in held) == plan.SEEDS
    one = next(s for s in held if s.block == "flapping")
    moved = drive(one, FISH)
    np.testing.assert_array_equal(moved.root(3.0), one.pose)
    rate = (moved.joints(2.31) - moved.joints(2.30)) / 0.01
    assert 0.1 < np.abs(rate).max() <= FISH.servo.speed_no_load


def test_test_episodes_have_their_own_turbulence():
    for segment in FULL.segments:
        if segment.flow.rms > 0:
            assert (segment.flow.box == BOXES["judge"]) == (segment.split == "test"), segment.id


def test_fresh_test_episodes_share_nothing_with_the_shipped_ones():
    fresh = plan.fresh_test(FISH, seed=5)
    assert {s.split for s in fresh.segments} == {"test"}
    assert not {s.episode for s in fresh.segments} & {s.episode for s in FULL.segments}
    shipped = {str(s.drive) for s in FULL.segments if s.block in ("straight", "gait", "random")}
    assert not shipped & {str(s.drive) for s in fresh.segments}
    with pytest.raises(ConfigError, match="0 drew the shipped one"):
        plan.fresh_test(FISH, seed=0)


def test_every_block_and_split_is_in_the_preview():
    small = plan.preview(FISH)
    assert {part.block for part in plan.TRAINING} <= {s.block for s in small.segments}
    assert {s.split for s in small.segments} == {"train", "val", "test"}
    assert {s.slip for s in small.segments} == {plan.DEFAULT_SLIP, *plan.OTHER_SLIPS}
    assert small.water < 130


@pytest.mark.parametrize("robot", [FISH, SECOND], ids=["fish", "tendon_fish"])
def test_no_wave_asks_more_of_the_servos_than_they_can_do(robot):
    waves = [s for s in plan.full(robot).segments if s.drive["kind"] in ("gait", "chirp", "manoeuvre")]
    assert {s.drive["kind"] for s in waves} == {"gait", "chirp", "manoeuvre"}
    for segment in waves[::8]:
        moved = drive(segment, robot)
        ticks = np.arange(ticks_of(segment, robot)[1])
        at = np.array([moved.joints(t * 0.02) if moved.joints else moved.command(t, None) for t in ticks])
        assert at.shape[1] == robot.n_joints
        assert np.abs(at).max() < robot.servo.range + 1e-9, segment.id
        fastest = np.abs(np.diff(at, axis=0)).max() / 0.02
        turn = 2.8 if segment.block == "manoeuvre" else 0.0  # rad/s, of a bias of 120 deg that comes within a quarter of a second
        assert fastest < 1.05 * robot.servo.speed_no_load + turn, segment.id


def test_the_second_fish_gets_only_controllers_that_know_it():
    steering = lambda made: {s.drive["controller"] for s in made.segments if s.block == "policy"}
    assert steering(FULL) == set(plan.POLICIES)
    assert steering(plan.full(SECOND)) == {"dob", "pi", "adrc-c1", "pd"}
    with pytest.raises(ConfigError, match="has 11 observations"):
        plan.full(SECOND, policies=("paper",))
    with pytest.raises(UnknownName, match="dod"):
        plan.full(FISH, policies=("dod",))
