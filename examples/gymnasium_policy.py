"""A shipped policy in 64 Gymnasium environments at once.

    python examples/gymnasium_policy.py

The part of the id before the colon is imported, which registers the tasks. The engine is the fastest one here (`envs.engine`).
"""

import gymnasium
import numpy as np

from fishmj.policy import Policy

FISH, STEPS = 64, 60  # control steps of 0.2 s

envs = gymnasium.make_vec("fishmj:fishmj/StationHold-v0", num_envs=FISH, seconds=STEPS * 0.2)
policy = Policy.load("station")
seen, _ = envs.reset(seed=0)
start, total, left = np.hypot(seen[:, 0], seen[:, 1]), np.zeros(FISH), np.zeros(FISH, bool)
for _ in range(STEPS):
    seen, reward, terminated, truncated, _ = envs.step(policy(seen))
    total += reward
    left |= terminated
end = np.hypot(seen[:, 0], seen[:, 1])
envs.close()

print(f"{FISH} fish, {STEPS * 0.2:.0f} s: from {np.median(start):.2f} m to {np.median(end):.3f} m off the target (medians)")
print(f"return {total.mean():.1f} of at most {STEPS}; {left.sum()} left the tank")
assert np.median(end) < 0.1 < np.median(start) and not left.any()
