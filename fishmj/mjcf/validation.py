"""Everything that is wrong with a description, in lines that a reader can act on: file, block, key, got, expected, what to do.

    errors, notes = examine(table, "my_fish.toml")

`schema.py` says what a single key may be. Here is what takes two of them: stations that rise to the link's length, steps that
nest, a servo whose damping holds its own back-EMF, masses that fit the volume; and what is possible but unlikely (notes).
"""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from math import isfinite, pi, radians
from typing import Any, NamedTuple

from pydantic import ValidationError

from fishmj import names
from fishmj.mjcf import schema

LONG, HEAVY = (0.05, 3.0, 30.0), (0.01, 300.0, 3e5)  # m, kg: below and above the first two a note, above the third refused
WIDTHS = (0.8, 1.25, 0.05, 20.0)  # factor on the widths that lets the fish float: outside the first two a note, the last two refused
MOTOR = 3.0  # times: figures of one motor that differ by more do not belong together
WATER_NEEDS = ("k", "cn", "cf", "ca_forward", "ca_backward", "ke", "lift_a", "lift_b", "stall_angle", "stall_width", "stall_lag")
RESERVED = ("world",)  # MuJoCo's own body


class Finding(NamedTuple):
    """One thing that is wrong. block: "link"; index: which of several, from 0; key: "mass", or "" for the whole block."""

    block: str
    index: int | None
    key: str
    got: str
    expected: str
    todo: str = ""


def examine(table: Mapping[str, Any], where: str) -> tuple[list[str], list[str]]:
    """(errors, notes), one line each, of a description as TOML gives it; `where` begins each line."""
    given = table.get("schema", schema.SCHEMA)
    if given != schema.SCHEMA:  # another format: every other line would be noise
        kind = "a fitted water, for --water" if isinstance(given, str) and given.startswith("fishmj.water/") else "another format"
        finding = Finding("", None, "schema", shown(given), repr(schema.SCHEMA), f"this file is {kind}, not a robot")
        return [line(finding, table, where)], []
    found = list(_single_keys(table))
    bad = {(f.block, f.index) for f in found} | {(f.block, None) for f in found}
    listed = not any(f.block == "link" and f.index is None for f in found)
    found += list(_relations(table, bad, listed))
    notes = [] if found else [line(note, table, where) for note in _unlikely(table)]
    return [line(finding, table, where) for finding in sorted(found, key=_order)], notes


def line(f: Finding, table: Mapping[str, Any], where: str) -> str:
    """`FILE [[link]] 2 'body1' mass: got nan, expected a number above 0 kg; what to do`."""
    place = ""
    if f.block:
        place = f" [[{f.block}]]" if f.block in schema.LISTS else f" [{f.block}]"
    if f.index is not None:
        entry = table[f.block][f.index]
        label = entry.get("name") if isinstance(entry, Mapping) else None
        place += f" {f.index + 1}" + (f" {label!r}" if names.is_name(label) else "")
    key = (f" {f.key}" if f.key.isprintable() and len(f.key) <= 64 else f" {shown(f.key)}") if f.key else ""
    if not f.expected:  # the catalogue of effects words its own
        return f"{where}{place}{key}: {f.got}"
    return f"{where}{place}{key}: got {f.got}, expected {f.expected}" + (f"; {f.todo}" if f.todo else "")


def shown(value: Any, most: int = 60) -> str:
    """A value for a message: short, on one line, and safe whatever it holds."""
    if isinstance(value, bool):
        text = str(value).lower()  # as TOML spells it
    elif isinstance(value, int) and value.bit_length() > 128:
        text = f"an integer of {value.bit_length()} bits"
    elif isinstance(value, str):
        text = repr(value[:most])
        if len(value) > most or len(text) > most + 2:
            text = f"{text[: most - 4]}...{text[0]}"
    elif isinstance(value, Mapping):
        text = f"a block of {len(value)} keys"
    elif isinstance(value, list):
        text = f"[{', '.join(shown(item, 20) for item in value[:6])}{', ...' * (len(value) > 6)}]"
    else:
        text = repr(value)
    return text if len(text) <= most + 2 else text[: most - 3] + "..."


