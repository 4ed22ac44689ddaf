"""The water `hybrid`: the surrogate swims, and every so often a short stretch in the flow solver corrects its coefficients.

    hybrid = Hybrid(Surrogate(robot, chain, base), Solver(robot, domain))
    for command in commands:                          (J,) rad, one a bus tick
        hybrid.tick(command)
    hybrid.episode(), hybrid.state, hybrid.off        what it did, the factors, why it was switched off ("" while it is on)

    surrogate   |first|---------- every ----------|---------- every ----------|
    solver            |lead|span|                 |lead|span|                    re-seeded from the surrogate's state

The solver's water stays as its fish left it and the fish is put where the surrogate's is: during `lead` it is led along the
surrogate's own path, to the letter, until the water has got used to it, then it swims the same commands by its servos. How far
the two drift apart within `span` moves the factors (`online_correction.matched`). A fish at rest in still water needs no lead.
The surrogate's own state is never moved, so a corrected swim has no jumps. A solver that is missing, fails or takes longer than
`patience` seconds a stretch switches itself off once, with one warning; what was learnt stays. Uniform streams only.
"""

import time
from copy import copy
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from fishmj import console
from fishmj.campaign.data.run_segments import Driven
from fishmj.dynamics import planar_chain, strip_forces
from fishmj.engines.single import SingleFish
from fishmj.errors import ConfigError, FishmjError
from fishmj.flow import Flow
from fishmj.hydro_fit import online_correction
from fishmj.hydro_fit.fit.tolerance import WINDOW, of_movement
from fishmj.lbm_oracle.immersed.snapshot import reseed
from fishmj.lbm_oracle.run.setup import DomainWatch, SwimSetup
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import reference_qpos
from fishmj.mjcf.servos import arrived, on_the_bus
from fishmj.water import residual_hooks


class Path(NamedTuple):
    """A movement by physics steps of dt: states at its start and after each of m steps, (m + 1, 3 + J)."""

    q: np.ndarray
    v: np.ndarray
    dt: float

    def at(self, t: float) -> np.ndarray:
        """(3 + J,) t seconds after its start, in straight lines from step to step."""
        step = min(max(t / self.dt, 0.0), len(self.q) - 1.0)
        k = max(min(int(step), len(self.q) - 2), 0)
        return self.q[k] + (step - k) * (self.q[k + 1] - self.q[k])


class CorrectionSegment(NamedTuple):
    """n ticks of free swimming in the better water: states before the first and after each, (n + 1, 3 + J)."""

    q: np.ndarray
    v: np.ndarray


class Oracle(Protocol):
    """A better water."""

    def stretch(self, path: Path, past: list[np.ndarray], commands: np.ndarray) -> CorrectionSegment:
        """Along the path, then by `commands` (n, J) from its end; `past`: all commands on the bus before those, oldest first."""


class Solver:
    """The flow solver, set up at the first stretch and kept.

    Args:
        flow: a uniform stream. slip, device: of the solver.
    """

    def __init__(self, robot: Robot, domain, *, flow: Flow | None = None, slip: float = 1.0, device: str = "cpu"):
        self.robot, self.domain, self.flow, self.slip, self.device = robot, domain, flow or Flow(), slip, device
        self.run: Any = None

    def stretch(self, path: Path, past: list[np.ndarray], commands: np.ndarray) -> CorrectionSegment:
        """As `Oracle.stretch`.

        Raises:
            LeftDomain, SimDiverged, OracleUnstable, ConfigError: it fails.
        """
        run = self.reseeded(path)
        self.tow(run, path)
        run.tethered, run.root, run.prescribed = False, None, None
        run.commands, run.ticks, first = [np.array(command) for command in past], len(past) - 1, len(run.rows)
        start = (np.concatenate([run.pose[:3], run.angles()]), np.concatenate([run.pose[3:], run.rates()]))
        for command in commands:
            run.tick(command)
        pose, joint, rate = (np.array([row[i] for row in run.rows[first:]]) for i in (3, 4, 5))
        after = np.concatenate([pose[:, :3], joint], 1), np.concatenate([pose[:, 3:], rate], 1)
        return CorrectionSegment(*(np.concatenate([[one], rows]) for one, rows in zip(start, after, strict=True)))

    def tow(self, run, path: Path) -> np.ndarray:
        """(n, N, 3) mean wrenches F_x, F_y, M_z over the ticks of a path that the fish follows to the letter."""
        run.tethered, run.root, run.prescribed = True, (lambda t: path.at(t)[:3]), (lambda t: path.at(t)[3:])
        for _ in range(round((len(path.q) - 1) * path.dt / self.robot.timing.bus_dt)):
            run.tick()
        return np.array([row[-1] for row in run.rows]).reshape(-1, len(self.robot.links), 6)[:, :, [0, 1, 5]]

    def reseeded(self, path: Path):
        """The run with its fish at the start of the path."""
        q, v = path.q[0], path.v[0]
        pose, joints = tuple(q[:3].tolist()), tuple(q[3:].tolist())
        if self.run is None:
            water: dict[str, Any] = {"domain": self.domain, "flow": self.flow, "slip": self.slip, "device": self.device}
            coupled = SwimSetup(robot=self.robot, pose=pose, joints=joints, **water).coupled()
            self.run = Driven(coupled, self.robot, follow=DomainWatch(self.domain, pose[2]))
        run, edge = self.run, DomainWatch(self.domain, pose[2])
        reseed(run.coupled, reference_qpos(run.coupled.body.model, pose, joints), v)
        run.coupled.take_wrench(1.0)  # what is left of the stretch before
        while self.domain.follows and edge.follow(run.coupled):  # the window goes where the fish is
            pass
        run.follow = edge
        run.begin()
        return run


