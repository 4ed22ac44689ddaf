"""DAgger (dataset aggregation) for the water: a model is refitted in the states that its policy visits.

    roll out in the surrogate -> the flow solver swims the same states -> do the returns agree? else aggregate, refit, ...

A fitted water is accurate for the campaign's movements, and a policy soon leaves these. In each round the policy therefore acts
in the present surrogate, and the solver, as the expert, computes the water there. The new segments join all earlier ones, and the
next model is fitted to all (Ross, Gordon, Bagnell 2011, arXiv 1011.0686; for models of dynamics Ross, Bagnell 2012,
arXiv 1203.1007). The policy itself is not trained here; `fishmj train --correct` trains it anew before each round.

Each episode yields two segments: the whole episode, steered by the policy in the solver from the same start, which gives the
return; and a short one from the state of the surrogate half-way, which the policy may never reach in the solver. Every sixth
episode of a round validates, and of fewer the last. Segments, models and rows of finished rounds are kept: the same call
continues with them.

    fishmj hydro_fit correct paper --device cuda --out runs/correct

Nothing is written outside --out: the data sets of earlier fits are only read, and the rounds' segments have one of their own.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj import control
from fishmj.base import console, interrupt
from fishmj.base.calib import OWN, constant
from fishmj.base.cores import usable_cores
from fishmj.base.errors import ConfigError, DatasetError
from fishmj.base.store import read_json, write_json
from fishmj.base.store.atomic import same_as_begun
from fishmj.base.store.manifest import shipped
from fishmj.base.workers import ask_all
from fishmj.engines.extensions import Extensions
from fishmj.engines.single import SingleFish
from fishmj.hydro_fit.campaign.data import plan as plans
from fishmj.hydro_fit.campaign.data.collect import ON_GPU, Local, Pool, collect, tanks_on
from fishmj.hydro_fit.campaign.data.plan import CampaignPlan
from fishmj.hydro_fit.campaign.data.run_segments import Setup
from fishmj.hydro_fit.campaign.data.segment import Segment, drive, ticks_of
from fishmj.hydro_fit.segment_dataset import SEGMENTS, SegmentDataset, open_dataset, open_each
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY
from fishmj.lbm_oracle.run.run_log import flow_at_links
from fishmj.lbm_oracle.run.solver_water import SolverWater, boundary_name, water_of_fit
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.mjcf.servos import arrived_of, on_the_bus
from fishmj.tasks import station_hold as task
from fishmj.water import residual_hooks
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import flat

AGREED = 0.05  # of the solver's mean return
LEAST = 0.1  # of the reward at the target: a return near zero, where approach and effort cancel, is no yardstick
SWIMS = 1200.0  # s of swims in a fit
DRAWS = 10_000  # of a bootstrap
FEW = 60.0  # s of swims in all, which take less time here than other processes need to start
BEGUN = "correct.json"  # options of a correction, in its folder
SHORT = 3.0  # s, of the segment from the surrogate's state half-way


class Surrogate(SingleFish):
    """One fish in the strip water, by bus ticks, for roll-outs of a policy. water: coefficients. learnt: a residual, or None.

    A `Drive` reads its state as that of a `Run`.
    """

    def __init__(
        self, robot: Robot, ch: planar_chain.Chain, water: strip_forces.Coefficients, *, learnt=None, pose=(0.0, 0.0, 0.0)
    ):
        nets = () if learnt is None else (learnt,)
        added = Extensions(None, np.zeros(0), np.array(residual_hooks.at_rest() if nets else []), nets, robot)
        super().__init__(ch, planar_chain.nominal(robot)._replace(water=water), added)
        self.robot, self.steps = robot, round(robot.timing.bus_dt / ch.dt)
        self.delay = round(robot.timing.command_latency / ch.dt)
        self.q, self.v = np.array([*pose, *np.zeros(ch.n - 1)], float), np.zeros(ch.n + 2)
        self.commands, self.ticks = [np.zeros(ch.n - 1)], 0

    def tick(self, command, flow) -> None:
        """Advances 20 ms after sending `command`, (J,) rad; `flow` (N, 2) m/s at the links."""
        stream = [tuple(u) for u in np.asarray(flow).tolist()]
        self.commands.append(on_the_bus(self.robot.servo, np.asarray(command, float)))
        ramp = self.robot.timing.command_path == "move_time"
        for i in range(self.steps):
            target = arrived_of(self.commands, self.ticks * self.steps + i, self.delay, self.steps, ramp)
            s = self.advance(list(self.q), list(self.v), list(target), stream, (0.0, 0.0))
            self.q, self.v = np.array(s.q), np.array(s.v)
        self.ticks += 1

    @property
    def pose(self) -> np.ndarray:
        """Pose and rates (x, y, yaw, x', y', yaw') of the reference point, m and rad."""
        return np.concatenate([self.q[:3], self.v[:3]])

    def angles(self) -> np.ndarray:
        """Joint angles (J,) rad."""
        return self.q[3:].copy()

    def rates(self) -> np.ndarray:
        """Joint rates (J,) rad/s."""
        return self.v[3:].copy()


class Rollout(NamedTuple):
    """One episode in the surrogate: states after every tick, (T, 3 + J)."""

    q: np.ndarray
    v: np.ndarray


def roll_out(robot: Robot, model: HydroModel, segment: Segment) -> Rollout:
    """Swims the segment's drive in the surrogate instead of the solver; the settling is included but not returned."""
    fish = Surrogate(robot, planar_chain.chain_of(robot), model.swimmer(robot).water, learnt=model.learnt, pose=segment.pose)
    if segment.velocity:
        fish.v[:] = segment.velocity
    if segment.joints:
        fish.q[3:], fish.commands[0] = segment.joints, np.array(segment.joints)
    moved, states = drive(segment, robot), []
    before, end = ticks_of(segment, robot)
    for k in range(end):
        now = flow_at_links(segment.flow, robot, fish.q[None], np.array([k * robot.timing.bus_dt]))[0]
        fish.tick(moved.command(k, fish), now)
        states.append((fish.q.copy(), fish.v.copy()))
    q, v = (np.array(column) for column in zip(*states[before:], strict=True))
    return Rollout(q, v)


def roll_outs(robot: Robot, model: HydroModel, segments: Sequence[Segment]) -> list[tuple[Segment, Rollout]]:
    """Each segment with its swim in the surrogate, on all cores."""
    total, found = sum(one.seconds for one in segments), {}
    with console.Progress(total, "roll out", unit="sim s") as bar:
        jobs = usable_cores() if total > FEW else 1
        for k, rolled in ask_all(list(enumerate(segments)), partial(_numbered, robot, model), jobs):
            found[k] = rolled
            bar.update(sum(segments[i].seconds for i in found))
    return [(segment, found[k]) for k, segment in enumerate(segments)]


def _numbered(robot: Robot, model: HydroModel, one: tuple[int, Segment]) -> tuple[int, Rollout]:
    return one[0], roll_out(robot, model, one[1])


def mean_return(robot: Robot, segment: Segment, q: np.ndarray, v: np.ndarray) -> float:
    """Mean reward of a control step of the station-holding task, exact states, (T, 3 + J)."""
    every = round(robot.timing.control_dt / robot.timing.bus_dt)
    steps = len(q) // every
    far = np.linalg.norm(q[every - 1 : steps * every : every, :2] - np.asarray(segment.drive["target"], float), axis=-1)
    return float(np.mean(task.reward(np, far, v[: steps * every, 3:].reshape(steps, every, -1))))


def late_square(robot: Robot, segment: Segment, q: np.ndarray, v: np.ndarray) -> float:
    """Mean square of the distance from the target in the second half, m2; arguments of `mean_return`."""
    far = q[len(q) // 2 :, :2] - np.asarray(segment.drive["target"], float)
    return float(np.mean(np.sum(far * far, -1)))


def round_plan(robot: Robot, policy: str, rolls: list[tuple[Segment, Rollout]], number: int) -> CampaignPlan:
    """Plan of a round: each episode, and a short segment from the surrogate's state half-way through it."""
    segments = []
    for segment, rolled in rolls:
        at = len(rolled.q) // 2
        start: dict = {"pose": tuple(rolled.q[at, :3].tolist()), "joints": tuple(rolled.q[at, 3:].tolist())}
        start |= {"velocity": tuple(rolled.v[at].tolist()), "seconds": min(SHORT, segment.seconds), "settle": 0.0}
        segments += [segment, replace(segment, id=f"{segment.id}_mid", **start)]
    return CampaignPlan(label=f"round {number} of {policy}", robot=robot, seed=number, segments=tuple(segments))


def correct(
    policy: "str | Callable[[int, HydroModel], str]", robot: Robot, model: HydroModel, folder: Path, setup: Setup, *,
    refit: Callable[[HydroModel, Path], HydroModel],
    rounds: int = 5, episodes: int = 4, seconds: float = 20.0, speeds: tuple[float, float] | None = None,
    pool: Pool | None = None,
) -> dict:  # fmt: skip
    """Collects, compares and refits until the returns agree within `AGREED` or the rounds are over.

    Args:
        policy: name or file, or a function of round and model that returns the one of that round.
        model: the surrogate at the start.
        folder: folder of the rounds: `solver`, a data set that grows, and a model and a row of each round.
        refit: function of a round's model and the rounds' data set that returns the next model.
        speeds: m/s, bounds of the draw of the stream's speed; by default those of the campaign.
    Returns:
        rounds (a row each, as of `compare_returns`), agreed, model (the last one).
    Raises:
        ConfigError: a policy for another fish, or no round. DatasetError: the solver kept nothing of a round.
    """
    if rounds < 1 or episodes < 1:
        raise ConfigError(f"correct: {rounds} rounds of {episodes} episodes; expected 1 or more of each")
    rows: list[dict] = []
    for number in range(1, rounds + 1):
        kept = folder / f"round-{number}.json"
        row = read_json(kept) if kept.is_file() else {}
        helm = policy(number, model) if callable(policy) else policy
        made = f"{sha256_of(model)} {getattr(control.make(helm, robot), 'sha256', helm)}"
        if row.get("model") != made:
            sized = {"episodes": episodes, "seconds": seconds, "seed": number, "speeds": speeds}
            row = {"round": number} | _round(helm, robot, model, folder / "solver", setup, pool, **sized)
            write_json(kept, row | {"model": made})
        rows.append(row := {key: value for key, value in row.items() if key != "model"})
        console.say(
            f"round {number}: return {row['solver']:.3f} in the solver, {row['surrogate']:.3f} in the surrogate"
            f" ({100 * row['gap']:.1f} % apart)"
        )
        if row["gap"] <= AGREED or number == rounds:
            break
        model = _refitted(model, folder, row, refit)
    return {"rounds": rows, "agreed": rows[-1]["gap"] <= AGREED, "model": model}


def _round(policy, robot: Robot, model: HydroModel, solver: Path, setup: Setup, pool: Pool | None, **sized) -> dict:
    """Rolls out, solves and compares one round. sized: as of `plan.on_policy`, whose seed is the number of the round."""
    plan = plans.on_policy(robot, policy, slip=model.slip, **sized)
    rolls = roll_outs(robot, model, plan.segments)
    collect(round_plan(robot, policy, rolls, sized["seed"]), solver, setup, pool=pool)
    return compare_returns(robot, solver, rolls)


def _refitted(model: HydroModel, folder: Path, row: dict, refit: Callable[[HydroModel, Path], HydroModel]) -> HydroModel:
    """Model after a round; refitted if none is kept for this model and these segments."""
    place = folder / f"round-{row['round']}"
    made = {"from": sha256_of(model), "round": row}
    note = place / "made.json"
    if note.is_file() and read_json(note) == made:
        return HydroModel.load(place / f"{model.name}.toml")
    model = refit(model, folder / "solver")
    model.save(place)
    write_json(note, made)
    return model


def sha256_of(model: HydroModel) -> str:
    """sha256 of the coefficients and weights that determine how a fish swims in the model."""
    parts: list = [flat(model.base), *(() if model.learnt is None else (*model.learnt.net, *(model.learnt.reach or ())))]
    return hashlib.sha256(b"".join(np.asarray(part, np.float32).tobytes() for part in parts)).hexdigest()


def compare_returns(robot: Robot, folder: Path, rolls: list[tuple[Segment, Rollout]]) -> dict:
    """Both waters over the ticks that the solver kept.

    Returns:
        n episodes; mean return a control step in `solver` and `surrogate`; low, high: 95 % bootstrap interval of the mean of
        surrogate minus solver over the paired episodes; rmse_solver, rmse_surrogate: RMS distance from the target in the second
        half, m; gap: the difference over the solver's return.
    """
    data, pairs = open_dataset(folder), []
    for segment, rolled in rolls:
        if "file" not in data.about[segment.id]:
            continue
        record = data[segment.id]
        n = len(record.q)
        if n * robot.timing.bus_dt >= robot.timing.control_dt:
            both = [(q[:n], v[:n]) for q, v in ((record.q, record.v), (rolled.q, rolled.v))]
            pairs.append([f(robot, segment, q, v) for f in (mean_return, late_square) for q, v in both])
    if not pairs:
        raise DatasetError(f"{folder}: the solver kept no episode of this round: {data.lost()}")
    rows, least = np.array(pairs), LEAST * constant("reward", "wG")
    solver, surrogate, *squares = rows.mean(0).tolist()
    drawn = np.random.default_rng(0).integers(len(rows), size=(DRAWS, len(rows)))
    low, high = np.quantile((rows[:, 1] - rows[:, 0])[drawn].mean(1), [0.025, 0.975]).tolist()
    row = {"n": len(rows), "solver": solver, "surrogate": surrogate, "low": low, "high": high}
    row |= {"rmse_solver": squares[0] ** 0.5, "rmse_surrogate": squares[1] ** 0.5}
    return row | {"gap": abs(surrogate - solver) / max(abs(solver), least)}


def main(argv: list[str]) -> int:
    """Runs the verb `correct`; exit code 1 if the returns do not agree after the last round."""
    parser = console.parser("hydro_fit correct", __doc__)
    add = parser.add_argument
    add("policy", type=console.text, metavar="POLICY", help="name of a controller or a policy file")
    add("--fish", type=console.text, default="fish", help="a shipped name or a description (.toml)")
    add("--model", type=console.text, help="the surrogate to begin with: name or .toml; default that of the fish")
    sets = "data sets that it was fitted to, those of earlier corrections (OUT/solver) too; default data/hydro/<robot>; read only"
    add("--data", type=console.path, nargs="+", metavar="FOLDER", help=sets)
    place = "folder of the rounds and of the corrected model; goes on with what is there"
    add("--out", type=console.out_folder, default="runs/correct", help=place)
    add("--rounds", type=console.whole(1, 100), default=4, help="at most; it ends when the returns agree")
    add("--episodes", type=console.whole(1, 1000), default=6, help="of each round")
    add("--seconds", type=console.number(2, 600), default=20.0, help="of each episode")
    streams = "m/s, of the streams: bounds of a draw for each episode; default 0,0.35"
    add(
        "--flow-speeds",
        type=console.Listed(console.number(0, 5), 2, distinct=False, rising=True),
        metavar="LOW,HIGH",
        help=streams,
    )
    add("--domain", choices=EVERY, help="box of water; by default that of the model's segments; laptop is a preview")
    add("--device", type=console.devices, default="auto", help="auto, cpu, cuda, cuda:N, cuda:all or a list; default auto")
    tanks = f"segments side by side on each device; by default {ON_GPU} on a GPU, else 1"
    add("--tanks", type=console.whole(1, 1000), metavar="N", help=tanks)
    args = parser.parse_args(argv)
    robot, out = load_robot(args.fish), Path(args.out)
    began = HydroModel.load(args.model or robot.name)
    helm = control.make(args.policy, robot)  # a wrong name fails before anything else is looked at
    first = open_each(args.data or [shipped(OWN / "hydro" / robot.name)])
    tank = water_of_fit(began.dataset, began.slip, args.domain)
    warn_of_two_waters(first, tank)
    water = args.rounds * args.episodes * args.seconds
    less = "take fewer --rounds and --episodes; --domain laptop is a preview"
    work = [(tank.box, water)]
    solver_cost.agree("hydro_fit correct", args.device, work, instead=less, tanks=args.tanks or 1)
    devices = devices_of(args.device)
    setup = Setup(robot=robot, domain=tank.box, device=devices[0], sharpness=tank.sharpness)
    speeds = args.flow_speeds and (args.flow_speeds[0], args.flow_speeds[-1])
    sized = {"episodes": args.episodes, "seconds": args.seconds, "speeds": speeds}
    begun = {"policy": getattr(helm, "sha256", args.policy), "model": sha256_of(began), "domain": tank.box.name}
    same_as_begun(out / BEGUN, begun | {"data": [data.sha256 for data in first]} | sized)
    pool = Local(tanks_on(devices[0], args.tanks), devices)
    refit = lambda model, solver: refitted(robot, model, first, solver, out)
    with interrupt.keeping(lambda: kept_words(out)):
        found = correct(args.policy, robot, began, out, setup, refit=refit, pool=pool, rounds=args.rounds, **sized)
    path = found["model"].save(out)
    console.say(console.table(found["rounds"]), f"model: {path}, refitted {len(found['rounds']) - 1} times")
    if not found["agreed"]:
        gap = found["rounds"][-1]["gap"]
        console.warn(
            f"the returns are {gap:.1%} apart, expected at most {AGREED:.0%}; the last round judges and is not fitted:"
            f" take more --rounds than {args.rounds}"
        )
    if args.json:
        console.emit_json({"rounds": found["rounds"], "agreed": found["agreed"], "model": str(path)})
    return console.OK if found["agreed"] else console.FAILED_CHECK


def warn_of_two_waters(first: Sequence[SegmentDataset], tank: SolverWater) -> None:
    """Warns of each data set that was solved in another box or boundary than the rounds' tank."""
    for data in first:
        if told := data.other_water({"domain": tank.domain, "boundary": boundary_name(tank.sharpness)}):
            console.warn(told)


def kept_words(out: Path) -> str:
    """Text of an interrupted correction."""
    rounds, swims = (len(list(out.glob(kind))) for kind in ("round-*.json", f"solver/{SEGMENTS}/*.json"))
    return f"{out} holds {rounds} finished rounds and {swims} segments of the solver; {interrupt.again()}"


def refitted(
    robot: Robot, model: HydroModel, first: Sequence[SegmentDataset], solver: Path, out: Path, *, swims: float = SWIMS
) -> HydroModel:
    """Model refitted to the free swims of all rounds and, thinned to `swims` s in all, of the first data sets.

    Args:
        out: folder of the rounds; finished stages of the fit are kept there.
    """
    from fishmj.hydro_fit.fit.gauss_newton import flaps
    from fishmj.hydro_fit.fit.incremental import Refit
    from fishmj.hydro_fit.fit.rollout import is_free
    from fishmj.hydro_fit.fit.training_loop import use_cores_as_devices

    use_cores_as_devices()
    keep = lambda r: not r.meta.get("replicate_of") and (is_free(r) or flaps(r))
    of = lambda sets, split: [r for data in sets for r in data.records(split, slip=model.slip) if keep(r)]
    added = open_dataset(solver)
    new, old = ({split: of(sets, split) for split in ("train", "val")} for sets in ([added], first))
    room = max(swims - sum(r.seconds for r in new["train"]), swims / 3)
    every = max(1, ceil(sum(r.seconds for r in old["train"]) / room))
    water = {key: model.dataset[key] for key in ("grid", "boundary") if key in model.dataset}
    before = ", ".join(data.sha256 for data in first)
    made = {"sha256": added.sha256, "folder": solver.name, "first": before, "origin": "synthetic"} | water
    again = Refit(robot, model, new["train"] + old["train"][::every], (old["val"], new["val"]), dataset=made, folder=out / "fit")

    def words() -> str:
        again.loop.save()  # the stage that is under way
        return kept_words(out)

    with interrupt.keeping(words):
        return replace(again.run(), name=model.name)
