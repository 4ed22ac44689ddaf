"""Drag, lift and shedding of a cylinder or square bar of your choice in the flow solver, and how far to trust the drag.

    python examples/cylinder.py --diameter 0.008 --speed 0.012 --study --out runs/cylinder

The literature has C_D = 1.33 to 1.35 for a cylinder at Re 100. `--near`: cells double away from the body. `--study`: three
grids, order and uncertainty. cylinder_CELLS.png (section_ of a square) has the vorticity, .csv the forces in SI. Everything is
synthetic.
"""

import argparse
from pathlib import Path

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle import Scene, cylinder, grid_study, section

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--diameter", type=float, default=0.01, help="m (default 0.01)")
parser.add_argument("--square", action="store_true", help="a square bar of that side, face on, in place of the cylinder")
speed = parser.add_mutually_exclusive_group()
speed.add_argument("--speed", type=float, help="of the stream, m/s (default: that of Re 100)")
speed.add_argument("--re", type=float, default=100.0, help="Reynolds number, in place of the speed (default 100)")
parser.add_argument("--cells", type=float, default=10.0, help="across the diameter, 6 or more (default 10)")
parser.add_argument("--study", action="store_true", help="with 0.7, 1 and 1.4 times as many cells (9 or more; a square: even)")
parser.add_argument("--box", type=float, nargs=3, default=(40, 40, 16), metavar=("L", "W", "INLET"), help="diameters (40 40 16)")
parser.add_argument("--near", type=float, nargs="*", default=(2, 8), help="diameters to where cells double (2 8; none: nowhere)")
parser.add_argument("--times", type=float, default=60.0, help="diameters of water that pass (default 60)")
parser.add_argument("--out", type=Path, default=Path("."), metavar="FOLDER", help="of pictures and forces (default: here)")
parser.add_argument("--device", default="cpu", help="cpu or cuda (default cpu)")
args = parser.parse_args()
d, nu = args.diameter, 1e-6  # m, m2/s
turn = d / (u := args.speed or args.re * nu / d)  # s in which a diameter of water passes
args.out.mkdir(parents=True, exist_ok=True)
body = section(d / 2 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])) if args.square else cylinder(d)
aside = lambda t: (0.1 * d * (1 - np.cos(np.pi / 2 * min(t / turn, 4))),)  # and back: without it the street begins later


def drag(dx: float) -> float:
    """Mean C_D over the last three tenths of the run."""
    long, wide, inlet = np.multiply(args.box, d)
    scene = Scene(box=(long, wide), dx=dx, nu=nu, stream=u, near=np.multiply(args.near, d), device=args.device)
    scene.add(body, at=(inlet, wide / 2), joints=("slide y",), motion=aside)
    record, last, path = scene.run(args.times * turn), 0.3 * args.times * turn, str(args.out / f"{body.name}_{d / dx:.3g}")
    scene.plot(f"{path}.png"), record.write(f"{path}.csv")
    found, lift = scene.drag_coefficient(last), scene.coefficients()[record.times > record.times[-1] - last, 1]
    try:
        shedding = f"St = {scene.strouhal(args.times * turn / 2):.3f}"
    except ConfigError as error:  # too short, or steady
        shedding = f"no St ({error})"
    print(scene, f"C_D = {found:.2f}, C_L' = {lift.std():.3f} (r.m.s.), {shedding}", sep="\n", flush=True)
    return found


asked = np.multiply(args.cells, (0.7, 1.0, 1.4))
across = 2 * np.round(asked / 2) if args.square else asked  # even: its faces lie midway between nodes on all grids
try:
    print(grid_study(drag, d / across)) if args.study else drag(d / args.cells)
except ConfigError as error:
    parser.error(str(error))
