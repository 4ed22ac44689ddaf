"""Does the hybrid mend a surrogate that is known to be wrong? Episodes of the test plan, against a solver that never stops.

python -m fishmj.hydro_fit hybrid --device cuda                         ten episodes of 20 s, tail 10 % shorter
python -m fishmj.hydro_fit hybrid --right --device cuda                 the same with the fitted surrogate as it is
python -m fishmj.hydro_fit hybrid --domain laptop --episodes 1 --seconds 10   a look on a CPU
"""

from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj import console
from fishmj.campaign import plan as plans
from fishmj.campaign.drives import drive, ticks_of
from fishmj.campaign.hybrid import Hybrid, Solver, Surrogate
from fishmj.campaign.segment import Segment
from fishmj.campaign.tank import Setup, side_by_side
from fishmj.errors import ConfigError
from fishmj.hydro_fit import chain
from fishmj.hydro_fit.model import HydroModel
from fishmj.hydro_fit.record import Record
from fishmj.lbm_oracle.device import device_of
from fishmj.lbm_oracle.domain import preset
from fishmj.mjcf.description import Robot, load_robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.store import write_json

SHORTER = 0.9  # of the tail's length, in the wrong surrogate
LOOKED = 50  # ticks after a new seed that are set against a swim without one


def main(argv: list[str]) -> int:
    """The verb `hybrid`; exit code 1 where the correction misses its aim."""
    parser = console.parser("hydro_fit hybrid", "Correct a surrogate by short stretches of the flow solver while it swims.")
    parser.add_argument("--fish", default="fish", help="a shipped name or a description (.toml)")
    parser.add_argument("--model", default="swift", help="the fitted surrogate: name or .toml; its base is used")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each episode")
    parser.add_argument("--every", type=float, default=8.0, help="s from stretch to stretch; each is 0.8 s")
    parser.add_argument("--right", action="store_true", help="leave the surrogate as it was fitted")
    parser.add_argument("--domain", default="window")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--tanks", type=int, default=1, help="continuous runs side by side; 12 fill a GPU")
    parser.add_argument("--seed", type=int, default=1, help="of the fresh test episodes")
    parser.add_argument("--out", help="JSON file of the figures")
    args = parser.parse_args(argv)
    robot = load_robot(args.fish)
    setup = Setup(robot=robot, domain=preset(args.domain), device=str(device_of(args.device)))
    model = HydroModel.load(args.model).base_only
    found = trial(robot, model, setup, episodes_of(robot, args), every=args.every, right=args.right, tanks=args.tanks)
    console.say(console.table([{k: row[k] for k in SHOWN} for row in found["episodes"]]))
    console.say(f"place, mean over episodes: {found['before']:.3f} m -> {found['after']:.3f} m; transient {found['transient']}")
    if args.out:
        write_json(Path(args.out), found)
    if args.json:
        console.emit_json(found)
    return console.OK if found["ok"] else console.FAILED_CHECK


SHOWN = ("episode", "before_m", "after_m", "hybrid_m", "covered", "wall_s", "off")


def episodes_of(robot: Robot, args) -> list[Segment]:
    """Free swims in still water from fresh test episodes, as long as asked for.

    Raises:
        ConfigError: fewer than one episode, or without a stretch.
    """
    if args.episodes < 1 or args.seconds <= args.every:
        raise ConfigError(
            f"hybrid: {args.episodes} episodes of {args.seconds} s; expected 1 or more of more than {args.every} s or more"
        )
    scale = max(1.0, args.episodes / 6)
    made = [s for s in plans.fresh_test(robot, seed=args.seed, scale=scale).segments if s.block in ("straight", "turning")]
    made = [s for s in made if s.slip == plans.DEFAULT_SLIP and not s.replicate_of][: args.episodes]
    return [replace(s, seconds=args.seconds, settle=0.0) for s in made]


