"""DAgger near still water: episodes of policies in the flow solver's water, and a refit of the fitted water to them.

    python -m studies.fitted_water.still_rounds solve POLICY [POLICY ..] --water W --seed 4300 --seconds 25 --out runs/one
    python -m studies.fitted_water.still_rounds refit --water W --data REFERENCE EARLIER --rounds runs/one --out runs/water-1
    python -m studies.fitted_water.still_rounds drift --water W --rounds runs/one

`drift` swims pieces of 4 s in the fit from the solver's states, after the first 10 s, and prints by how much the velocity of
the last second is off. `solve` needs a GPU (24 tanks; 84 s on one H200), `refit` does not (1,200 s of swims: 2.5 min on two
cores). The solver's water is that of the fit: its box, boundary and slip ratio. It differs from `fishmj hydro_fit correct` in
its streams: every second episode is in water at rest, without turbulence, the others below `--fastest`. `--middle` adds
the short segments from the fit's states half-way. `--most` is the limit of swims in a fit. *synthetic*
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.hydro_fit.campaign.dagger import dagger
from fishmj.hydro_fit.campaign.data import plan as plans
from fishmj.hydro_fit.campaign.data.collect import Local, collect
from fishmj.hydro_fit.campaign.data.run_segments import Setup
from fishmj.hydro_fit.campaign.data.segment import Segment
from fishmj.hydro_fit.fit import rollout
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.lbm_oracle.fluid.device import devices_of
from fishmj.lbm_oracle.run.solver_water import water_of_fit
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import flat

EPISODES = 24
VALIDATE = (4, 11, 16, 23)  # two of either kind
SETTLED, SWIM = 10.0, 4.0  # s of an episode that `drift` leaves out; of a piece


def episodes(robot: Robot, policies: list[str], seed: int, seconds: float, slip: float, fastest: float) -> list[Segment]:
    """Episodes in still water and in streams below `fastest` (m/s) in turn, two of each policy."""
    drawn = [plans.on_policy(robot, policy, episodes=EPISODES, seconds=seconds, seed=seed, slip=slip) for policy in policies]
    made = []
    for k in range(EPISODES):
        rest, segment = k % 2 == 0, drawn[k // 2 % len(policies)].segments[k]
        flow = replace(segment.flow, speed=0.0 if rest else fastest * (k % 12) / 12)
        flow = replace(flow, turbulence="none") if rest else flow
        made.append(replace(segment, flow=flow, split="val" if k in VALIDATE else "train"))
    return made


def solve(given) -> int:
    """Swims the episodes in the fitted water and in the solver, and prints the mean returns of both."""
    robot, model = load_robot("fish"), HydroModel.load(given.water)
    drawn = episodes(robot, given.policies, given.seed, given.seconds, model.slip, given.fastest)
    rolls = dagger.roll_outs(robot, model, drawn)
    plan = dagger.round_plan(robot, ", ".join(given.policies), rolls, given.seed)
    if not given.middle:
        plan = replace(plan, segments=tuple(segment for segment, _ in rolls))
    devices, tank = devices_of(given.device), water_of_fit(model.dataset, model.slip)
    setup = Setup(robot=robot, domain=tank.box, device=devices[0], sharpness=tank.sharpness)
    collect(plan, given.out, setup, pool=Local(EPISODES // len(devices), devices))
    console.say(console.table([dagger.compare_returns(robot, given.out, rolls)]))
    return console.OK


def refit(given) -> int:
    """Refits the water to the rounds and the earlier data sets."""
    first = [open_dataset(folder) for folder in given.data]
    model = HydroModel.load(given.water)
    made = dagger.refitted(load_robot("fish"), model, first, given.rounds, given.out, swims=given.most)
    console.say(f"wrote {made.save(given.out)}", made.notes)
    return console.OK


def drift(given) -> int:
    """Swims 4 s in the fit from the solver's states; prints mean and root mean square of the errors, m/s, rad/s."""
    robot, model = load_robot("fish"), HydroModel.load(given.water)
    data, chain = open_dataset(given.rounds), planar_chain.chain_of(robot)
    records = [data[name] for name in sorted(data.about)]
    tick = records[0].tick
    first, size = (round(seconds / tick) for seconds in (SETTLED, SWIM))
    pieces = [(n, a, a + size) for n, r in enumerate(records) for a in range(first, len(r.q) - size + 1, size)]
    fleet = rollout.cut(chain, robot, records, pieces)
    swum = rollout.SwimWindow(chain, planar_chain.nominal(robot)).run(fleet, flat(model.base), model.learnt)
    mine, theirs = (rollout.windows(track, fleet, tick, 1.0) for track in (swum, rollout.recorded(fleet)))
    errors = {key: (getattr(mine, key) - getattr(theirs, key))[:, -1] for key in ("surge", "sway", "yaw_rate")}
    rows = [
        {"error": "mean"} | {key: error.mean() for key, error in errors.items()},
        {"error": "rms"} | {key: np.sqrt(np.mean(error**2)) for key, error in errors.items()},
    ]
    console.say(console.table(rows))
    return console.OK


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(required=True)
    both = {function: verbs.add_parser(function.__name__, help=function.__doc__) for function in (solve, refit, drift)}
    for function, verb in both.items():
        verb.set_defaults(run=function)
        verb.add_argument("--water", default="swift-reference", help="fitted water to begin with (default: swift-reference)")
        if function is not drift:
            verb.add_argument("--out", type=Path, required=True, help="data set, or folder of the water, to write")
    add = both[solve].add_argument
    add("policies", nargs="+", metavar="POLICY", help="name or file")
    add("--seed", type=int, required=True, help="of the draws of the episodes")
    add("--seconds", type=float, default=30.0, help="of an episode (default: 30)")
    add("--fastest", type=float, default=0.05, help="bound of the streams, m/s (default: 0.05)")
    add("--middle", action="store_true", help="short segments from the fit's states, too")
    add("--device", default="cuda:all", help="of the solver (default: cuda:all)")
    for function in (refit, drift):
        both[function].add_argument("--rounds", type=Path, required=True, help="data set that `solve` wrote")
    add = both[refit].add_argument
    add("--data", type=Path, nargs="+", required=True, help="data sets of earlier fits")
    add("--most", type=float, default=dagger.SWIMS, help="s of swims in the fit (default: 1200)")
    given = parser.parse_args(argv)
    return given.run(given)


if __name__ == "__main__":
    raise SystemExit(console.run(main))
