"""Runs the missing segments of a plan and keeps them as a data set: resumable, with progress and time left, within a budget.

Written in this order: the split, the segments one by one as they finish, the manifest. The same call continues an interrupted
one; a segment that exists, is complete and was made in the same way is not run again.

    fishmj hydro_fit collect --device cuda
    fishmj hydro_fit collect --device cuda:all
    fishmj hydro_fit collect --preview --out runs/preview
    fishmj hydro_fit collect --fish my_fish.toml --scale 0.2 --out runs/my_fish
    fishmj hydro_fit collect --ray auto --tanks 12
"""

import argparse
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from fishmj.base import console, interrupt
from fishmj.base.calib import OWN
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError, DatasetError, StoreError
from fishmj.base.store import Manifest, read_json, sha256, write_json
from fishmj.hydro_fit.campaign.data import plan as plans
from fishmj.hydro_fit.campaign.data.plan import CampaignPlan
from fishmj.hydro_fit.campaign.data.run_segments import Finished, Setup, on_device
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.hydro_fit.record import files, write_record
from fishmj.hydro_fit.segment_dataset import SEGMENTS, SPLIT, same_fish, split_hashes
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.fluid.guard import check_speed
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, PREVIEWS, Domain, preset
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, IN_WINDOW, REFERENCE, boundary_name, boundary_option, refuse_beside
from fishmj.lbm_oracle.run.spread import ray_device, spread
from fishmj.lbm_oracle.run.stability import SLOW
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

SCHEMA = "fishmj.campaign/1"
ON_GPU = 12  # tanks of two million cells that fill one
BOX, PREVIEW_BOX = "window", "laptop"  # where no data set says another
NARROWEST = 2.5  # cells across a hull; the second robot has 2.75 at 2 cm, and markers lie 0.7 of a cell inside each side
GO = "--budget SECONDS or --device cpu"  # begins what takes a CPU long


class Pool(Protocol):
    """Interface of a pool that runs segments: tanks in this process, or workers elsewhere."""

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        """Yields finished segments in any order; `go_on` and `waiting` as in `run_segments.side_by_side`."""


@dataclass(frozen=True)
class Local:
    """Tanks side by side on this machine: on the set-up's device in this process, or on several in one process each.

    tanks: number on each device. devices: their names; empty: the set-up's.
    """

    tanks: int = 1
    devices: tuple[str, ...] = ()

    def run(self, waiting: deque[Segment], setup: Setup, go_on: Callable[[float], bool]) -> Iterator[Finished]:
        """Yields finished segments in any order."""
        return spread(partial(on_device, setup=setup, tanks=self.tanks), waiting, self.devices or (setup.device,), go_on)


@dataclass(frozen=True)
class Collected:
    """Result of a call of `collect`; seconds of water, wall time, bytes of the whole data set."""

    folder: Path
    segments: int
    there: int  # before the call
    run: int
    missing: int
    stopped: dict[str, str]  # why segments ended early, by id
    lost: list[str]  # of these, the ones of which nothing sound was left
    recorded_s: float
    water_s: float  # run by this call
    wall_s: float
    bytes: int

    @property
    def complete(self) -> bool:
        """Returns True if no segment is missing."""
        return self.missing == 0