class Surrogate(SingleFish):
    """One fish in the strip water with or without a residual, by bus ticks in NumPy.

    Args:
        water: coefficients; replaced while it swims. learnt: a residual. stream: (2,) m/s of uniform flow.
    """

    def __init__(
        self,
        robot: Robot,
        ch: planar_chain.Chain,
        water: strip_forces.Coefficients,
        *,
        learnt=None,
        stream=(0.0, 0.0),
        pose=(0.0, 0.0, 0.0),
    ):
        hooks = None if learnt is None else (lambda memory: residual_hooks.LearnedResidual(np, ch, learnt, memory))
        super().__init__(ch, planar_chain.nominal(robot), hooks, residual_hooks.at_rest())
        self.robot, self.water = robot, water
        self.stream = [tuple(float(u) for u in stream)] * ch.n
        self.steps = round(robot.timing.bus_dt / ch.dt)
        self.delay = round(robot.timing.command_latency / ch.dt)
        self.q, self.v = np.array([*pose, *np.zeros(ch.n - 1)], float), np.zeros(ch.n + 2)
        self.commands, self.ticks = [np.zeros(ch.n - 1)], 0
        self.trail: list | None = None  # states after every physics step, while someone wants them

    def tick(self, command, flow=None) -> None:
        """20 ms on, after sending `command`, (J,) rad; `flow` (N, 2) m/s at the links in place of the uniform stream."""
        stream = self.stream if flow is None else [tuple(u) for u in np.asarray(flow).tolist()]
        self.commands.append(on_the_bus(self.robot.servo, np.asarray(command, float)))
        ramp = self.robot.timing.command_path == "move_time"
        self.swimmer = self.swimmer._replace(water=self.water)
        for i in range(self.steps):
            target = arrived(self.commands, self.ticks * self.steps + i, self.delay, self.steps, ramp)
            s = self.advance(list(self.q), list(self.v), list(target), stream, (0.0, 0.0))
            self.q, self.v = np.array(s.q), np.array(s.v)
            if self.trail is not None:
                self.trail.append((self.q, self.v))
        self.ticks += 1


@dataclass
class OpenSegment:
    """A stretch under way: ticks at its start and of its lead, and the surrogate where the lead ends."""

    at: int
    lead: int
    start: Surrogate | None = None


class MovementError:
    """How differently a surrogate with other factors moves over a stretch, in tolerances of a right one.

    Means of velocity ahead, to the left, and yaw rate over windows of `WINDOW` s: (R, B) for factors (10, B).
    """

    def __init__(self, start: Surrogate, base: strip_forces.Coefficients, seen: CorrectionSegment, commands, own: float):
        self.start, self.base, self.commands = start, base, commands
        self.window = max(1, min(round(WINDOW / start.robot.timing.bus_dt), len(commands)))
        self.seen = self._means(np.stack([_body(q, v) for q, v in zip(seen.q[1:], seen.v[1:], strict=True)])[..., None])
        speed, turn = of_movement(*self.seen[..., 0].T)
        self.wide = np.stack([speed, speed, turn], 1)[..., None] * np.sqrt(own)

    def __call__(self, factors: np.ndarray) -> np.ndarray:
        fish, count = copy(self.start), factors.shape[1]
        wide = lambda a: np.repeat(np.asarray(a, float)[..., None], count, -1)
        fish.q, fish.v, fish.attached, fish.memory = wide(fish.q), wide(fish.v), wide(fish.attached), list(wide(fish.memory))
        fish.commands, fish.trail = list(fish.commands[: fish.ticks + 1]), None
        fish.water = online_correction.applied(self.base, online_correction.fresh()._replace(factors=factors))
        out = []
        for command in self.commands:
            fish.tick(command)
            out.append(_body(fish.q, fish.v))
        return ((self._means(np.stack(out)) - self.seen) / self.wide).reshape(-1, count)

    def _means(self, values: np.ndarray) -> np.ndarray:
        """(T, 3, B) -> (K, 3, B)."""
        k = len(values) // self.window
        return values[: k * self.window].reshape(k, self.window, *values.shape[1:]).mean(1)


