"""The blind benchmark: data with a hidden effect or without one, and a score of the search's answers.

    fishmj gap bench --cases 400 --seed 3 --out runs/bench

The generators are independent of the questioned model. Thresholds come from `data/calib/gap.toml`, frozen before.
"""
