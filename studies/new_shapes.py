"""Speeds of shapes of `fishmj new` in their unfitted water and in the flow solver, compared with a real fish.

    python -m studies.new_shapes --out runs/new_shapes                      the preview: 52 swims, some 40 s each on a CPU
    python -m studies.new_shapes --preset window --out runs/new_shapes      a finer grid, on a GPU

Every shape swims every gait from rest in still water, driven by its servos: in the strip water with the coefficients of its shape
(`fishmj/mjcf/priors.py`), and in the flow solver at each slip ratio. `tendon_fish` has the measured gaits and speeds of a real
robot (data/calib/tendon_fish.toml): at the slip ratio that reproduces its speeds, 0.99, the solver's hull has a real hull's
friction. The last two of five beats count. Each finished swim is a row of OUT/new_shapes_PRESET.csv; the same command does the
missing swims and the picture. If a swim of a shape is beyond a factor of `WITHIN`, the exit status is 1.
"""

import csv
import io
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import ConfigError, OracleUnstable, SimDiverged
from fishmj.base.figures import canvas, save, style
from fishmj.base.store import write_text
from fishmj.lbm_oracle.output.slice_plots import COLOURS, STYLE
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, PREVIEWS, Domain, preset
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.swim import INTERRUPTED, drive, figures
from fishmj.mjcf import Robot, load_robot
from fishmj.mjcf.new.fish_toml import SIDE_SPAN, FishAnswers, robot_of
from fishmj.mjcf.new.shape import joints_of, typical
from fishmj.mjcf.servos import SHELF
from fishmj.sim import Sim

WITHIN = 1.5  # either way
BEATS = 5
SLIP = 0.99  # of the solver's hull: at it the real fish swims as it was measured to


class Shape(NamedTuple):
    """Answers to `fishmj new`: lengths in m, mass in kg or None for the displaced mass, head as a share of the length."""

    length: float
    height: float
    width: float
    tail: float
    links: int = 4
    head: float | None = None
    mass: float | None = None


SHAPES = {
    "default": Shape(0.6, 0.108, 0.0713, 0.135),
    "trout": Shape(0.45, 0.1, 0.06, 0.125, mass=0.7),
    "eel": Shape(0.8, 0.07, 0.06, 0.07, 6),
    "bream": Shape(0.5, 0.2, 0.08, 0.2, 3),
    "tuna": Shape(0.7, 0.15, 0.12, 0.24, 3, 0.55),
    "boxfish": Shape(0.4, 0.13, 0.11, 0.12, 2, 0.7),
    "carp": Shape(0.6, 0.11, 0.07, 0.14, 5, mass=1.6),
    "pike": Shape(0.9, 0.1, 0.08, 0.11, 5, 0.45),
    "catfish": Shape(0.5, 0.08, 0.1, 0.09, 4),
    "shark": Shape(0.9, 0.15, 0.13, 0.22, 4, 0.45),
    "perch": Shape(0.4, 0.11, 0.06, 0.12, 3),
    "salmon": Shape(0.75, 0.15, 0.09, 0.17, 5, 0.38),
    "minnow": Shape(0.3, 0.06, 0.04, 0.07, 3),
    "sturgeon": Shape(0.85, 0.09, 0.09, 0.12, 6, 0.35),
    "sunfish": Shape(0.35, 0.16, 0.06, 0.15, 3, 0.5),
    "mackerel": Shape(0.55, 0.1, 0.075, 0.15, 4, 0.5),
}
REAL = "tendon_fish"
GAITS = {"1 Hz, 30 deg": (1.0, 30.0, 60.0), "0.7 Hz, 20 deg": (0.7, 20.0, 60.0), "1.5 Hz, 20 deg, lag 45": (1.5, 20.0, 45.0)}
COLUMNS = ("fish", "gait", "slip", "measured_m_s", "strips_m_s", "solver_m_s", "ratio", "status")
NUMBERS = ("slip", "measured_m_s", "strips_m_s", "solver_m_s", "ratio")


class Swim(NamedTuple):
    """Gait of a fish. measured: speed of the real one, m/s."""

    fish: str
    name: str
    gait: Gait
    measured: float | None = None