def trial(robot: Robot, model: HydroModel, setup: Setup, segments, *, every: float, right: bool, tanks: int = 1) -> dict:
    """Every episode three times: in the solver, in the surrogate alone before and after, and in the hybrid between."""
    waiting = deque(segments)
    solved = {done.segment.id: done for done in side_by_side(waiting, setup, tanks=tanks)}
    rows, transients = [], []
    for segment in segments:
        done = solved[segment.id]
        truth = Record(done.meta, **({"power": np.full(len(done.arrays["q"]), np.nan)} | done.arrays))
        row, transient = _one(robot, model, setup, segment, truth, every, right)
        rows.append(row)
        transients.append(transient)
        console.say(f"{segment.id}: {row['before_m']:.3f} m -> {row['after_m']:.3f} m")
    before, after = (float(np.mean([row[key] for row in rows])) for key in ("before_m", "after_m"))
    covered = max(row["covered"] for row in rows)
    ok = covered <= 0.1 + 1e-9 and (after <= 1.05 * before if right else after <= 0.5 * before)
    mean = np.mean(transients, 0)
    told = {f"{(k + 1) * 20} ms": round(float(mean[k]), 3) for k in (0, 2, 4, 9, 24, 34, LOOKED - 1)}
    return {"ok": ok, "before": before, "after": after, "covered": covered, "transient": told, "right": right, "episodes": rows}


def _one(robot: Robot, model: HydroModel, setup: Setup, segment: Segment, truth: Record, every: float, right: bool):
    ch = chain.chain_of(robot) if right else shorter_tail(robot)
    water, ticks = model.swimmer(robot).water, min(ticks_of(segment, robot)[1], len(truth.q))
    moved = drive(segment, robot)
    commands = [moved.command(k, None) for k in range(ticks)]
    own = model.scores.get("own_alone", [0.0] * 3)

    def alone(coefficients) -> np.ndarray:
        fish = Surrogate(robot, ch, coefficients, pose=segment.pose)
        for command in commands:
            fish.tick(command)
        return fish.q

    solver = Solver(robot, setup.domain, slip=segment.slip, device=setup.device)
    hybrid = Hybrid(Surrogate(robot, ch, water, pose=segment.pose), solver, own, every=every)
    for command in commands:
        hybrid.tick(command)
    ends = (alone(water), alone(hybrid.surrogate.water), hybrid.surrogate.q)
    far = [float(np.linalg.norm(q[:2] - truth.q[ticks - 1, :2])) for q in ends]
    told = hybrid.episode()
    row = {"episode": segment.id, **dict(zip(("before_m", "after_m", "hybrid_m"), far, strict=True)), **told}
    row |= {"wall_s": sum(stretch["wall_s"] for stretch in told["stretches"]), "solver_wall_s": truth.meta["wall_s"]}
    return row, transient(solver, truth, commands, robot)


def transient(solver: Solver, truth: Record, commands, robot: Robot) -> np.ndarray:
    """(LOOKED,) error of the wrenches after a new seed in the middle of a swim, over their rms in the swim that had none."""
    from fishmj.mjcf.bus import on_the_bus

    q, v = truth.before
    at = min(len(q) // 2, len(q) - LOOKED)
    sent = [q[0, 3:], *(on_the_bus(robot.servo, np.asarray(c)) for c in commands)]
    seen = solver.stretch(q[at], v[at], sent[: at + 1], np.array(commands[at : at + LOOKED]))
    error = seen.wrench - truth.wrench[at : at + LOOKED]
    size = np.sqrt((truth.wrench**2).mean((0, 1)))
    return np.sqrt(((error / size) ** 2).mean((1, 2)))


def shorter_tail(robot: Robot) -> chain.Chain:
    """The robot's chain in the water of a tail that is a tenth shorter."""
    tail = robot.links[-1]
    short = replace(tail, length=SHORTER * tail.length, sections=tuple((SHORTER * s, h, w) for s, h, w in tail.sections))
    strips = chain.chain_of(robot, geometry_of(replace(robot, links=(*robot.links[:-1], short)))).strips
    return chain.chain_of(robot)._replace(strips=strips)
