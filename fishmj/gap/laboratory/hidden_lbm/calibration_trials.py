"""Calibration trials of a robot with hidden constants, and the sealed file that holds these.

    fishmj campaign hidden_trials --water second                     seconds; all water is the second robot's
    fishmj campaign hidden_trials --water swims --domain laptop --repeats-swims 1 --seconds 8          a CPU, minutes
    fishmj campaign hidden_trials --water lbm --domain window_coarse --device cuda --tanks 12    a GPU, 38 s: all water

The trials are sine, square and impulse in air and in water, swims at two beat rates and a coast-down, with repeats; a table of
weighings is added. The robot is `virtual_robot` with redrawn gain, damping, friction, latencies and masses; the flow solver can
simulate its swims, with a drawn slip ratio. A fit may read the whole folder except `sealed.json`, whose sha256 is in the
manifest; `calibrate score` opens it.
"""

import secrets
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import Manifest, sha256, write_json
from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants
from fishmj.gap.laboratory.virtual_robot.trials import masses, plant, trial_of, weighings
from fishmj.lbm_oracle.run.domain import EVERY
from fishmj.log import Trial, excitation, write_dataset
from fishmj.log.excitation import PERIOD, Excitation

SEALED = "sealed.json"
SCHEMA = "fishmj.sealed/1"
OUT = Path("data") / "calib" / "trials"
REPEATS = 3
BENCH = ("sine", "square", "impulse")  # the paper's signals
SWIMS = ("gait", "gait_slow", "tow_ahead")  # 1 Hz and 30 deg, another beat rate, coasting
SECOND, SOLVER = "fishmj.gap.laboratory.virtual_robot", "fishmj.gap.laboratory.hidden_lbm.hidden"
GENERATORS = {"second": (SECOND, SECOND), "swims": (SOLVER, SECOND), "lbm": (SOLVER, SOLVER)}  # --water: swims, bench in water
MEDIA = ("air", "water")
FIRST_SWIM = 100  # index of the first swim in the noise streams
ROUGHEST = 0.05  # largest drawn 1 - s; small values are likelier


@dataclass(frozen=True)
class Draw:
    """Hidden constant: a field of the virtual robot's constants, drawn uniformly from low to high."""

    field: str
    low: float
    high: float
    factor: bool = False  # multiplies the nominal value, else is added to it


DRAWS = (
    Draw("motor.gain", 0.8, 1.2, factor=True),
    Draw("motor.damping", 0.0, 0.08),
    Draw("motor.coulomb", 0.0, 0.06),
    Draw("network.delay", -0.02, 0.04),
    Draw("camera.delay", -0.02, 0.03),
    Draw("hull.mass", 0.0, 0.1),
    Draw("hull.com", -0.01, 0.01),
    Draw("hull.inertia", 0.0, 0.004),
)


def hidden(seed: int, medium: str = "water") -> RobotConstants:
    """Constants of a seed's robot: nuisance draw as in every virtual robot, then the hidden constants."""
    made = plant({}, seed, medium=medium)
    rng = random_streams.stream(seed, "calibration")
    fields = {}
    for item in DRAWS:
        group, _, key = item.field.partition(".")
        drawn, usual = float(rng.uniform(item.low, item.high)), float(getattr(getattr(made, group), key))
        fields[item.field] = drawn * usual if item.factor else drawn + usual
    return made.with_fields(fields)


def slip_of(seed: int) -> float:
    """Slip ratio of a seed's hull; only swims in the flow solver have one."""
    return 1.0 - ROUGHEST * float(random_streams.stream(seed, "slip").uniform()) ** 2


def truth(made: RobotConstants) -> dict[str, float]:
    """Exact values by the names of the calibration, SI."""
    m, n, c = made.motor, made.network, made.camera
    return {
        "kp": m.gain,
        "kd": m.constant**2 / m.resistance + m.rate_gain + m.viscous + m.damping,
        "friction": m.dry + m.coulomb,
        "command_latency": n.latency + n.delay + 0.5 * m.period,
        "camera_latency": c.latency + c.delay,
        **masses(made),
    }


def bench(repeats: int = REPEATS) -> Iterator[tuple[str, Excitation, str, int]]:
    """Yields (name, experiment, medium, repeat) of every servo trial."""
    for medium in MEDIA:
        for id_ in BENCH:
            for repeat in range(repeats):
                yield f"{medium}_{id_}_{repeat + 1}", excitation.get(id_), medium, repeat


def swims(repeats: int = REPEATS, seconds: float | None = None) -> list[tuple[str, Excitation, int]]:
    """(name, experiment, repeat) of every swim, cut to `seconds`."""
    rows = len(excitation.get("gait_slow").commands) if seconds is None else round(seconds / PERIOD)
    cut = lambda what: replace(what, commands=what.commands[:rows])
    return [(f"swim_{id_}_{r + 1}", cut(excitation.get(id_)), r) for id_ in SWIMS for r in range(repeats)]


def trials(seed: int, noise: float = 1.0, repeats: int = REPEATS, media: tuple[str, ...] = MEDIA) -> dict[str, Trial]:
    """Servo trials of a seed's robot in the second robot's water; each repeat has its own placing and noise."""
    robots = {medium: hidden(seed, medium) for medium in media}
    made = {}
    for index, (name, what, medium, repeat) in enumerate(bench(repeats)):
        if medium in media:
            made[name] = trial_of(robots[medium], what, seed, index, noise, name, first_of(name, repeat), (0.0, 0.0))
        if medium in media and medium == "air":
            made[name].meta["bench"] = "hung on a thread of 1 m at the reference point"
    return made


