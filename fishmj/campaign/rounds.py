"""Rounds of correction: what a policy does in the surrogate is replayed in the flow solver, added to the data, and refitted.

    roll in the surrogate -> its states and commands become segments of the solver -> do the returns agree? else refit -> ...

    found = correct("paper", robot, model, folder, setup, refit=refit)       until the returns differ by less than `AGREED`

Each episode yields two segments: the whole of it, steered by the policy in the solver from the same start, from which the return
is judged, and a short one from the state that the surrogate was in half-way, where the solver may never have taken the policy.

    python -m fishmj.hydro_fit correct POLICY --data data/hydro/swift --device cuda
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj import console
from fishmj.campaign import plan as plans
from fishmj.campaign.collect import Pool, collect
from fishmj.campaign.command import ON_GPU, Local
from fishmj.campaign.drives import drive, ticks_of
from fishmj.campaign.hybrid import Surrogate
from fishmj.campaign.plan import Plan
from fishmj.campaign.segment import Segment
from fishmj.campaign.tank import Setup, flow_at_links
from fishmj.errors import ConfigError, DatasetError
from fishmj.hydro_fit import chain
from fishmj.hydro_fit.dataset import open_dataset
from fishmj.hydro_fit.model import HydroModel
from fishmj.lbm_oracle.device import device_of
from fishmj.lbm_oracle.domain import preset
from fishmj.mjcf.description import Robot, load_robot
from fishmj.tasks import station_hold as task

AGREED = 0.05  # of the solver's mean return
SHORT = 3.0  # s, of the segment from the surrogate's state half-way


class Rolled(NamedTuple):
    """One episode in the surrogate: states after every tick, (T, 3 + J)."""

    q: np.ndarray
    v: np.ndarray


class AtTheHelm:
    """What a `Drive` asks of a run, answered by a surrogate."""

    def __init__(self, fish: Surrogate):
        self.fish = fish

    @property
    def pose(self) -> np.ndarray:
        return np.concatenate([self.fish.q[:3], self.fish.v[:3]])

    def angles(self) -> np.ndarray:
        return self.fish.q[3:].copy()

    def rates(self) -> np.ndarray:
        return self.fish.v[3:].copy()


def roll(robot: Robot, model: HydroModel, segment: Segment) -> Rolled:
    """The segment's drive, in the surrogate instead of the solver, settling included but not returned."""
    fish = Surrogate(robot, chain.chain_of(robot), model.swimmer(robot).water, learnt=model.learnt, pose=segment.pose)
    if segment.velocity:
        fish.v[:] = segment.velocity
    if segment.joints:
        fish.q[3:], fish.commands[0] = segment.joints, np.array(segment.joints)
    helm, moved, states = AtTheHelm(fish), drive(segment, robot), []
    before, end = ticks_of(segment, robot)
    for k in range(end):
        now = flow_at_links(segment, robot, fish.q[None], np.array([k * robot.timing.bus_dt]))[0]
        fish.tick(moved.command(k, helm), now)
        states.append((fish.q.copy(), fish.v.copy()))
    q, v = (np.array(column) for column in zip(*states[before:], strict=True))
    return Rolled(q, v)


def returned(robot: Robot, segment: Segment, q: np.ndarray, v: np.ndarray) -> float:
    """Mean reward of a control step of the station-holding task, exact states, (T, 3 + J)."""
    every = round(robot.timing.control_dt / robot.timing.bus_dt)
    steps = len(q) // every
    far = np.linalg.norm(q[every - 1 : steps * every : every, :2] - np.asarray(segment.drive["target"], float), axis=-1)
    return float(np.mean(task.reward(np, far, v[: steps * every, 3:].reshape(steps, every, -1))))


def round_plan(robot: Robot, policy: str, rolls: list[tuple[Segment, Rolled]], number: int) -> Plan:
    """The segments of a round: each episode, and a short one from the surrogate's state half-way through it."""
    segments = []
    for segment, rolled in rolls:
        at = len(rolled.q) // 2
        start: dict = {"pose": tuple(rolled.q[at, :3].tolist()), "joints": tuple(rolled.q[at, 3:].tolist())}
        start |= {"velocity": tuple(rolled.v[at].tolist()), "seconds": min(SHORT, segment.seconds), "settle": 0.0}
        segments += [segment, replace(segment, id=f"{segment.id}_mid", **start)]
    return Plan(label=f"round {number} of {policy}", robot=robot, seed=number, segments=tuple(segments))


