"""Checks between keys of a description: stations and length, masses and volume, nested steps, a servo's figures.

Possible but unlikely values only get a note, and the description is read.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import degrees, isfinite, pi, radians
from typing import Any

from fishmj.base import calib, names
from fishmj.base.calib import constant
from fishmj.base.errors import FishmjError, closest_name
from fishmj.base.plain_file import why_unreadable
from fishmj.mjcf.description import COMMAND_PATHS, LIFT_ROUNDED, Servo, Timing
from fishmj.mjcf.description_schema import KeyFault, shown
from fishmj.mjcf.servo_buses import BUSES, NEARER, beyond_travel

LONGEST, HEAVIEST = 30.0, 3e5  # m, kg: a longer or heavier fish is a mistake of units
THINNEST, FATTEST = 0.05, 20.0  # factor on the widths that lets the fish float; beyond, masses and sections have different units
ROUNDED = 0.01  # of the mass: mass_total may be rounded
WRITTEN = 1e-4  # of the mass: rounding of a program that writes it
NEAR = 1e-6  # relative: lengths that differ by less are the same
RESERVED = ("world",)  # MuJoCo's own body
# values beyond these are unlikely
LONG, HEAVY = (0.05, 3.0), (0.01, 300.0)  # m, kg: of robotic fish
WIDTHS = (0.8, 1.25)  # factor on the widths that lets the fish float
CHARGED = 0.5  # of the servos' voltage: a battery that counts as low only below it is never low
JUMP = 2.0  # times, of heights at a hinge
SWIFT = 30.0  # rad/s, of a servo's output: most turn freely at 4 to 12 rad/s, and a typed speed above this is one in rpm
MOTOR = 3.0  # times: figures of one motor that differ by more do not belong together


def relations(table: Mapping[str, Any], bad: set, listed: bool) -> Iterator[KeyFault]:
    """Errors between keys of sound blocks. listed: the links are a list of a possible length."""
    links = table.get("link", [])
    whole = ("link", None) not in bad
    for i, link in enumerate(links if listed else []):
        if ("link", i) not in bad:
            yield from _link(i, link)
    if whole:
        yield from _together(table, links, ("body", None) not in bad)
    if whole and ("fin", None) not in bad:
        yield from _fins(table.get("fin", []), links)
        yield from _clashes(table.get("fin", []), links)
    if ("servo", None) not in bad:
        yield from _servo(table.get("servo", {}))
    if ("timing", None) not in bad:
        yield from timing(table.get("timing", {}))
    if ("rig", None) not in bad:
        reach = servo_of(table.get("servo", {}))["range"] if ("servo", None) not in bad else 0.0
        yield from _rig(table.get("rig", {}), len(links) - 1 if whole and listed else None, reach)
    if ("water", None) not in bad:
        yield from _water(table.get("water", {}), len(links) if whole else None)
    if ("effect", None) not in bad:
        sized = {k: table.get(k, {} if k == "servo" else []) for k in ("link", "servo") if (k, None) not in bad}
        yield from _effects(table.get("effect", []), len(links) - 1 if whole and listed else None, sized)
    version = table.get("version", {})
    kept = version.get("parent_text", "") if ("version", None) not in bad else ""
    if kept and not names.is_name(kept):
        expected, todo = "the name of a file, without folders", "the parent lies beside its version"
        yield KeyFault("version", None, "parent_text", shown(kept), expected, todo)


def _link(i: int, link: Mapping[str, Any]) -> Iterator[KeyFault]:
    length, rows = link["length"], link["sections"]
    stations = [row[0] for row in rows]
    if stations[0] != 0 or abs(stations[-1] - length) > NEAR * length:
        last, whole = apart(stations[-1], length)
        got, expected = f"stations from {stations[0]:g} to {last} m", f"stations from 0 to length = {whole} m"
        yield KeyFault(
            "link", i, "sections", got, expected, "mend length or the rows; a station counts from the link's own front"
        )
    if any(b - a < 1e-6 for a, b in zip(stations, stations[1:], strict=False)):
        todo = "sort the rows; for a step in the outline set two rows 0.1 mm apart"
        yield KeyFault("link", i, "sections", f"stations {shown(stations)}", "stations that rise from row to row", todo)
    for n, (_, height, width) in enumerate(rows, 1):
        for what, value in (("height", height), ("width", width)):
            if not 1e-4 <= value <= 10.0:
                todo = "a pointed end is a small number such as 0.001" if value < 1e-4 else "check the unit: sections are in m"
                yield KeyFault("link", i, "sections", f"{what} {value:g} in row {n}", f"a {what} from 0.0001 to 10 m", todo)
    if (com := link.get("com")) is not None:
        tall = max(row[1] for row in rows)
        if com[1] != 0:
            expected = "y = 0, [back from the front, 0.0, up]"
            yield KeyFault("link", i, "com", shown(com), expected, "the fish is the same left and right")
        if not -length <= com[0] <= 2 * length or abs(com[2]) > tall / 2 * (1 + NEAR):
            expected = f"a point in the link: 0 to {length:g} m from its front, up to {tall / 2:g} m up or down, half its height"
            yield KeyFault("link", i, "com", shown(com), expected, "com is measured from the link's own front, not from the nose")
    if (start := link.get("fin_from")) is not None and start > length * (1 + NEAR):
        expected = f"a station of the link, 0 to length = {length:g} m"
        yield KeyFault("link", i, "fin_from", f"{start:g} m", expected, "measure it from the link's front")


def _together(table: Mapping[str, Any], links: Sequence[Mapping[str, Any]], body_sound: bool) -> Iterator[KeyFault]:
    """All links: names, length, mass, volume."""
    names = [link["name"] for link in links]
    for i, label in enumerate(names):
        if label in names[:i]:
            expected, todo = "another name for each link: they must differ", f"[[link]] {names.index(label) + 1} has it"
            yield KeyFault("link", i, "name", shown(label), expected, todo)
    length, mass = sum(link["length"] for link in links), sum(link["mass"] for link in links)
    for key, unit, total, most in (("length", "m", length, LONGEST), ("mass", "kg", mass, HEAVIEST)):
        if total > most:
            got, expected = f"{total:g} {unit} in all", f"at most {most:g} {unit} for the whole fish"
            yield KeyFault("link", None, key, got, expected, f"check the unit: {unit}")
    if links[0].get("fin_from") is not None and links[-1].get("fin_from") is None:
        got = f"a plate on the first link, {names[0]!r}, and none on the last, {names[-1]!r}"
        expected, todo = "the plate of a tail on the last link", "the links stand nose first; turn them round"
        yield KeyFault("link", 0, "fin_from", got, expected, todo)
    if not body_sound:
        return
    body = table.get("body", {})
    stated = body.get("mass_total")
    if stated is not None and abs(mass - stated) > ROUNDED * mass:
        todo = "mend one of them, or leave mass_total out"
        a, b = apart(stated, mass)
        yield KeyFault("body", None, "mass_total", f"{a} kg", f"the sum of the links' masses, {b} kg, within 1 %", todo)
    scale = width_scale(table)
    if scale is not None and not THINNEST <= scale <= FATTEST:
        got = f"{mass:g} kg in all for a hull that displaces {mass / scale:.3g} kg"
        yield KeyFault(
            "link", None, "mass", got, "about as much mass as displaced water", "check the units: kg, and sections in m"
        )


def apart(a: float, b: float) -> tuple[str, str]:
    """Two numbers with as many digits as their difference needs, 4 at least."""
    for digits in range(4, 17):
        if (texts := (f"{a:.{digits}g}", f"{b:.{digits}g}"))[0] != texts[1]:
            break
    return texts


def width_scale(table: Mapping[str, Any]) -> float | None:
    """Factor on all widths that makes the fish float; None if the sections are not sound."""
    rho, volume = table.get("body", {}).get("density_water", 1000.0), 0.0
    for link in table["link"]:
        for (a, ha, wa), (b, hb, wb) in zip(link["sections"], link["sections"][1:], strict=False):
            volume += pi / 4 * (b - a) * (2 * ha * wa + ha * wb + hb * wa + 2 * hb * wb) / 6  # height and width linear in between
    return sum(link["mass"] for link in table["link"]) / (rho * volume) if volume > 0 else None


def _fins(fins: Sequence[Mapping[str, Any]], links: Sequence[Mapping[str, Any]]) -> Iterator[KeyFault]:
    lengths, names = {link["name"]: link["length"] for link in links}, [fin["name"] for fin in fins]
    for i, fin in enumerate(fins):
        if fin["name"] in names[:i]:
            yield KeyFault("fin", i, "name", shown(fin["name"]), "another name for each fin: they must differ", "rename one")
        if fin["link"] not in lengths:
            near = closest_name(fin["link"], lengths)
            todo = f"did you mean {near!r}?" if near else "name the link that carries the fin"
            yield KeyFault("fin", i, "link", shown(fin["link"]), f"a link that exists: {', '.join(lengths)}", todo)
            continue
        if fin["span"] > (most := sum(lengths.values()) / 2):
            todo = "check the unit: m, of one plate from the hull to its tip"
            yield KeyFault("fin", i, "span", f"{fin['span']:g} m", f"at most half the fish's length, {most:.4g} m", todo)
        (front, rear), length = fin["station"], lengths[fin["link"]]
        if not (front < rear <= length * (1 + NEAR) and rear - front >= 1e-4):
            expected = f"[front edge, rear edge], the rear one behind, both within the link's {length:g} m"
            yield KeyFault("fin", i, "station", shown(fin["station"]), expected, "measure both from the link's front, in m")


def _clashes(fins: Sequence[Mapping[str, Any]], links: Sequence[Mapping[str, Any]]) -> Iterator[KeyFault]:
    """Names that would clash in the MuJoCo model."""
    drawn = {f"{fin['name']}_{side}" for fin in fins for side in ("left", "right")} | {f"{link['name']}_fluid" for link in links}
    for i, link in enumerate(links):
        if link["name"] in drawn | set(RESERVED):
            expected = "a name that the model does not use for something else"
            yield KeyFault("link", i, "name", shown(link["name"]), expected, "choose another")


def _both(block: str, given: Mapping[str, Any], key: str) -> Iterator[KeyFault]:
    if key in given and f"{key}_deg" in given:
        yield KeyFault(block, None, key, f"both {key} and {key}_deg", "one of them", f"keep {key}_deg")


def _perhaps_rad(block: str, given: Mapping[str, Any], key: str) -> Iterator[KeyFault]:
    """Error for a wide angle in deg that is a usual one in rad."""
    if (deg := given.get(f"{key}_deg", 180.0)) <= pi:
        todo = f"write {key} = {deg:g} if it is in rad, {key} = {radians(deg):.4g} if in deg"
        expected = "more than 3.14159 deg: so small a number may be in rad"
        yield KeyFault(block, None, f"{key}_deg", f"{deg:g} deg", expected, todo)


def angle(given: Mapping[str, Any], key: str, default: float) -> float:
    """Angle [rad] from `key` in rad or `key_deg` in deg."""
    return float(given[key]) if key in given else radians(given[f"{key}_deg"]) if f"{key}_deg" in given else default


def servo_of(given: Mapping[str, Any]) -> dict[str, float]:
    """All figures of a [servo] block, with the default servo's for missing ones; angles in rad."""
    plain = vars(Servo())
    return {
        key: angle(given, key, value) if key in ("range", "resolution") else given.get(key, value) for key, value in plain.items()
    }


