"""DAgger (dataset aggregation) for the water: a model is fitted again where the policy that uses it goes.

    roll out in the surrogate -> the flow solver swims the same states -> do the returns agree? else aggregate, refit, ...

A water fitted once is right where the campaign's movements were, and a policy soon leaves them. So in each round the policy
acts in the present surrogate; the solver, as the expert, says what the water does there; the new segments join all earlier ones,
and the next model is fitted to the lot (Ross, Gordon, Bagnell 2011, arXiv 1011.0686; for models of dynamics Ross, Bagnell 2012,
arXiv 1203.1007). The policy itself is not trained here.

    found = correct("paper", robot, model, folder, setup, refit=refit)       until the returns differ by less than `AGREED`

Each episode yields two segments: the whole of it, steered by the policy in the solver from the same start, from which the return
is judged, and a short one from the state that the surrogate was in half-way, where the solver may never have taken the policy.
The last episode of a round validates. Segments, models and rows of finished rounds are kept: the same call goes on with them.

    python -m fishmj.hydro_fit correct POLICY --domain window_coarse --device cuda --out runs/correct
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj import console
from fishmj.calib import constant
from fishmj.campaign.data import plan as plans
from fishmj.campaign.data.collect import Pool, collect
from fishmj.campaign.data.joint_commands import drive, ticks_of
from fishmj.campaign.data.plan import Plan
from fishmj.campaign.data.run_segments import Setup, flow_at_links
from fishmj.campaign.data.segment import Segment
from fishmj.campaign.hybrid.hybrid import Surrogate
from fishmj.dynamics import planar_chain
from fishmj.errors import ConfigError, DatasetError
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.mjcf.description import Robot
from fishmj.store import read_json, write_json
from fishmj.tasks import station_hold as task
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import flat

AGREED = 0.05  # of the solver's mean return
LEAST = 0.1  # of the reward at the target: a return near zero, where approach and effort cancel, is no yardstick
SHORT = 3.0  # s, of the segment from the surrogate's state half-way


class Rollout(NamedTuple):
    """One episode in the surrogate: states after every tick, (T, 3 + J)."""

    q: np.ndarray
    v: np.ndarray


class PolicyDriver:
    """The part of a `Run` that a `Drive` reads, of a surrogate."""

    def __init__(self, fish: Surrogate):
        self.fish = fish

    @property
    def pose(self) -> np.ndarray:
        return np.concatenate([self.fish.q[:3], self.fish.v[:3]])

    def angles(self) -> np.ndarray:
        return self.fish.q[3:].copy()

    def rates(self) -> np.ndarray:
        return self.fish.v[3:].copy()


def roll_out(robot: Robot, model: HydroModel, segment: Segment) -> Rollout:
    """The segment's drive, in the surrogate instead of the solver, settling included but not returned."""
    fish = Surrogate(robot, planar_chain.chain_of(robot), model.swimmer(robot).water, learnt=model.learnt, pose=segment.pose)
    if segment.velocity:
        fish.v[:] = segment.velocity
    if segment.joints:
        fish.q[3:], fish.commands[0] = segment.joints, np.array(segment.joints)
    driver, moved = PolicyDriver(fish), drive(segment, robot)
    states = []
    before, end = ticks_of(segment, robot)
    for k in range(end):
        now = flow_at_links(segment, robot, fish.q[None], np.array([k * robot.timing.bus_dt]))[0]
        fish.tick(moved.command(k, driver), now)
        states.append((fish.q.copy(), fish.v.copy()))
    q, v = (np.array(column) for column in zip(*states[before:], strict=True))
    return Rollout(q, v)


def mean_return(robot: Robot, segment: Segment, q: np.ndarray, v: np.ndarray) -> float:
    """Mean reward of a control step of the station-holding task, exact states, (T, 3 + J)."""
    every = round(robot.timing.control_dt / robot.timing.bus_dt)
    steps = len(q) // every
    far = np.linalg.norm(q[every - 1 : steps * every : every, :2] - np.asarray(segment.drive["target"], float), axis=-1)
    return float(np.mean(task.reward(np, far, v[: steps * every, 3:].reshape(steps, every, -1))))


