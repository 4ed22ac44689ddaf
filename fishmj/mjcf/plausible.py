"""What is possible in a description, but unlikely: it is read, and said once."""

from collections.abc import Iterator, Mapping
from typing import Any

from fishmj.calib import constant
from fishmj.mjcf.findings import Finding
from fishmj.mjcf.relations import servo_of, width_scale

LONG, HEAVY = (0.05, 3.0), (0.01, 300.0)  # m, kg: of robotic fish
WIDTHS = (0.8, 1.25)  # factor on the widths that lets the fish float
MOTOR = 3.0  # times: figures of one motor that differ by more do not belong together


def unlikely(table: Mapping[str, Any]) -> Iterator[Finding]:
    links, servo = table["link"], servo_of(table.get("servo", {}))
    length, mass = sum(link["length"] for link in links), sum(link["mass"] for link in links)
    for key, unit, total, (low, high) in (("length", "m", length, LONG), ("mass", "kg", mass, HEAVY)):
        if not low <= total <= high:
            yield Finding(
                "link",
                None,
                key,
                f"{total:g} {unit} in all",
                f"about {low:g} to {high:g} {unit} for a robotic fish",
                f"check the unit: {unit}",
            )
    scale = width_scale(table)
    if scale is not None and not WIDTHS[0] <= scale <= WIDTHS[1]:
        got = f"{mass:g} kg for a hull that displaces {mass / scale:.3g} kg: to float, all widths are scaled by {scale:.2f}"
        yield Finding("link", None, "mass", got, f"a factor from {WIDTHS[0]} to {WIDTHS[1]}", "check masses and sections")
    for i, link in enumerate(links):
        com = link.get("com")
        if com is not None and not 0 <= com[0] <= link["length"]:
            yield Finding(
                "link",
                i,
                "com",
                f"{com[0]:g} m from the front",
                f"a point in the link, 0 to {link['length']:g} m",
                "com counts from the link's own front",
            )
    rho = table.get("body", {}).get("density_water", 1000.0)
    if not 950.0 <= rho <= 1100.0:
        yield Finding("body", None, "density_water", f"{rho:g} kg/m3", "about 1000 kg/m3 in fresh water, 1025 in the sea")
    yield from _unlikely_servo(servo)
    yield from _unlikely_timing(table.get("timing", {}))


def _unlikely_timing(given: Mapping[str, Any]) -> Iterator[Finding]:
    """Latencies outside what a randomised fish has: the task draws those of the paper, whatever the description says."""
    for key in ("command_latency", "camera_latency"):
        (low, high), latency = constant("randomisation", key), given.get(key)
        if latency is not None and not low <= latency <= high:
            todo = "it is played as it is; randomised fish (training, judgement) draw theirs from that range at full randomisation"
            yield Finding("timing", None, key, f"{latency:g} s", f"{low:g} to {high:g} s", todo)


def _unlikely_servo(s: Mapping[str, float]) -> Iterator[Finding]:
    kb = s["torque"] / s["speed_no_load"]
    pairs = (
        ("constant", "N m s/rad", s["constant"] ** 2 / s["resistance"], kb, "constant^2 / resistance", "torque / speed_no_load"),
        ("voltage", "rad/s", s["voltage"] / s["constant"], s["speed_no_load"], "voltage / constant", "speed_no_load"),
        (
            "resistance",
            "N m",
            s["constant"] * s["voltage"] / s["resistance"],
            s["torque"],
            "constant voltage / resistance",
            "torque",
        ),
    )
    for key, unit, a, b, left, right in pairs:
        if not b / MOTOR <= a <= b * MOTOR:
            got = f"{left} = {a:.3g} {unit}"
            yield Finding(
                "servo",
                None,
                key,
                got,
                f"about {right} = {b:.3g} {unit}",
                "the figures are not of one motor; power will be wrong",
            )
    if s["kp"] * s["range"] < 0.2 * s["torque"]:
        yield Finding(
            "servo",
            None,
            "kp",
            f"{s['kp']:g} N m/rad",
            "kp times range nearer to the torque",
            "the servo never gives a fifth of its torque",
        )
    if s["kp"] * s["resolution"] > s["torque"]:
        yield Finding(
            "servo",
            None,
            "kp",
            f"{s['kp']:g} N m/rad",
            "kp times resolution below the torque",
            "one count of error gives full torque: the joint will chatter",
        )


__all__ = ["unlikely"]