def _servo(given: Mapping[str, Any]) -> Iterator[KeyFault]:
    for key in ("range", "resolution"):
        yield from _both("servo", given, key)
    s = servo_of(given)
    kb = s["torque"] / s["speed_no_load"]
    if s["kd"] < kb * (1 - 1e-4):
        default = "" if "kd" in given else ", the default fish's, since none is given"
        expected = f"at least torque / speed_no_load = {kb:.4g} N m s/rad, the damping of the motor's own back-EMF"
        figures = f"torque ({s['torque']:g} N m) or speed_no_load ({s['speed_no_load']:g} rad/s)"
        todo = f"{_of_a_data_sheet(s)}raise kd to {kb:.4g} or more, or correct {figures}"
        yield KeyFault("servo", None, "kd", f"{s['kd']:g} N m s/rad{default}", expected, todo)
    if doubts := list(_perhaps_rad("servo", given, "range")):
        yield from doubts
        return
    if s["resolution"] >= s["range"]:
        got, expected = f"{s['resolution']:.4g} rad", f"less than the range, {s['range']:.4g} rad"
        yield KeyFault("servo", None, "resolution", got, expected, "it is one count of the encoder")
    if s["kp"] * s["range"] < 0.01 * s["torque"]:
        expected = f"kp times range at least 1 % of the torque, {s['torque']:g} N m"
        key, got, unit = _blamed(s, "range")
        yield KeyFault("servo", None, key, got, expected, f"the servo would hardly hold itself; check {key}, in {unit}")


