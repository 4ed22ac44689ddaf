"""Make the flow solver's family of robots: healthy ones with free swims for a calibration, and robots with hidden effects.

python -m studies.solver_family --plan --models fish five_link.toml --robots 14 --out runs/solver_sets  minutes of a CPU
python -m studies.solver_family --out runs/solver_sets --device cuda --tanks 12      swims it, goes on where it stopped
python -m studies.solver_family --out runs/solver_sets --device cuda --shard 0/3     a third of the swims, beside others
python -m studies.solver_family --out runs/solver_sets --finish                      data sets of what is complete
python -m studies.solver_family --cut runs/old_sets --out runs/solver_sets           older data sets, launches left out
fishmj gap bench --generator solver --sets runs/solver_sets --jobs 0 --out runs/solver      searches them

All of it is *synthetic*. The models of a plan, their number of robots and its seed are those of --plan.
"""

import time
from pathlib import Path

from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError
from fishmj.gap.bench.bench_command import shard_of
from fishmj.gap.bench.solver_plan import PLAN, SETS, FamilyPlan, PlanSettings, read
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import NAMES, PREVIEWS, preset
from studies.solver_family import family_plan as plans
from studies.solver_family import launches
from studies.solver_family.swims import all_swims, finished, swum_all

RATE = 3500.0  # tank-steps a second of one process: 1.7 M on window_coarse took an H200 483 s (studies/calibration)
ON_GPU = 12


def main(argv: list[str]) -> int:
    """Plans, swims or finishes the sets. Returns the exit code."""
    parser = console.parser("studies.solver_family", __doc__)
    add = parser.add_argument
    add("--plan", action="store_true", help="draw the plan into OUT, say what it costs, and stop")
    add("--models", nargs="+", type=console.text, default=["fish"], metavar="MODEL", help="of --plan: names or TOML files")
    console.add_settings(parser, PlanSettings, "robots", "singles", "seed", "seconds", "calibration")
    add("--domain", choices=NAMES, default="window_coarse", help="of --plan: box of water; laptop is a preview")
    place = "auto, cpu, cuda, cuda:N, or several: cuda:all, cuda:0,cuda:1 (default auto)"
    add("--device", type=console.devices, default="auto", help=place)
    add("--tanks", type=console.whole(1, 256), help=f"swims side by side on each device (default {ON_GPU} on a GPU, else 1)")
    add("--shard", type=shard_of, default=(0, 1), metavar="I/N", help="every N-th swim from the I-th (default 0/1)")
    add("--finish", action="store_true", help="swim nothing: make data sets of the robots that are complete")
    old = "data sets that were made with launches in them: copy them into OUT, launches left out, and stop"
    add("--cut", type=console.path, metavar="FOLDER", help=f"{old} (default none)")
    add("--out", type=console.out_folder, required=True, help="folder; the same command goes on where it stopped")
    args = parser.parse_args(argv)
    if args.plan:
        return drawn(args)
    if args.cut:
        console.say(f"{launches.without_launches(args.cut, args.out)} data sets in {args.out / SETS}")
        return console.OK
    plan = read(args.out)
    if not args.finish:
        swim(plan, args)
    if args.shard[1] > 1 and not args.finish:
        return console.OK
    return packed(plan, args)


def drawn(args) -> int:
    """Draws the plan and prints its cost. Returns the exit code.

    Raises ConfigError: another plan is there, or two models of one name.
    """
    models = {Path(source).stem: source for source in args.models}
    if len(models) < len(args.models):
        raise ConfigError(f"solver_family: --models {' '.join(args.models)}: two of one name; rename a file")
    asked = PlanSettings(models, domain=args.domain, **console.settings_of(args, PlanSettings))
    if (args.out / PLAN).is_file():
        raise ConfigError(f"solver_family: {args.out} has a plan; go on without --plan, or take another --out")
    with console.Progress(args.robots * len(models), "plan", unit="robots") as bar:
        plan = plans.planned(asked, bar.update)
    plans.write(plan, args.out)
    facts = cost(plan)
    console.say(
        f"{facts['robots']} robots, {facts['sets']} sets, {facts['swims']} swims, {facts['water_s']:.0f} s of water,"
        f" {facts['steps'] / 1e6:.2f} M tank-steps on {args.domain}: about {console.duration(facts['gpu_s'])} of one H200 and a"
        f" process ({RATE:g} a second)"
    )
    if args.json:
        console.emit_json(facts)
    return console.OK


def cost(plan: FamilyPlan) -> dict:
    """Work of a plan: robots, sets, swims, water seconds, time steps and GPU seconds."""
    todo, box = all_swims(plan), preset(plan.asked.domain)
    steps = sum(swim.job.steps for swim in todo)
    facts: dict = {"robots": len(plan.robots), "sets": len({swim.set for swim in todo}), "swims": len(todo)}
    return facts | {"water_s": steps * box.dt, "steps": steps, "gpu_s": steps / RATE}


def swim(plan: FamilyPlan, args) -> None:
    """Swims the missing part of a shard. Raises TooMuch: a CPU would take too long, and this was not agreed to."""
    box, left = preset(plan.asked.domain), [s for s in all_swims(plan, args.shard) if not s.done(args.out)]
    water = sum(one.job.steps for one in left) * box.dt
    less = "take a plan of fewer --robots, shorter --seconds; --domain laptop is a preview"
    solver_cost.agree("solver_family", args.device, [(box, water)], instead=less, tanks=args.tanks or 1)
    device = ",".join(devices_of(args.device))
    words = lambda: f"{args.out} keeps every swim that was done; the same command goes on"
    begin = time.monotonic()
    with interrupt.keeping(words):
        steps = swum_all(plan, args.out, device, args.tanks or (ON_GPU if device.startswith("cuda") else 1), args.shard)
    seconds = time.monotonic() - begin
    preview = " (a preview)" if box.name in PREVIEWS else ""
    console.say(f"{len(left)} swims, {steps} tank-steps in {seconds:.0f} s on {device}: {steps / seconds:.0f} a second{preview}")


def packed(plan: FamilyPlan, args) -> int:
    """Makes the data sets; returns 1 if robots or swims are missing."""
    with console.Progress(len(plan.robots), "data sets", unit="robots") as bar:
        lost = finished(plan, args.out, bar.update)
    for name, why in lost.items():
        console.warn(f"{name}: {why}")
    made = len(list((args.out / SETS).glob("*.npz")))
    asked = len({swim.set for swim in all_swims(plan)})
    console.say(f"{args.out / SETS}: {made} of {asked} data sets, synthetic")
    if args.json:
        console.emit_json({"sets": made, "of": asked, "lost": lost})
    return console.OK if made == asked else console.FAILED_CHECK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
