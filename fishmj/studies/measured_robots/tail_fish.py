"""A tail-actuated robotic fish in a still tank: 27 conditions of tail amplitude and bias, filmed from above.

A condition is a group. Runs of 1.5 s start from the pose and speed of 1 s moving averages, and are predicted from there.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fishmj.gap.models.swimming_fish import Constant
from fishmj.gap.records.records import ResidualLayout, Sensor
from fishmj.log import Trial
from fishmj.studies.measured_robots.answer import described, solved
from fishmj.studies.measured_robots.decoy_terms import RIVALS
from fishmj.studies.measured_robots.folder import trials
from fishmj.studies.measured_robots.planar_body import Hull, MeanGait, PlanarBody, acting, covered
from fishmj.studies.measured_robots.study import Study, investigate

SPAN, WINDOW = 1.5, 1.0  # s
SCALE = np.array([0.02, 0.02, 0.15])  # m, m, rad: the protocol's units of error
ASIDE, FOLDS = 7, 4
VARIANTS: dict[str, dict] = {
    "a drag across the body of its own": dict(sway=True),
    "the video's clock corrected": dict(clock=True),
    "both": dict(sway=True, clock=True),
    "the video's clock corrected, runs of the same pictures as without": dict(clock=True, pictures=True),
}
# Only ratios of force to mass show in a pose. The mass is that of the published robot (Wang & Tan 2015), about; forces are rough,
# a fit adapts them.
HULL = Hull(
    mass=0.725,
    inertia=2.66e-3,
    surge_added=0.0,
    sway_added=0.0,
    yaw_added=0.0,
    thrust=0.1,
    torque=0.005,
    drag=0.2,
    sway_drag=0.0,
    yaw_drag=0.005,
)
CONSTANTS = tuple(Constant(name, 0.3) for name in ("thrust", "torque", "drag", "yaw_drag"))


def study(clock: bool = False, sway: bool = False, pictures: bool = False, seed: int = 0, without: str = "") -> Study:
    """The set as a study.

    Args:
        clock: correct the video's clock by what each trial's meta data say. pictures: but let runs and averages be the pictures
        that they are without, so that errors compare. sway: a quadratic drag across the body in the baseline, of its own size.
        seed: of what is kept aside. without: a constant that is deleted from the baseline.
    """
    records = [r for name, trial in trials("tail_fish").items() if (r := swim(name, trial, clock, pictures)) is not None]
    groups = sorted({r.group for r in records})
    order = [groups[i] for i in np.random.default_rng(seed).permutation(len(groups))]
    aside, fold = set(order[:ASIDE]), {g: i % FOLDS for i, g in enumerate(order[ASIDE:])}
    learn = [r for r in records if r.group not in aside]
    hull = HULL._replace(sway_drag=20.0 if sway else 0.0)
    constants = (*CONSTANTS, Constant("sway_drag", 0.3)) if sway else CONSTANTS
    if without:
        hull, constants = hull._replace(**{without: 0.0}), tuple(c for c in constants if c.name != without)
    plant = PlanarBody(hull, constants, [*acting(), *RIVALS])
    lines = (
        f"{len(records)} trials, {len(groups)} conditions, {sum(len(r.starts) for r in records)} runs of {SPAN} s of"
        f" {WINDOW:g} s moving averages; {ASIDE} conditions kept aside (seed {seed}), {FOLDS} folds of the others",
        "error: mean of (dx, dy, dyaw)^2 / (0.02 m, 0.02 m, 0.15 rad)^2",
        f"baseline: {', '.join(c.name for c in constants)}" + ("" if sway else "; one drag along the velocity, ahead and across"),
        "stamps: the video's, corrected by the ratio of frames to control rows" if clock else "stamps: the video's own",
    )
    return Study(
        name="tail_fish",
        plant=plant,
        learn=learn,
        aside=[r for r in records if r.group in aside],
        fold=np.array([fold[r.group] for r in learn]),
        error=lambda rs, row: error(plant, rs, row),
        floor=repeats(records),
        floor_of="runs of one condition's two trials that start alike",
        protocol=lines,
    )


def swim(name: str, trial: Trial, clock: bool = False, pictures: bool = False) -> MeanGait | None:
    """The runs of one trial; None when it is too short for one."""
    pose = trial.table("pose")
    t = pose["t"] * (trial.value("clock_ratio.pose", 1.0) if clock else 1.0)
    h = float(np.median(np.diff(t)))
    shown = float(np.median(np.diff(pose["t"]))) if pictures else h
    path = averaged(np.stack([pose["x"], pose["y"], np.unwrap(pose["yaw"])], 1), round(WINDOW / shown))
    steps = round(SPAN / shown)
    first = np.arange(0, len(path) - steps, steps)
    if not len(first):
        return None
    rate = np.gradient(path, h, axis=0)
    starts = np.concatenate([path[first], covered(0.0 * path[first], rate[first], path[first, 2])], 1)
    there = covered(path[first], path[first + steps], path[first, 2])
    gait = trial.table("gait")
    span = steps * h
    return MeanGait(
        name=name,
        group=str(trial.value("excitation")),
        dt=0.02,
        commands=np.array([[gait["amplitude"][0], gait["bias"][0]]]),
        starts=starts,
        span=span,
        pose=Sensor(span * np.arange(1, len(first) + 1), there, SCALE),
    )


def averaged(values: np.ndarray, n: int) -> np.ndarray:
    """(T - n + 1, C) mean of n rows."""
    return np.stack([np.convolve(column, np.ones(n) / n, "valid") for column in values.T], 1)


def error(plant: PlanarBody, records: Sequence[Any], row: np.ndarray) -> float:
    """The protocol's figure."""
    layout = ResidualLayout(list(records))
    residual = layout.residuals(plant.predict(list(records), row))[0]
    return float(np.mean((residual / layout.noise()) ** 2))


