"""Effects of a description in the flow solver's tanks: which can act there, and how.

    servo, gear, command    drive, torque and damping of each joint, in place of MuJoCo's servo
    fish                    masses of the links; gains and limits of the servos
    body                    forces and masses that are not the water's, such as a tether
    flow                    a velocity that is the same everywhere and at all times joins the tank's stream
    delays, measure         by whoever sends commands and reads sensors, as for every engine

The solver is the water. What an effect does to strips, to added mass or to forces of the water has no place in it: `in_tank` says
so, from what the effect's own functions do at their sites. It holds for the catalogue and for an effect of one's own.
"""

from collections.abc import Iterable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from fishmj import effects
from fishmj.dynamics import planar_chain
from fishmj.effects import Effect, EffectStack
from fishmj.effects.sites import BodyMotion, Constants, FlowAt, Gear
from fishmj.engines.extensions import Commanded
from fishmj.errors import ConfigError, UnknownName
from fishmj.flow import DrawnFlow, Flow
from fishmj.lbm_oracle.immersed.driven_body import DrivenBody
from fishmj.lbm_oracle.run.run import Run
from fishmj.mjcf.description import Robot, load_robot

WATER = "the solver is the water"
SOLID = {"chain": ("com", "inertia", "mass", "torque", "motor"), "swimmer": ("mass", "kp", "kv", "kb", "zero")}  # what may change
FORCES = ("fx", "fy", "n", "mx", "my", "mn")
OF_THE_WATER = ("u", "w", "tail", "sway_mass", "drag", "wet", "added")  # fields of a BodyMotion
STATES = 50  # random ones at which an effect is asked
CLOCK = 1  # place of the session's time in an effect's memory


def in_tank(effect: Effect) -> str:
    """Why an effect has no place in the flow solver's tanks; "" where it acts."""
    if effect.stochastic:
        return "it is drawn when data are made, no simulator holds it"
    if effect.water is not None:
        return f"it changes the forces of strips, {WATER}"
    for row in _sizes(effect):
        for site, judge in (("fish", _fish), ("body", _body), ("gear", _gear), ("flow", _flow)):
            if getattr(effect, site) is not None and (why := judge(effect, row)):
                return why
    return ""


def refused(robot: Robot) -> dict[str, str]:
    """{name: reason} of the robot's effects that have no place in a tank."""
    found = {fitted.name: in_tank(effects.get(fitted.name)) for fitted in robot.effects}
    return {name: why for name, why in found.items() if why}


def without(robot: Robot, names: Iterable[str]) -> Robot:
    """The robot without some of its effects. Raises UnknownName: it has no such effect."""
    have, names = [fitted.name for fitted in robot.effects], tuple(names)
    if wrong := [name for name in names if name not in have]:
        raise UnknownName(f"effect of {robot.name} to leave out", wrong[0], have)
    return replace(robot, effects=tuple(fitted for fitted in robot.effects if fitted.name not in names))


def check_effects(robot: Robot) -> None:
    """Raises ConfigError: some of the robot's effects have no place in a tank; names each, says why and what to do."""
    if found := refused(robot):
        each = "; ".join(f"{name}: {why}" for name, why in found.items())
        raise ConfigError(
            f"{robot.name} in the flow solver: {each}. Judge without: fishmj evaluate --leave-out {','.join(found)}; elsewhere"
            " take those blocks [[effect]] out of the description"
        )


class TankEffects:
    """The effects of one fish in its tank.

    Args:
        active: those of the description. row: (P,) this fish's parameters. memory: (M,) what they remember at its start.
        swimmer: its own constants, lists of floats.

    Attributes:
        memory: flat list, as it is now.
    """

    def __init__(self, robot: Robot, active: EffectStack, row, memory, swimmer: planar_chain.Swimmer):
        self.active, self.row = active, [float(x) for x in row]
        self.memory = [float(x) for x in memory][: len(active.memory)]
        self.chain, self.swimmer = active.begin(np, self.row, self.memory).fish(Constants(planar_chain.chain_of(robot), swimmer))
        self._still = [(0.0, 0.0)] * self.chain.n
        self._begun, self._tick, self._kept = self.memory[CLOCK], -1, list(self.memory)

    def stream(self, flow: Flow) -> Flow:
        """The tank's flow with what the effects add to its mean."""
        given = FlowAt(0.0, 0.0, 0.0, 0.0, 0.0)
        found = self.active.begin(np, self.row, self.memory).flow(given)
        if (found.u, found.v) == (0.0, 0.0):
            return flow
        drawn = flow.current()
        u, v = (float(c) for c in drawn.mean[0] + [found.u, found.v])
        known = {"turbulence": flow.turbulence, "intensity": flow.intensity, "seed": flow.seed, "box": flow.box}
        drawn = drawn._replace(mean=np.array([[u, v]]))
        return DrawnFlow(speed=float(np.hypot(u, v)), direction=float(np.arctan2(v, u)), drawn=drawn, **known)

    def shape(self, body: DrivenBody) -> None:
        """Give a body this fish's masses."""
        mass = np.asarray(self.swimmer.mass, float)
        body.set_masses(mass * self.chain.mass, self.chain.com, mass * self.chain.inertia)

    def restart(self) -> None:
        """A session begins: its clock stands at its start, joints and gears are as they are."""
        self.memory[CLOCK], self._tick = self._begun, -1

    def begin_tick(self, tick: int) -> None:
        """Called at the start of every attempt at a tick: a second one remembers what the first did at its start."""
        if tick == self._tick:
            self.memory = list(self._kept)
        self._tick, self._kept = tick, list(self.memory)

    def push(self, body: DrivenBody, target) -> float:
        """Set what acts in the next step of the body, for what the bus delivered, (J,) rad; the servos' power in it, W."""
        q, v = body.data.qpos.tolist(), body.data.qvel.tolist()
        ch, sw = self.chain._replace(dt=body.dt), self.swimmer
        hooks = Commanded(np, self.active, self.row, self.memory, 0.0)
        drive, resist = hooks.servos(ch, sw, q, v, list(target))
        rhs, mass = [0.0] * (ch.n + 2), [[0.0] * (r + 1) for r in range(ch.n + 2)]
        hooks.body(ch, sw, q, planar_chain.kinematics(np, ch, q, v, self._still), rhs, mass)
        applied = np.array(planar_chain.generalised(np, ch, q[2], rhs), float)
        applied[3:] += drive
        if hooks.session.acts("body"):
            body.added_mass = _generalised_mass(ch, q[2], mass)
        body.drive(applied, np.add(sw.kb, resist))
        self.memory = list(hooks.end(ch, sw, v, drive))
        return float(planar_chain.electrical_power(np, sw, v, drive))


