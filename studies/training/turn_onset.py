"""Time before a fish that starts on its target, headed downstream, turns: `python -m studies.training.turn_onset POLICY`.

    python -m studies.training.turn_onset station-family studies/training/seeds/seed-3.safetensors     30 s of one core

16 starts in each stream in the fitted water `swift`; medians. The turn begins where the heading is 30 deg off downstream, and
ends where it is 150 deg off. *synthetic*
"""

import argparse

import numpy as np

from fishmj.base import console
from fishmj.evaluate import protocol, run_trials
from fishmj.evaluate.metrics import settling_figures
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water

STREAMS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)  # m/s
BEGUN, DONE = 30, 150  # deg
COLUMNS = ("stream [m/s]", "turn begins [s]", "turned [s]", "settles [s]", "furthest [m]")


def row(policy: str, speed: float) -> dict[str, str]:
    """Row of the table: times of the turn and of settling [s], furthest distance [m], medians of 16 starts."""
    trials = protocol.trials(task="angle_of_attack", los_deg=(-180.0,), speeds=(speed,), repeats=16)
    swim = run_trials.run(policy, in_water(load_robot("fish"), "swift"), trials, engine="compiled")
    found, turned = settling_figures(swim), np.abs(np.degrees(swim.pose[:, :, 2]))
    first = [np.where((turned > angle).any(1), swim.t[(turned > angle).argmax(1)], np.inf) for angle in (BEGUN, DONE)]
    medians = [*map(np.median, first), np.nanmedian(found["settling_time"]), np.median(found["furthest"])]
    return dict(zip(COLUMNS, (f"{speed:g}", *(f"{value:.2f}" for value in medians)), strict=True))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="name, file or folder of a training")
    parser.add_argument("--speeds", nargs="+", type=float, default=STREAMS, metavar="M/S", help=f"streams (default: {STREAMS})")
    given = parser.parse_args(argv)
    for policy in given.policies:
        console.say(policy, console.table([row(policy, speed) for speed in given.speeds]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