def _blamed(s: Mapping[str, float], key: str) -> tuple[str, str, str]:
    """(key, value, unit) of the odd one in kp times an angle, range or resolution: the angle, if kp suits that of most servos."""
    usual = s["kp"] * getattr(Servo(), key) / s["torque"]  # with the default servo's angle
    suits = usual >= 0.2 if key == "range" else usual <= 1.0
    if suits:
        return key, f"{s[key]:.4g} rad ({degrees(s[key]):.4g} deg)", "rad, or deg with _deg behind its name"
    return "kp", f"{s['kp']:g} N m/rad", "N m/rad"


def _of_a_data_sheet(s: Mapping[str, float]) -> str:
    """Hint if torque in kg cm and speed in s/60 deg would make the figures fit, with their values in SI; "" otherwise."""
    from fishmj.mjcf.servos import KG_CM, S_PER_60_DEG

    torque, speed = s["torque"] * KG_CM, S_PER_60_DEG / s["speed_no_load"]
    heavy = f"{s['torque']:g} kg cm is {torque:.4g} N m"
    slow = f"{s['speed_no_load']:g} s/60 deg is {speed:.4g} rad/s"
    fits = lambda t, w: t / w <= 1.05 * s["kd"]
    possible = 0.03 <= s["speed_no_load"] <= 0.7  # s/60 deg, of servos
    if possible and fits(s["torque"], speed):
        return f"{slow}: is that its unit? or "
    if s["torque"] >= 2.0 and fits(torque, s["speed_no_load"]):
        return f"{heavy}: is that its unit? or "
    return f"{heavy}, {slow}: are these their units? or " if possible and fits(torque, speed) else ""