def first_of(name: str, repeat: int) -> str:
    """Name of the trial that this one repeats; "" for the first."""
    return f"{name[:-1]}1" if repeat else ""


def second_swims(seed: int, repeats: int = REPEATS, seconds: float | None = None) -> dict[str, Trial]:
    """Swims in the second robot's water."""
    made, out = hidden(seed), {}
    for index, (name, what, repeat) in enumerate(swims(repeats, seconds), FIRST_SWIM):
        out[name] = trial_of(made, what, seed, index, 1.0, name, first_of(name, repeat), (0.0, 0.0))
    return out


def solver_trials(seed: int, args) -> dict[str, Trial]:
    """Swims of the same robot in the flow solver, with the seed's slip ratio; with `--water lbm` also the servo trials."""
    from fishmj.gap.laboratory.hidden_lbm.hidden import Job, run_jobs
    from fishmj.gap.laboratory.hidden_lbm.hidden import trial_of as trial_of_run
    from fishmj.lbm_oracle.run.domain import preset

    made, slip, box = hidden(seed), slip_of(seed), preset(args.domain)
    rows = [(i, *row) for i, row in enumerate(swims(args.repeats_swims, args.seconds), FIRST_SWIM)]
    if args.water == "lbm":
        rows += [(i, name, what, repeat) for i, (name, what, medium, repeat) in enumerate(bench()) if medium == "water"]
    waiting = [
        Job(made=made, what=what, seed=seed, index=i, name=name, replicate_of=first_of(name, repeat), slip=slip, domain=box)
        for i, name, what, repeat in rows
    ]
    out = {}
    for run in run_jobs(waiting, args.device, args.tanks):
        out[run.job.name] = trial_of_run(run)
        console.say(f"{run.job.name}: {out[run.job.name].span[1]:.1f} s")
    return out


def write(out: str | Path, seed: int, made: dict[str, Trial], generators: dict[str, str], *, overwrite: bool = False) -> Path:
    """Writes trials, weighings, seal, manifest; `overwrite` removes trials of an earlier robot. Returns the manifest's path."""
    out, robot = Path(out), hidden(seed)
    for old in sorted(out.glob("*/meta.toml")) if overwrite else ():
        if old.parent.name not in made:
            shutil.rmtree(old.parent)
    write_dataset(out, made, overwrite=overwrite, page=weighings(robot, random_streams.stream(seed, "weighing")))
    values = truth(robot) | ({"slip": slip_of(seed)} if SOLVER in generators.values() else {})
    return seal(out, seed, values, generators)


def seal(out: Path, seed: int, values: dict[str, float], generators: dict[str, str]) -> Path:
    """Writes the sealed file and, last, the manifest, which holds its sha256 and does not list it."""
    (out / SEALED).unlink(missing_ok=True)
    found = Manifest.of(out)
    write_json(out / SEALED, {"schema": SCHEMA, "origin": "synthetic", "seed": seed, "values": values, "generators": generators})
    meta = {"origin": "synthetic", "licence": "Apache-2.0", "generators": generators}
    meta["sealed"] = {"file": SEALED, "sha256": sha256(out / SEALED)}
    return Manifest(found.files, meta).write(out)


def main(argv: list[str]) -> int:
    """The command `campaign hidden_trials`. Returns the exit code."""
    parser = console.parser("campaign hidden_trials", __doc__)
    add = parser.add_argument
    add("--out", type=console.out_folder, default=str(OUT), help="data set to write; refused if not empty")
    add("--water", choices=GENERATORS, default="second", help="water of the second robot, of the solver for swims, or for all")
    add("--repeats-swims", type=console.whole(1, 100), default=REPEATS, metavar="N", help="trials of each swim")
    cut = "cut the swims to this length; by default they run to their end"
    add("--seconds", type=console.number(1, 600), metavar="S", help=cut)
    add("--domain", choices=EVERY, default="paper", help="domain of the flow solver")
    add("--device", type=console.device, default="cpu", help=f"device of the flow solver: {console.DEVICE_HELP}")
    add("--tanks", type=console.whole(1, 256), default=1, help="swims that the solver runs at once")
    add("--seed", type=console.SEED, help="seed of the robot; random by default")
    add("--overwrite", action="store_true", help="replace the existing data set")
    args = parser.parse_args(argv)
    if args.out.is_dir() and any(args.out.iterdir()) and not (args.overwrite and (args.out / SEALED).is_file()):
        raise ConfigError(f"--out {args.out}: is not empty; choose another folder, or --overwrite one that this command wrote")
    seed = secrets.randbits(48) if args.seed is None else args.seed
    swimming, wet = GENERATORS[args.water]
    made = second_swims(seed, args.repeats_swims, args.seconds) if swimming == SECOND else solver_trials(seed, args)
    made |= trials(seed, media=MEDIA if wet == SECOND else ("air",))
    generators = {"air": SECOND, "water": wet, "swim": swimming, "weighing": SECOND}
    write(args.out, seed, made, generators, overwrite=args.overwrite)
    console.say(f"{args.out}: {len(made)} synthetic trials; the robot's constants are sealed in {SEALED}")
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
