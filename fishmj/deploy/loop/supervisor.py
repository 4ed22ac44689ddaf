"""Decides the permitted action: five states, conditions, and one table with the effect of each condition in each state.

After the supervisor of the Crazyflie's firmware: conditions are bits, found anew at every tick; the table alone decides.

    DOWN -> LINKED -> ARMED -> SWIMMING -> NEUTRAL -> DOWN

    DOWN       the robot is silent
    LINKED     it answers; its servos are without torque
    ARMED      it takes commands; the joints are held in place
    SWIMMING   the policy steers
    NEUTRAL    joints go to zero at a limited rate, then the torque goes off; only a person ends this state

A cell is a state to go to, HOLD (the last angles stay, the state too), REFUSE (no way up from here while it lasts), LET_GO (the
torque goes off at once instead of on the way to zero), or STAY. If several conditions are true at once, the most careful cell
wins: NEUTRAL, DOWN, LET_GO or REFUSE, HOLD, then a way up. A condition with LET_GO in NEUTRAL also acts on the way there.
"""

from enum import Enum, IntEnum, IntFlag, auto
from typing import NamedTuple


class SwimState(IntEnum):
    """State of the swim, of host and robot together."""

    DOWN = 0
    LINKED = 1
    ARMED = 2
    SWIMMING = 3
    NEUTRAL = 4


class Condition(IntFlag):
    """Conditions at a tick. Three lead up, `PERSON_LEAVES` leads from NEUTRAL to DOWN, all others hold or end a swim."""

    HEARD = auto()  # the robot answers, and has said what it is where its protocol can
    ASK_ARM = auto()  # a person asked to arm, and the robot says that it is armed where it can
    ASK_SWIM = auto()  # a person asked for the policy, and an observation is complete
    PERSON_LEAVES = auto()  # a person has looked at the fish and goes on
    FINISHED = auto()  # the time of the swim is over
    LINK_QUIET = auto()  # nothing heard for `quiet` s, or no command of ours arrived
    LINK_SILENT = auto()  # the same for `silent` s
    POSE_OLD = auto()  # the newest pose is older than `pose_old` s
    POSE_LOST = auto()  # older than `pose_lost` s
    POSE_JUMP = auto()  # the newest fix lies where the fish cannot be
    BATTERY_LOW = auto()
    SERVO_HOT = auto()
    SERVO_STUCK = auto()  # a joint does not follow
    SERVO_LOST = auto()  # a servo does not answer
    READING_BAD = auto()  # the robot sent an angle that is no number, or beyond any servo
    ACTION_NAN = auto()  # the policy's answer is not finite
    POLICY_MISMATCH = auto()  # the policy is for another fish, or for joints in another order
    WATCHDOG_MISSING = auto()  # the robot has no watchdog of its own, and no person stands at the tank
    ROBOT_NEUTRAL = auto()  # the robot's own watchdog ended the swim, or the robot began anew
    OPERATOR_STOP = auto()
    LEFT_TANK = auto()  # the newest pose lies beyond where the fish may swim
    STOP_NOW = auto()  # the operator stops what is on its way to zero already


class Stay(Enum):
    """Cells of the table that are not a state."""

    STAY = 0
    HOLD = 2
    REFUSE = 3
    LET_GO = 4


class Action(Enum):
    """Commands that the host sends in a state."""

    LISTEN = "listen"  # nothing but greetings
    HOLD = "hold"  # the last angles
    SWIM = "swim"  # the policy's
    RETURN = "return"  # to zero at a limited rate, then torque off
    LET_GO = "let go"  # torque off now: a servo that is hot, jammed or unheard is not pulled anywhere


