"""Passive markers in a turbulent current."""
