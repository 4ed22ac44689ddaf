"""Schema of a robot description: every block and key with its unit, bounds and meaning.

pydantic checks a description against these models; `validation.py` turns its errors into lines for a reader, and
`relations.py` adds the checks between several keys (masses that add up, steps that nest).
`KeyFault` is one error, `line` its text.
The table of keys in docs/simulate/your_own_fish.md is made from here.
Lengths in m from the front of each link backwards, angles in rad or in keys that end in `_deg`.
"""

from collections.abc import Mapping
from datetime import date, time
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from fishmj.base import names
from fishmj.mjcf.description import FASTEST

SCHEMA: Literal["fishmj.fish/1"] = "fishmj.fish/1"
MOST_LINKS = 12  # XLA compiles the closed form of 8 links in 13 s, of 12 in 76 s, of 16 not within 5 minutes (2 CPU cores)
LONGEST_TEXT = 200
FREE = ("origin", "measured", "notes")  # blocks for the reader's own notes: nothing in fishmj looks at them


def _name(text: str) -> str:
    if not names.is_name(text):
        raise ValueError("not a name")
    return text


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("not printable")
    return text


Name = Annotated[str, AfterValidator(_name)]
Text = Annotated[str, AfterValidator(_printable)]
Station = Annotated[float, Field(ge=0.0, le=30.0, allow_inf_nan=False)]  # m
Along = Annotated[float, Field(ge=-30.0, le=30.0, allow_inf_nan=False)]  # m
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
TWO, THREE = Field(min_length=2, max_length=2), Field(min_length=3, max_length=3)
NAME = "1 to 64 letters, digits, '_', '.' or '-', the first of them no '-'"
REQUIRED: Any = ...


def _field(what: str, unit: str, expected: str, default: Any, **bounds) -> Any:
    return Field(default, description=what, json_schema_extra={"unit": unit, "expected": expected}, **bounds)


def number(what: str, low: float, high: float, unit: str = "", *, above: bool = False, default: Any = REQUIRED) -> Any:
    """Field for a finite number from `low` (with `above`: beyond it) to `high`."""
    bounds: dict[str, Any] = {("gt" if above else "ge"): low, "le": high, "allow_inf_nan": False}
    return _field(what, unit, f"a number {span(low, high, above)}{f' {unit}' if unit else ''}", default, **bounds)


def whole(what: str, low: int, high: int, unit: str = "", *, default: Any = REQUIRED) -> Any:
    """Field for a whole number from `low` to `high`."""
    return _field(what, unit, f"a whole number {span(low, high)}{f' {unit}' if unit else ''}", default, ge=low, le=high)


def text(what: str, *, default: Any = "", most: int = LONGEST_TEXT, least: int = 0) -> Any:
    """Field for printable text."""
    expected = f"printable text of {f'{least} to ' if least else 'at most '}{most} characters"
    return _field(what, "", expected, default, max_length=most, min_length=least)


def name(what: str, default: Any = REQUIRED) -> Any:
    """Field for a name that may stand in paths, pages and source."""
    return _field(what, "", NAME, default)


def span(low: float, high: float, above: bool = False) -> str:
    """Range in words: `from 0 to 1`, `above 0 to 1`."""
    return f"{'above' if above else 'from'} {low:g} to {high:g}"


