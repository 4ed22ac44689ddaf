"""What is possible in a description, but unlikely: it is read, and said once."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fishmj.calib import constant
from fishmj.mjcf.findings import Fault
from fishmj.mjcf.relations import apart, servo_of, width_scale

LONG, HEAVY = (0.05, 3.0), (0.01, 300.0)  # m, kg: of robotic fish
WIDTHS = (0.8, 1.25)  # factor on the widths that lets the fish float
JUMP = 2.0  # times, of heights at a hinge
MOTOR = 3.0  # times: figures of one motor that differ by more do not belong together


def unlikely(table: Mapping[str, Any]) -> Iterator[Fault]:
    links, servo = table["link"], servo_of(table.get("servo", {}))
    length, mass = sum(link["length"] for link in links), sum(link["mass"] for link in links)
    for key, unit, total, (low, high) in (("length", "m", length, LONG), ("mass", "kg", mass, HEAVY)):
        if not low <= total <= high:
            yield Fault(
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
        yield Fault("link", None, "mass", got, f"a factor from {WIDTHS[0]} to {WIDTHS[1]}", "check masses and sections")
    for i, link in enumerate(links):
        com = link.get("com")
        if com is not None and not 0 <= com[0] <= link["length"]:
            yield Fault(
                "link",
                i,
                "com",
                f"{com[0]:g} m from the front",
                f"a point in the link, 0 to {link['length']:g} m",
                "com counts from the link's own front",
            )
    yield from _unlikely_outline(links)
    stated = table.get("body", {}).get("mass_total")
    if stated is not None and abs(mass - stated) > 1e-6 * mass:
        a, b = apart(stated, mass)
        todo = "the links' masses are what counts"
        yield Fault("body", None, "mass_total", f"{a} kg", f"the sum of the links' masses, {b} kg", todo)
    rho = table.get("body", {}).get("density_water", 1000.0)
    if not 950.0 <= rho <= 1100.0:
        yield Fault("body", None, "density_water", f"{rho:g} kg/m3", "about 1000 kg/m3 in fresh water, 1025 in the sea")
    yield from _unlikely_servo(servo)
    yield from _unlikely_timing(table.get("timing", {}))


def _unlikely_outline(links: Sequence[Mapping[str, Any]]) -> Iterator[Fault]:
    """Hinges, plates and ballast, from nose to tail."""
    for i, (front, rear) in enumerate(zip(links, links[1:], strict=False), 1):
        a, b = front["sections"][-1][1], rear["sections"][0][1]
        if max(a, b) >= JUMP * min(a, b):
            got = f"height {b:g} m at its front, {a:g} m at the rear end of the link before it"
            todo = "check that the links stand nose first and their sections front to rear"
            yield Fault("link", i, "sections", got, "heights that meet at the hinge", todo)
    for i, link in enumerate(links[:-1]):
        if link.get("fin_from") is not None:
            got, todo = f"a plate from {link['fin_from']:g} m on", "check that the links stand nose first"
            yield Fault("link", i, "fin_from", got, "a plate on the last link only", todo)
    high = sum(link["mass"] * link["com"][2] for link in links if link.get("com")) / sum(link["mass"] for link in links)
    if high > 1e-9:
        todo = "such a fish capsizes; up counts positive, ballast stands at a negative third number"
        yield Fault("link", None, "com", f"{1000 * high:.3g} mm above the axis on average", "the mass below the axis", todo)


def _unlikely_timing(given: Mapping[str, Any]) -> Iterator[Fault]:
    """Latencies longer than any that a randomised fish has: the task draws those of the paper, whatever the description says."""
    for key in ("command_latency", "camera_latency"):
        (low, high), latency = constant("randomisation", key), given.get(key)
        if latency is not None and latency > high:
            todo = f"it is played as it is; randomised fish (training, judgement) draw theirs from {low:g} to {high:g} s"
            yield Fault("timing", None, key, f"{latency:g} s", f"at most {high:g} s", todo)


def _unlikely_servo(s: Mapping[str, float]) -> Iterator[Fault]:
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
            yield Fault(
                "servo",
                None,
                key,
                got,
                f"about {right} = {b:.3g} {unit}",
                "the figures are not of one motor; power will be wrong",
            )
    if s["kp"] * s["range"] < 0.2 * s["torque"]:
        yield Fault(
            "servo",
            None,
            "kp",
            f"{s['kp']:g} N m/rad",
            "kp times range nearer to the torque",
            "the servo never gives a fifth of its torque",
        )
    if s["kp"] * s["resolution"] > s["torque"]:
        yield Fault(
            "servo",
            None,
            "kp",
            f"{s['kp']:g} N m/rad",
            "kp times resolution below the torque",
            "one count of error gives full torque: the joint will chatter",
        )


__all__ = ["unlikely"]