def repeats(records: Sequence[MeanGait], near: float = 0.5) -> float:
    """Error that even a model without fault has: half the mean square difference between runs of two trials of one condition
    whose starting speeds differ by less than `near` of the error's scale a run."""
    found = []
    for i, a in enumerate(records):
        for b in records[i + 1 :]:
            if a.group != b.group:
                continue
            for s, end in zip(a.starts, a.pose.values, strict=True):
                apart = np.abs(b.starts[:, 3:] - s[3:]) * a.span / SCALE
                j = int(np.argmin(apart.max(1)))
                if apart[j].max() < near:
                    found.append(0.5 * np.mean(((end - b.pose.values[j]) / SCALE) ** 2))
    return float(np.mean(found)) if found else 0.0


def run(say) -> tuple[str, dict]:
    """Words and figures of the set: its protocol, then what a drag across the body and the video's clock change."""
    said, figures = solved(study(), say)
    lines = [said, "the same search with"]
    figures["variants"] = {}
    for name, given in VARIANTS.items():
        other = study(**given)
        found = investigate(other, most=1)
        first = found.rounds[0]
        best = first.fitted.names[-1]
        ratio = found.kept_aside[-1] / found.kept_aside[0]
        figures["variants"][name] = {
            "error_kept_aside": list(found.kept_aside),
            "ratio": ratio,
            "floor": other.floor,
            "fitted": first.fitted.row[list(first.fitted.places[len(other.plant.constants) :])].tolist(),
            **described(first),
        }
        lines.append(
            f"  {name}: {best} {'accepted' if first.accepted else 'rejected'}, best in {first.best.count(best)} of {FOLDS} folds,"
            f" P(useful) = {first.useful:.2f}, P(best) = {first.p_best[best]:.2f};"
            f" error kept aside {found.kept_aside[0]:.4g} -> {found.kept_aside[-1]:.4g} ({ratio:.2f})"
        )
    return "\n".join(lines), figures
