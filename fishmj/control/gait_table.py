"""Measured steady gaits of a robot in its own water, from which the classical controllers take their model.

`measure` simulates the nominal fish in still water over a grid of frequency and amplitude, and with bias, in four seconds.
`gait_of` caches the result by robot, water and source code of fishmj.

A throttle u in [0, 1] moves along one line of the map, f = f0 + u (f1 - f0), A = A0 + u (A1 - A0), on which speed rises.
"""

import hashlib
from collections.abc import Callable, Mapping

import numpy as np

from fishmj import engines
from fishmj.base import console, store
from fishmj.base.compile_cache import cache_folder
from fishmj.base.errors import ConfigError, FishmjError, StoreError
from fishmj.base.source import package_sha256
from fishmj.control import gains_of
from fishmj.control.cpg import Cpg, Rates
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water import choice
from fishmj.water.flow import Flow, stack
from fishmj.water.water_identity import water_identity

QUICK = Rates(frequency=20.0, amplitude=10.0, bias=10.0)  # start-up does not matter here
SETTLE, WATCH = 10.0, 10.0  # s
BEATS = (0.1, 0.85)  # body lengths/s of the gaits that give wobble and sway; for slower fish, the faster half of the gaits
SLOWEST = 0.05  # body lengths/s; a fish whose fastest gait is slower does not swim


def swim(robot: Robot, lag, frequency, amplitude, bias, velocity=None, seconds=SETTLE + WATCH, engine="batch"):
    """Simulates steady gaits in still water; returns pose (B, T, 3), joint (B, T, J), servo power (B, T) at 50 Hz."""
    n = len(frequency)
    engine, cpg = engines.make(engine, robot), Cpg(robot, lag, QUICK)
    cpg.reset(n)
    state, params, current = engines.at_rest(robot, np.zeros((n, 3))), engines.nominal_params(robot, n), stack([Flow()] * n)
    if velocity is not None:
        state.v[:, 0] = velocity
    tick, rows = np.zeros(n, int), []
    for _ in range(round(seconds / robot.timing.control_dt)):
        state, trace = engine.advance(state, cpg(frequency, amplitude, bias), params, current, tick)
        tick = tick + cpg.ticks
        rows.append((trace.pose, trace.joint, trace.power))
    return tuple(np.concatenate([np.asarray(a) for a in column], 1) for column in zip(*rows, strict=True))


def gait_of(robot: Robot) -> dict:
    """Section [gait] of controllers.toml, with the lag [rad] and the measured gaits of this robot in its water.

    Raises ConfigError: the robot does not swim.
    """
    gait = gains_of("gait")
    lag = np.radians(gait["lag_deg"]) / max(robot.n_joints - 1, 2) * np.arange(robot.n_joints)
    model = surrogate(robot)
    asked = dict(lag=lag, frequency=gait["frequency"], amplitude_deg=gait["amplitude_deg"])
    found = cached("gaits", model, lambda: measure(model, **asked), asked)
    return {**gait, "lag": lag, **{key: value if value.ndim else float(value) for key, value in found.items()}}


def surrogate(robot: Robot) -> Robot:
    """Robot in a water that every engine supports: instead of the flow solver the fitted water, or strips if there is none."""
    if choice.label(robot) not in choice.SOLVED:
        return robot
    try:
        fitted = choice.fitted_for(robot)
    except FishmjError as error:
        console.warn(f"gaits are measured with the strip coefficients of the description: {error}")
        fitted = None
    return choice.in_water(robot, choice.FITTED if fitted else choice.STRUCTURED)


def cached(what: str, robot: Robot, make: Callable[[], Mapping], asked=None) -> dict[str, np.ndarray]:
    """Arrays that `make` computes from a robot's surrogate, or the cached ones.

    Args:
        what: folder in the cache. asked: everything else on which the result depends.
    """
    mark = repr((robot, robot.effects, water_identity(robot), asked, package_sha256()))
    path = cache_folder() / what / f"{robot.name}_{hashlib.sha256(mark.encode()).hexdigest()[:16]}.npz"
    try:
        return store.read_npz(path)
    except StoreError:  # missing or damaged
        made = {key: np.asarray(value, float) for key, value in make().items()}
    try:
        store.write_npz(path, made)
    except StoreError as error:
        console.warn(f"{what} of {robot.name} cannot be cached and are computed each time: {error}")
    return made


def measure(robot: "Robot | str", lag, frequency, amplitude_deg, engine: str = "batch") -> dict:
    """Measures steady speed over the grid, head yaw and sway per joint angle, turning rate per bias, and glide length.

    Args:
        lag: (J,) rad. frequency: (F,) Hz. amplitude_deg: (A,) deg.
    Returns:
        speed (F, A) m/s; wobble (J,) rad/rad; sway (J,) m/rad; turn: yaw rate per bias and speed, 1/m; glide m; residual (2,):
        shares of head yaw and sway that the joints do not explain.
    Raises:
        ConfigError: no gait of the grid swims.
    """
    robot = load_robot(robot)
    f, a = (g.ravel() for g in np.meshgrid(frequency, np.radians(amplitude_deg), indexing="ij"))
    with console.Progress(3, f"gaits of {robot.name}", unit="parts") as bar:
        pose, joint, _ = swim(robot, lag, f, a, np.zeros(len(f)), engine=engine)
        bar.update(1)
        late = round(SETTLE / robot.timing.bus_dt)
        shift = np.linalg.norm(pose[:, -1, :2] - pose[:, late, :2], axis=-1)
        speed = shift / ((pose.shape[1] - 1 - late) * robot.timing.bus_dt)
        if not (top := speed.max()) > (least := SLOWEST * robot.length):
            raise ConfigError(
                f"robot {robot.name} in water {choice.label(robot)}: the fastest of {len(f)} gaits swims {top:.3g} m/s, expected"
                f" {least:.3g} m/s or more; no classical controller can steer it"
            )
        keep = (speed > min(BEATS[0] * robot.length, top / 2)) & (speed < BEATS[1] * robot.length)
        wobble, sway, residual = _beat(pose[keep, late:], joint[keep, late:])
        turn = _turn(robot, lag, engine)
        bar.update(2)
        glide = _glide(robot, lag, engine)
    grid = (len(frequency), len(amplitude_deg))
    return {"speed": speed.reshape(grid), "wobble": wobble, "sway": sway, "residual": residual, "turn": turn, "glide": glide}


