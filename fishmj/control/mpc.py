"""Sampling-based model predictive control (MPPI) of amplitude, bias and frequency, with the averaged model of measured gaits.

    p' = w e(psi) + U,   w' = (s(f, A)^2 - w^2) / l,   psi' = g bias s(f, A)
    cost = mean over the horizon of d + effort (A f)^3,  + final d at its end;   d = |r - p|
    plan <- mean of the samples, weighted by exp(-(cost - least cost) / temperature)

Averaged model with amplitude and bias as controls: Castano & Tan 2019 (J. Dyn. Syst. Meas. Control 141, 071012). Sampling:
Williams et al. 2017 (J. Guid. Control Dyn. 40, 344). s, g and l are measured (`gait_table`). A plan interpolates (f, A, bias)
linearly between three knots. A decision, 96 samples of 12 model steps, takes 0.3 ms on one core, 6 ms for 72 fish together.

    mpc        assumes still water, as in the paper: U = 0, w the measured forward speed over ground
    mpc-flow   U and w from the flow observer of `dob`
    privileged true U, w the forward speed through the water: an upper bound for any flow observer
"""

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.control.cpg import Cpg, cpg_of
from fishmj.control.estimator import StateEstimate, StateEstimator, turned
from fishmj.control.gait_table import SpeedToGait, gait_of, throttle_of
from fishmj.control.observer import FlowEstimate, forward, glided
from fishmj.mjcf.description import Robot

KNOTS, STEPS, FINE = 3, 12, 64  # knots of a plan, steps of the model, cells along each axis of its speed table


class AveragedModel:
    """Model of the fish averaged over a beat.

    Args:
        low, high: (3,) bounds of f [Hz], A [rad] and bias [rad]. turn: g, 1/m. glide: l, m. step: s.
    """

    def __init__(self, throttle: SpeedToGait, low, high, turn: float, glide: float, step: float):
        self.low, self.high, self.turn, self.glide, self.step = low, high, turn, glide, step
        f, a = (np.linspace(low[i], high[i], FINE) for i in range(2))
        self.table = throttle.speed(*np.meshgrid(f, a, indexing="ij"))
        self.scale = (FINE - 1) / np.maximum(high[:2] - low[:2], 1e-9)

    def speed(self, controls) -> np.ndarray:
        """Steady speed (..) m/s of controls (.., 3) within the bounds."""
        i, j = (np.rint((controls[..., k] - self.low[k]) * self.scale[k]).astype(np.intp) for k in range(2))
        return self.table[i, j]

    def path(self, surge, heading, flow, controls) -> tuple[np.ndarray, np.ndarray]:
        """Predicted positions x and y (B, S, H) m relative to the start.

        Args:
            surge: (B,) m/s. heading: (B,) rad. flow: (B, 2) m/s. controls: (B, S, H, 3).
        """
        steady = self.speed(controls)
        psi = heading[:, None, None] + self.step * np.cumsum(self.turn * controls[..., 2] * steady, -1)
        w, speeds = np.broadcast_to(surge[:, None], steady.shape[:2]), np.empty_like(steady)
        for k in range(steady.shape[-1]):
            w = np.maximum(w + self.step * (steady[..., k] ** 2 - w * w) / self.glide, 0.0)
            speeds[..., k] = w
        x, y = (np.cumsum(speeds * f(psi) + flow[:, i, None, None], -1) for i, f in enumerate((np.cos, np.sin)))
        return self.step * x, self.step * y


