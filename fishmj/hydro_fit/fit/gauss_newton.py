"""Base coefficients from free swims: Gauss-Newton on a few physical factors.

A fit of forces alone can be right to a per cent in every force and wrong by a tenth in speed: thrust is the small difference of
large forces. Ten factors, each on one kind of force, are therefore fitted until the swims of the model match the recorded ones in
velocity, yaw rate and servo power over windows, and held fish in mean thrust. Steps are damped (Levenberg 1944, Marquardt 1963).
The Jacobian is by differences, all perturbed waters in one batch.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fishmj.base.least_squares import Problem, damped_steps
from fishmj.hydro_fit.fit import training_windows
from fishmj.hydro_fit.fit.identifiability import Identified, identify
from fishmj.hydro_fit.fit.regression_rows import RegressionRows, attachment, base_force
from fishmj.hydro_fit.fit.rollout import FishBatch, SwimTrack, SwimWindow, is_free, recorded, repeated, windows
from fishmj.hydro_fit.fit.training_loop import Loop
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.dynamics.tolerance import TOLERANCE
from fishmj.water.prior import Prior, flat, names_of, prior_of, unflat

SPREAD = 0.3  # standard deviation of ln factor: how far the swims may pull from what the forces said
STEP = 0.02  # of ln factor, for the differences
DAMPING = (0.1, 1.0, 10.0, 1e3)  # of the last one, all tried at once
LEAST = 0.005  # relative fall of the objective that is worth another iteration
CLIP = 5.0  # tolerances; a fish that went astray pulls no harder
FLAPPING = ("chirp", "gait", "flapping")  # blocks that may hold a fish with moving joints
PUSHED = "flapping"  # by its mean thrust alone: to the letter, a tail does what no servo makes it do, with ten times the force
THRUST = 0.035  # of the tow drag; a third of what is asked: there are few of them beside the swims
TOW = 0.3  # m/s, of that drag


class Scaled(NamedTuple):
    """Coefficients after the fit, uncertainty of the factors, and the objective before and after."""

    water: strip_forces.Coefficients
    found: Identified
    before: float
    after: float
    jacobian: np.ndarray  # (R, S) of the scaled residuals
    rounds: int


def groups(links: int) -> dict[str, tuple[str, ...]]:
    """Coefficients that each factor multiplies."""
    return {
        "body_mass": tuple(f"k{i + 1}" for i in range(links - 1)),
        "tail_mass": (f"k{links}",),
        "body_drag": tuple(f"cn{i + 1}" for i in range(links - 1)),
        "tail_drag": (f"cn{links}",),
        "friction": ("cf",),
        "form_drag": ("ca_forward",),
        "edge": ("ke",),
        "lift": ("lift_a", "lift_b"),
        "stall_angle": ("stall_angle",),
        "stall_lag": ("stall_lag",),
    }


def scaled(water: np.ndarray, factors: np.ndarray, links: int, limits: Prior) -> np.ndarray:
    """Flat coefficients times exp(factors), within hard bounds and passive; `factors` (S,) in the order of `groups`."""
    names, out = names_of(links), np.array(water, float)
    for factor, members in zip(factors, groups(links).values(), strict=True):
        at = [names.index(name) for name in members]
        out[at] = np.clip(out[at] * np.exp(factor), limits.low[at], limits.high[at])
    a, b = names.index("lift_a"), names.index("lift_b")
    out[a] = max(out[a], 0.5 - out[b])
    return out


def factors_of(water: np.ndarray, members: Sequence[np.ndarray] | np.ndarray, links: int) -> np.ndarray:
    """Factors (E, S) with which `scaled` makes these members of the water, where no bound was met; 0 where either is 0."""
    names, factors = names_of(links), np.zeros((len(members), len(groups(links))))
    for column, group in zip(factors.T, groups(links).values(), strict=True):
        at = next((i for i in map(names.index, group) if water[i] > 0), None)
        for e, member in enumerate(members):
            if at is not None and member[at] > 0:
                column[e] = np.log(member[at] / water[at])
    return factors


class Match:
    """Residuals of a water relative to the records, in tolerances.

    Args:
        fleet: free swims. held: rows of held fish, or None. tick: s. drag: tow drag, the unit of thrust errors, N.
        swim: rollouts. learnt: a residual that acts in the swims.
    """

    _residual_force: np.ndarray | None  # (3, N, M) force of the residual on held fish

    def __init__(self, swim: SwimWindow, fleet: FishBatch, tick: float, held: RegressionRows | None, drag: float, learnt=None):
        self.swim, self.fleet, self.tick = swim, fleet, tick
        self.held, self.drag, self.learnt = held, drag, learnt
        self.recorded_windows = windows(recorded(fleet), fleet, tick)
        self.thrust = None if held is None else thrusts(held, held.force)

    @property
    def learnt(self):
        """Residual that acts in the swims, or None."""
        return self._learnt

    @learnt.setter
    def learnt(self, learnt) -> None:
        """Sets the residual."""
        self._learnt, self._residual_force = learnt, None

    def residuals(self, waters: np.ndarray) -> np.ndarray:
        """Residuals (W, R) of W flat waters."""
        fleet, count = repeated(self.fleet, len(waters)), len(waters)
        size = len(self.fleet.q)
        track = self.swim.run(fleet, np.repeat(waters, size, 0), self.learnt)
        out = []
        for i, water in enumerate(waters):
            part = SwimTrack(*(a[i * size : (i + 1) * size] for a in track))
            out.append(np.concatenate([self.swim_errors(part), self.thrust_errors(water)]))
        return np.stack(out) if count else np.zeros((0, 0))

    def swim_errors(self, track: SwimTrack) -> np.ndarray:
        """Errors of the windows of all swims."""
        view, errors = windows(track, self.fleet, self.tick), []
        speed = np.hypot(self.recorded_windows.surge, self.recorded_windows.sway)
        channels = (("surge", speed, "speed"), ("sway", speed, "speed"), ("yaw_rate", None, "yaw"), ("power", None, "power"))
        for name, size, kind in channels:
            share, floor = TOLERANCE[kind]
            modelled, measured = getattr(view, name), getattr(self.recorded_windows, name)
            tolerance = share * np.abs(measured if size is None else size) + floor
            error = np.where(np.isfinite(modelled), np.clip((modelled - measured) / tolerance, -CLIP, CLIP), CLIP)
            errors.append(error[np.isfinite(measured)])
        return np.concatenate(errors) / np.sqrt(max(1, view.surge.shape[1]))

    def thrust_errors(self, water: np.ndarray) -> np.ndarray:
        """Errors of the mean thrust on held fish."""
        if self.held is None:
            return np.zeros(0)
        c = unflat(water.tolist())
        s = self.swim.chain.strips
        if self.learnt is not None and self._residual_force is None:  # it depends on the motion alone
            self._residual_force = training_windows.warm_up(self.swim.chain, self.held, c, self.learnt, self.tick).force
        force = base_force(self.held, s, c, attachment(self.held, s, c, self.tick))
        modelled = thrusts(self.held, force if self._residual_force is None else force + self._residual_force)
        return pseudo_huber((modelled - self.thrust) / (THRUST * self.drag))


def pseudo_huber(error: np.ndarray) -> np.ndarray:
    """Pseudo-Huber residuals: their squares grow linearly beyond `CLIP`, so that large errors pull with a constant force.

    r^2 = 2 c^2 (sqrt(1 + (e / c)^2) - 1)
    """
    return np.sign(error) * CLIP * np.sqrt(2.0 * (np.sqrt(1.0 + (error / CLIP) ** 2) - 1.0))


def flaps(record: SegmentRecord) -> bool:
    """Returns True for a held fish that beats its tail, which is judged by its thrust."""
    return record.meta["block"] in FLAPPING and not is_free(record)


def thrusts(rows: RegressionRows, force: np.ndarray) -> np.ndarray:
    """Mean force along the links' own axes, sum over the links, of every record: (R,) N."""
    along = force[0].sum(0)
    return np.array([along[span].mean() for span in rows.spans()])