Cell = SwimState | Stay
C = Condition
DOWN, LINKED, ARMED, SWIMMING, NEUTRAL = SwimState
STAY, HOLD, REFUSE, LET_GO = Stay
TABLE: dict[Condition, tuple[Cell, Cell, Cell, Cell, Cell]] = {
    #                    DOWN    LINKED  ARMED     SWIMMING NEUTRAL
    C.HEARD:            (LINKED, STAY,   STAY,     STAY,    STAY),
    C.ASK_ARM:          (STAY,   ARMED,  STAY,     STAY,    STAY),
    C.ASK_SWIM:         (STAY,   STAY,   SWIMMING, STAY,    STAY),
    C.PERSON_LEAVES:    (STAY,   STAY,   STAY,     STAY,    DOWN),
    C.FINISHED:         (STAY,   STAY,   NEUTRAL,  NEUTRAL, STAY),
    C.LINK_QUIET:       (STAY,   REFUSE, HOLD,     HOLD,    STAY),
    C.LINK_SILENT:      (REFUSE, DOWN,   NEUTRAL,  NEUTRAL, STAY),
    C.POSE_OLD:         (STAY,   STAY,   HOLD,     HOLD,    STAY),
    C.POSE_LOST:        (STAY,   REFUSE, NEUTRAL,  NEUTRAL, STAY),
    C.POSE_JUMP:        (STAY,   STAY,   HOLD,     HOLD,    STAY),
    C.BATTERY_LOW:      (STAY,   REFUSE, NEUTRAL,  NEUTRAL, STAY),
    C.SERVO_HOT:        (STAY,   REFUSE, NEUTRAL,  NEUTRAL, LET_GO),
    C.SERVO_STUCK:      (STAY,   REFUSE, NEUTRAL,  NEUTRAL, LET_GO),
    C.SERVO_LOST:       (STAY,   REFUSE, NEUTRAL,  NEUTRAL, LET_GO),
    C.READING_BAD:      (STAY,   REFUSE, NEUTRAL,  NEUTRAL, STAY),
    C.ACTION_NAN:       (STAY,   STAY,   NEUTRAL,  NEUTRAL, STAY),
    C.POLICY_MISMATCH:  (STAY,   REFUSE, NEUTRAL,  NEUTRAL, STAY),
    C.WATCHDOG_MISSING: (STAY,   REFUSE, NEUTRAL,  NEUTRAL, STAY),
    C.ROBOT_NEUTRAL:    (STAY,   STAY,   NEUTRAL,  NEUTRAL, STAY),
    C.OPERATOR_STOP:    (STAY,   REFUSE, NEUTRAL,  NEUTRAL, STAY),
    C.LEFT_TANK:        (STAY,   REFUSE, NEUTRAL,  NEUTRAL, STAY),
    C.STOP_NOW:         (STAY,   REFUSE, NEUTRAL,  NEUTRAL, LET_GO),
}  # fmt: skip
ACTIONS = {
    DOWN: Action.LISTEN, LINKED: Action.LISTEN, ARMED: Action.HOLD, SWIMMING: Action.SWIM, NEUTRAL: Action.RETURN,
}  # fmt: skip
NONE = Condition(0)


class Event(NamedTuple):
    """A change of state: time on the host's clock, s, old and new state, the causing conditions, and the other true ones."""

    t: float
    before: SwimState
    after: SwimState
    because: Condition
    conditions: Condition


class Decision(NamedTuple):
    """State and action from this tick on; `because`: conditions that hold the fish, refuse a way up, or changed the state."""

    state: SwimState
    action: Action
    because: Condition


def care(cell: Cell) -> int:
    """Priority of a cell: of several, the highest wins."""
    if isinstance(cell, Stay):
        return {STAY: 0, HOLD: 2, REFUSE: 3, LET_GO: 3}[cell]
    return {NEUTRAL: 5, DOWN: 4}.get(cell, 1)


def decide(state: SwimState, conditions: Condition) -> Decision:
    """Reads the table for one tick. A pure function."""
    cells = {condition: TABLE[condition][state] for condition in TABLE if condition in conditions}
    strictest = max((care(cell) for cell in cells.values()), default=0)
    ruling = [condition for condition, cell in cells.items() if care(cell) == strictest] if strictest else []
    because = Condition(sum(ruling))
    cell = cells[ruling[0]] if ruling else STAY
    after = cell if isinstance(cell, SwimState) else state
    if after is NEUTRAL and any(TABLE[condition][NEUTRAL] is LET_GO for condition in cells):
        return Decision(after, Action.LET_GO, because)
    held = ACTIONS[after] is Action.SWIM and (cell is HOLD or cell is REFUSE)
    return Decision(after, Action.HOLD if held else ACTIONS[after], because)


class Supervisor:
    """The state, and its history. state: now. events: changes so far, oldest first."""

    def __init__(self) -> None:
        self.state = SwimState.DOWN
        self.events: list[Event] = []

    def step(self, now: float, conditions: Condition) -> Decision:
        """Decides for the tick at `now` s and records a change of state."""
        decision = decide(self.state, conditions)
        if decision.state is not self.state:
            self.events.append(Event(now, self.state, decision.state, decision.because, conditions))
            self.state = decision.state
        return decision

    @property
    def cause(self) -> Condition:
        """Conditions that led to the present or last NEUTRAL; NONE before."""
        return next((event.because for event in reversed(self.events) if event.after is SwimState.NEUTRAL), NONE)


def named(conditions: Condition) -> str:
    """Names of conditions: `LINK_QUIET, POSE_OLD`; "" for none."""
    return ", ".join(condition.name or "" for condition in Condition if condition in conditions)
