"""Segments of the campaign in the flow solver: what a record holds, and what is kept of one that stops."""

from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from fishmj.base.errors import SimDiverged
from fishmj.hydro_fit.campaign.data import plan, run_segments
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.lbm_oracle.run.domain import preset
from fishmj.mjcf import build, load_robot
from fishmj.water.flow import Flow

FISH = load_robot("fish")
SMALL = run_segments.Setup(domain=replace(preset("laptop"), shape=(60, 36, 16)), device="cpu")


@pytest.fixture(scope="module")
def water():
    """Three short segments of the solver, side by side."""
    plain = {"block": "any", "split": "train"}
    gait = {"kind": "gait", "frequency": 1.5, "amplitude": 0.4, "lag": 1.0, "bias": 0.3, "ramp": 0.1}
    swim = Segment(id="swim", episode="swim", seconds=0.4, drive=gait, pose=(0.0, 0.0, 0.5), **plain)
    hold = {"kind": "hold", "rate": 0.5}
    held = Segment(
        id="held", episode="held", seconds=0.2, settle=0.1, drive=hold, flow=Flow(speed=0.2), nudge=(0.3, 0.1), **plain
    )
    steer = {"kind": "policy", "controller": "dob", "target": (1.0, 0.0)}
    gusty = Flow(speed=0.2, direction=np.pi, turbulence="default", intensity=0.1, seed=3)
    steered = Segment(id="steered", episode="steered", seconds=0.2, drive=steer, flow=gusty, **plain)
    done = run_segments.on_device(deque([swim, held, steered]), SMALL.device, setup=SMALL, tanks=2)
    return {item.segment.id: (item, SegmentRecord(item.meta, **{"power": np.nan, **item.arrays})) for item in done}


@pytest.mark.oracle
def test_the_wrenches_of_a_record_are_what_moves_the_fish(water):
    """Newton: the impulse of the water over a tick is the change of the links' momentum, in x, y and for every tick."""
    record = water["swim"][1]
    model = build("fish", bare=True)
    data = mujoco.MjData(model)

    def momentum(q, v):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        return data.subtree_linvel[0, :2] * model.body_subtreemass[0]

    before = np.array([momentum(q, v) for q, v in zip(*record.before, strict=True)])
    after = np.array([momentum(q, v) for q, v in zip(record.q, record.v, strict=True)])
    pushed, gained = record.wrench[:, :, :2].sum(1), (after - before) / record.tick
    assert np.abs(gained).max() > 0.3
    order = 0.035  # of the step, which is first order: 2.7 % at 4 ms, 1.2 % at 2 ms
    np.testing.assert_allclose(pushed, gained, atol=order * np.abs(gained).max())


@pytest.mark.oracle
def test_acceleration_times_the_tick_is_the_change_of_velocity(water):
    record = water["swim"][1]
    np.testing.assert_allclose(record.before[1][0], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cumsum(record.acceleration, 0)[-1] * record.tick, record.v[-1], atol=1e-9)
    assert record.t[0] == pytest.approx(0.02) and record.seconds == pytest.approx(0.4)
    assert (record.power > 1.4).all(), "with the electronics"


@pytest.mark.oracle
def test_a_held_fish_follows_its_path_to_the_letter(water):
    item, record = water["held"]
    assert item.meta["prescribed"] == {"joints": True, "root": True} and len(record.q) == 10
    np.testing.assert_allclose(record.q[:, 2], 0.5 * record.t, atol=1e-9)
    np.testing.assert_allclose(record.q[:, :2], [[0.3 * 0.02, 0.1 * 0.02]] * 10, atol=1e-9)
    np.testing.assert_allclose(record.flow, np.broadcast_to([0.2, 0.0], record.flow.shape))
    assert record.wrench[:, :, 0].sum(1).mean() > 0, "the stream pushes it along"
    assert "power" not in item.arrays


