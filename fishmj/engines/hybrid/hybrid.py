"""Online correction of a swimming fish's water by short segments in a reference water, the flow solver.

    hybrid = Hybrid(robot, HybridOptions(every=50.0), kind=flow)
    params, current = hybrid.tick(fish, params, current, k)     before bus tick k: water and stream of that tick for MuJoCo
    hybrid.report()                                             corrections, their times, sizes and standard deviations

    MuJoCo      |first|---------- every ----------|---------- every ----------|
    segments          |lead|span|                 |lead|span|                    initialised from MuJoCo's state and stream
                                 |.. solved ..|^  corrected from this tick on

Each of the B fish has its own correction (`online_correction`). Only the water changes, never the state of the swim, so a
corrected swim has no jumps. MuJoCo does not wait: a worker thread runs the solver and the comparison, and its result is applied
at the next bus tick. With `wait` MuJoCo waits for each result, which makes runs reproducible. If the reference water is missing
or fails, it is switched off with one warning; the corrections so far stay.
"""

import atexit
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_kind, number, setting
from fishmj.engines import FishParams, FishState
from fishmj.engines.hybrid import online_correction
from fishmj.engines.hybrid.hybrid_segment import FreeSwim, HybridSegment, Misses, Oracle, Replay
from fishmj.engines.hybrid.online_correction import FACTORS, Correction
from fishmj.lbm_oracle.run.domain import PREVIEWS
from fishmj.lbm_oracle.run.solver_water import PLAIN, SolverWater, boundary_entry, water_of_fit
from fishmj.mjcf.description import Robot
from fishmj.water import choice
from fishmj.water.flow import Current, Flow, shifted

OWN = 2.0  # 90th percentile of the mean square residual, in tolerances, of a correct water; docs/simulate/fitted_water.md
SPAN = 2.0  # s, compared part of a segment
LEAD = f"s in which the fish is first moved along MuJoCo's path; {SPAN:g} s more are compared"
LEAVING = 10.0  # s that the end of the program waits for a tick of the solver


@dataclass(frozen=True, kw_only=True)
class HybridOptions:
    """Schedule and solver options of the correction of a water.

    Attributes:
        first, every, lead, span: s; from `first` on, the solver swims (lead + span) in every period `every`.
        domain, slip, boundary: of the solver: box by name (`laptop` is a preview), slip ratio of the hull, immersed boundary by
            name; None: those with which the segments of the fitted water were solved. device: auto, cpu, cuda or cuda:N.
        tank: flow whose mean is the stream of the tanks, with MuJoCo's eddies; None: MuJoCo's own stream.
        patience: s of wall clock for a segment; a later result is dropped. side_by_side: number of tanks at a time.
        wait: MuJoCo waits for the solver, however long it takes, so that runs are reproducible.

    Raises ConfigError: invalid times.
    """

    first: float = setting(10.0, number(0, 600), "s before the first segment")
    every: float = setting(50.0, number(4, 600), "s from the start of a segment to the next; each lasts 3.5 s")
    lead: float = setting(1.5, number(0, 60, above=True), LEAD)
    span: float = SPAN
    domain: str | None = None
    slip: float | None = None
    boundary: str | None = None
    device: str = "auto"
    tank: Flow | None = None
    own: float = setting(
        OWN, number(0, 1e6, above=True), "mean square residual, in tolerances, below which the water counts as correct"
    )
    patience: float = 60.0
    side_by_side: int = 12
    wait: bool = False

    def __post_init__(self):
        if not (self.span > 0 and self.lead > 0 and self.first >= 0 and self.lead + self.span <= self.every + 1e-9):
            got = f"first {self.first}, lead {self.lead} and span {self.span} s"
            raise ConfigError(f"hybrid: {got}; expected first >= 0, lead and span > 0, and both within {self.every} s")

    def solver(self, robot: Robot) -> SolverWater:
        """Water of the tanks. Raises ConfigError: no boundary has this name."""
        name = robot.name if choice.label(robot) == choice.FITTED else choice.label(robot)
        fitted = None if name in choice.KINDS else choice.fitted_water(name)
        made, slip = (fitted.dataset, fitted.slip) if fitted is not None else ({}, PLAIN.slip)
        made = made | ({"boundary": self.boundary} if self.boundary else {})
        return water_of_fit(made, slip if self.slip is None else self.slip, self.domain)

    def label(self, robot: Robot) -> str:
        """One line for tables: all options that a swim depends on."""
        return f"hybrid, {self.solver(robot).label}, {self.lead + self.span:g} of {self.every:g} s"


