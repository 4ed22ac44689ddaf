"""Ablation of the fitted water: the contribution of each part."""
