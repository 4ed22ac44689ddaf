"""Residuals of a healthy robot: simulated or recorded runs, and the whitening from them."""