@dataclass
class _Recording:
    """Segment under way, for all fish: states and water at its start, states and commands since then."""

    tick: int
    params: FishParams
    current: Current
    states: list = field(default_factory=list)  # (q, v) of the lead
    start: Any = None  # FishState where the lead ends
    commands: list = field(default_factory=list)

    def segments(self, kind: Flow) -> list[HybridSegment]:
        """Segments of all fish with finite states."""
        q, v = (np.stack(column, 1) for column in zip(*self.states, strict=True))
        commands = np.stack(self.commands, 1)
        made = []
        for i in range(len(q)):
            row = lambda tree: type(tree)(*(np.asarray(a)[i : i + 1] for a in tree))  # noqa: B023, E731  used at once
            current = Current._make([*(np.asarray(a)[i : i + 1] for a in self.current[:5]), *self.current[5:]])
            made.append(HybridSegment(i, self.tick, q[i], v[i], row(self.start), commands[i], row(self.params), current, kind))
        return [one for one in made if np.isfinite(one.q).all() and np.isfinite(one.commands).all()]


@dataclass
class _Job:
    """Work of the thread: segments in the reference water, and the corrections from them."""

    segments: list[HybridSegment]
    states: list[Correction]  # of all fish, during the segments
    idle: list[float]  # s since the last segment of each fish
    began: float = field(default_factory=time.perf_counter)
    found: list[tuple[HybridSegment, Correction, dict]] = field(default_factory=list)
    failed: str = ""
    done: bool = False

    def run(self, oracle: Callable[[], Oracle], replay: Replay, own: float) -> None:
        """Solves, replays and compares the segments."""
        try:
            seen = list(zip(self.segments, oracle().swim(self.segments), strict=True))
            matched = lambda pair: self._matched(pair[0], pair[1], replay, own)
            self.found = [matched(pair) for pair in seen[:1]]  # compiles once, not in every thread
            with ThreadPoolExecutor(usable_cores()) as pool:
                self.found += pool.map(matched, seen[1:])
        except Exception as error:  # noqa: BLE001  the fish swims on, whichever error solver, driver or device raise
            self.failed = " ".join(str(error).split()) or type(error).__name__
        self.wall, self.done = time.perf_counter() - self.began, True

    def _matched(self, segment: HybridSegment, seen: "FreeSwim | str", replay: Replay, own: float):
        before = self.states[segment.fish]
        if isinstance(seen, str):
            return segment, before, {"failed": seen}
        misses = Misses(replay, segment, seen, own)
        size = lambda state: float(np.sqrt(np.mean(misses(state.factors[:, None], state.stream[:, None]) ** 2)))
        after = online_correction.matched(before, misses, idle=self.idle[segment.fish])
        moved = not np.array_equal(after.unknowns, before.unknowns)
        return segment, after, {"moved": moved, "before": size(before), "after": size(after) if moved else size(before)}


