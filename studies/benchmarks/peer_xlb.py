"""XLB on the CPU, as a worker in an environment of its own: it pins a Warp that fishmj does not use.

    python peer_xlb.py 80 56 30        then a line with a number of steps on standard input, `done` on standard output

Run by path with the interpreter of that environment, in which fishmj cannot be imported.
"""

import sys


def main(shape: tuple[int, ...]) -> None:
    """Runs periodic D3Q19 with BGK collision in single precision, XLB's Warp backend."""
    import warp as wp
    import xlb
    from xlb.compute_backend import ComputeBackend
    from xlb.grid import grid_factory
    from xlb.operator.stepper import IncompressibleNavierStokesStepper
    from xlb.precision_policy import PrecisionPolicy

    backend, precision = ComputeBackend.WARP, PrecisionPolicy.FP32FP32
    velocities = xlb.velocity_set.D3Q19(precision_policy=precision, compute_backend=backend)
    xlb.init(velocity_set=velocities, default_backend=backend, default_precision_policy=precision)
    step = IncompressibleNavierStokesStepper(grid=grid_factory(shape, compute_backend=backend), collision_type="BGK")
    here, there, faces, missing = step.prepare_fields()
    number = 0
    for line in sys.stdin:
        for _ in range(int(line)):
            here, there = step(here, there, faces, missing, 1.0, number)
            here, there = there, here
            number += 1
        wp.synchronize()
        sys.stdout.write("done\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(tuple(map(int, sys.argv[1:4])))