def collect(
    plan: CampaignPlan,
    out: str | Path,
    setup: Setup,
    *,
    pool: Pool | None = None,
    budget: float | None = None,
    retry: bool = False,
    quiet: bool = False,
) -> Collected:
    """Completes the data set in `out` to the plan; further episodes in it are kept.

    Args:
        budget: seconds of wall time after which it stops with the finished segments. retry: run stopped segments again.

    Raises:
        ConfigError: `out` holds segments of another fish, grid or solver, or a bus tick is no multiple of the time step.
        DatasetError: an episode would change its split. OracleUnstable: a segment could not be set up. StoreError: the disk
            refuses.
    """
    folder, began = Path(out), time.perf_counter()
    if budget is not None and not budget > 0:
        raise ConfigError(f"collect: budget = {budget} s; expected a positive time, or none")
    check_step(plan, setup.domain)
    left = missing(plan, folder, retry)
    about = _state_split(folder, plan, setup, adding=bool(left))
    if budget is not None:  # whatever it is cut down to spans the states
        wanted = {segment.id for segment in left}
        left = deque(segment for segment in plans.spanning(plan.segments) if segment.id in wanted)
    there, before, done = len(plan.segments) - len(left), 0.0, 0
    total = sum(segment.water for segment in left)
    with console.Progress(max(total, 1e-9), "collect", unit="s", every=1e9 if quiet else None) as bar:

        def go_on(water: float) -> bool:
            left = float("inf") if budget is None else began + budget - time.perf_counter()
            ends = {} if budget is None else {"ends_in": console.duration(max(left, 0.0))}
            bar.update(before + water, segments=there + done, of=len(plan.segments), **ends)
            return left > 0

        for finished in (pool or Local()).run(left, setup, go_on) if left else ():
            write_record(folder / SEGMENTS, finished.meta, finished.arrays)
            before, done = before + finished.segment.water, done + 1
            bar.update(before, segments=there + done, of=len(plan.segments))
    return _closed(folder, plan, about, there, done, before, time.perf_counter() - began)


def check_step(plan: CampaignPlan, domain: Domain) -> None:
    """Raises ConfigError or OracleUnstable for a time step with which a segment of the plan could not be set up."""
    tick = plan.robot.timing.bus_dt
    steps = max(1, round(tick / domain.dt))
    if abs(steps * domain.dt - tick) > 1e-9:
        what = f"the bus tick of {tick:g} s of {plan.robot.name} is no multiple of dt = {domain.dt:g} s of {domain.name}"
        raise ConfigError(f"collect: {what}; take --dt {tick / steps:.9g}")
    check_speed(domain.lattice, max([SLOW, *(segment.flow.speed for segment in plan.segments)]), f"collect: {domain.name}")


def warn_of_cells(robot: Robot, domain: Domain) -> None:
    """Warns once of a hull that is too narrow for the cells of the domain."""
    dx = domain.levels[-1].dx
    cells = max(width for link in robot.links for _, _, width in link.sections) / dx
    if cells < NARROWEST:
        told = f"{robot.name} is {cells:.2g} cells of {dx:g} m wide in {domain.name}, expected {NARROWEST:g} or more"
        console.warn_once(f"{told}: its forces will be wrong; take a --domain of smaller cells")


def missing(plan: CampaignPlan, folder: Path, retry: bool = False) -> deque[Segment]:
    """Segments of the plan that are not complete in the folder and made as planned.

    With `retry` also those that stopped early.
    """
    there = {segment.id: _about(folder, segment) for segment in plan.segments}
    return deque(s for s in plan.segments if (meta := there[s.id]) is None or (retry and meta.get("stopped")))


def _closed(folder: Path, plan: CampaignPlan, about: dict, there: int, run: int, water: float, wall: float) -> Collected:
    """Writes the manifest, and returns the content of the data set."""
    kept = {s.id: meta for s in plan.segments if (meta := _about(folder, s)) is not None}
    stopped = {name: meta["stopped"] for name, meta in kept.items() if meta.get("stopped")}
    missing = len(plan.segments) - len(kept)
    notes = {
        "schema": SCHEMA,
        "origin": "synthetic",
        "licence": "Apache-2.0",
        "source": "fishmj.campaign",
        "complete": not missing,
    }
    notes |= {"label": plan.label, "seed": plan.seed, "missing": missing, **about}
    Manifest.of(folder, notes).write(folder)
    return Collected(
        folder=folder,
        segments=len(plan.segments),
        there=there,
        run=run,
        missing=missing,
        stopped=stopped,
        lost=sorted(name for name in stopped if "file" not in kept[name]),
        recorded_s=sum(meta["seconds"] for meta in kept.values() if "file" in meta),
        water_s=water,
        wall_s=wall,
        bytes=sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()),
    )


