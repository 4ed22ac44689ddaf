"""dm_control environments in two waters: the flow solver, and the strips that are fitted to it.

    python examples/solver_suite.py

Task, observation and reward are the same; only the water differs. The solver fills a tank at the start of each episode and
holds the fish for a second, until the stream has found its way round it. `laptop` is its smallest box: a preview, not a
judgement, 13 s on two idle cores. Everything is synthetic.
"""

import numpy as np

from fishmj import suite
from fishmj.policy import Policy

WATERS = {"lbm": {"solver": {"domain": "laptop", "device": "cpu"}}, "fitted": {}}
SETTING = {"random": 2, "flow_speed": 0.2, "turbulence": "none", "randomisation": 0.0, "noise": 0.0, "seconds": 1.0}

policy, found = Policy.load("station"), {}
for water, more in WATERS.items():
    env = suite.load("fish", "station_hold", SETTING | {"water": water} | more, {"flat_observation": True})
    step = env.reset()
    while not step.last():
        step = env.step(policy(step.observation["observations"][None])[0])
    found[water] = env.physics.reference_pose()
    print(f"{water:<10} at {np.round(found[water], 3)} (x m, y m, yaw rad) after {env.physics.time():.1f} s")
apart = np.hypot(*(found["lbm"] - found["fitted"])[:2])
assert apart < 0.1, f"the fitted water puts the fish {apart:.3f} m from where the solver does"
