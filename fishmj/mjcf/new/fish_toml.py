"""Builds the description from the answers: a robot, and the TOML text with the unit and origin of each number."""

from dataclasses import dataclass, replace
from math import degrees

import numpy as np

from fishmj.mjcf.description import Fin, Link, RigSpec, Robot, Servo, Timing
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.new.shape import SIDE, Outline, cut
from fishmj.mjcf.priors import balanced, water_prior
from fishmj.mjcf.servo_buses import BUSES
from fishmj.mjcf.servos import DataSheet, servo_from_sheet

RADIO = 0.5  # W, of a robot's electronics besides its servos' boards; a guess
SIDE_SPAN = 0.065  # of each side fin over the length, as the default fish has them
YELLOW, RED = (
    (0.04, 0.22),
    (0.4, 0.58, 0.74, 0.86, 0.95),
)  # painted stations of the head, from its hinge to the nose, about as there


@dataclass(frozen=True, kw_only=True)
class FishAnswers:
    """All answers about one fish."""

    name: str
    outline: Outline
    mass: float  # kg
    joints: list[float]  # m from the nose
    sheet: DataSheet
    side_span: float  # m, 0 for no side fins
    origin: dict[str, str]  # question -> given, asked, default, placed


def robot_of(fish: FishAnswers) -> Robot:
    """The robot in numbers. Raises ConfigError if the answers contradict each other."""
    links = balanced(cut(fish.outline, fish.joints), fish.mass)
    idle_power = round(RADIO + len(fish.joints) * fish.sheet.idle_power, 2)
    servo = servo_from_sheet(fish.sheet, idle_power=idle_power, where=f"new: servo {fish.sheet.name}")
    robot = Robot(
        name=fish.name, title=f"{fish.name}, {len(links)} links, {len(fish.joints)} servos, {fish.outline.length:.3g} m",
        links=links, servo=servo, fins=side_fins(fish, links), timing=Timing(), water=water_prior(links),
    )  # fmt: skip
    return replace(robot, rig=rig_of(robot, fish.sheet.bus))


def rig_of(robot: Robot, bus: str) -> RigSpec:
    """Default rig before any measurement: servos 1, 2, ... with equal direction, and paint as wide as the head."""
    head, hinge = robot.links[0], float(geometry_of(robot).origin[1])
    stations, widths = np.array(head.sections)[:, [0, 2]].T

    def band(shares: tuple[float, ...]) -> tuple[tuple[float, float], ...]:
        rows = [(hinge + share * head.length, np.interp((1 - share) * head.length, stations, widths)) for share in shares]
        return tuple((round(float(x), 4), max(round(float(width), 4), 1e-4)) for x, width in rows)

    return RigSpec(
        bus=bus, baud=BUSES[bus].baud, servo_ids=robot.servo_ids, signs=(1,) * robot.n_joints, zeros=(0.0,) * robot.n_joints,
        low_voltage=robot.low_voltage, red=band(RED), yellow=band(YELLOW),
    )  # fmt: skip


def side_fins(fish: FishAnswers, links: tuple[Link, ...]) -> tuple[Fin, ...]:
    """A pair of fins on the head, at the same share of the length as in the default fish, but not behind the head."""
    if fish.side_span == 0:
        return ()
    front, rear = (
        round(min(share * fish.outline.length, part * links[0].length), 4) for share, part in zip(SIDE, (0.5, 0.85), strict=True)
    )
    return (Fin(name="side", link=links[0].name, station=(front, rear), span=fish.side_span),)


def toml_of(robot: Robot, fish: FishAnswers) -> str:
    """The description as TOML with comments; `load_robot` reads back the same robot."""
    words = {
        "given": "given on the command line",
        "asked": "asked",
        "default": "default, not measured",
        "placed": "typical for this number of links, not measured",
    }
    said = {key: words[value] for key, value in fish.origin.items()}
    source = fish.outline.source
    high, wide = fish.outline.body
    sizes = {"length": f"{fish.outline.length:g} m", "height": f"{high:.4g} m", "width": f"{wide:.4g} m"}
    sizes |= {"tail_height": f"{fish.outline.rows[-1, 1]:.4g} m", "mass": f"{fish.mass:g} kg"}
    sizes |= {"joints": ", ".join(f"{x:.4g}" for x in fish.joints) + " m from the nose"}
    lines = [
        f"# {robot.title}. Made by `fishmj new`: change what you measure better.",
        "# Lengths in m from the front of each link backwards, masses in kg, angles in the keys that end in _deg.",
        *(f"#   {key.replace('_', ' ')} {value}: {said.get(key, source)}" for key, value in sizes.items()),
        'schema = "fishmj.fish/1"',
        f'name = "{robot.name}"',
        f'title = "{robot.title}"',
        "",
        "[body]",
        f"mass_total = {round(robot.mass, 9)}  # kg, {said.get('mass', 'derived')}; the links' masses must add up to it",
        f"density_water = {robot.density_water}   # kg/m3, fresh water",
        "",
        f"# sections: [distance from the front of the link, height, width], elliptical, linear in between; from {source}.",
        "# mass and com are derived: every link weighs what it displaces and balances about its own centroid, so that a bent",
        "# fish stays trimmed. com is [back from the front, left, up]; its depth, 0.2 of the body's height, is a guess.",
    ]
    for link in robot.links:
        lines += _link(link)
    for fin in robot.fins:
        lines += [
            "[[fin]]                      # guessed: a pair of horizontal plates that damps roll; --side-fin 0 for none",
            f'name = "{fin.name}"',
            f'link = "{fin.link}"',
            f"station = {list(fin.station)}  # front and rear edge from the link's front, m",
            f"span = {fin.span}  # of each, m",
            f"count = {fin.count}",
            "",
        ]
    lines += [*_servo(robot.servo, fish.sheet), *_timing(robot.timing), *_rig(robot.rig), *_water(robot.water)]
    return "\n".join(lines) + "\n"