def _state_split(folder: Path, plan: CampaignPlan, setup: Setup, adding: bool) -> dict:
    """Writes the split of the episodes before the first run; returns fish, grid and solver of the data set.

    Raises:
        DatasetError: an episode would change its split. ConfigError: the folder is of another fish or grid, or segments of
            another solver would be added (a complete data set stays as it is).
    """
    path, about = folder / SPLIT, setup.about
    before = read_json(path) if path.is_file() else {"episodes": {}, "plans": [], **about}
    try:
        episodes, plans, made = dict(before["episodes"]), list(before["plans"]), {key: before[key] for key in about}
    except (TypeError, KeyError, ValueError) as error:
        raise DatasetError(f"{path}: {error!r}; expected episodes, plans, robot and grid. Take another folder") from error
    same_fish(made["robot"], setup.robot, folder)
    for key, value in about.items():
        if made[key] != value and (adding or key != "solver"):
            raise ConfigError(f"{folder} holds segments of another {key}: {made[key]} (now {value}). Take another folder")
    moved = [
        f"{name}: expected {episodes[name]}, got {split}"
        for name, split in plan.episodes.items()
        if episodes.get(name, split) != split
    ]
    if moved:
        raise DatasetError(f"{path}: episodes would change their split: {', '.join(moved[:5])}; take another folder")
    episodes |= plan.episodes
    row = {"label": plan.label, "seed": plan.seed, "segments": len(plan.segments), "split_sha256": plan.split_sha256}
    table = {"episodes": dict(sorted(episodes.items())), "sha256": split_hashes(episodes), **made}
    write_json(path, table | {"plans": [old for old in plans if old != row] + [row]})
    return made


def _about(folder: Path, segment: Segment) -> dict | None:
    """Description of an existing segment that was made as planned, else None."""
    path, about = files(folder / SEGMENTS, segment.id)
    if not about.is_file():
        return None
    try:
        meta = read_json(about)
        made = Segment.of(meta["segment"])
    except (StoreError, TypeError, KeyError):
        return None  # damaged: run again
    if made.sha256 != segment.sha256:
        return None
    whole = "file" not in meta or path.is_file() and sha256(path) == meta["file"]["sha256"]
    return meta if whole else None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of `collect`; `--json` is the caller's."""
    add = parser.add_argument
    add("--fish", type=console.text, default="fish", metavar="NAME|FILE", help="description of the robot")
    place = "data set to write, or to continue when it is there; data/hydro/<fish>[-...] by default"
    add("--out", "--data", type=console.out_folder, metavar="FOLDER", help=place)
    scale = console.number(0, 100, above=True)
    add("--scale", type=scale, default=1.0, metavar="X", help="as many times the episodes; 1 is the whole campaign")
    parser.add_argument("--preview", action="store_true", help="two minutes of water on the small coarse box, for a CPU")
    fresh = "new test episodes and nothing else; by default those of the campaign"
    add("--fresh-test", type=console.whole(1, 2**32 - 1), metavar="SEED", help=fresh)
    same = f"all segments in the reference water: {REFERENCE.window}, slip {REFERENCE.slip:g}, its boundary; default: no"
    add("--reference", action="store_true", help=same)
    boundary_option(add, default=None)
    slip = "only segments of this slip ratio; may be repeated; by default all"
    add("--slip", type=console.number(0, 1), action="append", default=[], metavar="S", help=slip)
    fixed = "all segments at this slip ratio, for a water of its own; default: those of the plan"
    add("--all-at-slip", type=console.number(0, 1), metavar="S", help=fixed)
    add("--seed", type=console.SEED, default=0, help="of the draws")
    steers = "what steers on-policy episodes; may be repeated; by default the shipped policies that are made for the fish"
    add("--policy", type=console.text, action="append", default=[], metavar="NAME|FILE", help=steers)
    domain = f"box of water, _refined: finer round the fish; default: the data set's, else {BOX}, with --preview {PREVIEW_BOX}"
    add("--domain", choices=EVERY, help=domain)
    dt = "another time step; by default the data set's, else the domain's"
    add("--dt", type=console.number(1e-5, 0.02), metavar="S", help=dt)
    add("--device", type=console.devices, default="auto", help=console.DEVICES_HELP)
    tanks = f"segments side by side on each device; by default {ON_GPU} on a GPU, else 1"
    add("--tanks", type=console.whole(1, 256), metavar="N", help=tanks)
    ray = "run on a Ray cluster: an address, auto, or local:N for N workers here; by default without one"
    add("--ray", type=console.text, metavar="ADDRESS", help=ray)
    budget = "wall time after which no segment is begun; by default none; what is finished then is kept"
    add("--budget", type=console.number(0, 1e7), metavar="SECONDS", help=budget)
    parser.add_argument("--retry", action="store_true", help="run segments that stopped early again")
    parser.add_argument("--dry-run", action="store_true", help="print plan, folder, box and cost, for any device, and stop")


