"""Many data sets of the flow solver with hidden effects, in several tanks; the same command continues an interrupted run.

fishmj campaign hidden --sets 48 --effects none --device cuda --out data/gap/lbm_null --truth truth_null.json
fishmj campaign hidden --sets 36 --effects command_latency yaw_drag --device cuda --out data/gap/lbm --truth t.json
fishmj campaign hidden --sets 2 --effects none command_latency=0.04 --excitations gait,steps,tow_ahead --seconds 5 --dry-run

Set i hides effect i of the list, cyclically, in its own robot. OUT/<set>/ is a data set; only the truth file names its hidden
effect.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError, OracleUnstable
from fishmj.base.store import Manifest, read_json, write_json
from fishmj.gap.laboratory.hidden_lbm.hidden import Job, OwnedJobs, jobs, run_jobs, trial_of
from fishmj.gap.laboratory.virtual_robot import hidden_dataset
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, preset
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, spread
from fishmj.log import Trial, excitation
from fishmj.log.excitation import PERIOD, Excitation
from fishmj.log.trial_folder import write_trial
from fishmj.mjcf.reading import load_robot

SCHEMA = "fishmj.hidden/1"
TANK_STEPS = 5834.0  # a second: twelve tanks of two million cells on one H200 (studies/solver/NOTES.md)
FINER = 0.3  # of the ticks have finer steps, at twice the cost
ON_GPU = 12


def main(argv: list[str]) -> int:
    """The command `campaign hidden`. Returns the exit code."""
    parser = console.parser("campaign hidden", __doc__)
    add = parser.add_argument
    add("--sets", type=console.whole(1, 10_000), default=1, metavar="N", help="data sets, each of another robot")
    named = "none|random|NAME[=value]"
    add("--effects", type=console.text, nargs="+", default=["none"], metavar=named, help="one per set, in rotation")
    add("--model", type=console.text, default="fish", help="the robot, name or TOML file (default fish)")
    add("--excitations", type=console.text, default="designed", help="designed, casual, dry, all, or ids with commas")
    cut = "cut every experiment to this length; by default they run to their end"
    add("--seconds", type=console.number(1, 600), metavar="S", help=cut)
    add("--seed", type=console.SEED, default=0, help="seed of set 0; set i has seed + i")
    add("--noise", type=console.number(0, 100), default=1.0, help="factor on the sensors' noise")
    add("--nuisance", type=console.number(0, 0.5), default=0.1, help="relative half width of unmeasured constants")
    add("--slip", type=console.number(0, 1), default=1.0, help="slip ratio of the hull, quoted at the paper's grid")
    add("--domain", choices=EVERY, default="window_coarse", help="domain of the solver; laptop is a preview")
    add("--device", type=console.devices, default="auto", help=console.DEVICES_HELP)
    many = f"experiments at once on each device; by default {ON_GPU} on a GPU, else 1"
    add("--tanks", type=console.whole(1, 256), help=many)
    add("--out", type=console.out_folder, help="folder of data sets, continued if it exists; needed unless --dry-run")
    add("--truth", type=console.out_file, help="file for the hidden effects, outside --out; needed unless --dry-run")
    add("--dry-run", action="store_true", help="print plan and cost, and stop")
    args = parser.parse_args(argv)
    _apart(args)
    box, (trials, steps) = preset(args.domain), sized(args)
    water, gpu = steps * box.dt, steps / TANK_STEPS * (1 + FINER)
    if not args.dry_run:
        less = "take fewer --sets, shorter --seconds; --domain laptop is a preview"
        solver_cost.agree("campaign hidden", args.device, [(box, water)], instead=less, tanks=args.tanks or 1)
    console.say(
        f"{args.sets} sets, {trials} trials, {water:.0f} s of water, {steps / 1e6:.2f} M tank-steps on"
        f" {args.domain}: about {console.duration(gpu)} of one H200 with {ON_GPU} tanks ({water / gpu:.0f} times real time)"
    )
    if args.dry_run:
        if args.json:
            console.emit_json({"sets": args.sets, "water_s": water, "steps": steps, "gpu_s": gpu})
        return console.OK
    plan = plan_of(args, args.sets)
    device = ",".join(devices_of(args.device))
    _seal(args)
    tanks = args.tanks or (ON_GPU if device.startswith("cuda") else 1)
    lost = collect(args.out, plan, device, tanks)
    for name, why in lost.items():
        console.warn(f"{name}: {why}")
    if args.json:
        console.emit_json({"sets": len(plan), "out": args.out, "truth": args.truth, "lost": lost})
    return console.FAILED_CHECK if lost else console.OK


def collect(out: Path, plan: dict[str, list[Job]], device: str, tanks: int = 1) -> dict[str, str]:
    """Runs the missing part of `out`; a complete set gets its manifest. Returns trials without a valid part, with reasons.

    device: one, or several as for `devices_of`. tanks: trials at once on each.
    """
    waiting: list[tuple[tuple[str, str, int], Job]] = []  # set, name and steps of a job, and the job
    lost: dict[str, str] = {}
    for name, part in plan.items():
        if not (out / name / "manifest.json").is_file():
            waiting += [((name, job.name, job.steps), job) for job in part if not (out / name / job.name).is_dir()]
    total = sum(job.steps for _, job in waiting)
    done = 0
    with console.Progress(total, "hidden", unit="steps") as bar:
        for (name, number, steps), made in spread(partial(on_device, tanks=tanks), waiting, devices_of(device)):
            done += steps
            if isinstance(made, str):
                lost[f"{name}/{number}"] = made
            else:
                write_trial(out / name / number, made)
            bar.update(done, set=name)
    for name, part in plan.items():
        if all((out / name / job.name).is_dir() or f"{name}/{job.name}" in lost for job in part):
            _close(out / name, {key: why for key, why in lost.items() if key.startswith(f"{name}/")})
    return lost


def on_device(waiting: Waiting, device: str, go_on: GoOn, *, tanks: int) -> Iterator[tuple[tuple, Trial | str]]:
    """Trials of jobs on one device (`spread`), each with its job's key; the reason in place of a trial without a valid part."""
    jobs_of = OwnedJobs(waiting)
    for run in run_jobs(jobs_of, device, tanks):
        made: Trial | str
        try:
            made = trial_of(run)
        except OracleUnstable as error:
            made = str(error)
        yield jobs_of.owner(run), made


