"""Measured flow of a tank: mean current and turbulence on a grid, from drifters or a current meter."""
