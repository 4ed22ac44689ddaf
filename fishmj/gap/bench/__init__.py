"""The blind benchmark: data in which something is hidden or nothing is, and a score of what the search says about it.

    fishmj gap bench --cases 400 --seed 3 --out runs/bench

Generators are independent of the model that is questioned. Thresholds come from `data/calib/gap.toml`, frozen before.
"""