class EffectRun(Run):
    """A `Run` whose joints are moved by a fish's effects and servos; arguments as there."""

    def __init__(self, added: TankEffects, *args, **options):
        self.added = added
        super().__init__(*args, **options)

    def begin(self) -> None:
        super().begin()
        self.added.restart()

    def _driver(self, coupled, factor: int) -> "EffectServos":
        return EffectServos(self, coupled, factor)


class EffectServos:
    """The servos with the effects on their way, for one attempt at a tick."""

    def __init__(self, run: EffectRun, coupled, factor: int):
        self.run, self.body, self.factor = run, coupled.body, factor
        self.watts: list[float] = []
        run.added.begin_tick(run.ticks)

    def actuate(self, step: int) -> tuple:
        run = self.run
        self.watts.append(run.added.push(self.body, run.servo_target(run.ticks * run.steps + step // self.factor)))
        return run.prescribed_velocity(self.body.dt)

    def record(self) -> None:
        """Their power is known already."""

    def follow(self) -> None:
        """Nothing to follow."""

    @property
    def power(self) -> float:
        return sum(self.watts) / len(self.watts)


def _generalised_mass(ch: planar_chain.Chain, heading: float, lower: list) -> np.ndarray:
    """T^T M T over (x, y, psi, j ..) of a mass matrix over (ax, ay, alpha_i), given by its lower triangle."""
    size = len(lower)
    whole = np.array([[lower[max(r, c)][min(r, c)] for c in range(size)] for r in range(size)], float)
    back = np.array([planar_chain.generalised(np, ch, heading, row) for row in np.eye(size).tolist()]).T
    return back @ whole @ back.T


def _sizes(effect: Effect) -> list[SimpleNamespace]:
    """Parameters to ask an effect at: both typical sizes, both bounds."""
    picks = (lambda p: p.typical[0], lambda p: p.typical[1], lambda p: p.low, lambda p: p.high)
    return [SimpleNamespace(**{p.name: float(pick(p)) for p in effect.parameters}, joint=0) for pick in picks]


def _fish(effect: Effect, p) -> str:
    robot = load_robot("fish")
    given = Constants(planar_chain.chain_of(robot), planar_chain.nominal(robot))
    found = effect.fish(np, p, given)
    for group, free in SOLID.items():
        before, after = getattr(given, group), getattr(found, group)
        changed = [name for name in before._fields if not _same(getattr(before, name), getattr(after, name))]
        if "water" in changed:
            return f"it changes coefficients of strips, {WATER}"
        if other := [name for name in changed if name not in free]:
            return f"it changes {', '.join(other)} of the {group}, and the tank's hull is the description's"
    return ""


def _body(effect: Effect, p) -> str:
    """Whether what it does is the same whatever the water does."""
    rng = np.random.default_rng(0)
    state = {name: rng.normal(size=STATES) for name in BodyMotion._fields} | dict.fromkeys((*FORCES, "added"), 0.0)
    ask = lambda **water: effect.body(np, p, BodyMotion(**{**state, **water}), effect.memory, 0.004)[0]
    dry = ask(**dict.fromkeys(OF_THE_WATER, 0.0))
    if not _same(dry.added, 0.0):
        return f"it changes added mass, {WATER}"
    for _ in range(3):
        wet = ask(**{name: rng.normal(size=STATES) for name in OF_THE_WATER} | {"wet": 1.0, "added": 0.0})
        if not all(_same(getattr(dry, name), getattr(wet, name)) for name in FORCES) or not _same(wet.added, 0.0):
            return f"it is a force or an added mass of the water on the body, {WATER}"
    return ""


def _gear(effect: Effect, p) -> str:
    rng = np.random.default_rng(0)
    state = {name: rng.normal(size=STATES) for name in ("drive", "angle", "rate", "torque")}
    ask = lambda wet: effect.gear(np, p, Gear(**state, resist=0.0, wet=wet, kb=0.3, limit=1.6), effect.memory, 0.004)
    (dry, kept), (wet, other) = ask(0.0), ask(1.0)
    return "" if _same((*dry._replace(wet=1.0), *kept), (*wet, *other)) else f"it is a drag of water on the joints, {WATER}"


def _flow(effect: Effect, p) -> str:
    """Whether it adds one velocity, whatever the place, the time and the water's own."""
    rng = np.random.default_rng(0)
    place = FlowAt(*rng.normal(size=(5, STATES)))
    found = effect.flow(np, p, place)
    if all(np.ptp(np.asarray(a) - b) < 1e-9 for a, b in ((found.u, place.u), (found.v, place.v))):
        return ""
    return "its water differs from place to place or in time, and a tank takes a mean stream that is uniform and steady"


def _same(a, b) -> bool:
    """Equal numbers, in lists or arrays of any depth."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    return bool(np.all(np.equal(a, b)))