class Hybrid:
    """Observes swimming fish, and corrects their water.

    Args:
        kind: a flow with the turbulence and box of the background.
        oracle: the reference water; the flow solver by default.
        replay: model of the simulated swim, if it is not the robot's own.

    Attributes:
        states: the correction of each fish. rows: results of each fish's segments.
        off: reason for which the solver was switched off; "" while it works.
    """

    def __init__(
        self, robot: Robot, options: HybridOptions | None = None, *, kind: Flow | None = None, oracle: Oracle | None = None,
        replay: Replay | None = None,
    ):  # fmt: skip
        options = checked_kind("hybrid: options", options, HybridOptions) or HybridOptions()
        self.robot, self.options, self.kind = robot, options, kind or Flow()
        self.water = self.options.solver(robot)
        if oracle is None and self.water.domain in PREVIEWS:
            console.warn(f"hybrid: the box {self.water.domain} is a preview: the robot's water was fitted to another box")
        self._oracle, self._replay = oracle, replay or Replay(robot)
        self.size = robot.timing.bus_dt
        self.off, self._correction_row = "", set[str]()
        self._thread: threading.Thread | None = None
        self._over = False
        self.reset()

    def reset(self) -> None:
        """Clears records and corrections; a solver that was switched off stays off."""
        self.states: list[Correction] = []
        self.rows: list[list[dict]] = []
        self._last = -1
        self._recording: _Recording | None = None
        self._job: _Job | None = None

    def tick(self, fish: FishState, params: FishParams, current: Current, tick: int) -> tuple[FishParams, Current]:
        """Returns MuJoCo's water for bus tick `tick` of B fish, corrected; call it before the tick.

        Args:
            fish: present states. params, current: fish and background flow without any correction.
        Returns:
            params with the corrected water, current with the corrected stream; the arguments themselves without corrections.
        """
        if tick <= self._last:
            self.reset()
        if not self.states:
            self.states = [online_correction.fresh() for _ in np.asarray(fish.q)]
            self.rows = [[] for _ in self.states]
        self._last = tick
        self._collect(tick)
        self._record(fish, params, current, tick)
        self._collect(tick)  # again, in case `_record` has waited for a segment
        return self._corrected(params, current, tick)

    def close(self) -> None:
        """Waits for a running segment, and applies its result."""
        if self._thread is not None:
            self._thread.join()
        self._collect(self._last)

    def report(self, fish: int = 0) -> dict:
        """Report: options, segments by time, factors and stream with standard deviations, and `off`."""
        o, state = self.options, self.states[fish] if self.states else online_correction.fresh()
        covered = len(self.rows[fish]) * (o.lead + o.span) if self.rows else 0.0
        base = {"domain": self.water.domain, "slip": self.water.slip, **boundary_entry(self.water.sharpness)}
        base |= {"every": o.every, "lead": o.lead, "span": o.span, "own": o.own}
        share = covered / max((self._last + 1) * self.size, self.size)
        return {
            **base,
            "segments": self.rows[fish] if self.rows else [],
            "solver_share": share,
            **_correction_row(state),
            "off": self.off,
        }

    # ---- the record ----

    def _record(self, fish: FishState, params: FishParams, current: Current, tick: int) -> None:
        """Records states and commands during a segment, and passes it to the worker at its end."""
        o = self.options
        lead, span, every, first = (round(s / self.size) for s in (o.lead, o.span, o.every, o.first))
        now = self._recording
        if now is not None and tick > now.tick + lead:
            now.commands.append(np.array(np.asarray(fish.buffer)[:, -1], float))
            if tick == now.tick + lead + span:
                self._recording = None
                if np.array_equal(now.current.mean, current.mean):  # otherwise the stream was changed during the segment
                    self._hand_over(now.segments(self.kind))
        if tick >= first and (tick - first) % every == 0 and not self.off:
            if self._thread is not None and self._thread.is_alive():
                self._warn_once("slow", "the solver still works when the next segment is due: that segment is skipped")
            else:
                self._recording = _Recording(tick, params, current)
        now = self._recording
        if now is not None and tick <= now.tick + lead:
            now.states.append((np.array(fish.q, float), np.array(fish.v, float)))
            if tick == now.tick + lead:
                now.start = FishState(*(np.array(a, float) for a in fish))

    def _hand_over(self, segments: list[HybridSegment]) -> None:
        idle = [self.options.every if rows else 0.0 for rows in self.rows]
        job = self._job = _Job(segments, list(self.states), idle)
        arguments = (self._reference_water, self._replay, self.options.own)
        if self.options.wait:
            job.run(*arguments)
            return
        if self._thread is None:
            atexit.register(self._stop_at_exit)
        self._thread = threading.Thread(target=job.run, args=arguments, daemon=True, name="fishmj-hybrid")
        self._thread.start()

    def _stop_at_exit(self) -> None:
        """Stops the solver after its present tick at the end of the program, before the interpreter shuts down."""
        self._over = True
        if self._thread is not None:
            self._thread.join(LEAVING)

    def _reference_water(self) -> Oracle:
        """Reference water, made at the first call."""
        if self._oracle is None:
            from fishmj.engines.hybrid.tanks import Tanks

            o = self.options
            how: dict[str, Any] = {"device": o.device, "stream": o.tank, "side_by_side": o.side_by_side}
            self._oracle = Tanks(self.robot, self.water, **how, go_on=lambda: not self._over)
        return self._oracle

    # ---- results ----

    def _collect(self, tick: int) -> None:
        """Applies the results of a finished worker."""
        job = self._job
        if job is None or not job.done:
            return
        self._job = None
        late = not self.options.wait and job.wall > self.options.patience
        if job.failed:
            self.off = job.failed
            self._warn_once("off", f"no further corrections, the fish swims on in the present water: {job.failed}")
        elif late:
            self._warn_once(
                "late", f"a segment took {job.wall:.0f} s, more than the allowed {self.options.patience:g} s: dropped"
            )
        for segment, state, row in [] if late else job.found:
            if "failed" in row:
                self._warn_once("failed", f"a segment failed: {row['failed']}")
            else:
                self.states[segment.fish] = state
            times = {"t": segment.tick * self.size, "applied": tick * self.size}
            self.rows[segment.fish].append({**times, **row, "wall_s": job.wall, **_correction_row(state)})

    def _corrected(self, params: FishParams, current: Current, tick: int) -> tuple[FishParams, Current]:
        if all(not state.unknowns.any() for state in self.states):
            return params, current
        factors, stream = (np.stack([getattr(s, name) for s in self.states], -1) for name in ("factors", "stream"))
        water = online_correction.applied_to_rows(params.water, factors)
        return params._replace(water=water), shifted(current, stream.T, np.full(len(water), tick))

    def _warn_once(self, what: str, text: str) -> None:
        """Warns once for each kind `what`."""
        if what not in self._correction_row:
            self._correction_row.add(what)
            console.warn(f"hybrid: {text}")


def _correction_row(state: Correction) -> dict:
    """Factors and stream of a correction with standard deviations, for factors those of their logarithms."""
    sd = state.sd
    known = {"factors": state.factors, "factors_sd": sd[:FACTORS], "stream": state.stream, "stream_sd": sd[FACTORS:]}
    return {name: np.round(value, 6).tolist() for name, value in known.items()}