def _part(step: float, n: int) -> float:
    """A round whole part of a step [s], about its n-th."""
    return min((step / k for k in range(max(1, n - 2), n + 3)), key=lambda part: (len(f"{part:g}"), abs(part - step / n)))


def timing(given: Mapping[str, Any]) -> Iterator[KeyFault]:
    """Errors of steps that do not nest (physics into bus into control), with the nearest valid value of either step."""
    t = vars(Timing()) | dict(given)
    for small, large in (("physics_dt", "bus_dt"), ("bus_dt", "control_dt")):
        a, b = t[small], t[large]
        if wrong := [key for key in (small, large) if not (isfinite(t[key]) and t[key] > 0)]:
            yield KeyFault("timing", None, wrong[0], f"{t[wrong[0]]} s", "a positive number", "check the unit: s")
            continue
        n = max(1, round(b / a))
        if abs(b / a - n) > 1e-6:
            yield KeyFault(
                "timing", None, large, f"{b} s", f"a multiple of {small} = {a} s",
                f"nearest valid {large}: {n * a:g} s; {large} = {b:g} s goes with {small} = {_part(b, n):g} s",
            )  # fmt: skip
    if t["command_path"] not in COMMAND_PATHS:
        path = shown(t["command_path"])
        yield KeyFault("timing", None, "command_path", path, f"one of {', '.join(COMMAND_PATHS)}", "choose one of these")


