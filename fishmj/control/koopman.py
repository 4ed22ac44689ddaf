"""Koopman-LQR: a linear model of lifted states, identified by EDMD, and its linear-quadratic regulator for heading and speed.

    z+ = K z + B u,   psi+ = psi + k z + b u,   u = (A f, bias A f)            EDMD: least squares over swims of the surrogate
    z  = (v1, v2, w, v2 w, v1 w, v1 v2, v1^2, v2^2, w |w|, u of the step before)
    u  = u_d - L (x - x_d),   x = (psi, z),   x_d steady at speed |W| and course of W
    W  = v_d - U^,   v_d = k r, at most `approach`,   r from the fish to the target

Mamakoukas et al. 2021 (IEEE T-RO, arXiv 2010.05778): basis of products of velocities, Q on heading and forward speed. Positions
are left out of z: they follow from the velocities and have no weight. v1, v2 are body-frame velocities without the beat.

    koopman         still water: v over ground and U^ = 0, as in the paper
    koopman-flow    v through the water; U^ <- U^ + dt / tau (v - v^ - U^) with the model's v^
    koopman-rls     the same; K and B also adapt to each fish by recursive least squares that forgets towards the EDMD model, and
                    each control step does one step of the Riccati recursion
"""

import numpy as np
from scipy.linalg import solve_discrete_are

from fishmj import engines
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.units import wrap
from fishmj.control.cpg import Cpg, cpg_of
from fishmj.control.estimator import StateEstimator, turned
from fishmj.control.gait_table import SpeedToGait, cached, gait_of, surrogate, throttle_of
from fishmj.control.line_of_sight import capped
from fishmj.control.observer import FlowEstimate
from fishmj.mjcf.description import Robot
from fishmj.tasks.episode import ControlLoop, Scenario
from fishmj.water.flow import Flow, stack

FISH, STEPS, HELD = 96, 100, (5, 16)  # training swims: fish, control steps, range of control steps with a constant input
BIAS = np.radians(120)  # largest bias in them
RIDGE = 1e-6
FAR = 100  # an adapted model this many times as large as the EDMD model has diverged


def lifted(v1, v2, turn, before) -> np.ndarray:
    """Observables (B, 11) of body velocities (B,) m/s, yaw rate (B,) rad/s and the inputs (B, 2) of the step before."""
    products = v2 * turn, v1 * turn, v1 * v2, v1 * v1, v2 * v2, turn * np.abs(turn)
    return np.concatenate([np.stack([v1, v2, turn, *products], -1), before], -1)


def edmd(x, u, y) -> tuple[np.ndarray, np.ndarray]:
    """Linear model y = A x + B u of rows x (N, P), u (N, M), y (N, Q), by least squares: A (Q, P), B (Q, M)."""
    rows = np.concatenate([x, u], 1)
    gram = rows.T @ rows
    fit = np.linalg.solve(gram + RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)) / len(rows), rows.T @ y)
    return fit[: x.shape[1]].T, fit[x.shape[1] :].T


def lqr(a, b, q, r) -> tuple[np.ndarray, np.ndarray]:
    """Gain L (M, P) of u = -L x for x+ = a x + b u and cost x q x + u r u, and the solution (P, P) of its Riccati equation.

    Raises ConfigError: the Riccati equation has no solution.
    """
    try:
        p = solve_discrete_are(a, b, q, r)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ConfigError(f"Koopman-LQR: the Riccati equation of this model has no solution ({error})") from error
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a), p