def run(args: argparse.Namespace) -> int:
    """Collects; exit code 0 if the data set is complete, 1 if segments are missing or one had nothing sound."""
    robot = load_robot(args.fish)
    if args.reference:
        slip = args.slip[0] if args.slip else None
        refuse_beside("collect", IN_WINDOW, domain=args.domain, slip=slip, boundary=args.boundary)
        args.domain = IN_WINDOW.domain
    edge = REFERENCE.sharpness if args.reference else BOUNDARIES[args.boundary or "plain"]
    plan = plan_of(args, robot)
    if edge.law_height is not None and any(segment.slip != 1 for segment in plan.segments):
        raise ConfigError(f"collect: slip ratios beside --boundary {args.boundary}, which sets them; take --all-at-slip 1")
    out = Path(args.out) if args.out else default_folder(plan)
    domain = domain_of(args, out)
    check_step(plan, domain)
    warn_of_cells(robot, domain)
    if args.dry_run:  # here, for whatever machine
        if (out / SPLIT).is_file():
            same_fish(read_json(out / SPLIT).get("robot", {}), robot, out)
        say_plan(plan, robot, domain)
        say_cost(plan, out, domain, boundary_name(edge), args)
        return console.OK
    console.out_folder(str(out))
    if not args.ray:
        water = sum(segment.water for segment in missing(plan, out, args.retry))
        less = "take a smaller --scale, --domain laptop, --ray elsewhere, or --preview for a little"
        asked: dict[str, Any] = {"instead": less, "flag": GO, "asked": args.budget is not None}
        solver_cost.agree("hydro_fit collect", args.device, [(domain, water)], tanks=args.tanks or 1, **asked)
    devices = (ray_device(args.device),) if args.ray else devices_of(args.device)
    setup = Setup(robot=robot, domain=domain, device=devices[0], sharpness=edge)
    say_plan(plan, robot, domain)
    more = f"{out} holds every segment that was finished; {interrupt.again()}"
    with interrupt.keeping(lambda: more):
        found = collect(plan, out, setup, pool=pool_of(args, devices), budget=args.budget, retry=args.retry, quiet=args.json)
    report(found)
    if args.json:
        console.emit_json({**asdict(found), "complete": found.complete})
    return console.OK if found.complete and not found.lost else console.FAILED_CHECK


def say_plan(plan: CampaignPlan, robot: Robot, domain: Domain) -> None:
    """Prints the plan by blocks, and what it lacks."""
    what = f"{len(plan.segments)} segments, {plan.water:.0f} s of water for {robot.name}"
    console.say(f"{plan.label}: {what}", console.table(plan.rows()))
    if domain.name in PREVIEWS:
        console.say(f"{domain.name} is a preview: dx = {domain.dx} m is too coarse for a judgement")
    if not any(segment.block == "policy" for segment in plan.segments):
        console.say(f"no shipped controller is made for {robot.name}: no on-policy episodes; name one with --policy")


def say_cost(plan: CampaignPlan, out: Path, domain: Domain, boundary: str, args: argparse.Namespace) -> None:
    """Prints where the segments of the plan go, and what those that are missing there cost."""
    left = missing(plan, out, args.retry)
    water = sum(segment.water for segment in left)
    place = {"out": str(out), "domain": domain.name, "boundary": boundary}
    words = ", ".join(f"{key} {value}" for key, value in place.items())
    takes = f"about {console.duration(solver_cost.cpu_seconds([(domain, water)]))} on {usable_cores()} idle cores without a GPU"
    console.say(f"{words}: {len(left)} segments to solve, {water:.0f} s of water; {takes}")
    if args.json:
        told = {"plan": plan.label, "water_s": plan.water, "left_s": water, "blocks": plan.rows(), **place}
        console.emit_json(told | {"split_sha256": plan.split_sha256})


