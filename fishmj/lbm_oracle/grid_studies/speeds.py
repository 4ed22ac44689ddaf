"""`fishmj lbm_oracle speeds`: how fast the free fish swims, over beat frequency, slip ratio and depth.

python -m fishmj.lbm_oracle speeds --device cuda --out runs/speeds
python -m fishmj.lbm_oracle speeds --preset window --frequencies 1 --slips 1 --depths 0.25 --out runs/shallow
python -m fishmj.lbm_oracle speeds --preset laptop --frequencies 1 2 --slips 0.99 1 --beats 3 --device cpu --out runs/a

Still water, from rest, the paper's gait (30 deg, lag 60 deg, servo-driven) at each frequency; the last two beats count.
`aside_deg` is the direction of the path from the first heading. Each finished swim is a row of `speeds.json`. The same command
does the missing swims; another set-up in the same folder is refused. With `--robot` another fish swims that gait, with its own
number of joints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.figures import canvas, save, style
from fishmj.base.store import read_json, write_json
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.output.slice_plots import COLOURS, STYLE
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, Domain, preset
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.solver_water import robot_entry
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, spread
from fishmj.lbm_oracle.run.swim import INTERRUPTED, drive, figures
from fishmj.mjcf import load_robot

FREQUENCIES, SLIPS = (0.5, 1.0, 1.5, 2.0), (0.0, 0.95, 0.98, 0.99, 0.995, 1.0)
KEYS = ("frequency", "slip", "depth")
COLUMNS = (*KEYS, "speed_m_s", "aside_deg", "yaw_amplitude_deg", "power_W", "refined_ticks", "status")


def swim_row(domain: Domain, frequency: float, slip: float, beats: float, device: str, robot: str = "fish") -> dict:
    """Row of one swim: speed m/s, path from the first heading deg, swing of the heading deg, servo power W, early end."""
    gait = replace(Gait.of_the_paper(joints=load_robot(robot).n_joints), frequency=frequency)
    run = SwimSetup(domain=domain, robot=robot, slip=slip, device=device).run()
    drive(run, gait, beats / frequency, quiet=True)
    status = " ".join(run.stopped.split()) or "ok"
    if not run.rows:
        return dict.fromkeys(COLUMNS[3:-1]) | {"status": status}
    found = figures(run, frequency)
    kept = {name: found[name] for name in ("speed_m_s", "yaw_amplitude_deg", "power_W", "refined_ticks")}
    return kept | {"aside_deg": found["course_deg"], "status": status}


def on_device(
    waiting: Waiting, device: str, go_on: GoOn, *, box: Domain, beats: float, robot: str
) -> Iterator[tuple[tuple, dict]]:
    """Yields key and row of swims, one after another on one device (`spread`)."""
    while waiting:
        frequency, slip, depth = key = waiting.popleft()
        yield key, swim_row(box.changed(depth=depth), frequency, slip, beats, device, robot)


class SpeedTable:
    """Finished swims in `folder/speeds.json`, beside the set-up that they share.

    Raises:
        ConfigError: the folder holds another set-up.
    """

    def __init__(self, folder: Path, setup: dict):
        self.path, self.setup, self.rows = folder / "speeds.json", setup, {}
        if not self.path.is_file():
            return
        kept = read_json(self.path)
        if kept["setup"] != setup:
            raise ConfigError(f"{self.path} holds swims of {kept['setup']}, this is {setup}. Take another --out")
        self.rows = {tuple(row[key] for key in KEYS): row for row in kept["rows"]}

    def add(self, key: tuple, found: dict) -> None:
        """Keeps a swim; it is on disk before this returns."""
        self.rows[key] = dict(zip(KEYS, key, strict=True)) | found
        rows = [self.rows[k] for k in sorted(self.rows)]
        write_json(self.path, {"source": "fishmj.lbm_oracle speeds", "origin": "synthetic", "setup": self.setup, "rows": rows})


def swim_keys(frequencies: Sequence[float], slips: Sequence[float], depths: Sequence[float]) -> list[tuple]:
    """Keys (frequency Hz, slip ratio, depth m) of all swims, the short ones first.

    Raises:
        ConfigError: a frequency or depth that is not positive, a slip ratio outside 0 to 1.
    """
    if min(frequencies) <= 0 or min(depths) <= 0 or min(slips) < 0 or max(slips) > 1:
        expected = "expected positive frequencies and depths, slip ratios in 0..1"
        raise ConfigError(f"speeds: {list(frequencies)} Hz, slip {list(slips)}, depth {list(depths)} m; {expected}")
    return sorted(product(frequencies, slips, depths), key=lambda key: -key[0])


def main(argv: list[str]) -> int:
    """Runs the verb `speeds`; returns its exit code."""
    args = _parser().parse_args(argv)
    box, robot = preset(args.preset), load_robot(args.robot)
    depths = args.depths or [round(box.shape[2] * box.dx, 6)]
    keys = swim_keys(args.frequencies, args.slips, depths)
    setup = {"domain": box.name, "dx": box.dx, "dt": box.dt, "beats": args.beats} | robot_entry(robot)
    book = SpeedTable(Path(args.out), setup)
    left = [key for key in keys if key not in book.rows]
    swims = [(box.changed(depth=depth), args.beats / frequency) for frequency, _, depth in left]
    less = "take a coarser --preset, fewer --beats, --frequencies or --slips; --preset laptop is a preview"
    solver_cost.agree("lbm_oracle speeds", args.device, swims, instead=less)
    devices = devices_of(args.device)
    console.say(f"{len(keys)} swims, {len(keys) - len(left)} of them done before, in {book.path.parent}")
    if robot_entry(robot):
        console.say(f"{robot.name} swims the gait of the shipped fish; published speeds are those of the shipped fish")
    work = partial(on_device, box=box, beats=args.beats, robot=args.robot)
    with console.Progress(len(left), "speeds", every=1e9 if args.json else None) as bar:
        for number, (key, found) in enumerate(spread(work, left, devices), 1):
            if found["status"] == INTERRUPTED:
                return console.INTERRUPTED
            book.add(key, found)
            bar.update(number, speed=found["speed_m_s"] or 0.0)
    rows = [book.rows[key] for key in keys]
    title = f"{''.join(f'{name}, ' for name in robot_entry(robot).values())}{box.name}, {100 * box.dx:g} cm"
    picture = draw_speeds(rows, book.path.with_name("speeds.png"), title)
    console.say(console.table(rows, COLUMNS), f"wrote {book.path} and {picture}")
    lost = [row for row in rows if row["status"] != "ok"]
    if args.json:
        console.emit_json({"rows": rows, "stopped": len(lost), "out": book.path})
    return console.FAILED_CHECK if lost else console.OK


def _parser() -> console.Parser:
    p = console.parser("lbm_oracle speeds", "Speed of the free fish over beat frequency, slip ratio and depth.")
    add = p.add_argument
    several: dict[str, Any] = {"nargs": "+", "action": console.Distinct}
    add("--preset", choices=EVERY, default="window_coarse", help="box of water; laptop is a preview")
    add("--robot", type=console.text, default="fish", help="shipped name or TOML file")
    beat = console.number(0.05, 10)
    add("--frequencies", type=beat, **several, default=list(FREQUENCIES), metavar="HZ", help="of the beat")
    slip = "quoted at the paper's grid: 1 slides, 0 sticks"
    add("--slips", type=console.number(0, 1), **several, default=list(SLIPS), metavar="S", help=slip)
    add("--depths", type=console.number(0.05, 10), **several, metavar="M", help="of the water; the domain's own by default")
    add("--beats", type=console.number(0, 1000, above=True), default=8.0, help="of each swim; the last two count")
    place = "auto, cpu, cuda, cuda:N, or several: cuda:all, cuda:0,cuda:1; default auto, one of them"
    add("--device", type=console.devices, default="auto", help=place)
    out = "speeds.json and speeds.png; continues what is there"
    add("--out", type=console.out_folder, default="runs/speeds", metavar="FOLDER", help=out)
    return p


@style(STYLE)
def draw_speeds(rows: Sequence[dict], path: Path, title: str) -> Path:
    """Draws speed of free swims against the slip ratio, a line for each frequency and depth.

    The slip axis is stretched towards 1.
    """
    figure, ((axis,),) = canvas(1, 1, (6, 4))
    lines = sorted({(row["frequency"], row["depth"]) for row in rows})
    slips = sorted({row["slip"] for row in rows})
    for i, line in enumerate(lines):
        here = sorted((row for row in rows if (row["frequency"], row["depth"]) == line), key=lambda row: row["slip"])
        label = f"{line[0]:g} Hz" + (f", {line[1]:g} m deep" if len({depth for _, depth in lines}) > 1 else "")
        places, speeds = [slips.index(row["slip"]) for row in here], [row["speed_m_s"] for row in here]
        axis.plot(places, speeds, marker="o", ms=4, lw=1.4, color=COLOURS[i % len(COLOURS)], label=label)
    axis.set_xticks(range(len(slips)), [f"{slip:g}" for slip in slips])
    axis.set(xlabel="slip ratio, at the paper's grid", ylabel="speed [m/s]", ylim=(0, None))
    axis.set_title(title, loc="left")
    axis.legend(frameon=False, fontsize=8)
    return save(figure, path)
