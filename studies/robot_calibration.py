"""Share of the 90 % intervals of `fishmj calibrate model` that hold, on two-link arms with drawn numbers, *synthetic*.

    python -m studies.robot_calibration --arms 25 --seed 1        about 6 minutes on one core

Each arm differs from the described one in friction, damping, armature, gains and masses (within their tolerance of 3 %), and
swings in four logs of 3 s. A row is a kind of number, told or not: count, share inside the interval, and median error over the
interval's width.
"""

import argparse
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from fishmj import effects
from fishmj.base import console
from fishmj.gap.calibrate.robot_fit import fit_robot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.records.robot_logs import guess_columns, log_files, read_robot_logs, read_sheet
from fishmj.gap.records.shooting import robot_records

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from robot_arm import ARM, write_logs  # noqa: E402

JOINTS = {"shoulder": (0.15, 0.15, 0.01, "0.06"), "elbow": (0.08, 0.05, 0.006, "0.02")}  # largest friction, damping, armature
BODIES = {"upper": (0.6, 0.004, 0.0005), "lower": (0.4, 0.003, 0.0003)}  # mass, inertia across and along


def drawn(rng: np.random.Generator) -> tuple[dict[str, float], str]:
    """Numbers by name, and MJCF of one arm."""
    truth, text = {}, ARM
    for joint, (friction, damping, armature, stated) in JOINTS.items():
        dry = truth[f"coulomb_friction@{joint}"] = rng.choice([0.0, rng.uniform(0.1, 1.0)]) * friction
        viscous = truth[f"viscous_friction@{joint}"] = rng.uniform(0.1, 1.0) * damping
        rotor = truth[f"rotor_inertia@{joint}"] = rng.uniform(0.0, 1.0) * armature
        gain = truth[f"servo_gain@{joint}"] = rng.uniform(0.8, 1.2)
        text = text.replace(f'damping="{stated}"', f'damping="{viscous}" frictionloss="{dry}" armature="{rotor}"')
        text = text.replace(f'joint="{joint}" ctrl', f'joint="{joint}" gear="{gain}" ctrl')
    for body, (mass, across, along) in BODIES.items():
        factor = truth[f"mass@{body}"] = np.exp(0.03 * rng.standard_normal())
        told = lambda f, m=mass, i=across, k=along: f'mass="{f * m:g}" diaginertia="{f * i:g} {f * i:g} {f * k:g}"'
        text = text.replace(told(1.0), told(factor))
    return truth, text


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=25)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng, cases = np.random.default_rng(args.seed), defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(ARM)
        robot = read_robot(path)
        for k in range(args.arms):
            truth, text = drawn(rng)
            files = log_files(write_logs(Path(folder) / str(k), text, 4, 3.0, seed=int(rng.integers(1, 10**6))))
            names = list(read_sheet(files[0]).columns)
            columns = guess_columns(names, robot.sites("joint"), robot.actuators, torques=True)
            records = robot_records(read_robot_logs(files, columns)[0], robot.dt, robot.sites("joint"))
            for n in fit_robot(robot, records).numbers:
                if n.name in truth:
                    off = abs(n.value - truth[n.name]) / max(n.high - n.low, 1e-12)
                    cases[effects.kind_of(n.name), n.is_told].append((n.low <= truth[n.name] <= n.high, off))
            console.say(f"{k + 1} of {args.arms}")
    rows = [
        {
            "number": kind,
            "told": told,
            "count": len(c),
            "inside": np.mean([a for a, _ in c]),
            "error": np.median([b for _, b in c]),
        }
        for (kind, told), c in sorted(cases.items())
    ]
    console.say(console.table(rows))


if __name__ == "__main__":
    main()