def main(argv: list[str]) -> int:
    """Runs the verb by itself."""
    parser = console.parser("hydro_fit collect", __doc__)
    add_arguments(parser)
    return run(parser.parse_args(argv))


def plan_of(args: argparse.Namespace, robot: Robot) -> CampaignPlan:
    """Plan that the options select.

    Raises ConfigError: two kinds of plan at once; a slip ratio that no segment has; --all-at-slip beside another ratio.
    """
    if args.preview and args.fresh_test is not None:
        raise ConfigError("collect: --preview and --fresh-test are two plans; choose one")
    if args.preview:
        plan = plans.preview(robot, seed=args.seed, policies=args.policy)
    elif args.fresh_test is not None:
        plan = plans.fresh_test(robot, seed=args.fresh_test, policies=args.policy, scale=args.scale)
    else:
        plan = plans.full(robot, seed=args.seed, scale=args.scale, policies=args.policy)
    if args.all_at_slip is not None and (args.reference or args.slip):
        other = "--reference" if args.reference else "--slip"
        raise ConfigError(f"collect: --all-at-slip {args.all_at_slip:g} beside {other}; leave one of them out")
    slip = REFERENCE.slip if args.reference else args.all_at_slip
    plan = plan if slip is None else plan.moved_to(slip)
    return plan.at(args.slip) if args.slip else plan


def domain_of(args: argparse.Namespace, out: Path) -> Domain:
    """Domain of the option, else that of the continued data set, else `BOX` or, for a preview, `PREVIEW_BOX`."""
    if args.domain is None and (out / SPLIT).is_file():
        domain = domain_there(out)
    else:
        domain = preset(args.domain or (PREVIEW_BOX if args.preview else BOX))
    return domain if args.dt is None else domain.changed(dt=args.dt)


def domain_there(folder: Path) -> Domain:
    """Domain and time step of an existing data set. Raises DatasetError: its metadata lack them."""
    path = folder / SPLIT
    try:
        grid = read_json(path)["grid"]
        return preset(grid["domain"]).changed(dt=float(grid["dt"]))
    except (TypeError, KeyError, ValueError) as error:
        raise DatasetError(f"{path}: {error!r}; expected a grid with domain and dt. Take another folder") from error


def default_folder(plan: CampaignPlan) -> Path:
    """Folder data/hydro/<fish> for the whole campaign; a separate one for any other plan."""
    suffix = "" if plan.label == "full" else "-" + plan.label.replace(",", "").replace(" ", "-")
    return OWN / "hydro" / f"{plan.robot.name}{suffix}"


def tanks_on(device: str, asked: int | None = None) -> int:
    """Number of tanks side by side: as asked, else those that fill a GPU, and one on a CPU."""
    return asked or (ON_GPU if device.startswith("cuda") else 1)


def pool_of(args: argparse.Namespace, devices: tuple[str, ...]) -> Pool:
    """Pool of tanks here, or of workers of a Ray cluster."""
    tanks = tanks_on(devices[0], args.tanks)
    if args.ray:
        from fishmj.hydro_fit.campaign.data.ray_pool import RayPool

        return RayPool(args.ray, tanks=tanks)
    return Local(tanks, devices)


def report(found: Collected) -> None:
    """Prints a summary."""
    rate = f" ({found.bytes / found.recorded_s / 1e3:.1f} kB/s)" if found.recorded_s else ""
    console.say(
        f"{found.folder}: {found.segments - found.missing} of {found.segments} segments, {found.recorded_s:.0f} s recorded,"
        f" {found.bytes / 1e6:.2f} MB{rate};"
        f" {found.run} run now: {found.water_s:.0f} s of water in {console.duration(found.wall_s)}"
    )
    for name, why in found.stopped.items():
        kept = "nothing was sound" if name in found.lost else "kept as far as it was sound"
        console.warn(f"{name} stopped, {kept}: {why}")
    if found.missing:
        console.warn(f"{found.missing} segments are missing; the same command goes on with them")