def swims(robot: Robot, gait) -> dict[str, np.ndarray]:
    """Training data: swims of the surrogate in still water with random gaits, through the state estimator without noise.

    Returns:
        z (N, 11) observables, u (N, 2) inputs, after (N, 11) observables one step later, turned (N,) change of heading, rad.
    """
    robot = surrogate(robot)
    rng, loop = np.random.default_rng(0), ControlLoop(robot, "batch")
    params = engines.nominal_params(robot, FISH)
    camera = loop.sensors.ticks(np, np.full(FISH, robot.timing.camera_latency), params.effects, "pose")
    loop.start(np.zeros((FISH, 3)), Scenario(params, camera, stack([Flow()] * FISH)))
    cpg, eyes = cpg_of(robot, gait), StateEstimator(robot, gait["wobble"], gait["sway"])
    cpg.reset(FISH)
    eyes.reset(FISH)
    low = np.array([gait["frequency"][0], 0.0, -BIAS])
    high = np.array([gait["frequency"][-1], np.radians(gait["amplitude_deg"][-1]), BIAS])
    goal, left, u = np.zeros((FISH, 3)), np.zeros(FISH, int), np.zeros((FISH, 2))
    rows: list[tuple] = []
    with console.Progress(STEPS, f"swimming {robot.name} for its Koopman model", unit="steps") as bar:
        for k in range(STEPS):
            fix = eyes(loop.observe(np.zeros((FISH, 2)), np.zeros((FISH, 5 + 2 * robot.n_joints))))
            v = turned(fix.velocity, -fix.heading)
            z = lifted(v[:, 0], v[:, 1], fix.turn, u)
            new = left == 0
            goal = np.where(new[:, None], rng.uniform(low, high, (FISH, 3)), goal)
            left = np.where(new, rng.integers(*HELD, FISH), left) - 1
            commands = cpg(*goal.T)
            u = inputs(cpg)
            loop.act(commands)
            rows.append((z, u, fix.heading))
            bar.update(k + 1)
    z, u, heading = (np.array(column)[2:] for column in zip(*rows, strict=True))
    flat = lambda a: a.reshape(-1, a.shape[-1])
    return {"z": flat(z[:-1]), "u": flat(u[:-1]), "after": flat(z[1:]), "turned": np.diff(heading, axis=0).ravel()}


def inputs(cpg: Cpg) -> np.ndarray:
    """Inputs (B, 2) of the model: A f [rad Hz] and bias A f [rad^2 Hz], at the end of the present chunk."""
    drive = cpg.amplitude * cpg.frequency
    return np.stack([drive, cpg.bias * drive], -1)


class KoopmanModel:
    """EDMD model of a fish. x = (psi, z); psi+ - psi and z+ from (z, u).

    Attributes:
        rows: (12, 13) of (turned, z+) from (z, u). information: (13, 13) mean of (z, u)(z, u)' over the swims.
    """

    def __init__(self, data):
        z, u, after, turned_by = (data[key] for key in ("z", "u", "after", "turned"))
        self.rows = np.concatenate(edmd(z, u, np.concatenate([turned_by[:, None], after], 1)), 1)
        both = np.concatenate([z, u], 1)
        self.information = both.T @ both / len(both)


def of_state(rows, p: int) -> tuple[np.ndarray, np.ndarray]:
    """State matrix (.., P + 1, P + 1) and input matrix (.., P + 1, M) for x = (psi, z), from rows (.., P + 1, P + M)."""
    a = np.concatenate([np.zeros((*rows.shape[:-1], 1)), rows[..., :p]], -1)
    a[..., 0, 0] = 1.0
    return a, rows[..., p:]


