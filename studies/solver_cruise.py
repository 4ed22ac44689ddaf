"""Cruise of the shipped fish in the flow solver beat by beat, with one thing about the solver changed.

python -m studies.solver_cruise --domain window_coarse_refined_twice --beats 24     boundary of reference-3, 5 mm round the fish
python -m studies.solver_cruise --boxes 1.2,1.2,0.6 1,1,0.44                        larger boxes of finer cells
python -m studies.solver_cruise --part 2                                            half the time step
python -m studies.solver_cruise --set hull=0.9 rim=2.5                              markers drawn in further (cells)

The fish swims from rest (1 Hz, 30 deg, lag 60 deg). Prints the speed of each beat, m/s: the net displacement of its reference
point over the beat; then mean and standard error from the ninth beat on. `--csv FILE` appends rows (studies/solver/rows).
"""

import argparse
import csv
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.lbm_oracle.fluid import fluid
from fishmj.lbm_oracle.immersed import markers
from fishmj.lbm_oracle.run import setup
from fishmj.lbm_oracle.run.domain import preset
from fishmj.lbm_oracle.run.solver_water import BOUNDARIES

FROM = 8  # beats before: the fish speeds up


def sides(box: str) -> tuple[float, float, float]:
    """Sides of a box, m, from text `x,y,z`."""
    x, y, z = map(float, box.split(","))
    return x, y, z


def speeds(args: argparse.Namespace) -> list[float]:
    """Speed of each beat, m/s."""
    lengths: dict[str, Any] = {key: float(value) for key, value in (pair.split("=") for pair in args.set)}
    boundary = replace({**BOUNDARIES, "edges": markers.EDGES}[args.boundary], **lengths)
    domain = preset(args.domain)
    if args.boxes:
        first, *finer = map(sides, args.boxes)
        domain = replace(domain, fine=first, finer=tuple(finer))
    if args.part > 1:
        domain = domain.changed(dt=domain.dt / args.part)
    if args.cw is not None:
        setup.Fluid = partial(fluid.Fluid, cw=args.cw)  # type: ignore[misc, assignment]
    run = setup.SwimSetup(domain=domain, slip=1.0, device=args.device, sharpness=boundary, passes=args.passes).run()
    gait = setup.Gait.of_the_paper(joints=run.robot.n_joints)
    ticks = round(1.0 / gait.frequency / run.robot.timing.bus_dt)
    place, found = run.pose[:2].copy(), []
    for beat in range(args.beats):
        for _ in range(ticks):
            run.tick(gait(run.time))
            if run.stopped:
                raise SystemExit(f"beat {beat + 1}: {run.stopped}")
        found.append(float(np.hypot(*(run.pose[:2] - place))) * gait.frequency)
        place = run.pose[:2].copy()
        console.say(f"beat {beat + 1}: {found[-1]:.4f} m/s")
    return found


def main() -> None:
    """Command of the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", default="window_coarse_refined_twice")
    parser.add_argument("--boxes", nargs="*", help="x,y,z m of each finer box, coarsest first (default: the domain's)")
    parser.add_argument("--part", type=int, default=1, help="parts of the domain's time step (default: 1)")
    parser.add_argument("--beats", type=int, default=10)
    parser.add_argument("--boundary", choices=(*BOUNDARIES, "edges"), default="wall_stress")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=CELLS", help="lengths of markers.Sharpness")
    parser.add_argument("--cw", type=float, help="constant of the WALE filter (default: the solver's)")
    parser.add_argument("--passes", type=int, default=2, help="passes of the forcing (default: 2)")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--csv", type=Path, metavar="FILE")
    parser.add_argument("--label", default="", help="of the rows in --csv")
    args = parser.parse_args()
    found = speeds(args)
    if len(found) > FROM + 1:
        late = np.array(found[FROM:])
        error = late.std(ddof=1) / np.sqrt(len(late))
        console.say(f"beats {FROM + 1} to {len(found)}: {late.mean():.4f} +- {error:.4f} m/s")
    if args.csv:
        new = not args.csv.exists()
        with args.csv.open("a", newline="") as file:
            rows = csv.writer(file)
            if new:
                rows.writerow(["label", "domain", "beat", "speed_m_s"])
            rows.writerows([args.label, args.domain, beat + 1, round(speed, 5)] for beat, speed in enumerate(found))


if __name__ == "__main__":
    main()
