"""A swim of the solver: domain, set-up, actuation, refined ticks, limits of stability, several tanks side by side."""
