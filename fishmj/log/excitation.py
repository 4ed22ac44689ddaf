"""Experiments: named open-loop command sequences for a fish, 50 Hz, with a start pose and a purpose each.

    from fishmj import excitation
    run = excitation.get("chirp")                 of three joints; excitation.get("chirp", 4) of four
    run.t (T,) s, run.commands (T, J) rad, run.start (x, y, yaw), run.push (u, v, r)

Every run begins with 0.6 s at rest, so that the start pose can be averaged. A fast fish may reach the wall of a 3.6 m tank in
`gait`, `sine`, `burst_and_coast` and `out_and_back` (docs/tank/rig.md).
A gait beats joint k with A sin(2 pi f t - k lag) + bias, fading in over a second. A run with a push starts with the fish already
moving (let go from a carriage). The runs are written for three joints; `bent` lays them on another chain. All are deterministic;
`random_ramps(seed)` makes any number of further ones.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName

PERIOD = 0.02  # s, between commands
LEAD = 0.6  # s at rest before anything moves
JOINTS = 3  # that the experiments are written for


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """One experiment. `start` is the fish's start pose (tank frame: m, m, rad); `push` its first velocity in its own axes."""

    id: str
    commands: np.ndarray  # (T, J) rad, one row every PERIOD
    about: str
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    push: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m/s, m/s, rad/s

    def __post_init__(self):
        shape = np.shape(self.commands)
        if len(shape) != 2 or not all(shape):
            needs = "commands must be (T, J) rad, for a fish of J joints"
            raise ConfigError(f"excitation {self.id!r}: {needs}; got shape {shape}")
        if not np.all(np.isfinite(self.commands)) or np.max(np.abs(self.commands)) > np.pi:
            raise ConfigError(f"excitation {self.id!r}: commands must be finite and within +-pi rad; are they degrees?")

    @property
    def seconds(self) -> float:
        """Length, s."""
        return len(self.commands) * PERIOD

    @property
    def t(self) -> np.ndarray:
        """Times of sending (T,), s."""
        return np.arange(len(self.commands)) * PERIOD


def get(name: str, joints: int = JOINTS) -> Excitation:
    """The experiment called `name` for a fish of `joints` joints; raises UnknownName with the nearest one."""
    if name not in _MAKERS:
        raise UnknownName("excitation", name, _MAKERS)
    run = _MAKERS[name]()
    return run if joints == JOINTS else replace(run, commands=bent(run.commands, joints))


def bent(commands: np.ndarray, joints: int) -> np.ndarray:
    """Commands (T, 3) laid on a chain of `joints` joints, (T, joints).

    A chain of fewer joints takes the first of the three columns. In a longer one, each joint takes the angle interpolated at its
    place in the row, times 3 / joints, so that the whole chain bends as far.
    """
    if joints <= JOINTS:
        return commands[:, :joints]
    places = np.linspace(0.0, JOINTS - 1.0, joints)
    share = np.stack([np.maximum(1.0 - np.abs(places - j), 0.0) for j in range(JOINTS)])
    return commands @ share * (JOINTS / joints)


def names() -> tuple[str, ...]:
    """Ids of the library, in the order of a session."""
    return tuple(_MAKERS)


def gait(
    frequency: float, amplitude: float, lag: float, bias: float = 0.0, seconds: float = 10.0, joints: int = JOINTS,
    period: float = PERIOD,
) -> np.ndarray:  # fmt: skip
    """Commands (T, joints) of a steady beat [Hz, rad, rad between neighbours, rad], faded in over 1 s, one every `period` s."""
    t = np.arange(round(seconds / period)) * period
    wave = amplitude * np.sin(2 * np.pi * frequency * t[:, None] - lag * np.arange(joints)) + bias
    return _led(np.minimum(t, 1.0)[:, None] * wave, period)