def round_plan(robot: Robot, policy: str, rolls: list[tuple[Segment, Rollout]], number: int) -> Plan:
    """The segments of a round: each episode, and a short one from the surrogate's state half-way through it."""
    segments = []
    for segment, rolled in rolls:
        at = len(rolled.q) // 2
        start: dict = {"pose": tuple(rolled.q[at, :3].tolist()), "joints": tuple(rolled.q[at, 3:].tolist())}
        start |= {"velocity": tuple(rolled.v[at].tolist()), "seconds": min(SHORT, segment.seconds), "settle": 0.0}
        segments += [segment, replace(segment, id=f"{segment.id}_mid", **start)]
    return Plan(label=f"round {number} of {policy}", robot=robot, seed=number, segments=tuple(segments))


def correct(
    policy: str, robot: Robot, model: HydroModel, folder: Path, setup: Setup, *, refit: Callable[[HydroModel, Path], HydroModel],
    rounds: int = 5, episodes: int = 4, seconds: float = 20.0, pool: Pool | None = None,
) -> dict:  # fmt: skip
    """Collect, compare, refit, until the returns agree within `AGREED` or the rounds are over.

    Args:
        model: the surrogate at the start. folder: of the rounds: `solver`, a data set that grows, and a model and a row of each.
        refit: from the model of a round and the rounds' data set, the next model.
    Returns:
        rounds (a row each: returns of solver and surrogate, gap), agreed, model (the last one).
    Raises:
        ConfigError: a policy that does not know the fish, or no round. DatasetError: the solver kept nothing of a round.
    """
    if rounds < 1 or episodes < 1:
        raise ConfigError(f"correct: {rounds} rounds of {episodes} episodes; expected 1 or more of each")
    rows: list[dict] = []
    for number in range(1, rounds + 1):
        kept = folder / f"round-{number}.json"
        row = read_json(kept) if kept.is_file() else {}
        if row.get("model") != (made := sha256_of(model)):
            row = {"round": number} | _round(policy, robot, model, folder / "solver", setup, number, episodes, seconds, pool)
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


def _round(policy, robot: Robot, model: HydroModel, solver: Path, setup: Setup, number: int, episodes, seconds, pool) -> dict:
    """Roll out, solve, compare."""
    plan = plans.on_policy(robot, policy, episodes=episodes, seconds=seconds, seed=number, slip=model.slip)
    rolls = [(segment, roll_out(robot, model, segment)) for segment in plan.segments]
    collect(round_plan(robot, policy, rolls, number), solver, setup, pool=pool, quiet=True)
    return compare_returns(robot, solver, rolls)


def _refitted(model: HydroModel, folder: Path, row: dict, refit: Callable[[HydroModel, Path], HydroModel]) -> HydroModel:
    """The model after a round, as it is kept; refitted where none is kept for this model and what it did."""
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
    """Of what decides how a fish swims in it."""
    parts: list = [flat(model.base), *(() if model.learnt is None else (*model.learnt.net, *(model.learnt.reach or ())))]
    return hashlib.sha256(b"".join(np.asarray(part, np.float32).tobytes() for part in parts)).hexdigest()


def compare_returns(robot: Robot, folder: Path, rolls: list[tuple[Segment, Rollout]]) -> dict:
    """Mean return in both waters over the ticks that the solver kept, and their difference over the solver's."""
    data, pairs = open_dataset(folder), []
    for segment, rolled in rolls:
        if "file" not in data.about[segment.id]:
            continue
        record = data[segment.id]
        n = len(record.q)
        if n * robot.timing.bus_dt >= robot.timing.control_dt:
            pairs.append([mean_return(robot, segment, q[:n], v[:n]) for q, v in ((record.q, record.v), (rolled.q, rolled.v))])
    if not pairs:
        raise DatasetError(f"{folder}: the solver kept no episode of this round: {data.lost()}")
    (solver, surrogate), least = np.mean(pairs, 0).tolist(), LEAST * constant("reward", "wG")
    return {"n": len(pairs), "solver": solver, "surrogate": surrogate, "gap": abs(surrogate - solver) / max(abs(solver), least)}
