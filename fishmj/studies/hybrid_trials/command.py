"""Does the hybrid mend a surrogate that is known to be wrong? Episodes of the test plan, against a solver that never stops.

python -m fishmj.hydro_fit hybrid --wrong both --device cuda --out runs/hybrid     ten episodes of 20 s; goes on where it was
python -m fishmj.hydro_fit hybrid --wrong none ...                     the same with the fitted surrogate as it is
python -m fishmj.hydro_fit hybrid --first 0 ...                        a stretch from rest; else 1 s led and 1 s by its servos
python -m fishmj.hydro_fit hybrid --domain laptop --episodes 1         a look on a CPU

Wrong: `slip`, fitted to a hull along which no water slides (fit --slip 0 --base --name NAME-noslip makes it); `tail`, a tail 10 %
shorter; `both`. The continuous swims are kept in --out and serve every kind.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj import console
from fishmj.campaign.data import plan as plans
from fishmj.campaign.data.collect import Local, collect, domain_of_model
from fishmj.campaign.data.run_segments import Setup
from fishmj.campaign.data.segment import Segment, drive, ticks_of
from fishmj.campaign.hybrid.hybrid import Hybrid, Solver, Surrogate
from fishmj.campaign.hybrid.hybrid import Path as Along
from fishmj.dynamics import planar_chain
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import NAMES
from fishmj.mjcf.description import Robot, load_robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.store import read_json, write_json
from fishmj.water.hydro_model import HydroModel

SHORTER = 0.9  # of the tail's length, in the wrong surrogate
LOOKED = 100  # ticks after a new seed that are set against a swim without one
STRETCH = 2.0  # s
WRONG = ("slip", "tail", "both", "none")
SHOWN = ("episode", "before_m", "after_m", "hybrid_m", "covered", "wall_s", "off")


def main(argv: list[str]) -> int:
    """The verb `hybrid`; exit code 1 where the correction misses its aim."""
    parser = console.parser("hydro_fit hybrid", "Correct a surrogate by short stretches of the flow solver while it swims.")
    add = parser.add_argument
    add("--fish", type=console.text, default="fish", help="a shipped name or a description (.toml)")
    add("--model", type=console.text, default="swift", help="the fitted surrogate: name or .toml; its base is used")
    noslip = "that of a hull along which no water slides; default the model's name and -noslip"
    add("--noslip", type=console.text, help=noslip)
    add("--wrong", choices=WRONG, default="both", help="what is wrong about the surrogate")
    add("--episodes", type=console.whole(1, 1000), default=10, help="swims that are compared")
    add("--seconds", type=console.number(STRETCH, 600), default=20.0, help="of each episode")
    add("--every", type=console.number(STRETCH, 600), default=Hybrid.every, help="s from stretch to stretch; each is 2 s")
    first = "s before the first stretch; at 0 the fish need not be led"
    add("--first", type=console.number(0, 600), default=Hybrid.first, help=first)
    lead = "s of a stretch for which the fish is led, where it is not at rest"
    add("--lead", type=console.number(0, STRETCH), default=Hybrid.lead, help=lead)
    add("--domain", choices=NAMES, help="box of water; by default that of the model's segments; laptop is a preview")
    add("--device", type=console.device, default="auto", help="auto, cpu, cuda or cuda:N")
    add("--tanks", type=console.whole(1, 256), default=1, help="continuous runs side by side; 12 fill a GPU")
    add("--seed", type=console.whole(1, 2**32 - 1), default=1, help="of the fresh test episodes")
    place = "folder of continuous swims and figures; goes on with what is there"
    add("--out", type=console.out_folder, default="runs/hybrid", help=place)
    args = parser.parse_args(argv)
    robot, out = load_robot(args.fish), Path(args.out)
    right, model, segments = HydroModel.load(args.model), surrogate_of(args), episodes_of(robot, args)
    box = domain_of_model(args.domain, right)
    water = sum(segment.water for segment in segments)
    less = "take fewer --episodes, shorter --seconds; --domain laptop is a preview"
    solver_cost.agree("hydro_fit hybrid", args.device, [(box, water)], instead=less, tanks=args.tanks)
    setup = Setup(robot=robot, domain=box, device=str(device_of(args.device)))
    plan = plans.Plan(label="hybrid", robot=robot, seed=args.seed, segments=tuple(segments))
    collect(plan, out / "solver", setup, pool=Local(args.tanks), quiet=args.json)
    own = float(right.scores.get("from_rest", 1.0))  # of a right one, whatever is corrected
    when = {"first": args.first, "every": args.every, "lead": args.lead, "span": STRETCH - args.lead}
    found = trial(robot, model, setup, segments, out, when=when, wrong=args.wrong, own=own)
    console.say(console.table([{k: row[k] for k in SHOWN} for row in found["episodes"]]))
    console.say(f"place, mean over episodes: {found['before']:.3f} m -> {found['after']:.3f} m; transient {found['transient']}")
    write_json(out / f"{args.wrong}.json", found)
    if args.json:
        console.emit_json(found)
    return console.OK if found["ok"] else console.FAILED_CHECK


def surrogate_of(args) -> HydroModel:
    """The base that is to be corrected, right or fitted to another hull; the chain tells the shorter tail."""
    if args.wrong in ("slip", "both"):
        return HydroModel.load(args.noslip or f"{args.model.removesuffix('.toml')}-noslip").base_only
    return HydroModel.load(args.model).base_only


def episodes_of(robot: Robot, args) -> list[Segment]:
    """Free swims in still water from fresh test episodes, as long as asked for."""
    scale = max(1.0, args.episodes / 6)
    made = [s for s in plans.fresh_test(robot, seed=args.seed, scale=scale).segments if s.block in ("straight", "turning")]
    made = [s for s in made if s.slip == plans.DEFAULT_SLIP and not s.replicate_of][: args.episodes]
    return [replace(s, seconds=args.seconds, settle=0.0) for s in made]


def trial(robot: Robot, model: HydroModel, setup: Setup, segments, out: Path, *, when: dict, wrong: str, own: float) -> dict:
    """Every episode: in the solver (from `out`), in the surrogate alone before and after, and in the hybrid between.

    `when`: `first`, `every`, `lead` and `span` of `Hybrid`. An episode that is done is kept in `out` with what it was made from,
    and not done again.
    """
    data, rows = open_dataset(out / "solver", test=True), []
    for segment in segments:
        kept = out / wrong / f"{segment.id}.json"
        solved = data.about[segment.id]["file"]["sha256"]
        made = {"model": model.base._asdict(), "when": when, "own": own, "solver": solved, "wrong": wrong}
        row = read_json(kept) if kept.is_file() else {}
        if row.get("made") != made:
            row = _one(robot, model, setup, segment, data[segment.id], when, wrong, own) | {"made": made}
            write_json(kept, row)
        rows.append(row)
        console.say(f"{segment.id}: {row['before_m']:.3f} m -> {row['after_m']:.3f} m")
    before, after, between = (float(np.mean([row[key] for row in rows])) for key in ("before_m", "after_m", "hybrid_m"))
    covered = max(row["covered"] for row in rows)
    ok = covered <= 0.1 + 1e-9 and (after <= 1.05 * before if wrong == "none" else after <= 0.5 * before)
    mean = np.mean([row["transient"] for row in rows], 0)
    told = {f"{(k + 1) * 20} ms": round(float(mean[k]), 3) for k in (0, 2, 4, 9, 24, 49, 59, LOOKED - 1)}
    found = {"ok": ok, "wrong": wrong, "before": before, "after": after, "hybrid": between, "covered": covered}
    return found | {"transient": told, "episodes": rows}


def _one(
    robot: Robot, model: HydroModel, setup: Setup, segment: Segment, truth: SegmentRecord, when: dict, wrong: str, own: float
) -> dict:
    ch = shorter_tail(robot) if wrong in ("tail", "both") else planar_chain.chain_of(robot)
    water, ticks = model.swimmer(robot).water, min(ticks_of(segment, robot)[1], len(truth.q))
    moved = drive(segment, robot)
    commands = [moved.command(k, None) for k in range(ticks)]

    def alone(coefficients) -> np.ndarray:
        fish = Surrogate(robot, ch, coefficients, pose=segment.pose)
        for command in commands:
            fish.tick(command)
        return fish.q

    solver = Solver(robot, setup.domain, slip=segment.slip, device=setup.device)
    hybrid = Hybrid(Surrogate(robot, ch, water, pose=segment.pose), solver, own, **when)
    for command in commands:
        hybrid.tick(command)
    ends = (alone(water), alone(hybrid.surrogate.water), hybrid.surrogate.q)
    far = [float(np.linalg.norm(q[:2] - truth.q[ticks - 1, :2])) for q in ends]
    told = hybrid.episode()
    row = {"episode": segment.id, **dict(zip(("before_m", "after_m", "hybrid_m"), far, strict=True)), **told}
    row |= {"wall_s": sum(stretch["wall_s"] for stretch in told["stretches"]), "solver_wall_s": truth.meta["wall_s"]}
    return row | {"transient": transient(solver, truth, robot).tolist()}


def transient(solver: Solver, truth: SegmentRecord, robot: Robot) -> np.ndarray:
    """(LOOKED,) error of the wrenches after a new seed in the middle of a swim, over their rms in the swim that had none."""
    from scipy.interpolate import CubicHermiteSpline

    q, v = truth.before
    at = max(0, min(len(q) // 2, len(q) - LOOKED - 1))
    count, dt = min(LOOKED, len(q) - at), robot.timing.physics_dt
    spline = CubicHermiteSpline(np.arange(len(q)) * truth.tick, q, v)
    t = at * truth.tick + np.arange(round((count - 1) * truth.tick / dt) + 1) * dt
    path = Along(spline(t), spline(t, 1), dt)
    error = solver.tow(solver.reseeded(path), path) - truth.wrench[at : at + count - 1]
    size = np.sqrt((truth.wrench**2).mean((0, 1)))
    relative = np.sqrt(((error / size) ** 2).mean((1, 2)))
    return np.concatenate([relative, np.full(LOOKED - len(relative), relative[-1])])


def shorter_tail(robot: Robot) -> planar_chain.Chain:
    """The robot's chain in the water of a tail that is a tenth shorter."""
    tail = robot.links[-1]
    short = replace(tail, length=SHORTER * tail.length, sections=tuple((SHORTER * s, h, w) for s, h, w in tail.sections))
    strips = planar_chain.chain_of(robot, geometry_of(replace(robot, links=(*robot.links[:-1], short)))).strips
    return planar_chain.chain_of(robot)._replace(strips=strips)