class TomlTable(BaseModel):
    """A table of a description: refuses unknown keys, and texts or truth values in place of numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, protected_namespaces=())


class BodyBlock(TomlTable):
    """The whole fish."""

    mass_total: float | None = number("a check: the links' masses must add up to it within 1 %", 1e-3, 3e5, "kg", default=None)
    density_water: float = number("of the water that it floats in", 500.0, 2000.0, "kg/m3", default=1000.0)
    hull: Literal["turbulent", "laminar"] = _field(
        "its boundary layer, for `--boundary wall_stress`", "", "'turbulent' or 'laminar'", "turbulent"
    )
    reference: Literal["straight_com"] = _field("the point whose pose is reported", "", "'straight_com'", "straight_com")


class LinkBlock(TomlTable):
    """One rigid link."""

    name: Name = name("the links' names must differ")
    length: float = number("from its front hinge, or the nose, to its rear hinge, or the tail's end", 1e-3, 30.0, "m")
    mass: float = number("as it is in the water, flooded parts included", 1e-5, 3e5, "kg")
    sections: Annotated[list[Annotated[list[Station], THREE]], Field(min_length=2, max_length=500)] = _field(
        "ellipses; stations rise from 0 to `length`",
        "m",
        "2 to 500 rows [from the front, height, width] in m, the last two from 0.0001 to 10",
        REQUIRED,
    )
    com: Annotated[list[Along], THREE] | None = _field(
        "centre of mass, up at most half the link's height; left out: that of the shape",
        "m",
        "[back from the front, 0.0, up] in m",
        None,
    )
    fin_from: float | None = number(
        "behind this station a single sheet for the flow solver; on the last link", 0.0, 30.0, "m", default=None
    )
    colour: Annotated[list[Share], THREE] = _field("for pictures", "", "[red, green, blue], each from 0 to 1", [0.4, 0.5, 0.6])


class FinBlock(TomlTable):
    """Fixed horizontal plates, which damp roll."""

    name: Name = name("the fins' names must differ")
    link: str = _field("the link that carries it", "", "the name of a link", REQUIRED, max_length=64)
    station: Annotated[list[Station], TWO] = _field(
        "from the link's front", "m", "[front edge, rear edge] in m, within the link, the rear edge behind", REQUIRED
    )
    span: float = number("of each plate, at most half the fish's length", 1e-4, 10.0, "m")
    count: int = whole("left alone, or left and right", 1, 2, default=2)


class ServoBlock(TomlTable):
    """One kind of servo for all joints: torque = clip(kp error - kv rate, +-torque) - kb rate, kd = kv + kb."""

    kp: float | None = number("proportional gain", 1e-4, 1e6, "N m/rad", default=None)
    kd: float | None = number("damping in all, at least kb = torque / speed_no_load", 1e-6, 1e5, "N m s/rad", default=None)
    torque: float | None = number("at stall, at the output", 1e-4, 1e5, "N m", default=None)
    speed_no_load: float | None = number("at the output", 1e-2, FASTEST, "rad/s", default=None)
    voltage: float | None = number("for power only", 0.1, 1000.0, "V", default=None)
    resistance: float | None = number("for power only", 1e-4, 1e5, "ohm", default=None)
    constant: float | None = number("of the motor seen at the output, for power only", 1e-5, 1e4, "V s/rad", default=None)
    range: float | None = number("in the place of range_deg", 0.0, 3.141592653589794, "rad", above=True, default=None)
    range_deg: float | None = number("commands are clamped to plus and minus this", 0.0, 180.0, "deg", above=True, default=None)
    resolution: float | None = number("in the place of resolution_deg", 1e-7, 0.523598775598299, "rad", default=None)
    resolution_deg: float | None = number("commands are rounded to this", 1e-5, 30.0, "deg", default=None)
    idle_power: float | None = number("electronics of the whole robot", 0.0, 1e4, "W", default=None)


class TimingBlock(TomlTable):
    """Steps and delays; the steps are whole multiples of each other."""

    physics_dt: float | None = number("the water is fitted at it and belongs to it", 1e-4, 0.02, "s", default=None)
    bus_dt: float | None = number("between two commands on the bus", 1e-3, 0.2, "s", default=None)
    control_dt: float | None = number("between two decisions", 5e-3, 10.0, "s", default=None)
    command_path: Literal["linear", "hold", "move_time"] | None = _field(
        "what the bus does between two decisions", "", "'linear', 'hold' or 'move_time'", None
    )
    command_latency: float | None = number(
        "nominal, bus to servo; played as it is, whatever its length", 0.0, 1.0, "s", default=None
    )
    camera_latency: float | None = number("nominal; played as it is, in bus ticks, rounded up", 0.0, 1.0, "s", default=None)
    velocity_window: int | None = whole("in the tracker's line fit", 2, 500, "frames", default=None)


Each = Annotated[list[Annotated[float, Field(ge=0.0, le=50.0, allow_inf_nan=False)]], Field(min_length=1, max_length=MOST_LINKS)]


Ids = Annotated[list[Annotated[int, Field(ge=0, le=253)]], Field(min_length=1, max_length=MOST_LINKS - 1)]
Signs = Annotated[list[Literal[-1, 1]], Field(min_length=1, max_length=MOST_LINKS - 1)]
Zeros = Annotated[
    list[Annotated[float, Field(ge=-180.0, le=180.0, allow_inf_nan=False)]], Field(min_length=1, max_length=MOST_LINKS - 1)
]
Painted = Annotated[list[Annotated[list[Along], TWO]], Field(min_length=2, max_length=50)]
A_JOINT = "one number a joint, head first"


class RigBlock(TomlTable):
    """Wiring, supply and paint of the robot, for `fishmj deploy`; options of the command line take precedence."""

    bus: Literal["lx", "dynamixel-x", "dynamixel-ax"] = _field(
        "kind of servos on a `serial:` link", "", "'lx', 'dynamixel-x' or 'dynamixel-ax'", "lx"
    )
    baud: (
        Literal[9600, 19200, 38400, 57600, 115200, 200000, 250000, 400000, 500000, 1000000, 2000000, 3000000, 4000000] | None
    ) = _field(
        "of the servo bus; default 115200 of lx, 1000000 of dynamixel", "1/s", "a baud rate such as 115200 or 1000000", None
    )
    servo_ids: Ids | None = _field("numbers on the bus; default 1, 2, ...", "", f"{A_JOINT}, each from 0 to 253", None)
    signs: Signs | None = _field("-1 for a servo that turns the other way; default 1", "", f"{A_JOINT}, each 1 or -1", None)
    zeros: Zeros | None = _field("in the place of zeros_deg", "rad", f"{A_JOINT}, each from -3.14159 to 3.14159", None)
    zeros_deg: Zeros | None = _field(
        "of each servo, from its middle, with its joint straight; default 0", "deg", f"{A_JOINT}, each from -180 to 180", None
    )
    low_voltage: float | None = number(
        "below it for 1 s the swim ends; default 3.2 V a LiPo cell, or 86 % of [servo] voltage", 0.1, 1000.0, "V", default=None
    )
    red: Painted | None = _field(
        "paint on the head link, before yellow", "m", "2 to 50 rows [x, width] in m, body frame, x rising, width above 0", None
    )
    yellow: Painted | None = _field(
        "paint on the head link, behind red", "m", "2 to 50 rows [x, width] in m, body frame, x rising, width above 0", None
    )
    paint_height: float = number("of the paint over the water", -1.0, 1.0, "m", default=-0.005)


class WaterBlock(TomlTable):
    """Start values of the strip model (docs/simulate/water.md); missing ones come from the shape of the sections."""

    model: Text | None = text(
        "these strips ('structured'), 'fitted', or a fitted water by name or .toml; default: fitted if there is one",
        default=None,
        most=500,
        least=1,
    )
    k: Each | None = _field("added mass over rho pi/4 h^2", "", "one number a link, each from 0 to 50", None)
    cn: Each | None = _field("cross-flow drag", "", "one number a link, each from 0 to 50", None)
    cf: float | None = number("tangential friction", 0.0, 3.0, default=None)
    ca_forward: float | None = number("form drag of the head", 0.0, 20.0, default=None)
    ca_backward: float | None = number("the same, swimming backwards", 0.0, 20.0, default=None)
    ke: float | None = number("momentum shed at the trailing edge", 0.0, 10.0, default=None)
    lift_a: float | None = number("normal force of the edge, detached; a + b at least 0.5", 0.0, 100.0, default=None)
    lift_b: float | None = number("the same, attached", 0.0, 100.0, default=None)
    stall_angle: float | None = number("in the place of stall_angle_deg", 0.0, 3.2, "rad", above=True, default=None)
    stall_angle_deg: float | None = number("where the tail stalls", 0.0, 180.0, "deg", above=True, default=None)
    stall_width: float | None = number("in the place of stall_width_deg", 0.008726646259971, 3.2, "rad", default=None)
    stall_width_deg: float | None = number("how sharply", 0.5, 180.0, "deg", default=None)
    stall_lag: float | None = number("travelled, in heights of the trailing edge", 0.01, 1000.0, default=None)
    suction: float | None = number("share of leading-edge suction behind the head", 0.0, 1.0, default=None)
    residual: float | None = number("share of a fitted water's learnt residual, 1 as fitted", 0.0, 2.0, default=None)
    edge_place: float | None = number("where the tail meets the flow it sheds, 1 at its rear end", 0.1, 1.5, default=None)
    tail_held: float | None = number("share of the tail's cross-flow drag that attached flow lacks", 0.0, 1.0, default=None)
    linear_drag: float | None = number("drag in proportion to the speed", 0.0, 20.0, "N s/m", default=None)
    stations: int | None = whole("strips a link, 6 where left out", 1, 64, default=None)


class EffectBlock(TomlTable):
    """Effect from calibration or gap search; leave it out at first (docs/simulate/effects.md)."""

    name: str = _field("of the catalogue", "", "the name of an effect", REQUIRED, max_length=64)
    parameters: dict[str, Any] = _field("by name", "", "a table of name = { value, low, high }", {})
    provenance: Text = text("the data that say so", most=2000)
    hash: Text = text("of that evidence")


class VersionBlock(BaseModel):
    """Origin of a version of a model; `gap apply` writes it."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    number: int = whole("of the version", 1, 10**6, default=1)
    parent: Text = text("the model before it", most=1000)
    parent_text: str = _field("the file beside it that holds the parent's text", "", "the name of a file, without folders", "")
    parent_sha256: Text = text("of that text")