def random_ramps(seed: int, seconds: float = 12.0, reach: float = 0.8, pause: tuple[float, float] = (0.2, 0.8)) -> np.ndarray:
    """Commands (T, 3): straight lines between uniformly drawn angles, as a policy at 5 Hz and slower would send them."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds / PERIOD)) * PERIOD
    knots = np.cumsum(rng.uniform(*pause, 1 + int(seconds / pause[0])))
    angles = rng.uniform(-reach, reach, (len(knots), JOINTS))
    knots, angles = np.concatenate([[0.0], knots]), np.concatenate([np.zeros((1, JOINTS)), angles])
    return _led(np.stack([np.interp(t, knots, angles[:, j]) for j in range(JOINTS)], 1))


def _led(commands: np.ndarray, period: float = PERIOD) -> np.ndarray:
    """Commands behind LEAD seconds of their first row."""
    commands = np.asarray(commands, float)
    return np.concatenate([np.repeat(commands[:1], round(LEAD / period), 0), commands])


def _path(*points: tuple[float, float, float, float]) -> np.ndarray:
    """Commands (T, 3) through (time [s], three angles [deg]), straight between; two points at one time are a step."""
    rows = np.array(points, float)
    t = np.arange(round(rows[-1, 0] / PERIOD)) * PERIOD
    knots = rows[:, 0] + 1e-9 * np.arange(len(rows))
    return _led(np.radians(np.stack([np.interp(t, knots, rows[:, 1 + j]) for j in range(JOINTS)], 1)))


def _steps(angles_deg, hold: float) -> np.ndarray:
    """Commands (T, 3) that jump from row to row of angles (n, 3) and stay `hold` seconds."""
    return _led(np.repeat(np.radians(np.asarray(angles_deg, float)), round(hold / PERIOD), 0))


def _alone(values) -> list[tuple[float, float, float]]:
    """Points of a path in which each joint in turn goes through `values` [deg] while the others stay straight."""
    return [tuple(v if k == j else 0.0 for k in range(JOINTS)) for j in range(JOINTS) for v in values]  # type: ignore[misc]


def _chirp(low: float, high: float, amplitude: float, lag: float, seconds: float) -> np.ndarray:
    """Sine whose frequency rises geometrically from low to high [Hz], amplitude in rad."""
    t = np.arange(round(seconds / PERIOD)) * PERIOD
    rate = np.log(high / low) / seconds
    phase = 2 * np.pi * low * np.expm1(rate * t) / rate
    return _led(amplitude * np.sin(phase[:, None] - lag * np.arange(JOINTS)) * np.minimum(t, 1.0)[:, None])


def _bursts(beats: float, rest: float, times: int, **beat) -> np.ndarray:
    """Gait for `beats` seconds, straight for `rest` seconds, repeated `times` times."""
    burst = gait(seconds=beats, **beat)[round(LEAD / PERIOD) :]
    end = burst * np.minimum(1.0, (len(burst) - 1 - np.arange(len(burst)))[:, None] * PERIOD / 0.2)
    return _led(np.concatenate([np.concatenate([end, np.zeros((round(rest / PERIOD), JOINTS))]) for _ in range(times)]))


LAG = np.radians(60)
SWIM = np.radians(30)
_MAKERS: dict[str, Callable[[], Excitation]] = {}


def _add(name: str, commands: Callable[[], np.ndarray], about: str, start=(0.0, 0.0, 0.0), push=(0.0, 0.0, 0.0)) -> None:
    _MAKERS[name] = lambda: Excitation(id=name, commands=commands(), about=about, start=start, push=push)


def _still(rows: int) -> Callable[[], np.ndarray]:
    return partial(np.zeros, (rows, JOINTS))


WEST = (-1.4, 0.0, 0.0)  # facing east, room to swim
_deg, _cruise = np.radians, partial(gait, 1.0, SWIM, LAG)
_add("idle", _still(200), "nothing moves: noise, idle power, sensor offsets")
_add("sine", lambda: gait(1.0, SWIM, 0.0), "calibration: 1 Hz in phase; joint tracking under load", WEST)
_add(
    "square",
    lambda: _steps([(20, 20, 20), (-20, -20, -20)] * 6, 0.8),
    "calibration: rise time and overshoot; torque limit, speed limit, latency",
)
_add(
    "impulse",
    lambda: _path(*[(t + d, a, a, a) for t in (1, 3, 5, 7) for d, a in ((0, 0), (0, 30), (0.2, 30), (0.2, 0))], (8.5, 0, 0, 0)),
    "calibration: 0.2 s pulses; latency and settling",
)
_add(
    "chirp",
    lambda: _chirp(0.2, 3.0, _deg(14), LAG, 14.0),
    "phase and amplitude over a decade of frequency: latency, gains, added mass",
)
_add("gait", _cruise, "steady swimming: speed, recoil, power", WEST)
_add("gait_slow", lambda: gait(0.5, SWIM, LAG, seconds=12.0), "slow swimming: linear against quadratic drag", WEST)
_add("gait_fast", lambda: gait(1.8, _deg(28), LAG, seconds=6.0), "fast swimming: torque and speed limits, supply voltage", WEST)
_add("gait_small", lambda: gait(1.2, _deg(12), LAG, seconds=12.0), "small beats: dead band, play, friction", WEST)
_add("gait_mirrored", lambda: -gait(1.0, SWIM, LAG), "gait with left and right exchanged: zero offsets, asymmetries", WEST)
_add("turn_left", lambda: gait(1.0, _deg(25), LAG, _deg(-20)), "steady turn: cross-flow drag, lift, yaw drag, camera latency")
_add("turn_right", lambda: gait(1.0, _deg(25), LAG, _deg(20)), "the other turn: zero offsets")
_add(
    "steps",
    lambda: _steps(_alone((0, 5, 0, -15, 0, 30, 0, -50, 0)), 0.5),
    "steps of different size, joint by joint: motion time, rate limit, latency",
)
_add(
    "staircase",
    lambda: _steps(_alone((0, 0.5, 1, 2, 3, 2, 1, 0.5, 0, 10, 20, 30, 40, 0)), 0.4),
    "small and large stairs: dead band, counts, command gain",
)
_add(
    "slow_triangle",
    lambda: _path(
        (0, 0, 0, 0), (3, 30, 30, 30), (9, -30, -30, -30), (12, 0, 0, 0), (13, 8, 8, 8), (15, -8, -8, -8), (16, 0, 0, 0)
    ),
    "10 deg/s and less: friction, play, creep, counts",
)
_add(
    "creep",
    lambda: _path((0, 0, 0, 0), (4, 4, 4, 4), (8, 0, 0, 0), (10, 8, 8, 8), (12, 0, 0, 0), (13, 10, 10, 10), (14, 0, 0, 0)),
    "ramps of 1 to 10 deg/s: stick-slip",
)
_add(
    "burst_and_coast",
    lambda: _bursts(2.5, 3.5, 2, frequency=1.5, amplitude=SWIM, lag=LAG),
    "coasting separates drag from thrust",
    WEST,
)
_add(
    "hold_angles",
    lambda: _steps(
        [(0, 0, 0), (20, 20, 20), (0, 0, 0), (40, 40, 40), (0, 0, 0), (-20, -20, -20), (-40, -40, -40), (0, 0, 0)], 1.5
    ),
    "static holds and what creeps after them: skin stiffness and its memory",
)
for _name, _yaw in (("drift_east", 0.0), ("drift_north", np.pi / 2), ("drift_west", np.pi), ("drift_south", -np.pi / 2)):
    _add(_name, _still(600), "passive drift: current, swirl, tether, camera axes", (0.6, 0.5, _yaw))
_add(
    "spin",
    lambda: gait(1.2, _deg(20), _deg(90), _deg(40), seconds=12.0),
    "turning on the spot: marker offset, yaw inertia and drag",
)
_add(
    "out_and_back",
    lambda: np.concatenate(
        [gait(1.0, SWIM, LAG, seconds=4.0), gait(1.0, SWIM, LAG, _deg(-28), 3.4)[30:], gait(1.0, SWIM, LAG, seconds=5.0)[30:]]
    ),
    "there, around and back: current, tether, scale against drag",
    (-1.2, -0.5, 0.0),
)
_add("station_left", _cruise, "swim along the tank's left side: shear and walls, with station_right", (-1.4, 1.3, 0.0))
_add("station_right", _cruise, "swim along the tank's right side", (-1.4, -1.3, 0.0))
_add("ramps", lambda: random_ramps(1), "random straight lines, like a policy's commands: everything a little")
for _draw in range(2, 7):
    _add(f"ramps_{_draw}", partial(random_ramps, _draw), "another draw of ramps")
_add("flap", lambda: _alone_beat(1.2, _deg(35), 3.5), "each joint beats alone: which servo, supply voltage against all together")
_add("tow_ahead", _still(400), "let go at 0.4 m/s ahead: drag from coasting alone", WEST, (0.4, 0.0, 0.0))
_add("tow_astern", _still(300), "let go at 0.3 m/s tail first: drag backwards", (1.2, 0.0, 0.0), (-0.3, 0.0, 0.0))
_add("tow_oblique", _still(300), "let go at a drift angle: lift and Munk moment", WEST, (0.35, 0.1, 0.0))
_add("tow_sideways", _still(300), "let go broadside: cross-flow drag and sway mass", (0.0, -1.0, 0.0), (0.0, 0.3, 0.0))
_add("twirl", _still(300), "let go turning: yaw drag and yaw inertia", (0.0, 0.0, 0.0), (0.0, 0.0, 2.0))

DESIGNED = (  # a session of twelve that shows most effects
    *("gait", "chirp", "steps", "slow_triangle", "turn_left", "gait_fast"),
    *("burst_and_coast", "drift_north", "out_and_back", "tow_oblique", "gait_mirrored", "ramps"),
)
CASUAL = ("ramps", *(f"ramps_{draw}" for draw in range(2, 7)))  # whatever a policy happened to do
DRY = ("sine", "square", "impulse", "chirp", "steps", "staircase", "slow_triangle", "hold_angles")  # worth doing in air


def listed(text: str) -> tuple[str, ...]:
    """Ids of `designed`, `casual`, `dry`, `all`, or of a list with commas. Raises UnknownName: no such excitation."""
    shelf = {"designed": DESIGNED, "casual": CASUAL, "dry": DRY, "all": names()}
    return shelf.get(text) or tuple(get(name.strip()).id for name in text.split(","))


def _alone_beat(frequency: float, amplitude: float, seconds: float) -> np.ndarray:
    """Joint 1, then 2, then 3, then all of them beat for `seconds` each."""
    beat = gait(frequency, amplitude, 0.0, seconds=seconds)[round(LEAD / PERIOD) :]
    masks = [*np.eye(JOINTS), np.ones(JOINTS)]
    return _led(np.concatenate([beat * mask for mask in masks]))
