"""`fishmj deploy weigh`: guides a person through scales, knife edge and pendulum; writes `measurements.toml`.

Every reading is taken three times, with the fish lifted off in between; a reading far from the others is asked again. The page is
written after every measurement, so an interrupted session continues at the same place.
"""

from collections.abc import Callable
from functools import partial
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.units import G
from fishmj.deploy.rig.rig_prompt import Person
from fishmj.log import measurements
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.reading import load_robot

REPEATS = 3
SWINGS = 10  # of the pendulum that are timed together: a stopwatch errs by 0.1 s
APART = {"scales": 0.01, "balance": 0.02, "pendulum": 0.02}  # relative spread of repeats above which one is asked for again
DOUBT = {"scales": 2.0, "balance": 1.5, "pendulum": 1.6}  # ratio to the description above which the unit is doubted
EDGE = 0.001  # m, of one reading on a knife edge
EXAMPLES = """examples:
  fishmj deploy weigh --out data/monday/trials
  fishmj deploy weigh --robot my_fish.toml --out data/my_fish
afterwards: fishmj calibrate mass --data data/monday/trials; fishmj gap find reads the page beside its trials by itself"""


def options() -> console.Parser:
    """The arguments."""
    made = console.parser(
        "deploy weigh", "Scales, knife edge and pendulum: the page of weighings of a data set.", examples=EXAMPLES
    )
    add = made.add_argument
    add("--robot", type=console.text, default="fish", help="description: shipped name or TOML file")
    add("--out", type=console.out_folder, required=True, metavar="FOLDER", help=f"folder of {measurements.FILE}: a data set")
    add("--repeats", type=console.whole(1, 20), default=REPEATS, help=f"of every reading (default {REPEATS})")
    as_one = "the robot cannot be taken apart: weigh it as one (fishmj calibrate mass needs every link)"
    add("--whole", action="store_true", help=as_one)
    add("--again", action="store_true", help="measure anew what the page has already")
    return made


def main(argv: list[str]) -> int:
    """The command. Exit code 0: the page is complete."""
    args = options().parse_args(argv)
    robot, person = load_robot(args.robot), Person()
    page: dict[str, Any] = {} if args.again else measurements.read(args.out)
    page = {"schema": "fishmj.measurements/1", "origin": "measured", "source": "fishmj deploy weigh", **page}
    console.say("Dry the robot; take the battery out only if it swims without it. Do not switch it on.")
    for table, measure in (("scales", _scales), ("balance", _balance), ("pendulum", _pendulum)):
        found = measure(robot, page.get(table, {}), args, person, partial(_keep, args.out, page, table))
        _keep(args.out, page, table, found)
    result = summary(page, robot)
    console.say(console.table(result), f"written: {args.out / measurements.FILE}")
    if args.json:
        console.emit_json({"page": args.out / measurements.FILE, "found": result})
    return console.OK


def _keep(folder: Path, page: dict, table: str, found: dict) -> None:
    page[table] = found
    folder.mkdir(parents=True, exist_ok=True)
    measurements.write(folder, page)


def _scales(robot: Robot, done: dict, args: Any, person: Person, keep: Callable[[dict], None]) -> dict:
    """Measures the table [scales], kg."""
    found = {"unit": "kg", **done}
    described = dict(zip((link.name for link in robot.links), (link.mass for link in robot.links), strict=True))
    for name, mass in {"whole": sum(described.values())}.items() if args.whole else described.items():
        if name not in found:
            what = "the whole robot" if name == "whole" else f"{name} alone, with what moves with it"
            found[name] = readings(person, f"mass of {what}, kg", mass, "scales", args.repeats)
            keep(found)
    return found


def _balance(robot: Robot, done: dict, args: Any, person: Person, keep: Callable[[dict], None]) -> dict:
    """Measures the table [balance], m from the nose."""
    if "at" in done:
        return done
    person.ready("lay the straight robot across a knife edge, nose to the left, until it balances")
    at = readings(person, "distance from the nose to the edge, m", middle_of(robot), "balance", args.repeats)
    return {"unit": "m from the nose, straight", "at": at, "error": EDGE}


