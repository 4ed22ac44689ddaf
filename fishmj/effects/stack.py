"""Stack of effects: the physics of a fish calls it at its sites.

    active = EffectStack((friction, latency), joints=3)
    session = active.begin(xp, parameters, memory)      # parameters: flat list, memory: flat list
    drive = session.servo(j, servo) ...                 # the physics calls the sites in order
    session.memory                                      # memory for the next step

Parameters and memory are flat lists of scalars or arrays in the order of `active.names` and `active.memory`: easy to carry
through a compiled loop, a scan or a log.

Commands pass the sites `command` along time, before any physics (`delivered`). Effects that are drawn once a run widen the
scatter of replicates, so no site of the physics holds them.
"""

from types import SimpleNamespace
from typing import Any, NamedTuple

from fishmj.base.errors import UnknownName
from fishmj.effects.effect import Effect
from fishmj.effects.robot_scales import DEFAULT, RobotScales
from fishmj.effects.sites import BodyMotion, Constants, FlowAt, Gear, LocalWater, ServoDrive

BASE = 2  # memory that is always there: current from the supply [A], time [s]


class Slot(NamedTuple):
    """Position of one effect in the flat lists."""

    effect: Effect
    first: int  # parameter
    memory: int  # first memory value
    per_joint: bool


class EffectStack:
    """An ordered set of effects for a fish with `joints` joints, without parameters of joints that it does not have.

    robot: constants of the fish, which size its effects; default, those of the default fish.

    Attributes:
        names: (effect, parameter) of every entry of the flat parameter list. null: their null values.
        memory: initial values of the flat memory list.
    """

    def __init__(self, effects, joints: int, robot: RobotScales = DEFAULT):
        self.effects: tuple[Effect, ...] = tuple(effect.on_joints(joints).on_robot(robot) for effect in effects)
        self.joints, self.robot = joints, robot
        self.names, self.null, memory, slots = [], [], [0.0] * BASE, []
        for effect in self.effects:
            per_joint = bool(set(effect.remembering) & {"servo", "gear", "command"})
            slots.append(Slot(effect, len(self.names), len(memory), per_joint))
            self.names += [(effect.name, p.name) for p in effect.parameters]
            self.null += list(effect.null)
            memory += list(effect.memory) * (joints if per_joint else 1)
        self.slots, self.memory = tuple(slots), tuple(memory)
        self.order = tuple(sorted(slots, key=lambda slot: slot.effect.rank))  # in which they act at a site

    def index(self, effect: str, parameter: str) -> int:
        """Place of a parameter in the flat list. Raises UnknownName."""
        if (effect, parameter) not in self.names:
            known = [own for name, own in self.names if name == effect]
            raise UnknownName(f"parameter of {effect} of a robot with {self.joints} joints", parameter, known)
        return self.names.index((effect, parameter))

    def effect(self, name: str) -> Effect:
        """One of its effects. Raises UnknownName."""
        found = {effect.name: effect for effect in self.effects}
        if name not in found:
            raise UnknownName("effect of this stack", name, found)
        return found[name]

    def flat(self, values: dict[str, dict[str, float]]) -> list[float]:
        """{effect: {parameter: value}} as the flat list; missing parameters keep their null."""
        row = list(self.null)
        for effect, given in values.items():
            for parameter, value in given.items():
                row[self.index(effect, parameter)] = value
        return row

    def begin(self, xp, parameters, memory) -> "EffectStep":
        """The sites for one physics step."""
        return EffectStep(self, xp, list(parameters), list(memory))

    def delay(self, xp, parameters, clock: str, t=0.0):
        """Sum of the transport delays of a clock [s] at the times t [s] since the session began.

        Negative: its stamps are late.
        """
        total = 0.0
        for slot in self.slots:
            p = vars(self.values(slot, parameters))
            if clock in slot.effect.delays:
                total = total + p[slot.effect.delays[clock]]
            if clock in slot.effect.drifts:
                total = total + (p[slot.effect.drifts[clock]] - 1.0) * t
        return total

    def values(self, slot: Slot, parameters) -> SimpleNamespace:
        """The parameters of one effect by name, and `robot`."""
        named = {p.name: parameters[slot.first + i] for i, p in enumerate(slot.effect.parameters)}
        return SimpleNamespace(**named, robot=self.robot)

    def measure(self, xp, parameters, seen):
        """Applies the measurement effects to the record `seen`; parameters may be arrays that broadcast over its time axis."""
        for slot in self.order:
            if slot.effect.measure is not None:
                seen = slot.effect.measure(xp, self.values(slot, parameters), seen)
        return seen