def _order(f: Finding) -> tuple:
    """As in the file's schema."""
    blocks = [*schema.keys()]
    return (blocks.index(f.block) if f.block in blocks else -1, -1 if f.index is None else f.index)


# what a single key may be


def _single_keys(table: Mapping[str, Any]) -> Iterator[Finding]:
    """What pydantic finds; several complaints about one key are one."""
    try:
        schema.Description.model_validate(dict(table))
    except ValidationError as error:
        told = set()
        for entry in error.errors(include_url=False, include_context=False):
            finding = _finding(entry, table)
            if finding[:3] not in told:
                told.add(finding[:3])
                yield finding


def _finding(entry: Mapping[str, Any], table: Mapping[str, Any]) -> Finding:
    place, kind, value = entry["loc"], entry["type"], entry["input"]
    block, index, key, inner = _split(place)
    if kind == "extra_forbidden":
        return _unknown(block, index, key, table)
    if kind == "missing" and not key:
        return Finding(block, None, "", "none", schema.said("", block)[2], f"describe the links: add [[{block}]] with {_main(block)}")
    if kind == "missing":
        what, _, expected = schema.said(block, key)
        return Finding(block, index, key, "nothing", expected, f"add {key} = ... ({what})")
    if block and not key:  # the block itself is no table, or there are too few or too many
        whole = schema.said("", block)[2]
        got = f"{len(value)} block{'s' * (len(value) != 1)}" if kind in ("too_short", "too_long") else shown(value)
        return Finding(block, index, "", got, whole, f"a block begins with {_header(block)} on a line of its own")
    if block not in schema.BLOCKS and block:  # [origin], [calibration.servo]
        return Finding(block, None, key, shown(value), schema.said("", block)[2], f"({schema.said('', block)[0]})")
    what, unit, expected = schema.said(block, key)
    return Finding(block, index, key, _got(value, inner), expected, _todo(value, kind, what, unit, key))


def _split(place: Sequence[Any]) -> tuple[str, int | None, str, list[Any]]:
    """(block, index, key, place within the value) of pydantic's place."""
    parts = [str(p) if not isinstance(p, int) else p for p in place]
    first = str(parts[0])
    if first in schema.LISTS:
        index = parts[1] if len(parts) > 1 and isinstance(parts[1], int) else None
        return first, index, str(parts[2]) if len(parts) > 2 else "", parts[3:]
    if first in schema.BLOCKS or first in ("calibration", *schema.FREE):
        return first, None, str(parts[1]) if len(parts) > 1 else "", parts[2:]
    return "", None, first, parts[1:]


def _got(value: Any, inner: Sequence[Any]) -> str:
    """The value, and where in its list it stands."""
    numbers = [i + 1 for i in inner if isinstance(i, int)]
    spot = "" if not numbers else f" in row {numbers[0]}" if len(numbers) > 1 else f" at number {numbers[0]}"
    length = f" ({len(value)} characters)" if isinstance(value, str) and len(value) > 60 else ""
    length = f" ({len(value)} of them)" if isinstance(value, list) else length
    return shown(value) + length + spot


def _todo(value: Any, kind: str, what: str, unit: str, key: str) -> str:
    """What to do about one key."""
    if key == "name" and isinstance(value, str) and names.nearest(value):
        return f"for example {names.nearest(value)[:24]!r}"
    if isinstance(value, str) and kind in ("float_type", "int_type"):
        return "write the number without quotes"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal") and unit:
        return f"check the number and its unit, {unit} ({what})"
    return f"correct it ({what})"