@pytest.mark.oracle
def test_the_flow_at_the_links_is_the_flow_there(water):
    item, record = water["steered"]
    q, t = record.before[0][7], 7 * 0.02
    model = build("fish")
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    where = np.array([data.site(f"{link.name}_centre").xpos for link in FISH.links])
    assert record.background == item.segment.flow
    np.testing.assert_allclose(record.flow[7], record.background.at(where, t)[:, :2], atol=1e-6)
    assert np.ptp(record.flow[..., 0]) > 0


@pytest.mark.oracle
def test_what_stops_is_kept_as_far_as_it_was_sound(monkeypatch):
    """Fish that diverge after 0.4 s (that is nothing sound) and after 1.9 s (0.4 s are)."""
    monkeypatch.setattr(run_segments, "DOUBT", 0.3)
    ticks = {"early": 12, "late": 30}

    def ticking(run, command):
        if run.ticks >= ticks[run.name]:
            raise SimDiverged("the water ran away")
        row = (run.ticks * 0.02, 0, np.zeros(3), np.zeros(6), np.zeros(3), np.zeros(3), 1.0, np.zeros((4, 6)), np.zeros((4, 6)))
        run.rows.append(row)
        run.ticks += 1
        yield

    monkeypatch.setattr(run_segments.Run, "ticking", ticking)
    made = run_segments._run
    named = lambda segment, *rest: (run := made(segment, *rest), setattr(run, "name", segment.id))[0]
    monkeypatch.setattr(run_segments, "_run", named)
    gait = {"kind": "gait", "frequency": 1.0, "amplitude": 0.1, "lag": 1.0, "bias": 0.0}
    both = [Segment(id=n, episode=n, block="gait", split="train", seconds=9.0, drive=gait) for n in ticks]
    early, late = sorted(
        run_segments.on_device(deque(both), SMALL.device, setup=SMALL, tanks=2), key=lambda item: item.segment.id
    )
    assert early.arrays == {} and early.meta["stopped"] == "the water ran away"
    assert len(late.arrays["q"]) == late.meta["rows"] == 15 and late.meta["stopped"] == "the water ran away"


def test_a_fish_at_the_edge_keeps_all_and_an_insane_one_nothing_after():
    row = lambda speed: (0, 0, np.zeros(3), np.full(6, speed), np.zeros(3), np.zeros(3), 1.0, np.zeros(1), np.zeros(1))
    run = SimpleNamespace(rows=[row(0.1)] * 200, stopped="left_domain at t = 4 s", robot=FISH)
    assert len(run_segments._sound(run, 50)) == 150
    run.stopped = "lost"
    assert len(run_segments._sound(run, 50)) == 150 - round(run_segments.DOUBT / 0.02)
    run.stopped, run.rows = "", [row(0.1)] * 20 + [row(np.nan)] + [row(0.1)] * 5
    assert len(run_segments._sound(run, 5)) == 15


def test_a_segment_may_begin_in_any_state():
    gait = {"kind": "gait", "frequency": 1.0, "amplitude": 0.1, "lag": 1.0, "bias": 0.0}
    state = {"pose": (0.0, 0.1, 0.4), "joints": (0.1, 0.2, -0.1), "velocity": (0.2, 0.0, 0.3, 1.0, -1.0, 0.5)}
    started = run_segments.SegmentRunner(
        Segment(id="a", episode="a", block="gait", split="train", seconds=1.0, drive=gait, **state), SMALL
    ).start
    np.testing.assert_allclose(started["q"], [*state["pose"], *state["joints"]])
    np.testing.assert_allclose(started["v"], state["velocity"])


@pytest.mark.oracle
def test_the_second_fish_swims_through_the_same_plan():
    second = load_robot("tendon_fish")
    segments = {segment.block: segment for segment in plan.full(second).segments}
    turning = replace(segments["turning"], seconds=0.2, pose=(0.0, 0.0, 0.0))
    (done,) = run_segments.on_device(deque([turning]), SMALL.device, setup=replace(SMALL, robot=second))
    assert done.meta["stopped"] == "" and done.meta["robot"]["name"] == "tendon_fish"
    assert done.arrays["q"].shape == (10, 5) and done.arrays["wrench"].shape == (10, 3, 3)
    assert np.isfinite(done.arrays["wrench"]).all() and np.abs(done.arrays["wrench"]).max() > 0