class EffectStep:
    """One physics step: the sites, and the changing memory."""

    def __init__(self, active: EffectStack, xp, parameters: list, memory: list):
        self.xp, self.memory = xp, memory
        self._placed = [(slot, active.values(slot, parameters)) for slot in active.order]

    @property
    def current(self):
        """Current of all servos from the supply one step ago, A."""
        return self.memory[0]

    @property
    def time(self):
        """Time since the session began, s."""
        return self.memory[1]

    def command(self, joint: int, value, h: float):
        """A command on its way to the servo, rad."""
        return self._visit("command", value, h, joint)

    def servo(self, joint: int, servo: ServoDrive, h: float) -> ServoDrive:
        """One joint before its drive."""
        return self._visit("servo", servo, h, joint)

    def gear(self, joint: int, gear: Gear, h: float) -> Gear:
        """One joint after its drive."""
        return self._visit("gear", gear, h, joint)

    def body(self, body: BodyMotion, h: float) -> BodyMotion:
        """Forces on the whole body."""
        return self._visit("body", body, h)

    def water(self, water: LocalWater, h: float) -> LocalWater:
        """Forces on the links."""
        return self._visit("water", water, h)

    def fish(self, constants: Constants) -> Constants:
        """Masses and coefficients."""
        return self._plain("fish", constants)

    def flow(self, place: FlowAt) -> FlowAt:
        """Water velocity at one place."""
        return self._plain("flow", place)

    def end(self, current, h: float) -> list:
        """Memory for the next step."""
        self.memory[0], self.memory[1] = current, self.memory[1] + h
        return self.memory

    def acts(self, site: str) -> bool:
        """Returns True if any effect acts at this site."""
        return any(getattr(slot.effect, site) is not None for slot, _ in self._placed)

    def _plain(self, site: str, value: Any):
        for slot, p in self._placed:
            function = getattr(slot.effect, site)
            if function is not None:
                value = function(self.xp, p, value)
        return value

    def _visit(self, site: str, value: Any, h: float, joint: int = 0):
        for slot, p in self._placed:
            function = getattr(slot.effect, site)
            if function is None:
                continue
            size = len(slot.effect.memory)
            first = slot.memory + (joint * size if slot.per_joint else 0)
            here = SimpleNamespace(**vars(p), joint=joint) if slot.per_joint or site in ("servo", "gear", "command") else p
            value, after = function(self.xp, here, value, tuple(self.memory[first : first + size]), h)
            self.memory[first : first + size] = after
        return value


def delivered(xp, active: EffectStack, parameters, commands, h: float):
    """Commands as the servos receive them, except for the delay of the clock "command", which the servo applies itself.

    Args:
        xp: numpy, or jax.numpy outside a compiled function.
        active: the effects, in their order.
        parameters: (P,) one parameter row, or (B, P) a batch of them.
        commands: (T, J) rad, one row every `h` s: each physics step, or each event of the bus.

    Returns:
        (T, J) rad for one row of parameters, (B, T, J) for a batch.
    """
    commands, rows = xp.asarray(commands), xp.asarray(parameters)
    given = xp.broadcast_to(commands, (*rows.shape[:-1], *commands.shape))
    if not any(slot.effect.command for slot in active.slots):
        return given
    session = active.begin(xp, [rows[..., i] for i in range(rows.shape[-1])], active.memory)
    joints = range(commands.shape[1])
    moments = [xp.stack([session.command(j, given[..., k, j], h) for j in joints], -1) for k in range(len(commands))]
    return xp.stack(moments, -2)