def _rig(given: Mapping[str, Any], n_joints: int | None, reach: float) -> Iterator[KeyFault]:
    """Errors of a rig; reach: largest command to either side, rad."""
    bus = BUSES[given.get("bus", "lx")]
    yield from _both("rig", given, "zeros")
    for key in ("servo_ids", "signs", "zeros", "zeros_deg"):
        if n_joints is not None and key in given and len(given[key]) != n_joints:
            expected = f"{n_joints}, one a joint" if n_joints > 1 else "1, of its joint"
            yield KeyFault("rig", None, key, f"{shown(given[key])} ({len(given[key])} of them)", expected, "head first")
    if any(abs(zero) > pi for zero in given.get("zeros", ())):
        expected, todo = "one number a joint, each from -3.14159 to 3.14159 rad", "angles in degrees go into zeros_deg"
        yield KeyFault("rig", None, "zeros", shown(given["zeros"]), expected, todo)
    ids = given.get("servo_ids", [])
    if len(set(ids)) < len(ids):
        yield KeyFault(
            "rig", None, "servo_ids", shown(ids), "each number once", "two servos of one number answer at the same time"
        )
    if any(number > bus.most_id for number in ids):
        yield KeyFault("rig", None, "servo_ids", shown(ids), f"0 to {bus.most_id} on {bus.name}", "number its servos again")
    zeros = [*given.get("zeros", ()), *map(radians, given.get("zeros_deg", ()))]
    if any(zeros) and (got := beyond_travel(bus, zeros, reach)):
        expected = f"+-{degrees(bus.travel):.3g} deg in all, what a servo of {bus.name} turns"
        yield KeyFault("rig", None, "zeros_deg", got, expected, NEARER)
    for key in ("red", "yellow"):
        rows = given.get(key, [])
        if any(row[1] <= 0 for row in rows) or any(b[0] <= a[0] for a, b in zip(rows, rows[1:], strict=False)):
            yield KeyFault(
                "rig", None, key, shown(rows), "rows [x, width] with x rising and widths above 0, m", "from the rear to the front"
            )
    red, yellow = given.get("red"), given.get("yellow")
    if (red is None) != (yellow is None):
        todo = "the tracker needs both colours"
        yield KeyFault("rig", None, "yellow" if yellow is None else "red", "nothing", "both red and yellow, or neither", todo)
    elif red and yellow and red[0][0] < yellow[-1][0]:
        yield KeyFault(
            "rig",
            None,
            "red",
            f"paint from x = {red[0][0]:g} m",
            f"red before yellow, which ends at {yellow[-1][0]:g} m",
            "x counts to the nose",
        )


def _water(given: Mapping[str, Any], n_links: int | None) -> Iterator[KeyFault]:
    for key in ("stall_angle", "stall_width"):
        yield from _both("water", given, key)
    yield from _perhaps_rad("water", given, "stall_angle")
    for key in ("k", "cn"):
        if key in given and n_links is not None and len(given[key]) != n_links:
            got = f"{shown(given[key])}, {len(given[key])} of them"
            yield KeyFault("water", None, key, got, f"one number a link, {n_links}", "the robot has as many [[link]] blocks")
    if (model := given.get("model")) is not None and (wrong := _no_water(model)):
        yield wrong
    if "lift_a" in given and "lift_b" in given and given["lift_a"] + given["lift_b"] < 0.5 - LIFT_ROUNDED:
        got = f"lift_a + lift_b = {given['lift_a'] + given['lift_b']:.9g}"
        yield KeyFault(
            "water", None, "lift_b", got, "at least 0.5", "less would feed energy to the fish (docs/simulate/water.md)"
        )


def _no_water(model: str) -> KeyFault | None:
    """Error for an unknown water, else None.

    Valid are strips alone, the shipped fitted water, a fitted one by name (`NAME-base`: without residual) or an existing file.
    """
    known, (model, _) = ["structured", "fitted", *calib.waters()], names.split_member(model)
    if model in known or model.removesuffix("-base") in calib.waters():
        return None
    if model.endswith(".toml"):
        if not (wrong := why_unreadable(model, "")) or not why_unreadable(model.replace("-base.toml", ".toml"), ""):
            return None  # of strips alone the file is that of the whole water
        return KeyFault(
            "water", None, "model", f"{shown(model)}, which {wrong}".replace("which no such", "no such"), _WATER, _PATH
        )
    near = closest_name(model, known)
    todo = f"did you mean {near!r}? " if near else ""
    return KeyFault("water", None, "model", shown(model), _WATER, f"{todo}Known: {', '.join(known)}".strip())