class Description(TomlTable):
    """The whole file."""

    schema_: Literal["fishmj.fish/1"] = Field(
        SCHEMA,
        alias="schema",
        description="the format; a file without it is read as this one",
        json_schema_extra={"unit": "", "expected": f"{SCHEMA!r}"},
    )
    name: Name | None = name("in data sets, waters, policies, logs; left out: the file's name", None)
    title: Text = text("for pages and pictures")
    notes: Any = _field("your own notes, text or a block", "", "text or a block [notes]", None)
    origin: dict[str, Any] = _field("your own notes: where the numbers come from", "", "a block [origin]", {})
    measured: dict[str, Any] = _field("your own notes: what you measured", "", "a block [measured]", {})
    body: BodyBlock = _field("", "", "a block [body]", BodyBlock())
    link: Annotated[list[LinkBlock], Field(min_length=2, max_length=MOST_LINKS)] = _field(
        "", "", f"2 to {MOST_LINKS} blocks [[link]], nose first", REQUIRED
    )
    fin: Annotated[list[FinBlock], Field(max_length=16)] = _field("", "", "at most 16 blocks [[fin]]", [])
    servo: ServoBlock = _field("", "", "a block [servo]", ServoBlock())
    timing: TimingBlock = _field("", "", "a block [timing]", TimingBlock())
    rig: RigBlock = _field("", "", "a block [rig]", RigBlock())
    water: WaterBlock = _field("", "", "a block [water]", WaterBlock())
    effect: Annotated[list[EffectBlock], Field(max_length=64)] = _field("", "", "at most 64 blocks [[effect]]", [])
    calibration: dict[str, dict[str, Any]] = _field(
        "what `fishmj calibrate` measured; it writes it", "", "blocks [calibration.VERB]", {}
    )
    version: VersionBlock = _field("", "", "a block [version]", VersionBlock())


