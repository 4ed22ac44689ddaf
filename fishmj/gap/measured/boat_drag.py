"""Compares linear with quadratic drag on the coast-down of a boat of 13 to 15 kg.

    linear      du/dt = -(c / m) u          quadratic    du/dt = -(c / m) |u| u

The speed column is integrated acceleration that each GPS fix resets; the first row after a fix is a measurement, about one per
second. Each run is left out in turn: the other runs give c and the noise, its own rows the initial speed under either law. The
likelihoods of its speeds are compared.
"""

from typing import NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base.errors import LogError
from fishmj.gap.measured.folder import trials
from fishmj.gap.measured.planar_body import Hull, PlanarBody
from fishmj.gap.measured.significance import LEAST_GROUPS, LEVEL, exact_p, smallest_p
from fishmj.gap.models.swimming_fish import Constant
from fishmj.gap.thresholds import thresholds
from fishmj.log import Trial

RESET = 1.0  # m/s, least fall of the column at a fix
MISSED = 3.0  # m/s; some fixes read 4 to 7 m/s, too fast for a boat pushed by hand
MOVING = 0.2  # m/s
ROWS = 5  # least fixes of a run
MASS = 14.0  # kg; the source says 13 to 15
HULL = Hull(mass=MASS, inertia=1, surge_added=0, sway_added=0, yaw_added=0, thrust=0, torque=0, drag=1.0, sway_drag=0, yaw_drag=0)
LAWS = {"quadratic": np.geomspace(0.05, 50.0, 61), "linear": np.geomspace(0.05, 50.0, 61)}  # c, N s2/m2 and N s/m
STARTS = np.linspace(0.2, 4.0, 77)  # m/s
LEAST_FOR_SURE = 0.95


class BoatCoast(NamedTuple):
    """Speeds (K,) at t (K,) [s since the first of them]."""

    name: str
    t: np.ndarray
    speed: np.ndarray


def coast(name: str, trial: Trial) -> BoatCoast:
    """Rows right after a fix, since the boat last rested (two slow fixes in sequence)."""
    table = trial.table("velocity")
    fixes = np.flatnonzero(np.diff(table["surge"]) < -RESET) + 1
    t, speed = table["t"][fixes], table["surge"][fixes]
    still = np.flatnonzero((speed[1:] < MOVING) & (speed[:-1] < MOVING)) + 1
    begin = int(still[-1]) + 1 if len(still) else 0
    t, speed = t[begin:], speed[begin:]
    keep = speed < MISSED
    t, speed = t[keep], speed[keep]
    return BoatCoast(name, t - t[0] if len(t) else t, speed)


def plant() -> PlanarBody:
    """The boat: quadratic drag as its constant, linear drag as an effect of the catalogue."""
    return PlanarBody(HULL, (Constant("drag", 1.0),), [effects.get("linear_surge_drag")])


def squares(boat: PlanarBody, runs: list[BoatCoast], law: str) -> np.ndarray:
    """Least sum of squares (L, C) of each run over the initial speed, for every c of a law."""
    rows = np.zeros((len(LAWS[law]), len(boat.null)))
    rows[:, 0 if law == "quadratic" else boat.index("linear_surge_drag", "coefficient")] = LAWS[law]
    seconds = np.ceil(max(float(r.t[-1]) for r in runs)) + 1.0
    track = boat.coasts(STARTS, rows, float(seconds))  # (C, S, N) at every step
    return np.stack([np.array([_least(each, r, boat.dt) for each in track]) for r in runs])


def _least(track: np.ndarray, run: BoatCoast, step: float) -> float:
    """Least sum of squares over the initial speeds of one c. track: (S, N) at every step."""
    at = run.t / step
    i = at.astype(int)
    sampled = track[:, i] + (at - i) * (track[:, i + 1] - track[:, i])
    return float(np.min(np.sum((sampled - run.speed) ** 2, 1)))