_WATER = "'structured', 'fitted', or a fitted water by name or .toml file"
_PATH = "a path counts from the folder in which the command runs"


def _effects(blocks: Sequence[Mapping[str, Any]], n_joints: int | None, sized: Mapping[str, Any]) -> Iterator[KeyFault]:
    """Errors from the catalogue's own checks; the catalogue is loaded only for a fish that has effects."""
    if not blocks:
        return
    from fishmj.effects import RobotScales, catalogue, effect_calibration

    names = [block["name"] for block in blocks]
    for i, block in enumerate(blocks):
        if block["name"] not in catalogue():
            near = closest_name(block["name"], catalogue())
            expected = f"an effect of the catalogue{f', such as {near!r}' if near else ''}"
            yield KeyFault("effect", i, "name", shown(block["name"]), expected, "docs/simulate/effects.md lists them all")
            continue
        try:
            effect_calibration.block_of(dict(block), "", n_joints, RobotScales.of_table(sized))
        except FishmjError as error:
            yield KeyFault("effect", i, "", " ".join(str(error).split()).strip(": "), "")
        if block["name"] in names[:i]:
            got = f"{shown(block['name'])}, listed {names.count(block['name'])} times"
            yield KeyFault("effect", i, "name", got, "each effect once", "keep one block")


# possible but unlikely values


def unlikely(table: Mapping[str, Any]) -> Iterator[KeyFault]:
    """Notes on possible but unlikely values."""
    links, servo = table["link"], servo_of(table.get("servo", {}))
    length, mass = sum(link["length"] for link in links), sum(link["mass"] for link in links)
    for key, unit, total, (low, high) in (("length", "m", length, LONG), ("mass", "kg", mass, HEAVY)):
        if not low <= total <= high:
            got, expected = f"{total:g} {unit} in all", f"about {low:g} to {high:g} {unit} for a robotic fish"
            yield KeyFault("link", None, key, got, expected, f"check the unit: {unit}")
    scale = width_scale(table)
    if scale is not None and not WIDTHS[0] <= scale <= WIDTHS[1]:
        got = f"{mass:g} kg for a hull that displaces {mass / scale:.3g} kg: to float, all widths are scaled by {scale:.2f}"
        yield KeyFault("link", None, "mass", got, f"a factor from {WIDTHS[0]} to {WIDTHS[1]}", "check masses and sections")
    for i, link in enumerate(links):
        com = link.get("com")
        if com is not None and not 0 <= com[0] <= link["length"]:
            got, expected = f"{com[0]:g} m from the front", f"a point in the link, 0 to {link['length']:g} m"
            yield KeyFault("link", i, "com", got, expected, "com counts from the link's own front")
    yield from _unlikely_outline(links)
    stated = table.get("body", {}).get("mass_total")
    if stated is not None and abs(mass - stated) > WRITTEN * mass:
        a, b = apart(stated, mass)
        todo = "the links' masses are what counts"
        yield KeyFault("body", None, "mass_total", f"{a} kg", f"the sum of the links' masses, {b} kg", todo)
    rho = table.get("body", {}).get("density_water", 1000.0)
    if not 950.0 <= rho <= 1100.0:
        yield KeyFault("body", None, "density_water", f"{rho:g} kg/m3", "about 1000 kg/m3 in fresh water, 1025 in the sea")
    yield from _unlikely_servo(servo)
    yield from _unlikely_timing(table)
    low, volts = table.get("rig", {}).get("low_voltage"), servo["voltage"]
    if low is not None and not CHARGED * volts <= low < volts:
        todo = "below it a swim ends, and no robot arms; right only where the voltage that is measured is not that of the servos"
        yield KeyFault(
            "rig", None, "low_voltage", f"{low:g} V", f"from {CHARGED * volts:g} V to below {volts:g} V, [servo] voltage", todo
        )


