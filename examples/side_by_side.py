"""Four dm_control environments side by side: the same fish in four kinds of turbulence, one policy.

    python examples/side_by_side.py

Each environment has its own MuJoCo model and its own water, so any number of them may run in one process. The policy sees 11
numbers of each fish and never the current. The water is the one fitted to the flow solver (synthetic).
"""

import numpy as np

from fishmj import suite
from fishmj.policy import Policy

TURBULENCE = ("none", "default", "gust", "vortex_street")
SPEED = 0.2  # m/s
SECONDS = 12.0


def environment(turbulence: str):
    """One `rl.control.Environment`; `random` is its seed."""
    task = {"random": 4, "flow_speed": SPEED, "turbulence": turbulence, "seconds": SECONDS}
    task["intensity"] = 0.0 if turbulence == "none" else 0.1  # still water has no eddies
    return suite.load("fish", "station_hold", task_kwargs=task, environment_kwargs={"flat_observation": True})


environments, policy = [environment(kind) for kind in TURBULENCE], Policy.load("station")
steps, rewards = [env.reset() for env in environments], []
while not steps[0].last():
    seen = np.stack([step.observation["observations"] for step in steps])  # (4, 11)
    steps = [env.step(action) for env, action in zip(environments, policy(seen), strict=True)]
    rewards.append([step.reward for step in steps])

distance = [float(np.hypot(*step.observation["observations"][:2])) for step in steps]
for kind, metres, reward in zip(TURBULENCE, distance, np.mean(rewards[-10:], 0), strict=True):
    print(f"{kind:<14}{metres:.3f} m from the target after {SECONDS:.0f} s, reward {reward:.2f} a step in the last 2 s")
assert max(distance) < 0.15, "every fish holds its place"