def _unknown(block: str, index: int | None, key: str, table: Mapping[str, Any]) -> Finding:
    """An unknown key or block, with the nearest known one."""
    name, own = shown(key)[1:-1], "your own notes go into [notes], [origin] or [measured]"
    if block:
        known = schema.keys(block)
        near, home = get_close_matches(key, known, 1, 0.6), _home(key, block)
        todo = f"it belongs under {home}; a key belongs to the last [block] above it" if home and not near else own
        return Finding(block, index, name, "an unknown key", _one_of(near, known), todo)
    blocks = [k for k in schema.keys() if k not in ("schema", "name", "title")]
    if not isinstance(table[key], Mapping | list):
        near, home = get_close_matches(key, schema.keys(), 1, 0.6), _home(key)
        if home and not near:
            return Finding("", None, name, "a key at the top of the file", f"it under {home}", "move it below that line")
        return Finding("", None, name, "an unknown key", _one_of(near, ["schema", "name", "title", "notes"]), own)
    near = get_close_matches(key, blocks, 1, 0.6)
    expected = _one_of([_header(k) for k in near], [_header(k) for k in blocks], quote=False)
    return Finding("", None, f"[{name}]", "an unknown block", expected, own)


def _one_of(near: Sequence[str], known: Sequence[str], *, quote: bool = True) -> str:
    """The nearest first, then the others."""
    others = ", ".join(k for k in known if k not in near)
    return f"{repr(near[0]) if quote else near[0]} or another of {others}" if near else f"one of {others}"


def _home(key: str, but: str = "") -> str:
    """The header of another block that has this key; "" where none has."""
    return next((_header(b) for b in schema.BLOCKS if b != but and key in schema.keys(b)), "")


def _header(block: str) -> str:
    return f"[[{block}]]" if block in schema.LISTS else f"[{block}]"


def _main(block: str) -> str:
    """The keys of a block that must be there."""
    return ", ".join(k for k, info in schema.BLOCKS[block].model_fields.items() if info.is_required())


# what takes two keys


def _relations(table: Mapping[str, Any], bad: set, listed: bool) -> Iterator[Finding]:
    """Errors between keys, of the blocks that are sound by themselves. listed: the links are a list of a possible length."""
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
    if ("water", None) not in bad:
        yield from _water(table.get("water", {}), len(links) if whole else None)
    if ("effect", None) not in bad:
        yield from _effects(table.get("effect", []))
    version = table.get("version", {})
    kept = version.get("parent_text", "") if ("version", None) not in bad else ""
    if kept and not names.is_name(kept):
        yield Finding("version", None, "parent_text", shown(kept), "the name of a file, without folders", "the parent lies beside its version")


def _link(i: int, link: Mapping[str, Any]) -> Iterator[Finding]:
    length, rows = link["length"], link["sections"]
    stations = [row[0] for row in rows]
    if stations[0] != 0 or abs(stations[-1] - length) > 1e-9:
        expected = f"stations from 0 to length = {length:g} m"
        yield Finding("link", i, "sections", f"stations from {stations[0]:g} to {stations[-1]:g} m", expected, "mend length or the rows")
    if any(b - a < 1e-6 for a, b in zip(stations, stations[1:], strict=False)):
        todo = "sort the rows; for a step in the outline set two rows 0.1 mm apart"
        yield Finding("link", i, "sections", f"stations {shown(stations)}", "stations that rise from row to row", todo)
    for n, (_, height, width) in enumerate(rows, 1):
        for what, value in (("height", height), ("width", width)):
            if not 1e-4 <= value <= 10.0:
                todo = "a pointed end is a small number such as 0.001" if value < 1e-4 else "check the unit: sections are in m"
                yield Finding("link", i, "sections", f"{what} {value:g} in row {n}", f"a {what} from 0.0001 to 10 m", todo)
    if (com := link.get("com")) is not None:
        tall = max(row[1] for row in rows)
        if com[1] != 0:
            yield Finding("link", i, "com", shown(com), "y = 0, [back from the front, 0.0, up]", "the fish is the same left and right")
        if not -length <= com[0] <= 2 * length or abs(com[2]) > 3 * tall:
            expected = f"a point in the link: 0 to {length:g} m from its front, up to {tall / 2:g} m up or down"
            yield Finding("link", i, "com", shown(com), expected, "com is measured from the link's own front, not from the nose")
    if (start := link.get("fin_from")) is not None and start > length:
        yield Finding("link", i, "fin_from", f"{start:g} m", f"a station of the link, 0 to length = {length:g} m", "measure it from the link's front")


