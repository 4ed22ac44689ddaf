"""Stable-baselines3 in ten lines: its PPO on 64 fish at once, judged on flows that it was not trained in. Extra `sb3`.

python examples/sb3_ppo.py           300,000 steps
python examples/sb3_ppo.py 20000     a look at it
"""

import sys

from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from fishmj.train.sb3 import FishVecEnv
from fishmj.train.settings import preset

task = preset("quick")  # station holding in gusts; `change(task, task={"memory": 4}, control_dt=0.1)` makes another
fish, others = FishVecEnv(task, 64), FishVecEnv(task, 64, box="tune")
model = PPO("MlpPolicy", fish, n_steps=32, batch_size=512, seed=0, device="cpu")
before, _ = evaluate_policy(model, others, 64, warn=False)
model.learn(int(sys.argv[1]) if sys.argv[1:] else 300_000)
after, spread = evaluate_policy(model, others, 64, warn=False)
print(f"return of 64 episodes: untrained {before:.1f}, trained {after:.1f} (standard deviation {spread:.1f})")
