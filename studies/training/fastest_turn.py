"""Shortest settling of a fish that begins at its target, headed downstream: an open-loop search in a fitted water.

    python -m studies.training.fastest_turn --water swift-reference --speed 0.2 --seed 0

Seven seconds of actions are searched by the cross-entropy method, in calm water and with the stream known. No policy can know as
much, so that the time bounds from below what a policy may be asked. Everything is synthetic.
"""

import argparse

import numpy as np

from fishmj import engines
from fishmj.base import console
from fishmj.engines import at_rest, in_water, nominal_params, ticks_per
from fishmj.mjcf import load_robot
from fishmj.water.flow import Flow, stack

ACTIONS, FISH, ROUNDS, BEST = 35, 512, 150, 40
KEPT = 0.3  # of an action's change, in the next one: neighbours move together
NEAR = 0.1  # m, as `evaluate.metrics` has it


def cost(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cost (B,) of poses (B, T, 3): mean distance, the last second once more, heading; and distances (B, T), m."""
    far = np.linalg.norm(pose[..., :2], axis=-1)
    away = np.abs(pose[..., 2] % (2 * np.pi) - np.pi)
    return far.mean(1) + far[:, -50:].mean(1) + 0.05 * away[:, -25:].mean(1), far


def main() -> None:
    """Searches, and prints the settling time of the best every 25 rounds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--water", default="swift-reference", help="fitted water (default swift-reference)")
    parser.add_argument("--speed", type=float, default=0.2, help="of the stream, m/s (default 0.2)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng, robot = np.random.default_rng(args.seed), in_water(load_robot("fish"), args.water)
    engine, most = engines.make("compiled", robot), np.radians(60)
    _, ticks = ticks_per(robot)
    mean, spread = np.zeros((ACTIONS, 3)), np.full((ACTIONS, 3), 0.7)
    least, best = np.inf, mean
    with console.Progress(ROUNDS, "search", unit="rounds") as bar:
        for done in range(ROUNDS):
            noise = rng.normal(size=(FISH, ACTIONS, 3))
            for k in range(1, ACTIONS):
                noise[:, k] = KEPT * noise[:, k - 1] + np.sqrt(1 - KEPT**2) * noise[:, k]
            tried = np.clip(mean + spread * noise, -1, 1)
            tried[:2] = np.clip(mean, -1, 1), best
            start, still = at_rest(robot, np.zeros((FISH, 3))), np.zeros(FISH, int)
            commands = np.repeat(tried * most, ticks, 1)
            _, trace = engine.advance(start, commands, nominal_params(robot, FISH), stack([Flow(speed=args.speed)] * FISH), still)
            found, far = cost(np.asarray(trace.pose))
            order = np.argsort(found)[:BEST]
            mean = 0.1 * mean + 0.9 * tried[order].mean(0)
            spread = np.maximum(0.1 * spread + 0.9 * tried[order].std(0), 0.05)
            if found[order[0]] < least:
                least, best = found[order[0]], tried[order[0]].copy()
            if done % 25 == 24:
                out = np.flatnonzero(far[order[0]] > NEAR)
                console.say(f"round {done + 1}: settles in {(out[-1] + 1) * robot.timing.bus_dt if len(out) else 0:.2f} s")
            bar.update(done + 1)


if __name__ == "__main__":
    main()