def _together(table: Mapping[str, Any], links: Sequence[Mapping[str, Any]], body_sound: bool) -> Iterator[Finding]:
    """All links: names, length, mass, volume."""
    told = [link["name"] for link in links]
    for i, label in enumerate(told):
        if label in told[:i]:
            yield Finding("link", i, "name", shown(label), "another name for each link: they must differ", f"[[link]] {told.index(label) + 1} has it")
    length, mass = sum(link["length"] for link in links), sum(link["mass"] for link in links)
    for key, unit, total, most in (("length", "m", length, LONG[2]), ("mass", "kg", mass, HEAVY[2])):
        if total > most:
            yield Finding("link", None, key, f"{total:g} {unit} in all", f"at most {most:g} {unit} for the whole fish", f"check the unit: {unit}")
    if not body_sound:
        return
    body = table.get("body", {})
    stated = body.get("mass_total")
    if stated is not None and abs(mass - stated) > 1e-9:
        todo = "mend one of them, or leave mass_total out"
        yield Finding("body", None, "mass_total", f"{stated:g} kg", f"the sum of the links' masses, {mass:.9g} kg", todo)
    scale = width_scale(table)
    if scale is not None and not WIDTHS[2] <= scale <= WIDTHS[3]:
        got = f"{mass:g} kg in all for a hull that displaces {mass / scale:.3g} kg"
        yield Finding("link", None, "mass", got, "about as much mass as displaced water", "check the units: kg, and sections in m")


def width_scale(table: Mapping[str, Any]) -> float | None:
    """Factor on all widths that lets the fish float; None where the sections are not sound."""
    rho, volume = table.get("body", {}).get("density_water", 1000.0), 0.0
    for link in table["link"]:
        for (a, ha, wa), (b, hb, wb) in zip(link["sections"], link["sections"][1:], strict=False):
            volume += pi / 4 * (b - a) * (2 * ha * wa + ha * wb + hb * wa + 2 * hb * wb) / 6  # height and width linear in between
    return sum(link["mass"] for link in table["link"]) / (rho * volume) if volume > 0 else None