def _unlikely_outline(links: Sequence[Mapping[str, Any]]) -> Iterator[KeyFault]:
    """Hinges, plates and ballast, from nose to tail."""
    for i, (front, rear) in enumerate(zip(links, links[1:], strict=False), 1):
        a, b = front["sections"][-1][1], rear["sections"][0][1]
        if max(a, b) >= JUMP * min(a, b):
            got = f"height {b:g} m at its front, {a:g} m at the rear end of the link before it"
            todo = "check that the links stand nose first and their sections front to rear"
            yield KeyFault("link", i, "sections", got, "heights that meet at the hinge", todo)
    for i, link in enumerate(links[:-1]):
        if link.get("fin_from") is not None:
            got, todo = f"a plate from {link['fin_from']:g} m on", "check that the links stand nose first"
            yield KeyFault("link", i, "fin_from", got, "a plate on the last link only", todo)
    high = sum(link["mass"] * link["com"][2] for link in links if link.get("com")) / sum(link["mass"] for link in links)
    if high > 1e-9:
        todo = "such a fish capsizes; up counts positive, ballast stands at a negative third number"
        yield KeyFault("link", None, "com", f"{1000 * high:.3g} mm above the axis on average", "the mass below the axis", todo)


def _unlikely_timing(table: Mapping[str, Any]) -> Iterator[KeyFault]:
    """Notes on latencies outside the paper's range, about which a randomised fish draws its own, and on 0 of an own fish."""
    for key in ("command_latency", "camera_latency"):
        (low, high), latency = constant("randomisation", key), table.get("timing", {}).get(key)
        if latency is None or low <= latency <= high or (latency == 0.0 and table.get("name") in calib.shipped()):
            continue
        drawn = Timing(**{key: latency}).drawn_latency(key)
        centre = "about it" if latency else "as if it were not measured"
        todo = f"randomised fish (training, judgement) draw theirs {centre}, from {drawn[0]:g} to {drawn[1]:g} s"
        yield KeyFault("timing", None, key, f"{latency:g} s", f"{low:g} to {high:g} s", todo)


def _unlikely_servo(s: Mapping[str, float]) -> Iterator[KeyFault]:
    kb, stall = s["torque"] / s["speed_no_load"], s["constant"] * s["voltage"] / s["resistance"]
    pairs = (
        ("constant", "N m s/rad", s["constant"] ** 2 / s["resistance"], kb, "constant^2 / resistance", "torque / speed_no_load"),
        ("voltage", "rad/s", s["voltage"] / s["constant"], s["speed_no_load"], "voltage / constant", "speed_no_load"),
        ("resistance", "N m", stall, s["torque"], "constant voltage / resistance", "torque"),
    )
    speed = s["speed_no_load"]
    if speed > SWIFT:
        todo = f"is it in rpm? {speed:g} rpm is {speed * pi / 30:.4g} rad/s"
        yield KeyFault("servo", None, "speed_no_load", f"{speed:g} rad/s", f"at most about {SWIFT:g} rad/s, at the output", todo)
    for key, unit, a, b, left, right in () if speed > SWIFT else pairs:
        if not b / MOTOR <= a <= b * MOTOR:
            got, expected = f"{left} = {a:.3g} {unit}", f"about {right} = {b:.3g} {unit}"
            yield KeyFault("servo", None, key, got, expected, "the figures are not of one motor; power will be wrong")
    if s["kp"] * s["range"] < 0.2 * s["torque"]:
        expected, todo = "kp times range nearer to the torque", "the servo never gives a fifth of its torque"
        yield KeyFault("servo", None, *_blamed(s, "range")[:2], expected, todo)
    if s["kp"] * s["resolution"] > s["torque"]:
        expected, todo = "kp times resolution below the torque", "one count of error gives full torque: the joint will chatter"
        yield KeyFault("servo", None, *_blamed(s, "resolution")[:2], expected, todo)
