"""Segments of the flow solver that a water is fitted to: what is swum, by whom it is steered, how it is kept."""
