"""Error of MuJoCo's step over a segment of the search of robots in MJCF, by integrator and by the moment of a command.

python -m studies.gap_benchmark.step_error

Drawn robots of the benchmark (gap/laboratory/articulated) move for 0.3 s under commands that change every 5 ms. The reference is
MuJoCo at 0.1 ms. A semi-implicit step moves by the force about its start: a command that is meant over [t, t + h] acts h / 2
early (`early`); `centred` takes the mean over [t - h / 2, t + h / 2]. Rates begin half a step earlier in both, as in the search.
"""

import mujoco
import numpy as np

from fishmj.base import console
from fishmj.gap.laboratory.articulated.robot_plan import RobotPlan, draw_plan, mjcf
from fishmj.gap.laboratory.articulated.robot_stand import SwingReference

SECONDS, TICK, FINE, SEEN = 0.3, 0.005, 1e-4, 0.01
ROBOTS = 6
WAYS = {  # step [s], integrator, share of a step by which commands are late, semi-implicit
    "2 ms, early": (0.002, "implicitfast", 0.0, True),
    "2 ms, centred": (0.002, "implicitfast", 0.5, True),
    "1 ms, centred": (0.001, "implicitfast", 0.5, True),
    "2 ms, RK4": (0.002, "RK4", 0.0, False),
}


def rolled(plan: RobotPlan, u: np.ndarray, start: tuple, step: float, integrator: str, late: float, semi: bool) -> np.ndarray:
    """(K, J) angles every `SEEN` s under commands u (n, J)."""
    m = mujoco.MjModel.from_xml_string(mjcf(plan, step, integrator))
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:], d.ctrl[:] = *start, u[0]
    mujoco.mj_forward(m, d)
    d.qvel[:] = start[1] - semi * 0.5 * step * d.qacc
    edges, whole = TICK * np.arange(len(u) + 1), np.concatenate([np.zeros((1, u.shape[1])), np.cumsum(u * TICK, 0)])
    at = step * (np.arange(round(SECONDS / step) + 1) - late)
    summed = np.stack([np.interp(at, edges, column) for column in whole.T], 1) + np.minimum(at, 0.0)[:, None] * u[0]
    out = []
    for mean in np.diff(summed, axis=0) / step:
        d.ctrl[:] = mean
        mujoco.mj_step(m, d)
        out.append(d.qpos.copy())
    every = round(SEEN / step)
    return np.array(out)[every - 1 :: every]


def errors(family: str, torques: bool) -> dict[str, float]:
    """Mean over robots of the root mean square error of each way, mrad."""
    found: dict[str, list[float]] = {name: [] for name in WAYS}
    for seed in range(ROBOTS):
        plan = draw_plan(family, np.random.default_rng(100 + seed))
        if plan.torques != torques:
            continue
        reference, t = SwingReference(plan, np.random.default_rng(seed)), TICK * np.arange(70)
        start = reference.at(1.0)[:2]
        u = np.array([reference.at(1.0 + x)[0] for x in t])
        if torques:
            u = 0.1 * plan.column("limit") * np.sin(2.0 * np.pi * 1.3 * t)[:, None]
        best = rolled(plan, u, start, FINE, "implicitfast", 0.5, True)
        for name, way in WAYS.items():
            found[name].append(1e3 * float(np.sqrt(np.mean((rolled(plan, u, start, *way) - best) ** 2))))
    return {name: float(np.mean(values)) for name, values in found.items()}


def main() -> None:
    """Prints the table."""
    rows = []
    for family in ("pendulum", "two_link", "arm"):
        for kind, torques in (("torque", True), ("servo", False)):
            rows.append({"robot": family, "commands": kind} | errors(family, torques))
    console.say("error over 0.3 s, mrad", console.table(rows))


if __name__ == "__main__":
    main()