BLOCKS: dict[str, type[BaseModel]] = {
    "body": BodyBlock,
    "link": LinkBlock,
    "fin": FinBlock,
    "servo": ServoBlock,
    "timing": TimingBlock,
    "rig": RigBlock,
    "water": WaterBlock,
    "effect": EffectBlock,
    "version": VersionBlock,
}
LISTS = ("link", "fin", "effect")  # blocks that may stand several times, [[...]]


def said(block: str, key: str) -> tuple[str, str, str]:
    """(meaning, unit, expected value) of a key of a block; of a key at the top of the file if `block` is empty."""
    model = BLOCKS[block] if block else Description
    for field_name, info in model.model_fields.items():
        if key == (info.alias or field_name):
            extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
            return info.description or "", str(extra.get("unit", "")), str(extra.get("expected", ""))
    raise KeyError(key)


def keys(block: str = "") -> list[str]:
    """The keys of a block, or of the file."""
    model = BLOCKS[block] if block else Description
    return [info.alias or field_name for field_name, info in model.model_fields.items()]


def header(block: str) -> str:
    """Header of a block in the file: `[servo]`, `[[link]]`."""
    return f"[[{block}]]" if block in LISTS else f"[{block}]"


class KeyFault(NamedTuple):
    """One error in a description. block: "link"; nth: index among several, from 0; key: "mass", or "" for the whole block."""

    block: str
    nth: int | None
    key: str
    got: str
    expected: str
    todo: str = ""


def line(f: KeyFault, table: Mapping[str, Any], where: str) -> str:
    """Text of a fault: `FILE [[link]] 2 'body1' mass: got nan, expected a number above 0 kg; what to do`."""
    place = f" {header(f.block)}" if f.block else ""
    if f.nth is not None:
        entry = table[f.block][f.nth]
        label = entry.get("name") if isinstance(entry, Mapping) else None
        place += f" {f.nth + 1}" + (f" {label!r}" if names.is_name(label) else "")
    key = (f" {f.key}" if f.key.isprintable() and len(f.key) <= 64 else f" {shown(f.key)}") if f.key else ""
    if not f.expected:  # the catalogue of effects words its own
        return f"{where}{place}{key}: {f.got}"
    return f"{where}{place}{key}: got {f.got}, expected {f.expected}" + (f"; {f.todo}" if f.todo else "")


def shown(value: Any, most: int = 60) -> str:
    """Value for a message: short, on one line, and printable."""
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
    elif isinstance(value, date | time):
        text = f"the {'time' if isinstance(value, time) else 'date'} {value.isoformat()}"
    elif isinstance(value, list):
        text = f"[{', '.join(shown(item, 20) for item in value[:6])}{', ...' * (len(value) > 6)}]"
    else:
        text = repr(value)
    return text if len(text) <= most + 2 else text[: most - 3] + "..."
