"""The robot's own watchdog: silent hosts, bounds and rates, whatever happens."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fishmj.base.errors import ConfigError
from fishmj.deploy.protocols.messages import RobotState
from fishmj.deploy.protocols.watchdog import LONGEST, Limits, Watchdog

STRAIGHT = (0.0, 0.0, 0.0)
HOLD, NEUTRAL = 0.1, 0.3


def armed(measured=STRAIGHT, now: float = 0.0) -> Watchdog:
    watchdog = Watchdog(3)
    assert watchdog.arm(now, HOLD, NEUTRAL, measured)
    return watchdog


def test_nothing_moves_before_it_is_armed():
    watchdog = Watchdog(3)
    assert not watchdog.command(0.0, (1.0, 1.0, 1.0)) and watchdog.step(0.02, STRAIGHT) is None
    assert watchdog.state is RobotState.IDLE


def test_armed_it_holds_the_joints_where_they_are():
    assert armed((0.3, -0.2, 0.1)).step(0.02, (0.3, -0.2, 0.1)) == (0.3, -0.2, 0.1)


def test_silence_leads_to_hold_and_then_to_neutral_at_the_times_asked():
    watchdog = armed()
    assert watchdog.command(1e-6, (0.5, 0.5, 0.5))
    states = {}
    for tick in range(1, 21):
        watchdog.step(0.02 * tick, STRAIGHT)
        states.setdefault(watchdog.state, 0.02 * tick)
    assert states == {RobotState.ARMED: 0.02, RobotState.HOLD: pytest.approx(0.12), RobotState.NEUTRAL: pytest.approx(0.32)}


def test_the_times_count_from_arming_where_no_command_ever_comes():
    watchdog = armed()
    watchdog.step(HOLD, STRAIGHT)
    assert watchdog.state is RobotState.HOLD
    watchdog.step(NEUTRAL, STRAIGHT)
    assert watchdog.state is RobotState.NEUTRAL


def test_in_hold_the_target_stays_and_a_command_leads_out():
    watchdog = armed()
    watchdog.command(0.0, (0.5, 0.5, 0.5))
    moved = watchdog.step(0.02, STRAIGHT)
    assert watchdog.step(0.15, moved) == moved and watchdog.state is RobotState.HOLD
    assert watchdog.command(0.2, (0.5, 0.5, 0.5)) and watchdog.state is RobotState.ARMED


def test_neutral_moves_joints_to_zero_at_its_rate_and_only_disarm_exits():
    watchdog, rate = armed((1.0, -0.5, 0.2)), Limits().neutral_rate
    watchdog.fault()
    target, now = (1.0, -0.5, 0.2), 0.0
    while any(target):
        now += 0.02
        last, target = target, watchdog.step(now, target)
        assert target is not None
        assert all(abs(b - a) <= rate * 0.02 + 1e-9 and abs(b) <= abs(a) for a, b in zip(last, target, strict=True))
    assert now == pytest.approx(1.0 / rate, abs=0.021)
    assert not watchdog.command(now, (1.0, 1.0, 1.0)) and not watchdog.arm(now, HOLD, NEUTRAL, STRAIGHT)
    watchdog.disarm()
    assert watchdog.state is RobotState.IDLE and watchdog.arm(now, HOLD, NEUTRAL, STRAIGHT)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_is_a_fault(bad):
    watchdog = armed()
    assert not watchdog.command(0.0, (0.1, bad, 0.1)) and watchdog.state is RobotState.NEUTRAL


@pytest.mark.parametrize("speed", [(0.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (math.nan, 1.0, 1.0), (1.0,)])
def test_a_speed_that_is_not_positive_is_a_fault(speed):
    watchdog = armed()
    assert not watchdog.command(0.0, (0.1, 0.1, 0.1), speed) and watchdog.state is RobotState.NEUTRAL


def test_a_command_of_other_joints_is_not_taken():
    watchdog = armed()
    assert not watchdog.command(0.0, (0.1, 0.1)) and watchdog.state is RobotState.ARMED


@pytest.mark.parametrize(
    ("hold", "neutral"),
    [(0.0, 0.3), (0.3, 0.3), (0.3, 0.1), (-0.1, 0.3), (0.1, LONGEST + 0.01), (math.nan, 0.3), (0.1, math.inf)],
)
def test_it_refuses_to_arm_without_times_that_protect(hold, neutral):
    watchdog = Watchdog(3)
    assert not watchdog.arm(0.0, hold, neutral, STRAIGHT) and watchdog.state is RobotState.IDLE


def test_it_refuses_to_arm_where_a_joint_was_not_measured():
    assert not Watchdog(3).arm(0.0, HOLD, NEUTRAL, (0.0, math.nan, 0.0))
    assert not Watchdog(3).arm(0.0, HOLD, NEUTRAL, (0.0, 0.0))


def test_watchdog_refuses_to_arm_out_of_range_joints_but_allows_the_stop():
    """A wrong zero: the way back into the range would be a jump at full speed."""
    limits, watchdog = Limits(), Watchdog(3)
    assert not watchdog.arm(0.0, HOLD, NEUTRAL, (0.0, limits.servo_range + limits.near + 0.01, 0.0))
    assert watchdog.state is RobotState.IDLE and watchdog.step(0.02, STRAIGHT) is None
    assert watchdog.arm(0.0, HOLD, NEUTRAL, (0.0, -limits.servo_range - 0.01, 0.0)), "a count or two beyond its stop"


def faulted(measured) -> Watchdog:
    watchdog = armed(measured)
    watchdog.fault()
    return watchdog


def seconds_of_torque(watchdog: Watchdog, read, most: float = 10.0) -> float:
    """s from now 0 until the torque goes off. read: target -> measured."""
    now, target = 0.0, watchdog.target
    while now < most and target is not None:
        now += 0.02
        target = watchdog.step(now, read(target))
    return now


def test_neutral_removes_torque_once_joints_are_straight_and_stays_neutral():
    watchdog = faulted((1.0, -0.5, 0.2))
    assert seconds_of_torque(watchdog, lambda target: target) == pytest.approx(1.0 / Limits().neutral_rate, abs=0.05)
    assert watchdog.state is RobotState.NEUTRAL and watchdog.rested
    assert watchdog.step(20.0, (0.5, 0.5, 0.5)) is None, "water that bends it does not switch it on again"
    assert not watchdog.command(20.0, STRAIGHT) and not watchdog.arm(20.0, HOLD, NEUTRAL, STRAIGHT)
    watchdog.disarm()
    assert watchdog.arm(20.0, HOLD, NEUTRAL, STRAIGHT) and watchdog.step(20.02, STRAIGHT) == STRAIGHT
    watchdog.fault()
    assert watchdog.step(20.04, (0.5, 0.0, 0.0)) is not None, "the next NEUTRAL has its own time"


@pytest.mark.parametrize("broken", [0.4, math.nan])
def test_a_joint_that_is_stuck_or_silent_gets_no_more_than_rest(broken):
    watchdog = faulted((0.4, 0.0, 0.0))
    assert seconds_of_torque(watchdog, lambda target: (broken, *target[1:])) == pytest.approx(Limits().rest, abs=0.05)
    assert watchdog.state is RobotState.NEUTRAL


def test_a_host_that_dies_leaves_a_fish_without_torque():
    watchdog = armed((0.3, 0.3, 0.3))
    assert seconds_of_torque(watchdog, lambda target: target) == pytest.approx(NEUTRAL + 0.3 / Limits().neutral_rate, abs=0.05)


@pytest.mark.parametrize("garbage", [40.0, -40.0, math.inf])
def test_a_reading_that_is_no_angle_does_not_move_the_target(garbage):
    assert armed((0.3, 0.0, 0.0)).step(0.02, (garbage, 0.0, 0.0)) == (0.3, 0.0, 0.0)


def test_commands_move_at_most_at_the_rate_or_the_speed_asked():
    watchdog = armed()
    watchdog.command(0.0, (1.0, 1.0, -1.0), (100.0, 2.0, 1.0))
    assert watchdog.step(0.02, STRAIGHT) == pytest.approx((Limits().rate * 0.02, 0.04, -0.02))


def test_a_stuck_joint_is_not_led_by_more_than_the_lead():
    watchdog = armed()
    for tick in range(1, 50):
        watchdog.command(0.02 * tick, (1.0, 1.0, 1.0))
        target = watchdog.step(0.02 * tick, (0.0, 0.02 * tick, math.nan))
    assert target == pytest.approx((Limits().lead, 1.0, 1.0))


def test_a_late_loop_is_not_caught_up():
    watchdog = armed()
    watchdog.fault()
    watchdog.target = (1.0, 1.0, 1.0)
    assert watchdog.step(60.0, (1.0, 1.0, 1.0)) == pytest.approx((1.0 - Limits().neutral_rate * 0.1,) * 3)


ACTS = st.one_of(
    st.tuples(st.just("arm"), st.floats(0.01, 3), st.floats(0.01, 3)),
    st.tuples(st.just("disarm")),
    st.tuples(st.just("fault")),
    st.tuples(st.just("command"), st.tuples(*[st.floats(-4, 4)] * 3)),
    st.tuples(st.just("command"), st.tuples(*[st.floats(allow_nan=True)] * 3)),
    st.tuples(st.just("silence")),
)


@given(st.lists(st.tuples(ACTS, st.floats(0.0, 0.2), st.tuples(*[st.floats(-1.5, 1.5) | st.just(math.nan)] * 3)), max_size=40))
def test_watchdog_targets_stay_in_range_and_silence_ends_in_neutral(steps):
    watchdog, limits, now, heard = Watchdog(3), Limits(), 0.0, 0.0
    for act, dt, measured in steps:
        now += dt
        before = watchdog.state
        if act[0] == "arm":
            if watchdog.arm(now, act[1], act[2], measured):
                heard = now
                assert before is RobotState.IDLE
        elif act[0] == "command":
            if watchdog.command(now, act[1]):
                heard = now
        elif act[0] != "silence":
            getattr(watchdog, act[0])()
        target = watchdog.step(now, measured)
        assert (target is None) == (watchdog.state is RobotState.IDLE or watchdog.rested)
        assert not watchdog.rested or watchdog.state in (RobotState.IDLE, RobotState.NEUTRAL)
        if before is RobotState.NEUTRAL and act[0] != "disarm":
            assert watchdog.state is RobotState.NEUTRAL
        if target is not None:
            assert all(abs(angle) <= limits.servo_range for angle in target)
            near = [
                abs(t - m) <= limits.lead + 1e-9 or abs(t) == limits.servo_range for t, m in zip(target, measured, strict=True)
            ]
            assert all(n or math.isnan(m) for n, m in zip(near, measured, strict=True))
            assert now - heard < watchdog.neutral + 1e-6 or watchdog.state is RobotState.NEUTRAL


def test_a_watchdog_that_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="joints"):
        Watchdog(9)
    with pytest.raises(ConfigError, match="hold"):
        Watchdog(3, hold=0.3, neutral=0.1)
    with pytest.raises(ConfigError, match="above 0"):
        Limits(rate=0.0)
