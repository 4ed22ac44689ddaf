"""The water `hybrid`: the surrogate swims, and every so often a short stretch in the flow solver corrects its coefficients.

    hybrid = Hybrid(Surrogate(robot, chain, base), Solver(robot, domain))
    for command in commands:                          (J,) rad, one a bus tick
        hybrid.tick(command)
    hybrid.episode(), hybrid.state, hybrid.off        what it did, the factors, why it was switched off ("" while it is on)

    surrogate   |---------- every ----------|---------- every ----------|
    solver      |lead|span|                 |lead|span|                    re-seeded from the surrogate's state, same commands

The solver's water stays as its fish left it and the fish is put where the surrogate's is: during `lead` the water gets used to
it, only rows of `span` count. The surrogate's own state is never moved, so a corrected swim has no jumps. A solver that is
missing, fails or takes longer than `patience` seconds a stretch switches itself off once, with one warning; what was learnt
stays. Uniform streams only.
"""

import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from fishmj import console
from fishmj.errors import ConfigError, FishmjError, MissingExtra
from fishmj.flow import Flow
from fishmj.hydro_fit import chain, correct, learned, terms
from fishmj.mjcf.bus import arrived, on_the_bus
from fishmj.mjcf.description import Robot


class Stretch(NamedTuple):
    """n ticks in the solver: states before the first and after each, and mean wrenches on the links over each."""

    q: np.ndarray  # (n + 1, 3 + J)
    v: np.ndarray  # (n + 1, 3 + J)
    wrench: np.ndarray  # (n, N, 3) F_x, F_y [N], M_z [N m], tank frame


class Oracle(Protocol):
    """A better water."""

    def stretch(self, q, v, past: list[np.ndarray], commands: np.ndarray) -> Stretch:
        """Swim `commands` (n, J) from q, v (3 + J,); `past`: commands on the bus before, oldest first."""


class Solver:
    """The flow solver, set up at the first stretch and kept.

    Args:
        flow: a uniform stream. slip, device: of the solver.
    """

    def __init__(self, robot: Robot, domain, *, flow: Flow | None = None, slip: float = 1.0, device: str = "cpu"):
        self.robot, self.domain, self.flow, self.slip, self.device = robot, domain, flow or Flow(), slip, device
        self.run: Any = None

    def stretch(self, q, v, past, commands) -> Stretch:
        """As `Oracle.stretch`.

        Raises:
            MissingExtra: the solver's packages are absent. LeftDomain, SimDiverged, OracleUnstable, ConfigError: it fails.
        """
        run = self._placed(np.asarray(q, float), np.asarray(v, float))
        run.commands = [np.array(command) for command in past]
        run.ticks = len(past) - 1
        first = len(run.rows)
        for command in commands:
            run.tick(command)
        _, _, _, pose, joint, rate, _, _, whole = (np.array(column) for column in zip(*run.rows[first:], strict=True))
        after = np.concatenate([pose[:, :3], joint], 1), np.concatenate([pose[:, 3:], rate], 1)
        places, rates = (np.concatenate([[start], rows]) for start, rows in zip((q, v), after, strict=True))
        return Stretch(places, rates, whole[:, :, [0, 1, 5]])

    def _placed(self, q: np.ndarray, v: np.ndarray):
        """The run with its fish in this state."""
        try:
            from fishmj.lbm_oracle.run import Run
            from fishmj.lbm_oracle.stage import Edge, Stage
            from fishmj.lbm_oracle.state import reseed
            from fishmj.mjcf.model import reference_qpos
        except ModuleNotFoundError as error:
            raise MissingExtra(str(error.name), "oracle", "the flow solver") from error

        pose, joints = tuple(q[:3].tolist()), tuple(q[3:].tolist())
        if self.run is None:
            stage = Stage(
                domain=self.domain, robot=self.robot, flow=self.flow, slip=self.slip, pose=pose, joints=joints, device=self.device
            )
            coupled = stage.coupled()
            coupled.body.place(reference_qpos(coupled.body.model, pose, joints), v)
            self.run = Run(coupled, self.robot, follow=Edge(self.domain, pose[2]))
            return self.run
        run = self.run
        coupled = run.coupled
        reseed(coupled, reference_qpos(coupled.body.model, pose, joints), v)
        edge = Edge(self.domain, pose[2])
        while self.domain.follows and edge.follow(coupled):  # the window goes where the fish is
            pass
        run.follow, run.fastest = edge, 0.0
        return run


