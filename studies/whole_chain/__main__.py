"""Holding station through the whole chain of the robot, against the direct simulation: same fish, water, streams, targets, noise.

    python -m studies.whole_chain --out runs/whole_chain                     24 trials, drawn frames, 2 % radio loss
    python -m studies.whole_chain --body virtual --out runs/second           in the second robot and its water
    python -m studies.whole_chain --body virtual --train --out runs/own      the same with a policy of its own water
    python -m studies.whole_chain --trials 2 --marks poses --out runs/look   no frames: poses with a tracker's errors

Chain: the host of `fishmj deploy` in lockstep with the loopback robot; camera frames that a tracker reads, servo counts, radio
latency and loss, supervisor, limits. Direct: `evaluate`'s own loop, or the second robot without its chain. Its observations have
the noise of the chain's own tracker: the errors of the chain's fixes through the velocity filter (`direct`).

    distance      between the true reference point and the target
    RMSE          of it from the first entry into 0.1 m until 30 s; for a trial that does not arrive 10 to 30 s
    within        the mean of chain - direct, paired by trial, and its 95 % bootstrap interval

--train measures the second robot, calibrates its water, and trains there; the training begins with --policy (`trained`).

At 0 s the policy takes over. The chain's fish drifts a little before that, during the handshake of robot and host.
"""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from fishmj.base import console, cores
from fishmj.base.errors import ConfigError
from fishmj.base.store import read_json, write_json
from fishmj.control.learned import LearnedController
from fishmj.deploy.loopback.bodies import FITTED, VIRTUAL
from fishmj.evaluate import metrics, protocol, run_trials
from fishmj.evaluate.protocol import Trials
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water
from studies.whole_chain.chain import MARKS, SECONDS, run_trial
from studies.whole_chain.direct import AsSensed, in_second_robot, observation_noise
from studies.whole_chain.trained import trained
from studies.whole_loop.steps import Loop

SPEEDS, REPEATS = (0.1, 0.2, 0.3), 1
LIMIT = 0.02  # m
TURBULENCE = {FITTED: "default", VIRTUAL: "gust"}  # the second robot's water is uniform in space


def one(out: Path, trials: Trials, policy: str, marks: str, loss: float, body: str, item: int) -> dict:
    """Figures of a trial, kept in `out`."""
    name = str(Path(policy).relative_to(out) if out in Path(policy).parents else policy)
    file = out / f"{name.replace('/', '_')}_{body}_{marks}_{loss:g}_{trials.items[item].seed[0]}_{item:02d}.json"
    if not file.is_file():
        write_json(file, run_trial(item, trials, policy, marks, loss, body))
    return read_json(file)


def options() -> console.Parser:
    """Parser of the study."""
    parser = console.parser("studies.whole_chain", __doc__ or "")
    add = parser.add_argument
    add("--policy", type=console.text, default="station", help="shipped name, file or folder of a training (default station)")
    add("--body", choices=(FITTED, VIRTUAL), default=FITTED, help="one fish in the fitted water, or the second robot in its own")
    add("--trials", type=console.whole(2, 72), default=24, help="of 24 a repeat: 3 speeds, 8 directions")
    add("--marks", choices=MARKS, default="tag", help="what is drawn and tracked; poses: no frames")
    add("--loss", type=console.number(0, 0.5), default=0.02, help="share of datagrams that get lost, each way")
    add("--seed", type=console.whole(0, 2**31), default=40, help="of the trials")
    add("--train", action="store_true", help="first train one that begins with --policy in the water of the body virtual")
    add("--preset", type=console.text, default="paper", help="of that training (default paper)")
    add("--engine", type=console.text, default="auto", help="of that training: planar is quick on a GPU (default auto)")
    add("--steps", type=console.number(1, 1e11), default=7e6, metavar="N", help="control steps of it (default 7e6)")
    add("--jobs", type=console.whole(1, 256), default=cores.usable_cores(), help="trials at a time (default: one a core)")
    add("--out", type=console.out_folder, required=True, help="folder; the same command goes on with what is there")
    return parser