def swims(fish: str) -> list[Swim]:
    """Swims of a fish: those of `GAITS` for a shape, the measured ones for the real fish."""
    if fish != REAL:
        joints = SHAPES[fish].links - 1
        wave = lambda hertz, swing, lag: Gait(joints=joints, frequency=hertz, amplitude=radians(swing), lag=radians(lag))
        return [Swim(fish, name, wave(*values)) for name, values in GAITS.items()]
    seen = read_toml(resolve(REAL))["measured"]
    keys = ("beat_hz", "tail_amplitude_deg", "fin_amplitude_deg", "fin_lag_deg", "speed")
    out = []
    for hertz, tail, fin, lag, speed in zip(*(seen[key] for key in keys), strict=True):
        gait = Gait(joints=2, frequency=hertz, amplitude=(radians(tail), radians(fin)), lag=radians(lag))
        out.append(Swim(fish, f"{hertz:g} Hz", gait, speed))
    return out


def robot_named(name: str) -> Robot:
    """A shipped robot, or the fish that `fishmj new` makes of the answers, with the default servo."""
    if name == REAL:
        return load_robot(REAL)
    shape = SHAPES[name]
    outline = typical(shape.length, shape.height, shape.width, shape.tail)
    joints, span = joints_of(shape.length, shape.links, shape.head), round(SIDE_SPAN * shape.length, 3)
    mass = round(outline.displaced, 2) if shape.mass is None else shape.mass
    fish = FishAnswers(name=name, outline=outline, mass=mass, joints=joints, sheet=SHELF["lx-824"], side_span=span, origin={})
    return robot_of(fish)


def in_strips(robot: Robot, gait: Gait) -> float:
    """Speed over ground in the water of the description over the last two beats, m/s."""
    truth = Sim(robot, water="structured").run(gait, BEATS / gait.frequency).table("truth")
    last = truth["t"] > truth["t"][-1] - 2 / gait.frequency - 1e-9
    x, y, t = (truth[key][last] for key in ("x", "y", "t"))
    return float(np.hypot(x[-1] - x[0], y[-1] - y[0]) / (t[-1] - t[0]))


def swim_row(swim: Swim, slip: float, domain: Domain, device: str) -> dict:
    """Row of one swim in the table. A solver that does not finish leaves no ratio; `status` has the reason."""
    robot, gait = robot_named(swim.fish), swim.gait
    strips = in_strips(robot, gait)
    row = dict.fromkeys(COLUMNS) | {"fish": swim.fish, "gait": swim.name, "slip": slip}
    row |= {"measured_m_s": swim.measured, "strips_m_s": round(strips, 4)}
    try:
        run = SwimSetup(robot=robot, domain=domain, slip=slip, device=device).run()
    except (ConfigError, OracleUnstable, SimDiverged) as error:
        return row | {"status": " ".join(str(error).split())}
    drive(run, gait, BEATS / gait.frequency, quiet=True)
    if run.stopped:
        return row | {"status": " ".join(run.stopped.split())}
    solver = figures(run, gait.frequency)["speed_m_s"]
    return row | {"solver_m_s": round(solver, 4), "ratio": round(solver / strips, 3), "status": "ok"}


def read(path: Path) -> dict[tuple, dict]:
    """Existing rows, by fish, gait and slip. Raises ConfigError for a table with other columns."""
    if not path.is_file():
        return {}
    table = csv.DictReader(path.read_text("utf-8").splitlines())
    if tuple(table.fieldnames or ()) != COLUMNS:
        raise ConfigError(f"{path}: columns {table.fieldnames}; expected {list(COLUMNS)}. Take another --out")
    number = lambda text: float(text) if text else None
    return {key(row): row for row in (row | {name: number(row[name]) for name in NUMBERS} for row in table)}


def key(row: dict) -> tuple:
    """Key of a row: fish, gait, slip."""
    return row["fish"], row["gait"], row["slip"]


