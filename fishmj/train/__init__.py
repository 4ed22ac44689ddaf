"""Training: PPO and SAC on the batched environments, resumable and seeded. `python -m fishmj.train --help`."""
