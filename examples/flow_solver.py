"""One trial in three waters: strips, the water fitted to the flow solver, and the flow solver round the moving fish.

    python examples/flow_solver.py

The solver is an engine like any other: trial, sensors and controller do not know which water moves the fish. `laptop` is its
smallest box, a window of 1.6 x 1.1 x 0.6 m in cells of 2 cm that follows the fish: a preview, not a judgement. The solver holds
the fish for a second first, until the stream has found its way round it. Everything is synthetic.
"""

import numpy as np

from fishmj import engines, evaluate
from fishmj.engines.lbm import LbmEngine
from fishmj.mjcf import load_robot

fish = load_robot("fish")
trial = evaluate.trials(speeds=[0.2], los_deg=[0], repeats=1, turbulence="none", duration=2.0)  # the target lies upstream
solver = LbmEngine(fish, trial.flows(), domain="laptop", device="cpu")
waters = {
    "strips": (engines.in_water(fish, "structured"), "batch"),
    "fitted water": (engines.in_water(fish), "planar"),
    "flow solver": (fish, solver),
}
nearer = {}
for name, (robot, engine) in waters.items():
    result = evaluate.run("station", robot, trial, engine)
    nearer[name] = 100 * float(result.distance[0, 0] - result.distance[0, -1])
    print(f"{name:<14} {nearer[name]:5.1f} cm nearer after {trial.duration:.0f} s, {np.mean(result.power[0]):.1f} W")
assert solver.stopped == [""], solver.stopped
assert abs(nearer["fitted water"] - nearer["flow solver"]) < abs(nearer["strips"] - nearer["flow solver"]), "the fit is nearer"
