"""Cases of the benchmark of `gap find --model`, drawn from its seed, and their data sets on disk.

    sets/
      rows.jsonl            what is in each set, a line each: kind, generator, robot, hidden effects, how much they show
      3-0007/robot.xml      the model in question
      3-0007/logs/*.npz     t, command_1.., position_1..: what `fishmj gap find 3-0007/logs --model 3-0007/robot.xml` takes

All data are *synthetic*. A case is one robot, drawn within the tolerances of its description, with its logs.
"""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.store import write_npz, write_text
from fishmj.gap.bench.cases import draw_card, spread
from fishmj.gap.laboratory.articulated import robot_session
from fishmj.gap.laboratory.articulated.hidden_faults import FAULTS
from fishmj.gap.laboratory.articulated.robot_plan import QUADROTOR, mjcf, rotor

KINDS = {"single": 0.52, "pair": 0.06, "none": 0.29, "off": 0.13}  # shares
FAMILIES = {"pendulum": 0.3, "two_link": 0.45, "arm": 0.17, "legs": 0.08}  # shares
MORE = {QUADROTOR: 1.0}  # families that --robots must name: a benchmark without them stays what it was
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
LOGS, SECONDS = 4, 4.5  # of a case; s of a log
FIRST = 1_000_000  # seeds of one benchmark's cases


class RobotCase(NamedTuple):
    """One data set to come. effects: names of what is hidden, their sites and sizes drawn later."""

    id: str
    kind: str  # single, pair, none, off
    generator: str
    family: str
    effects: tuple[str, ...]
    seed: int


def draw_cases(count: int, seed: int, generators: tuple[str, ...], families: tuple[str, ...], kinds=None) -> list[RobotCase]:
    """Draws `count` cases: kinds and robots in their shares, generators in turn, effects from shuffled decks."""
    rng = np.random.default_rng([seed, 51])
    shares = KINDS if kinds is None else {kind: KINDS[kind] for kind in kinds}
    order = spread(count, shares, rng)
    decks: dict[tuple[str, str], list[str]] = {}
    robots = spread(count, {name: (FAMILIES | MORE)[name] for name in families}, rng)
    out = []
    for i, (kind, family) in enumerate(zip(order, robots, strict=True)):
        mine = np.random.default_rng([seed, 52, i])
        generator = generators[
            int(np.random.default_rng([seed, 53, i // len(generators)]).permutation(len(generators))[i % len(generators)])
        ]
        if family == QUADROTOR and generator == robot_session.BAM:  # servo laws do not fly
            generator = robot_session.MUJOCO
        pool = list(robot_session.able(generator, kind == "off", family))
        deck = decks.setdefault((generator, f"{kind} of {QUADROTOR}" if family == QUADROTOR else kind), [])
        if kind == "pair":
            effects = tuple(str(n) for n in mine.choice(pool, 2, replace=False))
        else:
            effects = () if kind == "none" else (draw_card(deck, pool, mine),)
        if generator == robot_session.BAM and family not in robot_session.SMALL:
            family = robot_session.SMALL[int(mine.integers(len(robot_session.SMALL)))]
        if family == "pendulum" and any(name in FAULTS and FAULTS[name].coupled for name in effects):
            family = "two_link"
        out.append(RobotCase(f"{seed}-{i:04d}", kind, generator, family, effects, FIRST * (seed + 1) + 100 * i))
    return out


def facts(case: RobotCase) -> dict:
    """Entries of a row that are known before a data set is made. Two rows of one id that differ in them are of two benchmarks."""
    return {"id": case.id, "kind": case.kind, "generator": case.generator, "asked": list(case.effects), "seed": case.seed}


def make_set(folder: Path, case: RobotCase) -> dict:
    """Writes the data set of one case. Returns its row: DIVERGED where no drawn robot stays within reach."""
    begin = time.process_time()
    row = facts(case)
    try:
        session = robot_session.draw_session(case.generator, case.family, case.effects, case.seed, LOGS, SECONDS)
    except FloatingPointError as error:
        return row | {"family": case.family, "answer": "DIVERGED", "reason": str(error)}
    place = folder / case.id
    (place / "logs").mkdir(parents=True, exist_ok=True)
    write_text(place / "robot.xml", mjcf(session.plan))
    for i, log in enumerate(session.logs):
        columns = {"command": log.commands, "position": log.readings}
        if session.plan.rotors:
            columns = {f"cmd_{rotor(k)}": u for k, u in enumerate(log.commands.T)} | dict(zip(POSE, log.readings.T, strict=True))
        write_npz(place / "logs" / f"log{i + 1}.npz", {"t": log.t} | {k: v.astype(np.float32) for k, v in columns.items()})
    row |= {
        "family": session.plan.family,
        "joints": 0 if session.plan.rotors else len(session.plan.limbs),
        "torques": session.plan.torques,
        "servo": session.servo,
    }
    row |= {"truth": session.hidden, "visible": session.visible, "stand": session.stand._asdict()}
    return row | {"data_cpu_seconds": time.process_time() - begin}
