"""Drag, lift and shedding of a cylinder of your choice in the flow solver, and how far to trust the drag.

    python examples/cylinder.py --diameter 0.02 --re 60 --study --out runs/cylinder

The literature has C_D = 1.33 to 1.35 at Re 100. `--near`: cells double away from the cylinder. `--study`: three grids,
the observed order and the uncertainty. cylinder_CELLS.png has the vorticity, .csv the forces in SI. Everything is synthetic.
"""

import argparse
from pathlib import Path

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle import Scene, cylinder, grid_study

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--diameter", type=float, default=0.01, help="m (default 0.01)")
speed = parser.add_mutually_exclusive_group()
speed.add_argument("--speed", type=float, help="of the stream, m/s (default: that of Re 100)")
speed.add_argument("--re", type=float, default=100.0, help="Reynolds number, in place of the speed (default 100)")
parser.add_argument("--cells", type=float, default=10.0, help="across the diameter, 6 or more (default 10)")
parser.add_argument("--study", action="store_true", help="with 0.7, 1 and 1.4 times as many cells (9 or more)")
parser.add_argument("--box", type=float, nargs=3, default=(40, 40, 16), metavar=("L", "W", "INLET"), help="diameters (40 40 16)")
parser.add_argument("--near", type=float, nargs="*", default=(2, 8), help="diameters to where cells double (2 8; none: nowhere)")
parser.add_argument("--times", type=float, default=60.0, help="diameters of water that pass (default 60)")
parser.add_argument("--out", type=Path, default=Path("."), metavar="FOLDER", help="of pictures and forces (default: here)")
parser.add_argument("--device", default="cpu", help="cpu or cuda (default cpu)")
args = parser.parse_args()
d, nu = args.diameter, 1e-6  # m, m2/s
turn = d / (u := args.speed or args.re * nu / d)  # s in which a diameter of water passes
args.out.mkdir(parents=True, exist_ok=True)


def kick(t: float) -> tuple[float]:
    """A swing aside by 0.2 diameters and back, in the first four turns: without it the vortex street begins later."""
    return (0.1 * d * (1 - np.cos(2 * np.pi * min(t / (4 * turn), 1.0))),)


def drag(dx: float) -> float:
    """Mean C_D over the last three tenths of the run."""
    long, wide, inlet = np.multiply(args.box, d)
    scene = Scene(box=(long, wide), dx=dx, nu=nu, stream=u, near=np.multiply(args.near, d), device=args.device)
    scene.add(cylinder(d), at=(inlet, wide / 2), joints=("slide y",), motion=kick)
    record, last, name = scene.run(args.times * turn), 0.3 * args.times * turn, str(args.out / f"cylinder_{d / dx:.3g}")
    scene.plot(f"{name}.png"), record.write(f"{name}.csv")
    found, lift = scene.drag_coefficient(last), scene.coefficients()[record.times > record.times[-1] - last, 1]
    try:
        shedding = f"St = {scene.strouhal(args.times * turn / 2):.3f}"
    except ConfigError as error:  # too short, or steady
        shedding = f"no St ({error})"
    print(scene, f"C_D = {found:.2f}, C_L' = {lift.std():.3f} (r.m.s.), {shedding}", sep="\n", flush=True)
    return found


sizes = [d / (share * args.cells) for share in ((0.7, 1.0, 1.4) if args.study else (1.0,))]
try:
    print(grid_study(drag, sizes)) if args.study else drag(*sizes)
except ConfigError as error:
    parser.error(str(error))
