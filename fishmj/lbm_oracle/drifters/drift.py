"""`fishmj lbm_oracle drift`: passive markers in a turbulent current, the paper's characterisation of its flow tank.

python -m fishmj.lbm_oracle drift --device cuda --out runs/drift
python -m fishmj.lbm_oracle drift --water flow --n 210 --out runs/drift_flow

Markers are released one after another at the same place upstream, two integral lengths of water apart, so that each meets its own
eddies as in repeated drifts of one marker. `--water lbm` carries them in the solver's velocity field, `--water flow` in the
prescribed flow itself. The water moves to +x; the markers stay at mid-depth, the plane of the planar waters.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, OracleUnstable
from fishmj.base.figures import canvas, save, style
from fishmj.base.store import write_json, write_text
from fishmj.lbm_oracle.drifters.tracers import Release, Sampler, carry, figures, trilinear
from fishmj.lbm_oracle.fluid.fluid import Fluid, blend_at
from fishmj.lbm_oracle.output.slice_plots import STYLE
from fishmj.lbm_oracle.run import solver_cost, stability
from fishmj.lbm_oracle.run.domain import NAMES, Domain, preset
from fishmj.lbm_oracle.run.solver_water import cell_option
from fishmj.water.flow import LENGTH, PRESETS, Flow

TICK: float = constant("timing", "bus_dt")  # s between two looks at the water
EVERY = 5  # ticks between two rows of the CSV
MARGIN = 0.05  # of the box's length: beyond the sponge, no drift is read
WIDTH = 0.04  # m, of a marker: one cell of the prescribed flow and two of the paper's grid
PATIENCE = 3.0  # times the mean passage: a drift that takes longer has met a wall of still water


def main(argv: list[str]) -> int:
    """Runs the verb `drift`; returns its exit code."""
    args = _parser().parse_args(argv)
    domain = preset(args.domain).changed(dx=args.dx)
    flow = Flow(speed=args.speed, turbulence=args.turbulence, intensity=args.intensity, seed=args.seed)
    release = release_markers(domain, flow, n=args.n, seconds=args.seconds, interval=args.interval, width=args.spin_box)
    settle = domain.size[0] / flow.speed if args.settle is None else args.settle
    if not settle >= 0:
        raise ConfigError(f"drift: settle = {settle} s; expected 0 or more")
    end = release.times[-1] + release.longest
    if args.water == "lbm":
        less = "take fewer markers by --n, a coarser --dx; --water flow has no solver, --domain laptop is a preview"
        solver_cost.agree("lbm_oracle drift", args.device, [(domain, settle + end)], instead=less)
        looks = in_solver(domain, flow, settle=settle, end=end, device=args.device)
    else:
        looks = in_flow(flow, end=end)
    with console.Progress(end, f"drift ({args.water})", unit="s", every=1e9 if args.json else None) as bar:
        stopped: list[str] = []
        tracks = carry(_with_progress(looks, bar, stopped), release)
    found = figures(tracks) | {"water": args.water, "speed": args.speed, "turbulence": args.turbulence}
    found |= {"intensity": args.intensity, "seed": args.seed, "interval_s": release.times[1] if args.n > 1 else 0.0}
    found |= {"marker_width_m": release.width, "origin": "synthetic", "stopped": stopped[0] if stopped else ""}
    out = Path(args.out)
    title = f"{len(tracks)} drifts, {args.speed:g} m/s, {args.turbulence}, TI {100 * args.intensity:g} %, {args.water}"
    write_text(out / f"drift_{args.water}.csv", as_csv(tracks))
    write_json(out / f"drift_{args.water}.json", found)
    draw_tracks(tracks, out / f"drift_{args.water}.png", title)
    console.say(console.table([{"figure": name, "value": value} for name, value in found.items()]))
    if args.json:
        console.emit_json(found | {"out": out})
    if stopped:
        return console.FAILED_CHECK
    if found["distance_m"] < 2 * LENGTH.get(args.turbulence, 0.0):
        console.warn(f"drifts of {found['distance_m']:.2f} m are shorter than two eddies: too short to tell; raise --seconds")
        return console.CANNOT_TELL
    return console.OK


def release_markers(
    domain: Domain, flow: Flow, *, n: int, seconds: float | None, interval: float | None, width: float
) -> Release:
    """Release of n markers from the middle of the upstream end of the box, each two integral lengths of water after the other.

    Raises ConfigError: no markers, no current, a marker finer than a cell or wider than the margin.
    """
    edge = domain.sponge * domain.dx + MARGIN * domain.size[0]
    half = [(cells - 1) / 2 * domain.dx - edge for cells in domain.shape[:2]]
    if min(half) <= 0:
        raise ConfigError(f"drift: a box of {domain.size} m has no room inside its sponge of {edge:.2f} m; take a larger domain")
    if n < 1 or not flow.speed > 0:
        raise ConfigError(f"drift: n = {n}, speed = {flow.speed} m/s; expected markers and a current that carries them")
    if not domain.dx <= width <= 2 * edge:
        raise ConfigError(f"drift: spin-box = {width} m; expected {domain.dx:g} to {2 * edge:g} m (a cell to twice the margin)")
    apart = 2 * LENGTH.get(flow.turbulence, 0.0) / flow.speed if interval is None else interval
    if not apart >= 0:
        raise ConfigError(f"drift: interval = {apart} s; expected 0 or more")
    apart = round(apart / TICK) * TICK
    longest = PATIENCE * 2 * half[0] / flow.speed if seconds is None else seconds
    times = tuple(i * apart for i in range(n))
    low, high = (-half[0] - width, -half[1]), (half[0], half[1])
    return Release(times=times, start=(-half[0], 0.0, 0.0), low=low, high=high, longest=longest, width=width)


def in_solver(domain: Domain, flow: Flow, *, settle: float, end: float, device: str = "cpu") -> Iterator[tuple[float, Sampler]]:
    """Yields time and water of the solver after `settle` s, every tick until `end` s; there is no fish and the box does not move.

    Raises OracleUnstable: the set-up would not run, or the water is not finite.
    """
    stability.check(domain, speed=max(flow.speed, stability.SLOW))
    steps = round(TICK / domain.dt)
    if steps < 1 or abs(steps * domain.dt - TICK) > 1e-9:
        raise ConfigError(f"drift: the tick of {TICK} s is no multiple of dt = {domain.dt:g} s; take another domain or dx")
    blend = blend_at(domain.lattice)
    water = Fluid(domain.lattice, domain.shape, device, boundaries=domain.boundaries, flow=flow, blend=blend)
    water.run(round(settle / TICK) * steps)
    for tick in range(round(end / TICK) + 1):
        yield tick * TICK, trilinear(water.velocity(), domain.lattice, water.origin_lu)
        water.run(steps)


def in_flow(flow: Flow, *, end: float) -> Iterator[tuple[float, Sampler]]:
    """Yields time and the prescribed flow itself at the same ticks."""
    for tick in range(round(end / TICK) + 1):
        yield tick * TICK, partial(flow.at, t=tick * TICK)


def as_csv(tracks: list[np.ndarray]) -> str:
    """CSV text: marker, t since the first release s, x m, y m, heading rad; ten rows a second and the last."""
    lines = ["marker,t,x,y,heading"]
    for i, track in enumerate(tracks):
        kept = sorted({*range(0, len(track), EVERY), len(track) - 1})
        lines += [f"{i},{t:.2f},{x:.5f},{y:.5f},{turn:.5f}" for t, x, y, turn in track[kept]]
    return "\n".join(lines) + "\n"


def _with_progress(looks, bar, stopped: list[str]):
    """Yields the samples of the water with progress; water that fails ends them, with the reason in `stopped`."""
    t = None
    try:
        for t, water in looks:
            yield t, water
            bar.update(t)
    except OracleUnstable as error:
        if t is None:  # not even the first look: a set-up that cannot run
            raise
        stopped.append(str(error))
        console.warn(f"stopped after {t:.2f} s, the drifts until then are kept: {error}")


def _parser() -> console.Parser:
    p = console.parser("lbm_oracle drift", "Passive markers in a turbulent current: tracks, headings, spread.")
    add, seconds = p.add_argument, console.number(0, 100_000)
    add("--n", type=console.whole(1, 10_000), default=int(constant("tank", "drifts")), help="markers, one after another")
    add("--speed", type=console.number(0, 4, above=True), default=0.2, help="of the current, m/s")
    add("--turbulence", choices=PRESETS, default="default", help="of the current")
    intensity = constant("turbulence", "intensity")
    add("--intensity", type=console.number(0, 0.99), default=intensity, help="of the turbulence: u_rms / max(speed, 0.1 m/s)")
    add("--seed", type=console.SEED, default=0, help="of the turbulence")
    add("--seconds", type=seconds, metavar="S", help="longest drift; by default three times the mean passage")
    add("--interval", type=seconds, metavar="S", help="between releases; by default two integral lengths of water")
    add("--settle", type=seconds, metavar="S", help="before the first release; by default one passage of the box")
    width = "width of a marker: its spin is averaged across it"
    add("--spin-box", type=console.number(0, 10, above=True), default=WIDTH, metavar="M", help=width)
    add("--water", choices=("lbm", "flow"), default="lbm", help="the solver, or the prescribed flow itself")
    add("--domain", choices=NAMES, default="flow_tank", help="box of water; laptop is a preview")
    cell_option(add)
    add("--device", type=console.device, default="auto", help=console.DEVICE_HELP)
    out = "CSV, JSON and picture; those that are there are replaced"
    add("--out", type=console.out_folder, default="runs/drift", metavar="FOLDER", help=out)
    return p


@style(STYLE)
def draw_tracks(tracks: Sequence[np.ndarray], path: Path, title: str) -> Path:
    """Tracks (T, 4) of t s, x m, y m, heading rad: seen from above, and heading against time since release."""
    from matplotlib import colormaps

    figure, ((above, turn),) = canvas(1, 2, (11, 4.2))
    for i, track in enumerate(tracks):
        colour = colormaps["viridis"](i / max(len(tracks) - 1, 1))
        above.plot(track[:, 1], track[:, 2], color=colour, lw=1)
        turn.plot(track[:, 0] - track[0, 0], np.degrees(track[:, 3]), color=colour, lw=1)
    above.set(xlabel="x [m]", ylabel="y [m]", title=title)
    above.set_aspect("equal", adjustable="datalim")
    for limit in (-360.0, 360.0):
        turn.axhline(limit, color="#B3392F", lw=0.8, ls="--")
    turn.set(xlabel="time since release [s]", ylabel="heading [deg]", title="dashed: one full turn")
    return save(figure, path)