def _fins(fins: Sequence[Mapping[str, Any]], links: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    lengths, told = {link["name"]: link["length"] for link in links}, [fin["name"] for fin in fins]
    for i, fin in enumerate(fins):
        if fin["name"] in told[:i]:
            yield Finding("fin", i, "name", shown(fin["name"]), "another name for each fin: they must differ", "rename one")
        if fin["link"] not in lengths:
            near = get_close_matches(fin["link"], lengths, 1, 0.5)
            todo = f"did you mean {near[0]!r}?" if near else "name the link that carries the fin"
            yield Finding("fin", i, "link", shown(fin["link"]), f"a link that exists: {', '.join(lengths)}", todo)
            continue
        front, rear, length = *fin["station"], lengths[fin["link"]]
        if not (front < rear <= length + 1e-9 and rear - front >= 1e-4):
            expected = f"[front edge, rear edge], the rear one behind, both within the link's {length:g} m"
            yield Finding("fin", i, "station", shown(fin["station"]), expected, "measure both from the link's front, in m")


def _clashes(fins: Sequence[Mapping[str, Any]], links: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Names that would meet another one in the MuJoCo model."""
    drawn = {f"{fin['name']}_{side}" for fin in fins for side in ("left", "right")} | {f"{link['name']}_fluid" for link in links}
    for i, link in enumerate(links):
        if link["name"] in drawn | set(RESERVED):
            yield Finding("link", i, "name", shown(link["name"]), "a name that the model does not use for something else", "choose another")


def _both(block: str, given: Mapping[str, Any], key: str) -> Iterator[Finding]:
    if key in given and f"{key}_deg" in given:
        yield Finding(block, None, key, f"both {key} and {key}_deg", "one of them", f"keep {key}_deg")


def angle(given: Mapping[str, Any], key: str, default: float) -> float:
    """`key` in rad, or `key_deg` in deg, in rad."""
    return float(given[key]) if key in given else radians(given[f"{key}_deg"]) if f"{key}_deg" in given else default


def servo_of(given: Mapping[str, Any]) -> dict[str, float]:
    """Every figure of a [servo] block, the default servo's where it is silent; angles in rad."""
    from fishmj.mjcf.description import Servo

    plain = vars(Servo())
    return {key: angle(given, key, value) if key in ("range", "resolution") else given.get(key, value) for key, value in plain.items()}


def _servo(given: Mapping[str, Any]) -> Iterator[Finding]:
    for key in ("range", "resolution"):
        yield from _both("servo", given, key)
    s = servo_of(given)
    kb = s["torque"] / s["speed_no_load"]
    if s["kd"] < kb * (1 - 1e-4):
        expected = f"at least torque / speed_no_load = {kb:.4g} N m s/rad, the damping of the motor's own back-EMF"
        todo = f"raise kd to {kb:.4g} or more, or correct torque ({s['torque']:g} N m) or speed_no_load ({s['speed_no_load']:g} rad/s)"
        yield Finding("servo", None, "kd", f"{s['kd']:g} N m s/rad", expected, todo)
    if s["resolution"] >= s["range"]:
        yield Finding("servo", None, "resolution", f"{s['resolution']:.4g} rad", f"less than the range, {s['range']:.4g} rad", "it is one count of the encoder")
    if s["kp"] * s["range"] < 0.01 * s["torque"]:
        todo = "the servo would hardly hold itself; check kp, in N m/rad"
        yield Finding("servo", None, "kp", f"{s['kp']:g} N m/rad", f"kp times range at least 1 % of the torque, {s['torque']:g} N m", todo)


def timing(given: Mapping[str, Any]) -> Iterator[Finding]:
    """Steps must nest: physics into bus into control; names the nearest valid value otherwise."""
    from fishmj.mjcf.description import COMMAND_PATHS, Timing

    t = vars(Timing()) | dict(given)
    for small, large in (("physics_dt", "bus_dt"), ("bus_dt", "control_dt")):
        a, b = t[small], t[large]
        if wrong := [f"{key} = {value} s" for key, value in ((small, a), (large, b)) if not (isfinite(value) and value > 0)]:
            yield Finding("timing", None, large, wrong[0], "a positive number", "check the unit: s")
            continue
        n = max(1, round(b / a))
        if abs(b / a - n) > 1e-6:
            expected = f"a multiple of {small} = {a} s"
            yield Finding("timing", None, large, f"{large} = {b} s", expected, f"nearest valid {large}: {n * a:g} s")
    if t["command_path"] not in COMMAND_PATHS:
        got = f"command_path = {t['command_path']!r}"
        yield Finding("timing", None, "command_path", got, f"one of {', '.join(COMMAND_PATHS)}", "choose one of these")


def _water(given: Mapping[str, Any], n_links: int | None) -> Iterator[Finding]:
    for key in ("stall_angle", "stall_width"):
        yield from _both("water", given, key)
    for key in ("k", "cn"):
        if key in given and n_links is not None and len(given[key]) != n_links:
            got = f"{shown(given[key])}, {len(given[key])} of them"
            yield Finding("water", None, key, got, f"one number a link, {n_links}", "the robot has as many [[link]] blocks")
    if "lift_a" in given and "lift_b" in given and given["lift_a"] + given["lift_b"] < 0.5:
        got = f"lift_a + lift_b = {given['lift_a'] + given['lift_b']:g}"
        yield Finding("water", None, "lift_b", got, "at least 0.5", "less would feed energy to the fish (docs/water.md)")


def _effects(blocks: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """The catalogue's own checks; it is loaded only for a fish that has effects."""
    if not blocks:
        return
    from fishmj.effects import calibration, catalogue
    from fishmj.errors import FishmjError

    told = [block["name"] for block in blocks]
    for i, block in enumerate(blocks):
        if block["name"] not in catalogue():
            near = get_close_matches(block["name"], catalogue(), 1, 0.5)
            expected = f"an effect of the catalogue{f', such as {near[0]!r}' if near else ''}"
            yield Finding("effect", i, "name", shown(block["name"]), expected, "docs/effects.md lists them all")
            continue
        try:
            calibration.block_of(dict(block), "")
        except FishmjError as error:
            yield Finding("effect", i, "", " ".join(str(error).split()).strip(": "), "")
        if block["name"] in told[:i]:
            yield Finding("effect", i, "name", f"{shown(block['name'])}, listed {told.count(block['name'])} times", "each effect once", "keep one block")


# what is possible, but unlikely


def _unlikely(table: Mapping[str, Any]) -> Iterator[Finding]:
    links, servo = table["link"], servo_of(table.get("servo", {}))
    length, mass = sum(link["length"] for link in links), sum(link["mass"] for link in links)
    for key, unit, total, (low, high, _) in (("length", "m", length, LONG), ("mass", "kg", mass, HEAVY)):
        if not low <= total <= high:
            yield Finding("link", None, key, f"{total:g} {unit} in all", f"about {low:g} to {high:g} {unit} for a robotic fish", f"check the unit: {unit}")
    scale = width_scale(table)
    if scale is not None and not WIDTHS[0] <= scale <= WIDTHS[1]:
        got = f"{mass:g} kg for a hull that displaces {mass / scale:.3g} kg, so that all widths are scaled by {scale:.2f} to let it float"
        yield Finding("link", None, "mass", got, f"a factor from {WIDTHS[0]} to {WIDTHS[1]}", "check masses and sections")
    for i, link in enumerate(links):
        com = link.get("com")
        if com is not None and not 0 <= com[0] <= link["length"]:
            yield Finding("link", i, "com", f"{com[0]:g} m from the front", f"a point in the link, 0 to {link['length']:g} m", "com counts from the link's own front")
    rho = table.get("body", {}).get("density_water", 1000.0)
    if not 950.0 <= rho <= 1100.0:
        yield Finding("body", None, "density_water", f"{rho:g} kg/m3", "about 1000 kg/m3 in fresh water, 1025 in the sea")
    yield from _unlikely_servo(servo)
    t = table.get("timing", {})
    latency, tick = t.get("command_latency", 0.06), t.get("bus_dt", 0.02)
    if latency > 7 * tick + 1e-9:
        expected = f"at most 7 bus ticks, {7 * tick:g} s"
        todo = "engines of many fish remember no older commands and play it as 8 ticks at most; fishmj.sim plays it"
        yield Finding("timing", None, "command_latency", f"{latency:g} s", expected, todo)


def _unlikely_servo(s: Mapping[str, float]) -> Iterator[Finding]:
    kb = s["torque"] / s["speed_no_load"]
    pairs = (
        ("constant", "N m s/rad", s["constant"] ** 2 / s["resistance"], kb, "constant^2 / resistance", "torque / speed_no_load"),
        ("voltage", "rad/s", s["voltage"] / s["constant"], s["speed_no_load"], "voltage / constant", "speed_no_load"),
        ("resistance", "N m", s["constant"] * s["voltage"] / s["resistance"], s["torque"], "constant voltage / resistance", "torque"),
    )
    for key, unit, a, b, left, right in pairs:
        if not b / MOTOR <= a <= b * MOTOR:
            got = f"{left} = {a:.3g} {unit}"
            yield Finding("servo", None, key, got, f"about {right} = {b:.3g} {unit}", "the figures are not of one motor; power will be wrong")
    if s["kp"] * s["range"] < 0.2 * s["torque"]:
        yield Finding("servo", None, "kp", f"{s['kp']:g} N m/rad", "kp times range nearer to the torque", "the servo never gives a fifth of its torque")
    if s["kp"] * s["resolution"] > s["torque"]:
        yield Finding("servo", None, "kp", f"{s['kp']:g} N m/rad", "kp times resolution below the torque", "one count of error gives full torque: the joint will chatter")


__all__ = ["Finding", "examine", "line", "servo_of", "shown", "timing", "width_scale"]
