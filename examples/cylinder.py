"""Drag of a cylinder of your choice in the flow solver, and how far to trust it.

    python examples/cylinder.py
    python examples/cylinder.py --diameter 0.02 --speed 0.003 --study

The default is Re 100 in water, where the literature has C_D = 1.33 to 1.36 without walls near by. `--study` takes three grids
in place of one and prints the observed order and the uncertainty. The first run also compiles kernels. Everything is synthetic.
"""

import argparse

import numpy as np

from fishmj.lbm_oracle import Scene, cylinder, grid_study

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--diameter", type=float, default=0.01, help="m (default 0.01)")
parser.add_argument("--speed", type=float, default=0.01, help="of the stream, m/s (default 0.01)")
parser.add_argument("--cells", type=float, default=10.0, help="across the diameter (default 10)")
parser.add_argument("--study", action="store_true", help="0.7, 1 and 1.4 times as many cells")
parser.add_argument("--device", default="cpu", help="cpu or cuda (default cpu)")
parser.add_argument("--times", type=float, default=60.0, help="diameters of water that pass (default 60)")
args = parser.parse_args()
d, u, turn = args.diameter, args.speed, args.diameter / args.speed


def kick(t: float) -> tuple[float]:
    """A swing aside of a fifth of a diameter at the start, so that the vortex street need not wait for round-off."""
    return (0.1 * d * (1 - np.cos(2 * np.pi * min(t / (4 * turn), 1.0))),)


def drag(dx: float) -> float:
    """Mean C_D over the last three tenths of the run."""
    scene = Scene(box=(24 * d, 20 * d), dx=dx, nu=1e-6, stream=u, device=args.device)
    scene.add(cylinder(d), at=(8 * d, 10 * d), joints=("slide y",), motion=kick)
    scene.run(args.times * turn)
    print(scene)
    scene.plot("cylinder.png")
    return scene.drag_coefficient(0.3 * args.times * turn)


if args.study:
    print(grid_study(drag, [d / (share * args.cells) for share in (0.7, 1.0, 1.4)]))
else:
    print(f"C_D = {drag(d / args.cells):.2f}")
