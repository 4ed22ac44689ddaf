"""Coefficients of the strip model before anything is fitted, from the shape of the sections."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fishmj.mjcf.description import Link

PLATE = 0.35  # width over height below which a link is a plate


def water_prior(links: "Sequence[Link]") -> dict[str, Any]:
    """A [water] table as in `data/calib/fish.toml`: k and cn of a link by its mean width over height, the rest as there."""
    thin = [sum(row[2] for row in link.sections) / sum(row[1] for row in link.sections) < PLATE for link in links]
    return {
        "model": "structured",
        "k": [0.8 if plate else 0.9 for plate in thin],
        "cn": [2.0 if plate else 1.2 for plate in thin],
        "cf": 0.012,
        "ca_forward": 0.40,
        "ca_backward": 0.65,
        "ke": 0.5,
        "lift_a": 0.3,
        "lift_b": 0.7,
        "stall_angle_deg": 35.0,
        "stall_width_deg": 6.0,
        "stall_lag": 3.0,
        "stations": 6,
    }