def main(argv: list[str]) -> int:
    """Runs the study. Exit code 0: the chain is within 0.02 m of the direct simulation; 1: it is not."""
    args = options().parse_args(argv)
    if args.train:
        args.policy = _own(args)
    repeats = -(-args.trials // 24)
    trials = protocol.trials(
        speeds=SPEEDS, repeats=repeats, seed=args.seed, randomisation=0.0, duration=SECONDS, turbulence=TURBULENCE[args.body]
    )
    count = min(args.trials, len(trials))
    args.out.mkdir(parents=True, exist_ok=True)
    rows = _each(partial(one, args.out, trials, args.policy, args.marks, args.loss, args.body), count, args.jobs, "trials")
    sigma = observation_noise(np.mean([row["covariance"] for row in rows], 0), load_robot("fish"))
    told: dict = {
        "n": count,
        "body": args.body,
        "chain_rmse_m": float(np.mean([row["rmse"] for row in rows])),
        "arrived_chain": sum(row["arrival"] is not None for row in rows),
        "complete": sum(row["complete"] for row in rows),
        "share_of_fixes": float(np.mean([row["share_of_fixes"] for row in rows])),
        "ended": sorted({row["ended"] for row in rows if not row["complete"]}),
        "sigma": {name: float(sigma[at]) for name, at in (("position", 0), ("velocity", 2), ("yaw_rate", 4), ("joint", 5))},
    }
    shown, chain = [], np.array([row["rmse"] for row in rows])
    for name, sensed in (("measured", AsSensed.of(trials, sigma)), ("task", trials)):
        rmse, arrived = _direct(args.policy, args.body, sensed, count, args.jobs)
        found = metrics.difference("rmse", rmse, chain)
        told[name] = {"direct_rmse_m": float(np.mean(rmse)), "arrived_direct": arrived}
        told[name]["difference_m"] = [found.value, found.low, found.high]
        line = {"noise of the direct simulation": name, "n": count, "direct, m": told[name]["direct_rmse_m"]}
        between = f"{found.value:+.4f} ({found.low:+.4f} to {found.high:+.4f})"
        line |= {"chain, m": told["chain_rmse_m"], "chain - direct, m": between}
        shown.append(line | {"arrived: direct, chain": f"{arrived}, {told['arrived_chain']}"})
    write_json(args.out / f"whole_chain_{args.body}.json", told)
    console.say(console.table(shown))
    if args.json:
        console.emit_json(told)
    within = abs(told["measured"]["difference_m"][0]) <= LIMIT
    return console.OK if within and told["complete"] == count else console.FAILED_CHECK


def _own(args) -> str:
    """Folder of a policy that is trained for the body. Raises ConfigError if the body's water is a description already."""
    if args.body != VIRTUAL:
        raise ConfigError(f"--train --body {args.body}: fishmj train --water knows that water; take --body {VIRTUAL}")
    return trained(Loop(out=args.out, policy=args.policy, preset=args.preset, engine=args.engine, steps=int(args.steps)))


def _each(work, count: int, jobs: int, what: str) -> list[dict]:
    rows: list[dict] = []
    with ProcessPoolExecutor(jobs) as pool, console.Progress(count, what, "trials") as bar:
        for row in pool.map(work, range(count)):
            rows.append(row)
            bar.update(len(rows))
    return rows


def _direct(policy: str, body: str, trials: Trials, count: int, jobs: int) -> tuple[np.ndarray, int]:
    """RMSE (n,) m of the direct simulation, and the number of arrivals."""
    if body == VIRTUAL:
        rows = _each(partial(in_second_robot, trials=trials, policy=policy), count, jobs, "direct")
        return np.array([row["rmse"] for row in rows]), sum(row["arrival"] is not None for row in rows)
    robot = in_water(load_robot("fish"), FITTED)
    found = metrics.figures(run_trials.run(LearnedController(robot, policy), robot, trials, engine="compiled"))
    return found["rmse_after_arrival"][:count], int(np.sum(found["arrival"][:count]))


if __name__ == "__main__":
    raise SystemExit(console.run(main))
