"""Segments of the flow solver for the fit of a water: movements, steering, storage."""