def _link(link: Link) -> list[str]:
    rows = ", ".join(f"[{s}, {h}, {w}]" for s, h, w in link.sections)
    com, colour = link.com or (0.0, 0.0, 0.0), list(link.colour or ())
    return [
        "[[link]]",
        f'name = "{link.name}"',
        f"length = {link.length}",
        f"mass = {link.mass}",
        f"com = [{com[0]}, {com[1]}, {com[2]}]",
        f"sections = [{rows}]",
        *([f"fin_from = {link.fin_from}  # behind this station the section is a plate"] if link.fin_from is not None else []),
        *([f"colour = {colour}"] if colour else []),
        "",
    ]


def _servo(servo: Servo, sheet: DataSheet) -> list[str]:
    return [
        f"[servo]                      # {sheet.source or sheet.name}",
        f"kp = {servo.kp}  # N m/rad, guessed: saturates at about 12 deg of error",
        f"kd = {servo.kd}  # N m s/rad, derived: stall torque over no-load speed",
        f"torque = {servo.torque}  # N m, stall, data sheet",
        f"speed_no_load = {servo.speed_no_load}  # rad/s, data sheet",
        f"voltage = {servo.voltage}  # V, data sheet",
        f"resistance = {servo.resistance}  # ohm at the output, derived: voltage x constant / torque; the gears' loss is inside",
        f"constant = {servo.constant}  # V s/rad, derived: voltage over no-load speed",
        f"range_deg = {degrees(servo.range):.10g}  # commands are clamped to +- this; the default fish's",
        f"resolution_deg = {degrees(servo.resolution):.10g}",
        f"idle_power = {servo.idle_power}  # W, guessed: radio 0.5 W and the servos' boards",
        "",
    ]


def _timing(timing: Timing) -> list[str]:
    return [
        "[timing]                     # the default fish's; steps must be whole multiples of each other",
        f"physics_dt = {timing.physics_dt}  # s",
        f"bus_dt = {timing.bus_dt}  # s",
        f"control_dt = {timing.control_dt}  # s",
        f'command_path = "{timing.command_path}"  # linear | hold | move_time',
        f"command_latency = {timing.command_latency}  # s",
        f"camera_latency = {timing.camera_latency}  # s",
        f"velocity_window = {timing.velocity_window}  # camera frames",
        "",
    ]


def _rig(rig: RigSpec) -> list[str]:
    slow = (
        "set the servos to it: as delivered an X series has 57600, too slow for 50 Hz"
        if rig.bus == "dynamixel-x"
        else "of the line"
    )
    rows = lambda band: [list(row) for row in band] if band else None
    stated = (
        ("bus", f'"{rig.bus}"', f"kind of servos, check it: {' | '.join(BUSES)}"),
        ("baud", rig.baud, slow),
        ("servo_ids", list(rig.servo_ids or ()), "from the head to the tail; as you numbered them"),
        ("signs", list(rig.signs or ()), "-1 for a servo that turns the other way"),
        ("zeros_deg", [degrees(zero) for zero in rig.zeros or ()], "of each servo, from its middle, with its joint straight"),
        ("low_voltage", rig.low_voltage, "V under load, below which a swim ends; from the servo's voltage: check it"),
        ("red", rows(rig.red), "proposed paint: [x, width] in m, body frame, on the head link"),
        ("yellow", rows(rig.yellow), "the same, behind it"),
        ("paint_height", rig.paint_height, "m over the water"),
    )
    return [
        "[rig]                        # for fishmj deploy; options of the command line go before it (docs/tank/rig.md)",
        *(f"{key} = {value}  # {what}" for key, value, what in stated if value not in (None, [])),
        "",
    ]


def _water(water: dict) -> list[str]:
    notes = {
        "k": "added mass over rho pi/4 h^2, by shape (fishmj/mjcf/priors.py)",
        "cn": "cross-flow drag, by shape",
        "cf": "tangential friction",
        "ke": "momentum at the trailing edge",
        "stations": "strips a link",
    }
    text = lambda v: f'"{v}"' if isinstance(v, str) else str(v)
    rows = [f"{key} = {text(value)}" + (f"  # {notes[key]}" if key in notes else "") for key, value in water.items()]
    return ["[water]                      # prior: values from the literature (docs/simulate/water.md), fitted to no flow", *rows]