def _pendulum(robot: Robot, done: dict, args: Any, person: Person, keep: Callable[[dict], None]) -> dict:
    """Measures the table [pendulum], s of one swing."""
    if "period" in done:
        return done
    person.ready("hang the straight robot level on two threads of one length, as far in front of its balance point as behind it")
    thread = person.number("length of the threads, m", 0.1, 10.0)
    apart = person.number("distance between the threads, m", 0.02, 2.0)
    if thread is None or apart is None:
        raise ConfigError("weigh: the pendulum needs the length of its threads and their distance")
    expected = 4 * pi / apart * sqrt(inertia_of(robot) * thread / (float(geometry_of(robot).mass.sum()) * G))
    console.say(f"turn it by about 10 degrees about the vertical and let go; time {SWINGS} swings there and back")
    periods = readings(person, f"s of {SWINGS} swings", SWINGS * expected, "pendulum", args.repeats)
    page = {"unit": "s, turning about the vertical through the balance point, straight", "thread": thread, "apart": apart}
    return {**page, "period": [round(value / SWINGS, 5) for value in periods]}


def readings(person: Person, what: str, expected: float, kind: str, repeats: int) -> list[float]:
    """Repeats of one reading. A first one far from the description is questioned once; one far from the others is repeated."""
    values: list[float] = []
    while len(values) < repeats:
        value = person.number(f"{what}, reading {len(values) + 1} of {repeats}", 1e-6, 1e4)
        if value is None:
            continue
        ratio = max(value / expected, expected / value)
        if not values and ratio > DOUBT[kind]:
            console.say(
                f"the description says {expected:.4g}, {ratio:.3g} times another: is the unit right? Give it again if it is"
            )
            again = person.number(f"{what}, reading 1 of {repeats}", 1e-6, 1e4)
            value = value if again is None else again
        values.append(value)
        if len(values) == repeats and repeats > 1 and (odd := odd_one(values, APART[kind])) is not None:
            console.say(f"reading {odd + 1}, {values[odd]:g}, is far from the others: lift the robot off, and read again")
            values.pop(odd)
            expected = float(np.mean(values))
    return [round(value, 6) for value in values]


def odd_one(values: list[float], apart: float) -> int | None:
    """Index of the value furthest from the median if the spread is above `apart` of it; else None."""
    middle = float(np.median(values))
    away = np.abs(np.array(values) - middle)
    return int(np.argmax(away)) if away.max() > apart * abs(middle) else None


def middle_of(robot: Robot) -> float:
    """Distance from the nose to the centre of mass of the straight fish as described, m."""
    return float(robot.links[0].length + _moments(robot)[0])


def inertia_of(robot: Robot) -> float:
    """Moment of inertia about the vertical through the centre of mass of the straight fish as described, kg m2."""
    return _moments(robot)[1]


def _moments(robot: Robot) -> tuple[float, float]:
    """(centre of mass behind the head's rear hinge, m; inertia about the vertical through it, kg m2), straight."""
    g = geometry_of(robot)
    front = np.concatenate([[0.0], np.cumsum(g.joint)])  # of each link's origin from the head's, along the fish
    place = front + g.com[:, 0]
    middle = float(g.mass @ place / g.mass.sum())
    behind = float(g.joint[0]) - middle  # the head's rear hinge lies at joint[0] from its origin
    return behind, float(np.sum(g.inertia[:, 2] + g.mass * (place - middle) ** 2))


def summary(page: dict, robot: Robot) -> list[dict]:
    """Rows that compare the page with the description."""
    names = [link.name for link in robot.links]
    mass = float(sum(measurements.masses(page, measurements.weighed_parts(page, names))[0]))
    rows = [
        {"measured": "mass, kg", "value": mass, "described": float(geometry_of(robot).mass.sum())},
        {"measured": "balance from the nose, m", "value": measurements.balance(page, EDGE)[0], "described": middle_of(robot)},
        {"measured": "yaw inertia, kg m2", "value": measurements.inertia(page, mass)[0], "described": inertia_of(robot)},
    ]
    return rows