class Surrogate:
    """One fish in the strip water with or without a residual, by bus ticks in NumPy.

    Args:
        water: coefficients; replaced while it swims. learnt: a residual. stream: (2,) m/s of uniform flow.
    """

    def __init__(
        self, robot: Robot, ch: chain.Chain, water: terms.Coefficients, *, learnt=None, stream=(0.0, 0.0), pose=(0.0, 0.0, 0.0)
    ):
        self.robot, self.chain, self.water, self.learnt = robot, ch, water, learnt
        self.stream = [tuple(float(u) for u in stream)] * ch.n
        self.steps = round(robot.timing.bus_dt / ch.dt)
        self.delay = round(robot.timing.command_latency / ch.dt)
        self.swimmer = chain.nominal(robot)
        self.q, self.v = np.array([*pose, *np.zeros(ch.n - 1)], float), np.zeros(ch.n + 2)
        self.attached, self.memory = 0.5, learned.at_rest(ch.n)
        self.commands, self.ticks = [np.zeros(ch.n - 1)], 0

    def tick(self, command, flow=None) -> None:
        """20 ms on, after sending `command`, (J,) rad; `flow` (N, 2) m/s at the links in place of the uniform stream."""
        stream = self.stream if flow is None else [tuple(u) for u in np.asarray(flow).tolist()]
        self.commands.append(on_the_bus(self.robot.servo, np.asarray(command, float)))
        ramp, sw = self.robot.timing.command_path == "move_time", self.swimmer._replace(water=self.water)
        for i in range(self.steps):
            target = arrived(self.commands, self.ticks * self.steps + i, self.delay, self.steps, ramp)
            hooks = None if self.learnt is None else learned.Learned(np, self.chain, self.learnt, self.memory)
            given = (list(self.q), list(self.v), self.attached, list(target), stream, (0.0, 0.0), hooks)
            s = chain.step(np, self.chain, sw, *given)
            self.q, self.v, self.attached = np.array(s.q), np.array(s.v), s.attached
            self.memory = list(s.memory) if hooks else self.memory
        self.ticks += 1


@dataclass
class Hybrid:
    """A surrogate with a solver that corrects it.

    Attributes:
        every, lead, span: s of bus ticks; the solver runs for (lead + span) of every `every`.
        own: (3,) error of a right surrogate, `HydroModel.scores["own"]`. patience: wall-clock s that a stretch may take.
    """

    surrogate: Surrogate
    oracle: Oracle | None
    own: tuple | list | np.ndarray
    every: float = 8.0
    lead: float = 0.6
    span: float = 0.2
    patience: float = 60.0
    off: str = ""
    state: correct.Correction = field(default_factory=correct.fresh)
    rows: list = field(default_factory=list)  # (t, excess, wall s) of every stretch
    path: list = field(default_factory=list)  # q after every tick

    def __post_init__(self):
        if not (self.span > 0 and self.lead >= 0 and self.lead + self.span <= self.every):
            raise ConfigError(
                f"hybrid: lead {self.lead} s and span {self.span} s; expected span > 0 and both within {self.every} s"
            )
        self.base = self.surrogate.water
        self.size = self.surrogate.robot.timing.bus_dt
        self._open: dict | None = None
        if self.oracle is None:
            self._switch_off("there is no solver")

    def tick(self, command) -> None:
        """One bus tick; at the end of a stretch the solver swims the same commands and the coefficients follow."""
        fish, now = self.surrogate, self.surrogate.ticks
        if not self.off and now and now % round(self.every / self.size) == 0:
            self._open = {"q": fish.q.copy(), "v": fish.v.copy(), "x": fish.attached, "memory": list(fish.memory), "at": now}
        fish.tick(command)
        self.path.append(fish.q.copy())
        if self._open is not None and fish.ticks - self._open["at"] == round((self.lead + self.span) / self.size):
            self._look(self._open)
            self._open = None

    def _look(self, start: dict) -> None:
        fish, at, began = self.surrogate, start["at"], time.perf_counter()
        oracle = self.oracle
        if oracle is None or self.off:
            return
        try:
            seen = oracle.stretch(start["q"], start["v"], fish.commands[: at + 1], np.array(fish.commands[at + 1 :]))
        except (FishmjError, ArithmeticError, RuntimeError) as error:  # a device that is gone raises RuntimeError
            self._switch_off(" ".join(str(error).split()))
            return
        wall = time.perf_counter() - began
        self._learn(seen, start)
        self.rows.append((at * self.size, self.state.excess(self.own), wall))
        if wall > self.patience and len(self.rows) > 1:  # the first one sets the solver up
            self._switch_off(f"a stretch took {wall:.1f} s of the {self.patience:g} s that it may")

    def _learn(self, seen: Stretch, start: dict) -> None:
        fish, x, memory, lead = self.surrogate, start["x"], start["memory"], round(self.lead / self.size)
        s, ch = fish.chain.strips, fish.chain
        idle = self.every - self.span
        for k, wrench in enumerate(seen.wrench):
            states = (seen.q[k], seen.v[k], seen.q[k + 1], seen.v[k + 1])
            row = correct.rows_between(ch, *states, np.array(fish.stream), wrench, x, np.zeros((3, ch.n)), self.size)
            if fish.learnt is not None:
                hooks = learned.Learned(np, ch, fish.learnt, memory)
                force = hooks.advance(s, self.base, chain.Links([], [], list(row.omega), list(row.u), list(row.w), []), self.size)
                row, memory = row._replace(extra=np.array(force).T), list(hooks.end(ch, None, None, None))
            x = terms.attachment(np, s, self.base, row.u[-1], row.w[-1], row.omega[-1], x, self.size)
            if k >= lead:
                gap = idle if k == lead and self.rows else 0.0
                self.state = correct.update(self.state, s, self.base, row, own=self.own, tick=self.size, idle=gap)
        fish.water = correct.applied(self.base, self.state)

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
            "stretches": [{"t": t, "excess": excess, "wall_s": wall} for t, excess, wall in self.rows],
            "factors": self.state.factors.tolist(),
            "off": self.off,
        }
