"""Cruise of the shipped fish in the flow solver beat by beat, with one thing about the solver changed.

python -m studies.solver_cruise --domain window_coarse_refined_twice --beats 24     boundary of reference-3, 5 mm round the fish
python -m studies.solver_cruise --boxes 1.2,1.2,0.6 1,1,0.44                        larger boxes of finer cells
python -m studies.solver_cruise --water low-reynolds                                another water, 5 mm round the fish
python -m studies.solver_cruise --part 2                                            half the time step
python -m studies.solver_cruise --set hull=0.9 rim=2.5                              markers drawn in further (cells)

The fish swims from rest (1 Hz, 30 deg, lag 60 deg). Prints the speed of each beat, m/s: the net displacement of its reference
point over the beat; then mean and standard error from the ninth beat on. `--csv FILE` appends rows (studies/solver/rows).
"""

import argparse
import csv
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.lbm_oracle.fluid import fluid
from fishmj.lbm_oracle.immersed import markers
from fishmj.lbm_oracle.run import setup
from fishmj.lbm_oracle.run.domain import EVERY, preset
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, REFERENCES
from fishmj.lbm_oracle.run.swim import drive

FROM = 8  # beats before: the fish speeds up


def sides(box: str) -> tuple[float, float, float]:
    """Sides of a box, m, from text `x,y,z`. Raises ValueError: no three numbers."""
    x, y, z = map(float, box.split(","))
    return x, y, z


def speeds(args: argparse.Namespace) -> np.ndarray:
    """Speeds of the beats (n,), m/s; fewer than asked if the swim stopped."""
    lengths: dict[str, Any] = {key: float(value) for key, value in (pair.split("=") for pair in args.set)}
    water = REFERENCES[args.water]
    hull = {**BOUNDARIES, "edges": markers.EDGES}[args.boundary] if args.boundary else water.sharpness
    boundary = replace(hull, **lengths)
    domain = preset(args.domain).changed(nu=water.nu)
    if args.boxes:
        first, *finer = args.boxes
        domain = replace(domain, fine=first, finer=tuple(finer))
    if args.part > 1:
        domain = domain.changed(dt=domain.dt / args.part)
    if args.cw is not None:
        setup.Fluid = partial(fluid.Fluid, cw=args.cw)  # type: ignore[misc, assignment]
    run = setup.SwimSetup(domain=domain, slip=water.slip, device=args.device, sharpness=boundary, passes=args.passes).run()
    gait = setup.Gait.of_the_paper(joints=run.robot.n_joints)
    drive(run, gait, args.beats / gait.frequency)
    truth = run.trial().tables["truth"]
    ends = np.arange(np.floor(truth["t"][-1] * gait.frequency + 1e-6) + 1) / gait.frequency
    path = np.stack([np.interp(ends, truth["t"], truth[axis]) for axis in "xy"], 1)
    return np.hypot(*np.diff(path, axis=0).T) * gait.frequency


def main(argv: list[str]) -> int:
    """Prints the speed of each beat. Returns the exit code."""
    parser = console.parser("solver_cruise", __doc__ or "", json=False)
    add = parser.add_argument
    add("--domain", choices=EVERY, default="window_coarse_refined_twice", help="box of water")
    add(
        "--boxes",
        nargs="*",
        type=sides,
        default=[],
        metavar="X,Y,Z",
        help="m, of each finer box, coarsest first; default the domain's",
    )
    add("--part", type=console.whole(1, 100), default=1, metavar="N", help="parts of the domain's time step (default 1)")
    add("--beats", type=console.whole(1, 1000), default=10, metavar="N", help="of the swim (default 10)")
    add(
        "--water",
        choices=tuple(REFERENCES),
        default="reference-3",
        help="its slip ratio, boundary and viscosity (default reference-3)",
    )
    add("--boundary", choices=(*BOUNDARIES, "edges"), help="of the hull (default: the water's)")
    add("--set", nargs="*", default=[], metavar="NAME=CELLS", help="lengths of markers.Sharpness")
    add("--cw", type=console.number(0, 10), help="constant of the WALE filter (default: the solver's)")
    add("--passes", type=console.whole(1, 100), default=2, metavar="N", help="of the forcing (default 2)")
    add("--device", default="cuda", help="cpu, cuda or cuda:N (default cuda)")
    add("--csv", type=console.out_file, metavar="FILE", help="to which rows are appended (default none)")
    add("--label", type=console.text, default="as it is", help="of the rows in --csv (default: as it is)")
    args = parser.parse_args(argv)
    found = speeds(args)
    console.say(console.table([{"beat": beat, "speed_m_s": round(speed, 4)} for beat, speed in enumerate(found, 1)]))
    if len(late := found[FROM:]) > 1:
        error = late.std(ddof=1) / np.sqrt(len(late))
        console.say(f"beats {FROM + 1} to {len(found)}: {late.mean():.4f} +- {error:.4f} m/s")
    if args.csv:
        new = not args.csv.exists()
        with args.csv.open("a", newline="") as file:
            rows = csv.writer(file)
            if new:
                rows.writerow(["label", "domain", "beat", "speed_m_s"])
            rows.writerows([args.label, args.domain, beat, round(speed, 5)] for beat, speed in enumerate(found, 1))
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
