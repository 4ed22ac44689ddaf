"""Steady forces on a held fish over joint angle and angle of attack."""