def sized(args) -> tuple[int, int]:
    """(trials, time steps) of all sets, from one set per effect, since sets take effects in rotation. Raises as `plan_of`."""
    few = list(plan_of(args, min(args.sets, len(args.effects))).values())
    times = [len(range(i, args.sets, len(args.effects))) for i in range(len(few))]
    pairs = list(zip(times, few, strict=True))
    return sum(n * len(part) for n, part in pairs), sum(n * job.steps for n, part in pairs for job in part)


def plan_of(args, sets: int) -> dict[str, list[Job]]:
    """Jobs of the first sets, by the name of each. Raises ConfigError, UnknownName: no such effect, excitation or domain."""
    robot, box = load_robot(args.model), preset(args.domain)
    runs = [_cut(excitation.get(name, robot.n_joints), args.seconds) for name in excitation.listed(args.excitations)]
    plan = {}
    for i in range(sets):
        effects, seed = effects_of(args, i), args.seed + i
        plan[f"set_{i:03d}"] = jobs(effects, runs, seed, args.noise, args.nuisance, box, args.slip, robot=robot)
    return plan


def effects_of(args, i: int) -> dict:
    """Hidden effects of set i."""
    text = args.effects[i % len(args.effects)]
    return {} if text == "none" else hidden_dataset.parse([text], args.seed + i)


def _cut(what: Excitation, seconds: float | None) -> Excitation:
    return what if seconds is None else replace(what, commands=what.commands[: max(50, round(seconds / PERIOD))])


def _apart(args) -> None:
    """Checks the places of trials and truth, before anything is planned.

    Raises ConfigError: no place given, or the truth would lie among the trials.
    """
    if None in (args.out, args.truth) and not args.dry_run:
        raise ConfigError("campaign hidden: needs --out FOLDER for the trials and --truth FILE for the hidden effects")
    if None not in (args.out, args.truth):
        hidden_dataset.apart(args.out, args.truth)


def _seal(args) -> None:
    """Writes the hidden effects before the runs. Raises ConfigError: an earlier call had other options."""
    asked = {key: getattr(args, key) for key in ("sets", "seed", "noise", "nuisance", "slip", "domain", "excitations", "seconds")}
    asked |= {} if args.model == "fish" else {"model": args.model}
    hidden = {f"set_{i:03d}": {"effects": effects_of(args, i), "seed": args.seed + i} for i in range(args.sets)}
    body = {"schema": SCHEMA, "origin": "synthetic", "asked": asked, "hidden": hidden}
    if args.truth.is_file():
        if read_json(args.truth) != body:
            raise ConfigError(f"--truth {args.truth} belongs to another collection; choose another file and another --out")
        return
    if args.out.is_dir() and any(args.out.iterdir()):
        raise ConfigError(f"--out {args.out} is not empty and --truth {args.truth} does not exist; choose another folder")
    write_json(args.truth, body)


def _close(folder: Path, lost: dict[str, str]) -> None:
    """Writes the manifest, which makes the folder a data set."""
    if folder.is_dir() and not (folder / "manifest.json").is_file():
        Manifest.of(folder, {"origin": "synthetic", "licence": "Apache-2.0", "lost": lost}).write(folder)