def _body(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Velocity ahead, to the left, and yaw rate."""
    c, s = np.cos(q[2]), np.sin(q[2])
    return np.stack([c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]])


@dataclass
class Hybrid:
    """A surrogate with a solver that corrects it.

    Attributes:
        first, every, lead, span: s of bus ticks; from `first` on the solver runs for (lead + span) of every `every`. A stretch
            that begins at rest has no lead, but as long a span. Whole windows of `WINDOW` s are compared.
        own: mean square, in tolerances, that nine of ten swims from rest of a right surrogate miss by less than,
            `HydroModel.scores["from_rest"]`: the unit of what a stretch misses by.
        patience: wall-clock s that a stretch may take.
    """

    surrogate: Surrogate
    oracle: Oracle | None
    own: float = 1.0
    every: float = 20.0
    first: float = 4.0
    lead: float = 1.0
    span: float = 1.0
    patience: float = 60.0
    off: str = ""
    state: online_correction.Correction = field(default_factory=online_correction.fresh)
    rows: list = field(default_factory=list)  # (t, rms difference of movement before and after, wall s) of every stretch
    path: list = field(default_factory=list)  # q after every tick

    def __post_init__(self):
        if not (self.span > 0 and self.lead >= 0 and self.first >= 0 and self.lead + self.span <= self.every):
            got = f"first {self.first}, lead {self.lead} and span {self.span} s"
            raise ConfigError(f"hybrid: {got}; expected first >= 0, span > 0, and lead and span within {self.every} s")
        self.base = self.surrogate.water
        self.size = self.surrogate.robot.timing.bus_dt
        self._open: OpenSegment | None = None
        if self.oracle is None:
            self._switch_off("there is no solver")

    def tick(self, command) -> None:
        """One bus tick; at the end of a stretch the solver swims it, too, and the coefficients follow."""
        fish, since = self.surrogate, self.surrogate.ticks - round(self.first / self.size)
        if not self.off and since >= 0 and since % round(self.every / self.size) == 0:
            still = not np.any(fish.v) and not np.any(fish.stream)
            self._open = OpenSegment(fish.ticks, 0 if still else round(self.lead / self.size))
            fish.trail = [(fish.q, fish.v)]
        opened = self._open
        if opened is not None and fish.ticks == opened.at + opened.lead:
            opened.start = copy(fish)
        fish.tick(command)
        self.path.append(fish.q.copy())
        if opened is not None and fish.ticks == opened.at + round((self.lead + self.span) / self.size):
            self._correct(opened)
            self._open, fish.trail = None, None

    def _correct(self, opened: "OpenSegment") -> None:
        began, oracle, fish, start = time.perf_counter(), self.oracle, self.surrogate, cast(Surrogate, opened.start)
        if oracle is None or self.off:
            return
        led = list(fish.trail or ())[: opened.lead * fish.steps + 1]
        q, v = (np.array(column) for column in zip(*led, strict=True))
        path = Path(q, v, fish.chain.dt)
        commands = np.array(fish.commands[start.ticks + 1 :])
        try:
            seen = oracle.stretch(path, fish.commands[: start.ticks + 1], commands)
        except (FishmjError, ArithmeticError, RuntimeError) as error:  # a device that is gone raises RuntimeError
            self._switch_off(" ".join(str(error).split()))
            return
        wall = time.perf_counter() - began
        miss = MovementError(start, self.base, seen, commands, self.own)
        before = miss(self.state.factors[:, None])
        self.state = online_correction.matched(self.state, miss, idle=self.every if self.rows else 0.0)
        fish.water = online_correction.applied(self.base, self.state)
        after = miss(self.state.factors[:, None])
        rms = [float(np.sqrt(np.mean(r**2))) for r in (before, after)]
        self.rows.append((opened.at * self.size, *rms, wall))
        if wall > self.patience and len(self.rows) > 1:  # the first one sets the solver up
            self._switch_off(f"a stretch took {wall:.1f} s of the {self.patience:g} s that it may")

    def _switch_off(self, why: str) -> None:
        self.off = why
        console.warn(f"hybrid: the surrogate goes on by itself: {why}")

    def episode(self) -> dict:
        """Seconds swum, share of it in the solver, the stretches, the factors, and why it was switched off."""
        seconds = len(self.path) * self.size
        covered = len(self.rows) * (self.lead + self.span)
        return {
            "seconds": seconds,
            "covered": covered / max(seconds, self.size),
            "stretches": [dict(zip(("t", "before", "after", "wall_s"), row, strict=True)) for row in self.rows],
            "factors": self.state.factors.tolist(),
            "off": self.off,
        }