def correct(
    policy: str, robot: Robot, model: HydroModel, folder: Path, setup: Setup, *, refit: Callable[[], HydroModel],
    rounds: int = 5, episodes: int = 4, seconds: float = 20.0, pool: Pool | None = None,
) -> dict:  # fmt: skip
    """Collect, compare, refit, until the returns agree within `AGREED` or the rounds are over.

    Args:
        model: the surrogate at the start. folder: data set that grows. refit: fits a model to the data set as it is then.
    Returns:
        rounds (a row each: returns of solver and surrogate, gap), agreed, model (the last one).
    Raises:
        ConfigError: a policy that does not know the fish, or no round. DatasetError: the solver kept nothing of a round.
    """
    if rounds < 1 or episodes < 1:
        raise ConfigError(f"correct: {rounds} rounds of {episodes} episodes; expected 1 or more of each")
    rows = []
    for number in range(1, rounds + 1):
        plan = plans.on_policy(robot, policy, episodes=episodes, seconds=seconds, seed=number, slip=model.slip)
        rolls = [(segment, roll(robot, model, segment)) for segment in plan.segments]
        collect(round_plan(robot, policy, rolls, number), folder, setup, pool=pool, quiet=True)
        rows.append({"round": number} | compared(robot, folder, rolls))
        agreed = rows[-1]["gap"] <= AGREED
        console.say(
            f"round {number}: return {rows[-1]['solver']:.3f} in the solver, {rows[-1]['surrogate']:.3f} in the surrogate"
            f" ({100 * rows[-1]['gap']:.1f} % apart)"
        )
        if agreed or number == rounds:
            break
        model = refit()
    return {"rounds": rows, "agreed": agreed, "model": model}


def compared(robot: Robot, folder: Path, rolls: list[tuple[Segment, Rolled]]) -> dict:
    """Mean return in both waters over the ticks that the solver kept, and their difference over the solver's."""
    data, pairs = open_dataset(folder), []
    for segment, rolled in rolls:
        if "file" not in data.about[segment.id]:
            continue
        record = data[segment.id]
        n = len(record.q)
        if n * robot.timing.bus_dt >= robot.timing.control_dt:
            pairs.append([returned(robot, segment, q[:n], v[:n]) for q, v in ((record.q, record.v), (rolled.q, rolled.v))])
    if not pairs:
        raise DatasetError(f"{folder}: the solver kept no episode of this round: {data.lost()}")
    solver, surrogate = np.mean(pairs, 0).tolist()
    return {"n": len(pairs), "solver": solver, "surrogate": surrogate, "gap": abs(surrogate - solver) / max(abs(solver), 1e-9)}


def main(argv: list[str]) -> int:
    """The verb `correct`; exit code 1 where the returns do not agree after the last round."""
    from fishmj.hydro_fit.fit.recipe import Fit, Settings

    parser = console.parser("hydro_fit correct", "Correct a surrogate where a policy takes it.")
    parser.add_argument("policy", metavar="POLICY", help="name of a controller or a policy file")
    parser.add_argument("--fish", default="fish", help="a shipped name or a description (.toml)")
    parser.add_argument("--model", default="swift", help="the surrogate to begin with: name or .toml")
    parser.add_argument("--data", required=True, help="data set that the rounds are added to; copy a shipped one first")
    parser.add_argument("--out", required=True, help="folder of the corrected model")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--domain", default="window")
    parser.add_argument("--device", default="auto")
    args = parser.parse_args(argv)
    robot, folder, began = load_robot(args.fish), Path(args.data), HydroModel.load(args.model)
    setup = Setup(robot=robot, domain=preset(args.domain), device=str(device_of(args.device)))

    def refit() -> HydroModel:
        data = open_dataset(folder)
        parts = [[r for r in data.records(split, slip=began.slip)] for split in ("train", "val")]
        settings = Settings(residual=began.learnt is not None)
        return replace(Fit(robot, *parts, dataset={"sha256": data.sha256}, settings=settings).run(), name=began.name)

    sized = {"rounds": args.rounds, "episodes": args.episodes, "seconds": args.seconds}
    pool = Local(ON_GPU if setup.device.startswith("cuda") else 1)
    found = correct(args.policy, robot, began, folder, setup, refit=refit, pool=pool, **sized)
    path = found["model"].save(args.out)
    console.say(console.table(found["rounds"]), f"model: {path}")
    if args.json:
        console.emit_json({"rounds": found["rounds"], "agreed": found["agreed"], "model": str(path)})
    return console.OK if found["agreed"] else console.FAILED_CHECK
