"""`fishmj lbm_oracle real_fish`: the slip ratio at which the solver's fish swims as a real one did, and how well it predicts it.

python -m fishmj.lbm_oracle real_fish --domain window_coarse_refined --device cuda --tanks 12 --out runs/real
python -m fishmj.lbm_oracle real_fish --device cuda:all --tanks 12 --out runs/real           on all GPUs of this machine
python -m fishmj.lbm_oracle real_fish --domain laptop --slips 0.98 --beats 5 --swims 2 --out runs/preview

A tendon-driven fish was filmed from above at eight constant motor frequencies (data/calib/calibrate.toml, [real_fish]). The
solver's fish, with the joint angles of the filmed markers, swims from rest in still water; the last two beats count. Four of the
swims set s; the other four only judge it:

    J(s) = sum over the four of ln(u(s) / measured)^2,     ln u(s) monotone between the ratios that were swum

With `--robot` another fish of two joints makes the filmed movements. Its speeds are not compared, and no slip ratio is set: the
speed of that robot was not measured.

`low` and `high`: the least and the greatest s if one of the four is left out. Each finished swim is a row of `real_fish.csv`. The
same command does the missing swims; another set-up in the same folder is refused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import ConfigError, LogError
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, PREVIEWS, preset
from fishmj.lbm_oracle.run.finished_rows import OK, FinishedRows, keep_rows
from fishmj.lbm_oracle.run.run import Run, TankRun
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, boundary_entry, cell_option, study_options, study_slips
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, side_by_side
from fishmj.mjcf import load_robot

SLIPS = (0.6, 0.8, 0.9, 0.96, 0.98, 0.99)
BEATS = 12.0
LAST = 2  # beats that count
STEPS = 4001  # of s, between the least and the greatest that were swum
COLUMNS = ("beat_hz", "slip", "speed_m_s", "gain_a_beat", "status")


class RealSwim(NamedTuple):
    """A filmed swim: beat [Hz], amplitude of tail and fin [rad], lag of the fin [rad], speed [m/s]; `sets`: it sets s."""

    beat: float
    amplitude: tuple[float, float]
    lag: float
    speed: float
    sets: bool

    @property
    def gait(self) -> Gait:
        """Gait of the two joints."""
        return Gait(joints=2, frequency=self.beat, amplitude=self.amplitude, lag=self.lag)


class SlipFit(NamedTuple):
    """s, its range when one swim is left out, root mean square of ln(u / measured) over the swims that set it and the others."""

    slip: float
    low: float
    high: float
    misfit: float
    judged: float | None
    speeds: dict[float, float]  # beat Hz -> m/s at s


def swims() -> list[RealSwim]:
    """The filmed swims, slow ones first."""
    table = read_toml(resolve("calibrate"))["real_fish"]
    columns = (table[name] for name in ("beat_hz", "tail_deg", "fin_deg", "lag_deg", "speed", "sets"))
    return [
        RealSwim(beat, (radians(tail), radians(fin)), radians(lag), speed, sets)
        for beat, tail, fin, lag, speed, sets in zip(*columns, strict=True)
    ]


def fit_slip(real: Sequence[RealSwim], swum: dict[tuple[float, float], float]) -> SlipFit:
    """The slip ratio from the swims that set it. swum: (beat Hz, slip) -> m/s.

    Raises LogError: fewer than three ratios of one of the swims.
    """
    found = {swim.beat: sorted((s, u) for (beat, s), u in swum.items() if beat == swim.beat and u > 0) for swim in real}
    for swim in real:
        if len(found[swim.beat]) < 3:
            raise LogError(f"real_fish: {len(found[swim.beat])} slip ratios at {swim.beat:g} Hz; expected three or more")
    low, high = max(rows[0][0] for rows in found.values()), min(rows[-1][0] for rows in found.values())
    s = np.linspace(low, high, STEPS)
    off = {swim.beat: _logarithm(found[swim.beat], s) - np.log(swim.speed) for swim in real}
    setting, others = ([swim.beat for swim in real if swim.sets == sets] for sets in (True, False))
    best = lambda beats: int(np.argmin(sum(off[beat] ** 2 for beat in beats)))
    at = best(setting)
    without = [s[best([beat for beat in setting if beat != left])] for left in setting] if len(setting) > 1 else [s[at]]
    rms = lambda beats: float(np.sqrt(np.mean([off[beat][at] ** 2 for beat in beats])))
    speeds = {swim.beat: float(swim.speed * np.exp(off[swim.beat][at])) for swim in real}
    return SlipFit(float(s[at]), float(min(without)), float(max(without)), rms(setting), rms(others) if others else None, speeds)


def _logarithm(rows: list[tuple[float, float]], s: np.ndarray) -> np.ndarray:
    """ln u at s, interpolated monotonically between the simulated ratios."""
    from scipy.interpolate import PchipInterpolator

    slip, speed = np.array(rows).T
    return PchipInterpolator(slip, np.log(speed))(s)


def speed_of(run: Run, beat: float) -> tuple[float, float]:
    """Speed over the last two beats, m/s, and its relative gain in the last beat over the one before."""
    tick = run.robot.timing.bus_dt
    place = np.array([run.first[:2], *(row[3][:2] for row in run.rows)])
    way = lambda last, beats: place[-1 - round(last / beat / tick)] - place[-1 - round((last + beats) / beat / tick)]
    now, before = (float(np.hypot(*way(last, LAST))) / (LAST / beat) for last in (0, LAST))
    return now, (now / before - 1) / LAST if before > 0 else float("nan")


def run_swims(
    waiting: Waiting, device: str, go_on: GoOn, *, stage: SwimSetup, beats: float, tanks: int
) -> Iterator[tuple[tuple[float, float], dict]]:
    """Yields key and row of each swim as it ends; arguments as `side_by_side`.

    waiting: swims and slip ratios. stage: their water.
    """

    def start(key: tuple[RealSwim, float]) -> TankRun:
        swim, slip = key
        run = replace(stage, slip=slip, device=device).run(prescribed=swim.gait)
        tick = run.robot.timing.bus_dt

        def row(run: Run) -> tuple[tuple[float, float], dict]:
            enough = run.ticks * tick * swim.beat > 2 * LAST
            speed, gain = speed_of(run, swim.beat) if enough else (float("nan"), float("nan"))
            status = " ".join(run.stopped.split()) or OK
            return (swim.beat, slip), {"speed_m_s": speed, "gain_a_beat": gain, "status": status}

        return TankRun(run, round(beats / swim.beat / tick), row)

    return side_by_side(waiting, start, tanks=tanks, go_on=go_on)


def _robot() -> str:
    return read_toml(resolve("calibrate"))["real_fish"]["robot"]


def main(argv: list[str]) -> int:
    """Runs the verb `real_fish`; returns its exit code."""
    args = _parser().parse_args(argv)
    args.slips = study_slips("lbm_oracle real_fish", args.slips, args.boundary, SLIPS)
    domain = preset(args.domain).changed(dx=args.dx)
    real = [swim for swim in swims() if args.which == "all" or swim.sets == (args.which == "setting")][-args.swims :]
    if args.beats <= 2 * LAST:
        raise ConfigError(f"real_fish: --beats {args.beats:g}; expected more than {2 * LAST}: the last {LAST} count")
    robot, filmed = load_robot(args.robot or _robot()), load_robot(_robot())
    if robot.n_joints != filmed.n_joints:
        raise ConfigError(
            f"real_fish: {robot.name} has {robot.n_joints} joints; the swims were filmed of {filmed.name} with {filmed.n_joints}."
            " For another fish take lbm_oracle swim or speeds"
        )
    same = robot == filmed
    setup = {"domain": domain.name, "dx": domain.dx, "beats": args.beats, "robot": robot.name}
    setup |= {} if same or robot.name != filmed.name else {"robot": f"{robot.name}, changed"}
    setup |= boundary_entry(BOUNDARIES[args.boundary])
    book = FinishedRows(Path(args.out) / "real_fish.csv", COLUMNS, 2, setup, "real_fish")
    left = [(swim, slip) for swim in real for slip in args.slips if (swim.beat, slip) not in book.rows]
    water = sum(args.beats / swim.beat for swim, _ in left)
    less = "take fewer --slips, --swims or --beats; --domain laptop is a preview"
    work = [(domain, water)] if left else []
    solver_cost.agree("lbm_oracle real_fish", args.device, work, instead=less, tanks=min(args.tanks, max(len(left), 1)))
    if domain.name in PREVIEWS:
        console.say(f"{domain.name} is a preview: dx = {domain.dx} m is too coarse for a judgement")
    console.say(f"{len(left)} swims to do, {water:.0f} s of water, in {args.out}")
    stage = SwimSetup(domain=domain, robot=args.robot or _robot(), sharpness=BOUNDARIES[args.boundary])
    swimming = partial(run_swims, stage=stage, beats=args.beats, tanks=args.tanks)
    keep_rows(book, swimming, left, devices_of(args.device), water, lambda key: args.beats / key[0], "real_fish", args.json)
    rows = [book.rows[swim.beat, slip] for swim in real for slip in args.slips]
    lost = [row for row in rows if row["status"] != OK]
    console.say(console.table(rows, COLUMNS))
    for row in lost:
        console.warn(f"{row['beat_hz']:g} Hz, slip {row['slip']:g}: {row['status']}")
    answer: dict[str, Any] = {"rows": rows, "csv": book.path, "domain": domain.name, "dx": domain.body_level.dx}
    answer["boundary"] = args.boundary
    if not same:
        console.say("", f"{robot.name} is not the fish that was filmed ({filmed.name}): its speeds are not compared")
    if same and len(args.slips) >= 3 and any(swim.sets for swim in real):
        fit = fit_slip(real, {(row["beat_hz"], row["slip"]): row["speed_m_s"] for row in rows if row["status"] == OK})
        table = [
            {"beat_hz": w.beat, "sets s": "yes" if w.sets else "no", "measured_m_s": w.speed, "solver_m_s": fit.speeds[w.beat],
             "off": fit.speeds[w.beat] / w.speed - 1}
            for w in real
        ]  # fmt: skip
        console.say("", console.table(table), "", f"slip {fit.slip:.4f} ({fit.low:.4f} to {fit.high:.4f}), cells of"
                    f" {1e3 * domain.body_level.dx:g} mm at the fish; off by {100 * fit.misfit:.0f} % rms on the swims that set"
                    f" it{'' if fit.judged is None else f', {100 * fit.judged:.0f} % on the others'}")  # fmt: skip
        answer |= {"slip": fit._asdict(), "swims": table}
    if args.json:
        console.emit_json(answer)
    return console.FAILED_CHECK if lost else console.OK


def _parser() -> console.Parser:
    about = "Slip ratio of a real fish's hull on one grid, by four of its swims; four more judge."
    p = console.parser("lbm_oracle real_fish", about)
    add = p.add_argument
    add("--domain", choices=EVERY, default="window_coarse_refined", help="box of water; laptop is a preview")
    add("--robot", type=console.text, help="shipped name or TOML file with two joints; by default the fish that was filmed")
    cell_option(add)
    study_options(add, SLIPS)
    add("--beats", type=console.number(0, 1000, above=True), default=BEATS, help="of each swim; the last two count")
    add("--which", choices=("all", "setting", "judging"), default="all", help="those that set the slip ratio, or the others")
    add("--swims", type=console.whole(1, 8), default=8, metavar="N", help="only the N fastest of them")
    add("--tanks", type=console.whole(1, 256), default=1, help="swims side by side on each device; 12 keep a GPU busy; default 1")
    out = "real_fish.csv; continues what is there"
    add("--out", type=console.out_folder, default="runs/real_fish", metavar="FOLDER", help=out)
    return p
