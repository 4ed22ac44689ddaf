"""The command line of the campaign, for whoever offers it as a verb: `add_arguments(parser)` and `run(args)`.

python -m fishmj.hydro_fit collect --device cuda
python -m fishmj.hydro_fit collect --preview --out runs/preview
python -m fishmj.hydro_fit collect --fish my_fish.toml --scale 0.2 --out runs/my_fish
python -m fishmj.hydro_fit collect --ray auto --tanks 12
"""

import argparse
from dataclasses import asdict
from pathlib import Path

from fishmj import console, interrupt
from fishmj.campaign.data import plan as plans
from fishmj.campaign.data.collect import Collected, Local, Pool, collect, missing
from fishmj.campaign.data.plan import Plan
from fishmj.campaign.data.run_segments import Setup
from fishmj.errors import ConfigError
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import NAMES, PREVIEWS, preset
from fishmj.mjcf.description import Robot, load_robot

ON_GPU = 12  # tanks of two million cells that fill one
GO = "--budget SECONDS or --device cpu"  # begins what takes a CPU long


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `collect`; `--json` is the caller's."""
    add = parser.add_argument
    add("--fish", type=console.text, default="fish", metavar="NAME|FILE", help="description of the robot")
    add(
        "--out",
        "--data",
        type=console.out_folder,
        metavar="FOLDER",
        help="data set to write, or to continue when it is there; data/hydro/<fish>[-...] by default",
    )
    scale = console.number(0, 100, above=True)
    add("--scale", type=scale, default=1.0, metavar="X", help="as many times the episodes; 1 is the whole campaign")
    parser.add_argument("--preview", action="store_true", help="two minutes of water on the small coarse box, for a CPU")
    fresh = "new test episodes and nothing else; by default those of the campaign"
    add("--fresh-test", type=console.whole(1, 2**32 - 1), metavar="SEED", help=fresh)
    slip = "only segments of this slip ratio; may be repeated; by default all"
    add("--slip", type=console.number(0, 1), action="append", default=[], metavar="S", help=slip)
    add("--seed", type=console.SEED, default=0, help="of the draws")
    steers = "what steers on-policy episodes; may be repeated; by default the shipped policies that are made for the fish"
    add("--policy", type=console.text, action="append", default=[], metavar="NAME|FILE", help=steers)
    add("--domain", choices=NAMES, help="box of water; by default window, laptop with --preview")
    add("--dt", type=console.number(1e-5, 0.02), metavar="S", help="another time step; by default the domain's")
    add("--device", type=console.device, default="auto", help="auto, cpu, cuda or cuda:N")
    tanks = f"segments side by side on a device; by default {ON_GPU} on a GPU, else 1"
    add("--tanks", type=console.whole(1, 256), metavar="N", help=tanks)
    ray = "run on a Ray cluster: an address, auto, or local:N for N workers here; by default without one"
    add("--ray", type=console.text, metavar="ADDRESS", help=ray)
    budget = "wall time after which no segment is begun; by default none; what is finished then is kept"
    add("--budget", type=console.number(0, 1e7), metavar="SECONDS", help=budget)
    parser.add_argument("--retry", action="store_true", help="run segments that stopped early again")
    parser.add_argument("--dry-run", action="store_true", help="print the plan and stop")


def run(args: argparse.Namespace) -> int:
    """Collect; exit code 0 when the data set is complete, 1 when segments are missing or nothing of one was sound."""
    robot = load_robot(args.fish)
    plan = plan_of(args, robot)
    out = Path(args.out) if args.out else default_folder(plan)
    domain = preset(args.domain or ("laptop" if args.preview else "window"))
    if args.dt is not None:
        domain = domain.changed(dt=args.dt)
    if not (args.dry_run or args.ray):
        water = sum(segment.water for segment in missing(plan, out, args.retry))
        less = "take a smaller --scale, --domain laptop, --ray elsewhere, or --preview for a little"
        solver_cost.agree(
            "hydro_fit collect",
            args.device,
            [(domain, water)],
            instead=less,
            tanks=args.tanks or 1,
            flag=GO,
            asked=args.budget is not None,
        )
    device = args.device if args.ray else str(device_of(args.device))
    setup = Setup(robot=robot, domain=domain, device=device)
    console.say(
        f"{plan.label}: {len(plan.segments)} segments, {plan.water:.0f} s of water for {robot.name}", console.table(plan.rows())
    )
    if domain.name in PREVIEWS:
        console.say(f"{domain.name} is a preview: dx = {domain.dx} m is too coarse for a judgement")
    if not any(segment.block == "policy" for segment in plan.segments):
        console.say(f"no shipped controller is made for {robot.name}: no on-policy episodes; name one with --policy")
    if args.dry_run:
        if args.json:
            console.emit_json(
                {"plan": plan.label, "water_s": plan.water, "blocks": plan.rows(), "split_sha256": plan.split_sha256}
            )
        return console.OK
    more = f"{out} holds every segment that was finished; {interrupt.again()}"
    with interrupt.keeping(lambda: more):
        found = collect(plan, out, setup, pool=pool_of(args, device), budget=args.budget, retry=args.retry, quiet=args.json)
    report(found)
    if args.json:
        console.emit_json({**asdict(found), "complete": found.complete})
    return console.OK if found.complete and not found.lost else console.FAILED_CHECK


def main(argv: list[str]) -> int:
    """The verb by itself."""
    parser = console.parser("hydro_fit collect", "Segments of the flow solver that a water is fitted to.")
    add_arguments(parser)
    return run(parser.parse_args(argv))


def plan_of(args: argparse.Namespace, robot: Robot) -> Plan:
    """The plan that the options ask for.

    Raises:
        ConfigError: two kinds of plan at once; a slip ratio that no segment has.
    """
    plan = _drawn(args, robot)
    return plan.at(args.slip) if args.slip else plan


def _drawn(args: argparse.Namespace, robot: Robot) -> Plan:
    """The plan at every slip ratio."""
    if args.preview and args.fresh_test is not None:
        raise ConfigError("collect: --preview and --fresh-test are two plans; choose one")
    if args.preview:
        return plans.preview(robot, seed=args.seed, policies=args.policy)
    if args.fresh_test is not None:
        return plans.fresh_test(robot, seed=args.fresh_test, policies=args.policy, scale=args.scale)
    return plans.full(robot, seed=args.seed, scale=args.scale, policies=args.policy)


def default_folder(plan: Plan) -> Path:
    """data/hydro/<fish> for the whole campaign; everything else apart from it."""
    suffix = "" if plan.label == "full" else "-" + plan.label.replace(",", "").replace(" ", "-")
    return Path("data") / "hydro" / f"{plan.robot.name}{suffix}"


def pool_of(args: argparse.Namespace, device: str) -> Pool:
    """Tanks here, or workers of a Ray cluster."""
    tanks = args.tanks
    if args.ray:
        from fishmj.campaign.data.ray_pool import RayPool

        return RayPool(args.ray, tanks=tanks or (ON_GPU if device.startswith("cuda") else 1))
    return Local(tanks or (ON_GPU if device.startswith("cuda") else 1))


def report(found: Collected) -> None:
    """What was done, in words."""
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