def held_out(total: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log likelihood (L,) of each run left out, and index (L,) of c from the others. total: (L, C) squares; count: (L,)."""
    likely, chosen = [], []
    for i in range(len(total)):
        others = np.arange(len(total)) != i
        sums = total[others].sum(0)
        c = int(np.argmin(sums))
        freedom = count[others].sum() - others.sum() - 1  # one start a run, one c
        variance = sums[c] / freedom
        likely.append(-0.5 * total[i, c] / variance - 0.5 * count[i] * np.log(2 * np.pi * variance))
        chosen.append(c)
    return np.array(likely), np.array(chosen)


def run(say) -> tuple[str, dict]:
    """Text and figures of the set. Raises LogError: fewer than two usable runs."""
    every = [coast(name, trial) for name, trial in trials("usv_coastdown").items()]
    runs = [r for r in every if len(r.t) >= ROWS]
    if len(runs) < 2:
        raise LogError(
            f"usv_coastdown: {len(runs)} of {len(every)} runs with {ROWS} speeds at fixes, expected two at least; "
            "add runs to the folder"
        )
    return compared(runs, [r.name for r in every if len(r.t) < ROWS], say)


def compared(runs: list[BoatCoast], short: list[str], say=lambda text: None) -> tuple[str, dict]:
    """Compares both laws on the same runs: (text, figures)."""
    boat, count = plant(), np.array([len(r.t) for r in runs])
    likely, value, spread, rms = {}, {}, {}, {}
    for law, grid in LAWS.items():
        total = squares(boat, runs, law)
        likely[law], chosen = held_out(total, count)
        best = int(np.argmin(total.sum(0)))
        value[law], spread[law] = float(grid[best]), [float(grid[chosen.min()]), float(grid[chosen.max()])]
        rms[law] = float(np.sqrt(total[:, best].sum() / count.sum()))
        say(f"{law}: c = {value[law]:.3g}, held-out log likelihood {likely[law].sum():.2f}")
    ahead = likely["quadratic"] - likely["linear"]
    weights = np.random.default_rng(0).dirichlet(np.ones(len(runs)), thresholds().likelihood.bootstrap_draws)
    share = float(np.mean(weights @ ahead > 0))
    better = "quadratic" if ahead.sum() > 0 else "linear"
    p = share if better == "quadratic" else 1.0 - share
    gain = ahead if better == "quadratic" else -ahead
    exact = exact_p(gain, np.zeros(len(gain)))
    sure = p >= LEAST_FOR_SURE and exact <= LEVEL and len(runs) >= LEAST_GROUPS
    answer = f"{better} drag" if sure else "CLASS: linear or quadratic drag, these runs cannot tell"
    figures = {
        "name": "usv_coastdown",
        "origin": "measured",
        "runs": len(runs),
        "speeds": int(count.sum()),
        "too_short": short,
        "held_out_log_likelihood": {law: float(v.sum()) for law, v in likely.items()},
        "per_run": {r.name: float(a) for r, a in zip(runs, ahead, strict=True)},
        "p_better": {better: p},
        "p_exact": exact,
        "smallest_p": smallest_p(len(runs)),
        "coefficient": value,
        "coefficient_folds": spread,
        "rms": rms,
        "answer": answer,
    }
    lines = [
        "usv_coastdown",
        f"  {len(runs)} runs, {count.sum()} speeds at GPS fixes; {len(short)} run(s) of fewer than {ROWS} not used; {MASS:g} kg",
        *(
            f"  {law}: c = {value[law]:.3g} ({spread[law][0]:.3g} to {spread[law][1]:.3g} over the folds) {unit},"
            f" rms {rms[law]:.2f} m/s, held-out log likelihood {likely[law].sum():.2f}"
            for law, unit in (("quadratic", "N s2/m2"), ("linear", "N s/m"))
        ),
        f"  per run, quadratic minus linear: {', '.join(f'{a:+.2f}' for a in ahead)}; P({better} is better) = {p:.2f}",
        f"  exact p = {exact:.2g} over {len(runs)} runs ({smallest_p(len(runs)):.2g} at least), {int(np.sum(gain > 0))} for it",
        answer,
    ]
    return "\n".join(lines), figures