def as_csv(rows: list[dict]) -> str:
    """CSV text of the rows."""
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def main(argv: list[str]) -> int:
    """Runs the missing swims, prints the table and draws the picture; returns the exit code."""
    args = _parser().parse_args(argv)
    domain, path = preset(args.preset), Path(args.out) / f"new_shapes_{args.preset}.csv"
    rows = read(path)
    asked = [(swim, slip) for fish in args.fish for swim in swims(fish) for slip in args.slips]
    left = [(swim, slip) for swim, slip in asked if (swim.fish, swim.name, slip) not in rows]
    seconds = [(domain, BEATS / swim.gait.frequency) for swim, _ in left]
    solver_cost.agree("studies.new_shapes", args.device, seconds, instead="take fewer --fish or --slips, or --preset laptop")
    if args.preset in PREVIEWS:
        console.say(f"{args.preset} is a preview: dx = {domain.dx} m is too coarse for a judgement")
    with console.Progress(len(left), "new_shapes", every=1e9 if args.json else None) as bar:
        for number, (swim, slip) in enumerate(left, 1):
            row = swim_row(swim, slip, domain, args.device)
            if row["status"] == INTERRUPTED:
                return console.INTERRUPTED
            rows[key(row)] = row
            write_text(path, as_csv([rows[one] for one in sorted(rows)]))
            bar.update(number, ratio=row["ratio"] or 0.0)
    told = [rows[swim.fish, swim.name, slip] for swim, slip in asked]
    found = judged(told)
    written = [path, *([drawn(told, path.with_suffix(".png"))] if any(row["ratio"] for row in told) else [])]
    console.say(console.table(told, COLUMNS), *(f"wrote {one}" for one in written), console.table(found))
    if args.json:
        console.emit_json({"rows": told, "judged": found, "out": path})
    return console.OK if all(row["within"] == row["of"] for row in found) else console.FAILED_CHECK


def judged(rows: list[dict]) -> list[dict]:
    """Rows by slip ratio: number of swims within `WITHIN` either way, and both waters' ratios to the real fish's speeds."""
    out = []
    for slip in sorted({row["slip"] for row in rows}):
        here = [row for row in rows if row["slip"] == slip]
        shapes, real = ([row for row in here if (row["fish"] == REAL) == is_real] for is_real in (False, True))
        ratios = np.array([row["ratio"] or np.inf for row in shapes])
        told = {"slip": slip, "within": int(np.sum((ratios <= WITHIN) & (ratios >= 1 / WITHIN))), "of": len(ratios)}
        told["solver / strips"] = spread([row["ratio"] for row in shapes])
        for water in ("solver", "strips"):
            told[f"{water} / measured"] = spread([v and v / row["measured_m_s"] for row in real for v in [row[f"{water}_m_s"]]])
        out.append(told)
    return out


@style(STYLE)
def drawn(rows: list[dict], path: Path) -> Path:
    """Draws speeds in the solver over those in the strips at the lowest slip ratio, one colour a gait; the band is `WITHIN`."""
    figure, ((axis,),) = canvas(1, 1, (5.5, 4.5))
    least = min(row["slip"] for row in rows if row["ratio"])
    here = [row for row in rows if row["slip"] == least and row["ratio"]]
    groups = {name: [row for row in here if row["gait"] == name] for name in GAITS}
    groups["a real fish: measured over strips"] = [
        row | {"solver_m_s": row["measured_m_s"]} for row in here if row["fish"] == REAL
    ]
    for (name, group), colour in zip(groups.items(), COLOURS, strict=False):
        x, y = ([row[key] for row in group] for key in ("strips_m_s", "solver_m_s"))
        axis.loglog(x, y, "o", ms=5, color=colour, label=name)
    ends = np.array([0.8 * min(row["strips_m_s"] for row in here), 1.25 * max(row["strips_m_s"] for row in here)])
    axis.fill_between(ends, ends / WITHIN, ends * WITHIN, color="0.9", zorder=0, label=f"within a factor of {WITHIN:g}")
    axis.set(xlabel="unfitted strips [m/s]", ylabel=f"flow solver, slip ratio {least:g} [m/s]")
    axis.legend(frameon=False, fontsize=8)
    return save(figure, path)


def spread(values: list[float | None]) -> str:
    """Least, median and greatest of the values that are not None, as text."""
    given = [value for value in values if value is not None]
    return f"{min(given):.2f}, {np.median(given):.2f}, {max(given):.2f}" if given else "-"


def _parser() -> console.Parser:
    p = console.parser("studies.new_shapes", __doc__)
    several: dict[str, Any] = {"nargs": "+", "action": console.Distinct}
    p.add_argument("--fish", choices=(*SHAPES, REAL), **several, default=[*SHAPES, REAL], help="by default all")
    slip = "quoted at the paper's grid: 1 slides, 0 sticks"
    p.add_argument("--slips", type=console.number(0, 1), **several, default=[SLIP], metavar="S", help=slip)
    p.add_argument("--preset", choices=EVERY, default="laptop", help="box of water; laptop is a preview")
    p.add_argument("--device", type=console.device, default="auto", help="auto, cpu, cuda or cuda:N")
    p.add_argument("--out", type=console.out_folder, required=True, metavar="FOLDER", help="of the table")
    return p


if __name__ == "__main__":
    raise SystemExit(console.run(main))