def _beat(pose, joint):
    """Fits c and s in psi_head = psi - c . J and y = s . J over all gaits (ridge regression); returns them and the residuals."""
    t = np.linspace(-1, 1, pose.shape[1])
    line = np.stack([np.ones_like(t), t], 1)
    level = lambda x: x - line @ np.linalg.lstsq(line, x, rcond=None)[0]
    way = pose[:, -1, :2] - pose[:, 0, :2]
    normal = np.stack([-way[:, 1], way[:, 0]], -1) / np.linalg.norm(way, axis=-1, keepdims=True)
    left = np.einsum("btk,bk->bt", pose[:, :, :2], normal)
    x = np.concatenate([level(j) for j in joint])
    y = np.concatenate([level(np.stack([-yaw, side], 1)) for yaw, side in zip(pose[:, :, 2], left, strict=True)])
    fit = np.linalg.solve(x.T @ x + 1e-2 * np.trace(x.T @ x) * np.eye(x.shape[1]), x.T @ y)
    return fit[:, 0], fit[:, 1], (y - x @ fit).std(0) / y.std(0)


def _turn(robot: Robot, lag, engine) -> float:
    """Median of yaw rate / (bias x steady speed), 1/m: the effect of a bias on a swimming fish."""
    f, a, b = (g.ravel() for g in np.meshgrid((0.6, 1.0, 1.4), np.radians([15, 20, 25]), np.radians([15, 30, 60]), indexing="ij"))
    pose, _, _ = swim(robot, lag, f, a, b, engine=engine)
    late, dt = round(SETTLE / robot.timing.bus_dt), robot.timing.bus_dt
    rate = (pose[:, -1, 2] - pose[:, late, 2]) / ((pose.shape[1] - 1 - late) * dt)
    path = np.linalg.norm(np.diff(pose[:, late:, :2], axis=1), axis=-1).sum(1) / ((pose.shape[1] - 1 - late) * dt)
    return float(np.median(rate / (b * path)))


def _glide(robot: Robot, lag, engine) -> float:
    """Glide length l [m] in v' = -v^2 / l of a straight fish: the distance after which its speed has fallen to 1/e."""
    start = 0.56 * robot.length
    pose, _, _ = swim(robot, lag, np.zeros(1), np.zeros(1), np.zeros(1), np.full(1, start), seconds=3.0, engine=engine)
    speed = np.diff(pose[0, :, 0]) / robot.timing.bus_dt
    gone = np.cumsum(speed) * robot.timing.bus_dt
    return float(gone[-1] / np.log(start / speed[-1]))


class SpeedToGait:
    """Speed <-> (f, A) along the gait line, from the measured map.

    Args:
        gait: the values of controllers.toml [gait].
        low, high: ends of the line, (f [Hz], A [rad]).
    """

    def __init__(self, gait: Mapping, low, high):
        self.axes = np.asarray(gait["frequency"], float), np.radians(gait["amplitude_deg"])
        self.map = np.asarray(gait["speed"], float)
        self.low, self.high = np.asarray(low, float), np.asarray(high, float)
        self.u = np.linspace(0, 1, 41)
        line = self.low + self.u[:, None] * (self.high - self.low)
        self.speeds = np.maximum.accumulate(self.speed(*line.T))
        self.top = self.speeds[-1]

    def speed(self, frequency, amplitude):
        """Steady speed [m/s] at f [Hz] and A [rad], (B,); bilinear, and proportional to A^1.5 below the map."""
        floor = self.axes[1][0]
        scale = np.minimum(amplitude / floor, 1.0) ** 1.5 * np.minimum(frequency / self.axes[0][0], 1.0)
        (i, p), (j, q) = (_cell(axis, x) for axis, x in zip(self.axes, (frequency, amplitude), strict=True))
        m = self.map
        value = (1 - p) * ((1 - q) * m[i, j] + q * m[i, j + 1]) + p * ((1 - q) * m[i + 1, j] + q * m[i + 1, j + 1])
        return scale * value

    def __call__(self, speed):
        """(f [Hz], A [rad]) for a wanted steady speed (B,) m/s, clipped to the ends of the line."""
        u = np.interp(speed, self.speeds, self.u)
        return tuple(self.low[i] + u * (self.high[i] - self.low[i]) for i in range(2))


def throttle_of(gait: Mapping, gains: Mapping) -> SpeedToGait:
    """Gait line between the two ends in a controller's gains."""
    low, high = ((f, np.radians(a)) for f, a in zip(gains["frequency"], gains["amplitude_deg"], strict=True))
    return SpeedToGait(gait, low, high)


def _cell(axis, x):
    """Index of the cell that holds x, and the fractional position in it, clipped to the axis."""
    x = np.clip(x, axis[0], axis[-1])
    i = np.clip(np.searchsorted(axis, x, "right") - 1, 0, len(axis) - 2)
    return i, (x - axis[i]) / (axis[i + 1] - axis[i])