class KoopmanLqr:
    """Koopman-LQR over the CPG. The gain `observer_time` adds the flow estimate, `forget` [s] adaptation."""

    def __init__(self, name: str, cpg: Cpg, throttle: SpeedToGait, navigator: StateEstimator, model: KoopmanModel, gains):
        self.name, self.cpg, self.throttle, self.navigator, self.model, self.k = name, cpg, throttle, navigator, model, gains
        self.dt, self.p = navigator.dt, model.rows.shape[1] - 2
        self.estimate = FlowEstimate(gains.get("observer_time", 1.0), self.dt)
        self.line = throttle.low + throttle.u[:, None] * (throttle.high - throttle.low)  # (f, A) from slow to fast
        self.drive = np.maximum.accumulate(np.prod(self.line, 1))
        self.q = np.zeros((self.p + 1, self.p + 1))
        self.q[0, 0], self.q[1, 1] = gains["weight_heading"], gains["weight_speed"]
        self.r = np.diag([gains["weight_drive"], gains["weight_turn"]])
        self.first = lqr(*of_state(model.rows, self.p), self.q, self.r)

    def reset(self, n: int) -> None:
        """Starts n fish with the EDMD model and a flow estimate of zero."""
        self.cpg.reset(n)
        self.navigator.reset(n)
        self.estimate.reset(n)
        self.flow, self.through = np.zeros((n, 2)), np.zeros((n, 2))  # m/s
        self.rows = np.repeat(self.model.rows[None], n, 0)
        self.gain, self.riccati = (np.repeat(first[None], n, 0) for first in self.first)
        self.before: tuple | None = None
        if "forget" in self.k:
            self.prior = self.k["prior"] * self.k["forget"] / self.dt * self.model.information
            self.gram = np.repeat(self.prior[None], n, 0)
            self.moment = self.gram @ self.model.rows.T

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        k, fix = self.k, self.navigator(obs)
        old = inputs(self.cpg)
        if "observer_time" in k:
            self._observe(fix)
        v = turned(fix.velocity - self.flow, -fix.heading)
        z = lifted(v[:, 0], v[:, 1], fix.turn, old)
        if "forget" in k:
            self._adapt(z, fix.heading)
        want = capped(k["position"] * fix.target, k["approach"]) - self.flow
        error = wrap(np, fix.heading - np.arctan2(want[:, 1], want[:, 0]))
        speed = np.minimum(np.linalg.norm(want, axis=-1) * np.maximum(np.cos(error), 0.0), self.throttle.top)
        aim, drive = self._steady(speed)
        x = np.concatenate([error[:, None], z - aim], 1)
        u = -(self.gain @ x[..., None])[..., 0]
        most = np.radians(k["bias_deg"])
        u[:, 0] = np.maximum(u[:, 0] + drive, np.abs(u[:, 1]) / most)  # a slow gait cannot turn
        f, a = (np.interp(u[:, 0], self.drive, column) for column in self.line.T)
        commands = self.cpg(f, a, np.clip(u[:, 1] / (f * a), -most, most))
        self.before = z, inputs(self.cpg), fix.heading
        return commands

    def _steady(self, speed) -> tuple[np.ndarray, np.ndarray]:
        """Observables (B, P) and input A f (B,) of steady straight swimming at a speed (B,), by the model."""
        p = self.p
        still = np.eye(p) - self.rows[:, 1:, :p]
        unit = np.linalg.solve(still, self.rows[:, 1:, p, None])[..., 0]
        drive = speed / np.maximum(unit[:, 0], 1e-3)
        return unit * drive[:, None], drive

    def _observe(self, fix) -> None:
        """Updates the model's speed through the water and the flow estimate by one step."""
        if self.before is not None:
            z = lifted(self.through[:, 0], self.through[:, 1], self.before[0][:, 2], self.before[0][:, -2:])
            both = np.concatenate([z, self.before[1]], 1)
            most = 2 * self.throttle.top  # the lifted model is unstable far from its training data
            self.through = np.clip((self.rows[:, 1:3] @ both[..., None])[..., 0], -most, most)
        self.flow = self.estimate(fix.velocity, turned(self.through, fix.heading))

    def _adapt(self, z, heading) -> None:
        """Does one step of recursive least squares and of the Riccati recursion; resets a diverged model to the EDMD model."""
        if self.before is None:
            return
        keep = np.exp(-self.dt / self.k["forget"])
        both = np.concatenate(self.before[:2], 1)
        result = np.concatenate([(heading - self.before[2])[:, None], z], 1)
        anchor = (1 - keep) * self.prior
        self.gram = keep * self.gram + both[:, :, None] * both[:, None] + anchor
        self.moment = keep * self.moment + both[:, :, None] * result[:, None] + anchor @ self.model.rows.T
        self.rows = np.linalg.solve(self.gram, self.moment).transpose(0, 2, 1)
        wrong = ~(np.abs(self.rows).max((1, 2)) < FAR * np.abs(self.model.rows).max())
        self.rows[wrong] = self.model.rows
        a, b = of_state(self.rows, self.p)
        across = b.transpose(0, 2, 1) @ self.riccati
        self.gain = np.linalg.solve(self.r + across @ b, across @ a)
        self.riccati = self.q + a.transpose(0, 2, 1) @ self.riccati @ (a - b @ self.gain)
        wrong |= ~(np.abs(self.riccati).max((1, 2)) < FAR * np.abs(self.first[1]).max())
        self.rows[wrong], self.gain[wrong], self.riccati[wrong] = self.model.rows, *self.first


def build(robot: Robot, name: str, gains: dict) -> KoopmanLqr:
    """Makes the controller for a robot, from its gains in controllers.toml and swims of its surrogate."""
    gait = gait_of(robot)
    model = KoopmanModel(cached("koopman", surrogate(robot), lambda: swims(robot, gait)))
    throttle = throttle_of(gait, gains)
    return KoopmanLqr(name, cpg_of(robot, gait), throttle, StateEstimator(robot, gait["wobble"], gait["sway"]), model, gains)
