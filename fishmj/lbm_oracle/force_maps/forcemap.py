"""`fishmj lbm_oracle forcemap`: steady forces on a held fish against joint angle and angle of attack.

python -m fishmj.lbm_oracle forcemap --device cuda --tanks 6 --fields --out runs/forcemap
python -m fishmj.lbm_oracle forcemap --what joint --domain laptop --angles 0 30 60 --speeds 0.3 --out runs/preview

Signs (robot frame: x ahead, y left, yaw counter-clockwise):

    drag = -F_x,   lateral = -F_y,   yaw = M_z about the reference point
    AoA = bearing of the oncoming flow from the heading: 0 head-on, 90 from the left, 180 from behind
    joint = every joint by the same angle; positive turns the tail to the right of the fish

Each finished point is a row of `forcemap.csv`; a run into the same folder does the missing ones. `--fields` keeps the water at
the end of the points at 0.2 m/s: slices, a picture each of speed and vorticity, and one of all of them side by side.

fields/joint_joint20_aoa0.npz              the slice
fields/joint_joint20_aoa0.png              its speed; ..._vorticity.png its vorticity
fields/joint_joint20_aoa0.vti, .vtp        with --volume: box and fish for ParaView
velocity_joint.png, velocity_aoa.png       all points of a map side by side, on one scale
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import pi, radians
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.figures import canvas, save, style
from fishmj.base.units import WATER_DENSITY, WATER_VISCOSITY
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.force_maps.force_points import COLUMNS, KEYS, AveragingTimes, Point, measure_points
from fishmj.lbm_oracle.output import slice_plots
from fishmj.lbm_oracle.output.record_fields import slice_of, write_volume
from fishmj.lbm_oracle.output.slice_plots import COLOURS, STYLE
from fishmj.lbm_oracle.output.slices import add_fields, read_slice, write_slice
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, PREVIEWS, Domain, preset
from fishmj.lbm_oracle.run.finished_rows import OK, FinishedRows, keep_rows
from fishmj.lbm_oracle.run.run import Run
from fishmj.lbm_oracle.run.setup import SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, boundary_entry, boundary_option, cell_option
from fishmj.lbm_oracle.run.spread import GoOn, Waiting
from fishmj.mjcf import load_robot
from fishmj.mjcf.skin import skin
from fishmj.water.flow import Flow

SPEEDS = (0.1, 0.2, 0.3, 0.4, 0.5)  # m/s, the paper's
JOINTS = tuple(range(0, 61, 10))  # deg
ATTACKS = tuple(range(0, 181, 15))  # deg
BENT = 40.0  # deg, joints of the paper's second map
PICTURED = 0.2  # m/s, the paper's velocity panels


def main(argv: list[str]) -> int:
    """Runs the verb `forcemap`; returns its exit code."""
    args = _parser().parse_args(argv)
    domain, robot = _domain(args), load_robot(args.robot)
    points, plan = _points(args), AveragingTimes(settle=args.settle, seconds=args.seconds, length=robot.length)
    for point in points:
        if abs(point.joint) > 180 / pi * robot.servo.range + 1e-9:
            limit = 180 / pi * robot.servo.range
            raise ConfigError(f"forcemap: joint angle {point.joint:g} deg; the joints of {robot.name} turn by {limit:g} at most")
        plan.ticks(point.speed, robot.timing.bus_dt)  # refuses what is too short
    out = Path(args.out)
    book = FinishedRows(out / "forcemap.csv", COLUMNS, len(KEYS), _setup(args, domain), "forcemap")
    left = [p for p in points if not (p in book.rows and (not _pictured(args, p) or slice_path(out, p).exists()))]
    tick = robot.timing.bus_dt
    seconds = lambda point: sum(plan.ticks(point.speed, tick)) * tick
    held = [(domain, seconds(point)) for point in left]
    less = "take fewer --speeds and --angles, --what joint, a coarser --dx; --domain laptop is a preview"
    solver_cost.agree("lbm_oracle forcemap", args.device, held, instead=less, tanks=min(args.tanks, len(left)))
    if args.domain in PREVIEWS:
        console.say(f"{args.domain} is a preview: dx = {domain.dx} m is too coarse for a judgement")
    console.say(f"{len(points)} points, {len(points) - len(left)} of them done before, in {args.out}")

    options = {"robot": args.robot, "slip": args.slip, "sharpness": BOUNDARIES[args.boundary]}
    pictured = {"out": out, "points": [p for p in left if _pictured(args, p)], "z": args.slice, "whole": args.volume}
    work = partial(on_device, domain=domain, plan=plan, tanks=args.tanks, options=options, pictured=pictured)
    devices = devices_of(args.device) if left else ()
    keep_rows(book, work, left, devices, sum(map(seconds, left)), seconds, "forcemap", args.json)
    rows = [book.rows[p] for p in points]
    pictures = draw_forces(rows, out) + panels(out, [p for p in points if _pictured(args, p)])
    console.say(console.table(rows, ("what", "joint_deg", "aoa_deg", "speed", "drag_N", "lateral_N", "yaw_Nm", "status")))
    lost = [row for row in rows if row["status"] != OK]
    for row in lost:
        console.warn(f"joints {row['joint_deg']} deg, AoA {row['aoa_deg']} deg, {row['speed']} m/s: {row['status']}")
    if args.json:
        console.emit_json({"rows": rows, "stopped": len(lost), "csv": book.path, "pictures": pictures})
    return console.FAILED_CHECK if lost else console.OK


def on_device(
    waiting: Waiting, device: str, go_on: GoOn, *, domain: Domain, plan: AveragingTimes, tanks: int, options: dict, pictured: dict
) -> Iterator[tuple[Point, dict]]:
    """Yields points and their rows, `tanks` side by side on one device (`spread`); writes the water of those in `pictured`.

    Args:
        options: options of `stage`.
        pictured: folder `out`, `points`, `z` of the slice m, and `whole` to write the whole box.
    """
    robot = load_robot(options["robot"])

    def make(point: Point) -> Run:
        return stage(domain, point, device=device, **options).run(
            tethered=True, prescribed=lambda t: point.joints(robot.n_joints)
        )

    for point, row, run in measure_points(waiting, make, plan, tick=robot.timing.bus_dt, tanks=tanks, go_on=go_on):
        if point in pictured["points"]:
            keep(run, pictured["out"], point, z=pictured["z"], whole=pictured["whole"])
        yield point, row


def stage(domain: Domain, point: Point, **options) -> SwimSetup:
    """Set-up of the held fish of one point: the water moves to -x, the heading turns; the box is long along the wake."""
    joints = tuple(point.joints(load_robot(options.get("robot", "fish")).n_joints))
    flow = Flow(speed=point.speed, direction=pi)
    return SwimSetup(domain=domain, flow=flow, pose=(0.0, 0.0, -radians(point.aoa)), joints=joints, **options)


def _points(args) -> list[Point]:
    """Points of the map, low speeds first: they take longest, so that all tanks finish at about the same time."""
    made = []
    for speed in sorted(args.speeds):
        if args.what != "aoa":
            made += [Point("joint", float(a), 0.0, speed) for a in args.angles or JOINTS]
        if args.what != "joint":
            made += [Point("aoa", args.bent, float(a), speed) for a in args.angles or ATTACKS]
    return list(dict.fromkeys(made))


def _domain(args) -> Domain:
    domain = preset(args.domain).changed(dx=args.dx)
    return domain if args.dx is None else replace(domain, name=f"{domain.name} at {args.dx:g} m")


def _setup(args, domain: Domain) -> dict:
    """Set-up that all rows of one table must share."""
    box = {"domain": domain.name, "shape": list(domain.shape), "dx": domain.dx, "dt": domain.dt}
    asked = {"robot": load_robot(args.robot).name, "slip": args.slip, "settle": args.settle, "seconds": args.seconds}
    asked |= boundary_entry(BOUNDARIES[args.boundary])
    return box | asked | {"rho": WATER_DENSITY, "nu": WATER_VISCOSITY}


def _pictured(args, point: Point) -> bool:
    return args.fields and abs(point.speed - PICTURED) < 1e-9


def _parser() -> console.Parser:
    p = console.parser("lbm_oracle forcemap", "Steady drag, lateral force and yaw moment of a held fish in a current.")
    add = p.add_argument
    add("--what", choices=("joint", "aoa", "both"), default="both", help="the map: joint angle, angle of attack")
    angles = "of the chosen map; the paper's range by default"
    add("--angles", type=console.number(-180, 180), nargs="+", action=console.Distinct, metavar="DEG", help=angles)
    add("--bent", type=console.number(-90, 90), default=BENT, metavar="DEG", help="joint angle of the map over angles of attack")
    speeds = console.Listed(console.number(0, 4, above=True))
    add("--speeds", type=speeds, default=",".join(map(str, SPEEDS)), metavar="U,U,...", help="of the current, m/s")
    seconds = "averaged over; by default 6 m of water flow past"
    add("--seconds", type=console.number(0, 10_000, above=True), metavar="S", help=seconds)
    add("--settle", type=console.number(0, 10_000), metavar="S", help="before; by default 5 body lengths of water flow past")
    add("--domain", choices=EVERY, default="forcemap", help="box of water; laptop is a preview, _refined is finer at the fish")
    cell_option(add)
    console.add_settings(p, SwimSetup, "robot", "slip")
    boundary_option(add)
    add("--device", type=console.devices, default="auto", help=console.DEVICES_HELP)
    tanks = "points side by side on each device; 4 to 8 fill a GPU; default 1"
    add("--tanks", type=console.whole(1, 256), default=1, metavar="N", help=tanks)
    add("--fields", action="store_true", help=f"slices and pictures of the water at {PICTURED} m/s")
    add_fields(p, folder=False)
    out = "CSV and pictures; continues what is there"
    add("--out", type=console.out_folder, default="runs/forcemap", metavar="FOLDER", help=out)
    return p


LABELS = (("drag", "drag [N]", "N"), ("lateral", "lateral force [N]", "N"), ("yaw", "yaw moment [N m]", "Nm"))


@style(STYLE)
def draw_forces(rows: Sequence[dict], folder: Path) -> list[Path]:
    """Draws drag, lateral force and yaw moment with standard errors against the angle: one picture a map, one line a speed."""
    drawn = []
    for what, key, label in (("joint", "joint_deg", "joint angle [deg]"), ("aoa", "aoa_deg", "angle of attack [deg]")):
        here = sorted((row for row in rows if row["what"] == what), key=lambda row: row[key])
        if not here:
            continue
        figure, (axes,) = canvas(1, 3, (12, 3.8))
        for i, speed in enumerate(sorted({row["speed"] for row in here})):
            line = [row for row in here if row["speed"] == speed]
            for axis, (name, title, unit) in zip(axes, LABELS, strict=True):
                x, y = [row[key] for row in line], [row[f"{name}_{unit}"] for row in line]
                error = np.nan_to_num([row[f"{name}_sem_{unit}"] for row in line])
                colour = COLOURS[i % len(COLOURS)]
                axis.errorbar(x, y, error, color=colour, marker="o", ms=3, lw=1.4, capsize=2, label=f"{speed:g} m/s")
                early = [row["status"] != "ok" for row in line]  # crossed: the run stopped before its time
                axis.plot(np.array(x)[early], np.array(y)[early], "x", color="#222222", ms=8)
                axis.set(xlabel=label, ylabel=title)
        for axis in axes:
            axis.axhline(0, color="#C9CED6", lw=0.8, zorder=0)
        held = "AoA 0 deg" if what == "joint" else f"joints {here[0]['joint_deg']:g} deg"
        axes[0].set_title(held, loc="left")
        axes[0].legend(frameon=False, fontsize=8)
        drawn.append(save(figure, folder / f"forces_{what}.png"))
    return drawn


TOP = 1.6  # of the current's speed, end of the colour scale


def slice_path(out: Path, point: Point) -> Path:
    """Path of the slice of a point in the folder `out`."""
    return out / "fields" / f"{point.what}_joint{point.joint:g}_aoa{point.aoa:g}.npz"


def keep(run: Run, out: Path, point: Point, *, z: float | None = None, whole: bool = False) -> None:
    """Writes slice and pictures of a finished point, the slice last: if it exists, the others do too."""
    one, path = slice_of(run, z), slice_path(out, point)
    title = f"{point.title}, {point.speed:g} m/s, the water moves to the left{', stopped early' if run.stopped else ''}"
    slice_plots.panels([("", one)], path.with_suffix(".png"), title, TOP * point.speed)
    slice_plots.SlicePicture().write(path.with_name(f"{path.stem}_vorticity.png"), one, f"{title}, ")
    if whole:
        write_volume(run, path.with_suffix(".vti"), path.with_suffix(".vtp"), skin(run.robot, smooth=True))
    write_slice(path, one)


def panels(out: Path, points: Sequence[Point]) -> list[Path]:
    """Draws the speed of the water at all points of a map that have a slice."""
    drawn = []
    for what in ("joint", "aoa"):
        here = [point for point in points if point.what == what and slice_path(out, point).is_file()]
        if not here:
            continue
        named = [(f"{p.joint if what == 'joint' else p.aoa:g} deg", read_slice(slice_path(out, p))) for p in sorted(here)]
        fixed = "joint angle, AoA 0 deg" if what == "joint" else f"angle of attack, joints {here[0].joint:g} deg"
        title = f"speed of the water by {fixed}; {here[0].speed:g} m/s to the left"
        drawn.append(slice_plots.panels(named, out / f"velocity_{what}.png", title, TOP * here[0].speed))
    return drawn
