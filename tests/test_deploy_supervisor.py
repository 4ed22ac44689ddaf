"""The supervisor's table: every state with every condition, alone and together."""

from itertools import combinations

import pytest

from fishmj.deploy.loop.supervisor import (
    ACTIONS,
    NONE,
    STAY,
    TABLE,
    Action,
    Condition,
    Stay,
    Supervisor,
    SwimState,
    care,
    decide,
    named,
)

WAYS_UP = {
    (SwimState.DOWN, Condition.HEARD): SwimState.LINKED,
    (SwimState.LINKED, Condition.ASK_ARM): SwimState.ARMED,
    (SwimState.ARMED, Condition.ASK_SWIM): SwimState.SWIMMING,
    (SwimState.NEUTRAL, Condition.PERSON_LEAVES): SwimState.DOWN,
}
ASKED = Condition.HEARD | Condition.ASK_ARM | Condition.ASK_SWIM | Condition.PERSON_LEAVES
FAULTS = [condition for condition in Condition if condition not in ASKED | Condition.FINISHED]
AT_ONCE = Condition.SERVO_HOT | Condition.SERVO_STUCK | Condition.SERVO_LOST | Condition.STOP_NOW
HOLDING = Condition.LINK_QUIET | Condition.POSE_OLD | Condition.POSE_JUMP
STATES = list(SwimState)


def test_the_table_has_a_row_for_each_condition_and_a_cell_for_each_state():
    assert set(TABLE) == set(Condition)
    assert all(len(row) == len(SwimState) for row in TABLE.values())
    assert set(ACTIONS) == set(SwimState)


@pytest.mark.parametrize("state", STATES, ids=lambda s: s.name)
@pytest.mark.parametrize("condition", list(Condition), ids=lambda c: c.name)
def test_each_condition_alone_does_what_the_table_says(state, condition):
    found, cell = decide(state, condition), TABLE[condition][state]
    after = cell if isinstance(cell, SwimState) else state
    assert found.state is after
    held = after is SwimState.SWIMMING and cell is Stay.HOLD
    let_go = after is SwimState.NEUTRAL and TABLE[condition][SwimState.NEUTRAL] is Stay.LET_GO
    assert found.action is (Action.LET_GO if let_go else Action.HOLD if held else ACTIONS[after])
    assert found.because == (NONE if cell is STAY else condition)


@pytest.mark.parametrize("state", STATES, ids=lambda s: s.name)
def test_without_a_condition_nothing_changes(state):
    assert decide(state, NONE) == (state, ACTIONS[state], NONE)


@pytest.mark.parametrize("condition", FAULTS, ids=lambda c: c.name)
def test_each_fault_of_a_swim_holds_the_fish_or_ends_it(condition):
    found = decide(SwimState.SWIMMING, condition)
    if condition in HOLDING:
        assert found == (SwimState.SWIMMING, Action.HOLD, condition)
    else:
        assert found == (SwimState.NEUTRAL, Action.LET_GO if condition in AT_ONCE else Action.RETURN, condition)


def test_immediate_torque_off_overrides_any_other_condition_while_armed():
    for condition in Condition:
        for urgent in AT_ONCE:
            for state in (SwimState.ARMED, SwimState.SWIMMING):
                assert decide(state, condition | urgent).action is Action.LET_GO
            leaves = condition is Condition.PERSON_LEAVES
            assert decide(SwimState.NEUTRAL, condition | urgent).action is (Action.LISTEN if leaves else Action.LET_GO)
    assert {c for c, row in TABLE.items() for cell in row if cell is Stay.LET_GO} == set(AT_ONCE)


def test_the_only_ways_up_are_one_state_at_a_time():
    found = {
        (state, condition): cell
        for condition, row in TABLE.items()
        for state, cell in zip(SwimState, row, strict=True)
        if isinstance(cell, SwimState) and care(cell) == 1 or (state, cell) == (SwimState.NEUTRAL, SwimState.DOWN)
    }
    assert found == WAYS_UP


def test_neutral_is_left_by_a_person_alone():
    every = Condition(sum(Condition)) & ~Condition.PERSON_LEAVES
    assert decide(SwimState.NEUTRAL, every).state is SwimState.NEUTRAL
    assert decide(SwimState.NEUTRAL, every | Condition.PERSON_LEAVES).state is SwimState.DOWN


@pytest.mark.parametrize("state", [SwimState.LINKED, SwimState.ARMED], ids=lambda s: s.name)
def test_no_way_up_while_a_fault_that_bars_it_lasts(state):
    for condition in FAULTS:
        cell = TABLE[condition][state]
        asked = decide(state, condition | ASKED)
        if cell is STAY:
            assert asked.state > state
        else:
            assert asked.state is (cell if isinstance(cell, SwimState) else state), condition


def test_of_two_conditions_the_more_careful_cell_wins():
    for state in SwimState:
        for a, b in combinations(Condition, 2):
            cells = [TABLE[c][state] for c in (a, b)]
            strictest = max(cells, key=care)
            found = decide(state, a | b)
            assert found.state is (strictest if isinstance(strictest, SwimState) else state)
            assert decide(state, a | b) == decide(state, b | a)


def test_the_supervisor_keeps_every_change_with_its_causes():
    one = Supervisor()
    for t, conditions in enumerate((
        Condition.HEARD,
        Condition.HEARD | Condition.ASK_ARM,
        Condition.HEARD | Condition.ASK_SWIM,
        Condition.HEARD | Condition.POSE_OLD,
        Condition.POSE_LOST | Condition.POSE_OLD | Condition.LINK_QUIET,
        Condition.HEARD,
    )):  # fmt: skip
        one.step(float(t), conditions)
    assert [(e.before.name, e.after.name) for e in one.events] == [
        ("DOWN", "LINKED"), ("LINKED", "ARMED"), ("ARMED", "SWIMMING"), ("SWIMMING", "NEUTRAL"),
    ]  # fmt: skip
    assert one.state is SwimState.NEUTRAL and one.cause == Condition.POSE_LOST
    assert named(one.events[-1].conditions) == "LINK_QUIET, POSE_OLD, POSE_LOST"