def tow_drag(ch: planar_chain.Chain, robot: Robot) -> float:
    """Drag of the straight fish by the prior coefficients, N: the unit of thrust errors."""
    q, v = [0.0] * (ch.n + 2), [TOW, *[0.0] * (ch.n + 1)]
    k = planar_chain.kinematics(np, ch, q, v, [(0.0, 0.0)] * ch.n)
    forces = planar_chain.water_forces(np, ch, planar_chain.nominal(robot), k, 0.0, (0.0, 0.0), 1.0)
    return -float(sum(f[0] for f in forces))


def fit_rollout(
    robot: Robot, ch: planar_chain.Chain, match: Match, water: strip_forces.Coefficients, *, rounds: int = 8,
    report: Callable | None = None, loop: Loop | None = None,
) -> Scaled:  # fmt: skip
    """Fits the factors from `water` until the swims match; never ends worse than it began.

    Args:
        report: called with (round, rounds, objective). loop: keeps the state after each round.
    """
    limits, start = prior_of(robot), flat(water)
    names = tuple(groups(ch.n))
    size = len(names)
    loop = loop or Loop()
    # Ten factors cost eleven swims, forwards only, in one batch: no gradient through thousands of steps is needed. The prior
    # keeps factors that the swims do not determine at the value from the forces.
    residual = lambda rows: match.residuals(np.stack([scaled(start, row, ch.n, limits) for row in rows]))
    problem = Problem(residual, np.full(size, STEP), np.zeros(size), np.eye(size) / SPREAD**2)
    done, kept = loop.begin((np.zeros(size), np.float64(1e-2), np.float64(np.nan), np.float64(np.nan)))
    x, damping, best, first = kept
    r, jacobian = problem.linear(x)
    if not done:
        first = best = 0.5 * problem.cost(r[None], x[None])[0]
    while done < rounds:
        done += 1
        dampings = [damping * share for share in DAMPING]
        tried = problem.best(x, damped_steps(*problem.quadratic(x, r, jacobian), dampings))
        decrease = best - 0.5 * tried.cost
        # even the most damped step was no better, so `x` stays: the fit never ends worse than it began
        if decrease <= 0:
            break
        x, best, damping = tried.x, np.float64(0.5 * tried.cost), dampings[tried.place]
        if report is not None:
            report(done, rounds, float(best))
        if decrease < LEAST * best or done == rounds:
            break
        loop.after(done, (x, np.float64(damping), best, first))
        r, jacobian = problem.linear(x)
    jacobian = jacobian.T / STEP
    prior = Prior(names, np.ones(size), np.full(size, SPREAD), np.full(size, np.exp(-1.5)), np.full(size, np.exp(1.5)))
    result = scaled(start, x, ch.n, limits)
    # the Jacobian of the last round, one step before `x`: one at `x` would cost another round of swims
    judged = identify(prior, np.exp(x), jacobian.T @ jacobian)
    return Scaled(unflat(result.tolist()), judged, float(first), float(best), jacobian, done)