class SamplingMpc:
    """MPPI over the averaged model of still water."""

    def __init__(self, name: str, cpg: Cpg, model: AveragedModel, navigator: StateEstimator, gains):
        self.name, self.cpg, self.model, self.navigator, self.k = name, cpg, model, navigator, gains
        self.dt = navigator.dt
        times, knots = model.step * (np.arange(STEPS) + 0.5), np.linspace(0, model.step * STEPS, KNOTS)
        lines = lambda at: np.stack([np.interp(at, knots, unit) for unit in np.eye(KNOTS)], -1)
        self.between, self.shift = lines(times), lines(knots + self.dt)  # (H, K), (K, K)
        self.spread = gains["spread"] * (model.high - model.low)

    def reset(self, n: int) -> None:
        """Starts n fish with a slow straight plan; the samples are the same in every run and for every fish."""
        self.cpg.reset(n)
        self.navigator.reset(n)
        self.rng = np.random.default_rng(0)
        self.plan = np.tile(np.append(self.model.low[:2], 0.0), (n, KNOTS, 1))
        self.surge, self.flow = np.zeros(n), np.zeros((n, 2))

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        k, fix, model = self.k, self.navigator(obs), self.model
        self._observe(fix)
        half = self.rng.standard_normal((int(k["samples"]) // 2, KNOTS, 3)) * self.spread
        noise = np.concatenate([0 * half[:1], half, -half])
        plans = np.clip((self.shift @ self.plan)[:, None] + noise, model.low, model.high)
        x, y = model.path(self.surge, fix.heading, self.flow, self.between @ plans)
        target = fix.target - k["ahead"] * fix.velocity
        d = np.hypot(target[:, 0, None, None] - x, target[:, 1, None, None] - y)
        effort = (self.between @ (plans[..., 0] * plans[..., 1])[..., None])[..., 0] ** 3
        cost = (d + k["effort"] * effort).mean(-1) + k["final"] * d[..., -1]
        weight = np.exp(-(cost - cost.min(1, keepdims=True)) / k["temperature"])
        self.plan = np.einsum("bs,bski->bki", weight / weight.sum(1, keepdims=True), plans)
        return self.cpg(*self.plan[:, 0].T)

    def _observe(self, fix: StateEstimate) -> None:
        """Updates speed through the water and flow estimate, which stays zero here."""
        self.surge = np.maximum(turned(fix.velocity - self.flow, -fix.heading)[:, 0], 0.0)


class ObservingMpc(SamplingMpc):
    """MPPI with the flow observer of `dob`."""

    def reset(self, n: int) -> None:
        """Starts n fish with a flow estimate of zero."""
        super().reset(n)
        self.estimate = FlowEstimate(self.k["observer_time"], self.dt)
        self.estimate.reset(n)

    def _observe(self, fix: StateEstimate) -> None:
        bounds = self.model.low[:2], self.model.high[:2]
        steady = self.model.speed(np.clip(np.stack([self.cpg.frequency, self.cpg.amplitude], -1), *bounds))
        self.surge = glided(self.surge, steady, self.model.glide, self.dt)
        self.flow = self.estimate(fix.velocity, forward(self.surge, fix.heading))


class PrivilegedMpc(SamplingMpc):
    """MPPI with the true flow, for simulations only."""

    def reset(self, n: int) -> None:
        """Starts n fish; call `set_flow` before the first step."""
        super().reset(n)
        self.true_flow: np.ndarray | None = None

    def set_flow(self, flow) -> None:
        """Sets the true flow (B, 2) m/s at the fish now, in its body axes; call it before every step."""
        self.true_flow = np.asarray(flow, float)

    def _observe(self, fix: StateEstimate) -> None:
        if self.true_flow is None:
            raise ConfigError(f"controller {self.name}: needs `set_flow` before every step; fishmj evaluate and play do it")
        self.flow, self.true_flow = turned(self.true_flow, fix.head), None
        super()._observe(fix)


def build(robot: Robot, name: str, gains: dict) -> SamplingMpc:
    """Makes the controller for a robot, from its gains in controllers.toml."""
    gait, most = gait_of(robot), np.radians(gains["bias_deg"])
    throttle = throttle_of(gait, gains)
    ends = np.stack([throttle.low, throttle.high])
    low, high = np.append(ends.min(0), -most), np.append(ends.max(0), most)
    model = AveragedModel(throttle, low, high, gait["turn"], gait["glide"], gains["horizon"] / STEPS)
    kind = PrivilegedMpc if name == "privileged" else ObservingMpc if "observer_time" in gains else SamplingMpc
    return kind(name, cpg_of(robot, gait), model, StateEstimator(robot, gait["wobble"], gait["sway"]), gains)
