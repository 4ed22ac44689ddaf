"""Virtual robot for closed loops, advanced step by step by a radio loopback or a controller under test.

    fish = ClosedLoopRobot({"command_latency": {"delay": 0.02}}, seed=3)
    fish.send((0.3, 0.2, 0.1))                  # arrives after the radio's latency, or is lost
    packets = fish.advance(0.02)                # new readings: {"joint": {...}, "power": {...}, "pose": {...}}

Simulated time moves only with `advance`; a real-time caller waits between calls.
"""

import heapq
from collections.abc import Sequence
from itertools import count

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.session import Effects
from fishmj.gap.laboratory.virtual_robot.loop import H
from fishmj.gap.laboratory.virtual_robot.network import CommandRadio
from fishmj.gap.laboratory.virtual_robot.sensors import on_its_clock
from fishmj.gap.laboratory.virtual_robot.simulate import STILL, StateRecording, at_rest, run
from fishmj.gap.laboratory.virtual_robot.trials import SENSORS, plant, sense, weather
from fishmj.mjcf.description import Robot

MEMORY = 1.0  # s of past motion kept for delayed sensors
HORIZON = 3600.0  # s of gusts drawn at the start


class ClosedLoopRobot:
    """Virtual robot under external commands.

    Args:
        effects, seed, noise, nuisance, robot, medium: as in `trials.generate`.
        start: (x, y, yaw) in the tank, m and rad. flow: speed [m/s] and direction [rad] of the stream.
    """

    def __init__(
        self, effects: Effects | None = None, seed: int = 0, noise: float = 1.0, nuisance: float = 0.1,
        robot: "str | Robot" = "fish", medium: str = "water", start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        flow: tuple[float, float] = (0.0, 0.0),
    ):  # fmt: skip
        self.plant = made = plant(effects or {}, seed, nuisance=nuisance, robot=robot, medium=medium, flow=flow)
        self.noise = noise
        self._state = at_rest(start, made.zero, made.motor.voltage)
        for target in (self._state.goal, self._state.aim, self._state.seen, self._state.ramp):
            target[:] = 0.0
        self._anchor = self._state.z[:3].copy()
        changing = made.tank.sigma > 0.0 or made.odd.pulse != 0.0
        self._gust = weather(made, HORIZON, seed, 0) if changing else STILL
        self._radio = CommandRadio(made.network, made.odd, seed, 0, noise)
        self._streams = {name: random_streams.stream(seed, name, 0) for name in SENSORS}
        self._queue: list[tuple[float, int, np.ndarray]] = []
        self._order = count()
        self._past: StateRecording | None = None

    @property
    def time(self) -> float:
        """The robot's time, s."""
        return float(self._state.clock[0])

    def send(self, command: Sequence[float] | np.ndarray) -> None:
        """Sends target angles (J,) [rad] now. Raises ConfigError: another shape, or not finite."""
        angles, joints = np.asarray(command, float), len(self.plant.zero)
        if angles.shape != (joints,) or not np.all(np.isfinite(angles)):
            raise ConfigError(f"virtual robot: command {command!r}; expected {joints} finite angles in rad")
        arrival = self._radio.arrival(self.time, angles)
        if arrival is not None:
            heapq.heappush(self._queue, (arrival, next(self._order), angles))

    def advance(self, seconds: float) -> dict[str, dict[str, np.ndarray]]:
        """Advances by whole milliseconds; returns the new rows of the tables, without the tracker's velocity."""
        steps = round(seconds / H)
        if steps < 1:
            raise ConfigError(f"virtual robot: advance({seconds}); at least one step of {H} s")
        begin = self.time
        due = sorted(self._queue)
        commands = np.array([angles for _, _, angles in due]).reshape(-1, len(self.plant.zero))
        fresh = run(self.plant, self._state, [t for t, _, _ in due], commands, steps * H, self._gust, self._anchor)
        self._queue = [entry for entry in self._queue if entry[0] > fresh.t[-1] + 1e-9]
        heapq.heapify(self._queue)
        self._past = fresh if self._past is None else _joined(self._past, fresh)
        tables = sense(self.plant, self._past, self._streams, (begin, self.time), self.noise)
        if "pose" in tables:
            tables["pose"] = on_its_clock(self.plant.camera, tables["pose"])
        return tables

    def truth(self) -> np.ndarray:
        """Exact pose of the reference point and hinge angles (3 + J,): x, y, yaw, j1 ..; for scoring, not for control."""
        z = self._state.z
        return np.array([z[0], z[1], z[2], *np.diff(z[2:])])


def _joined(past: StateRecording, fresh: StateRecording) -> StateRecording:
    """Appends `fresh` to the last MEMORY seconds of `past`."""
    keep = past.t >= fresh.t[0] - MEMORY
    return StateRecording(np.concatenate([past.t[keep], fresh.t]), np.concatenate([past.data[keep], fresh.data]))
