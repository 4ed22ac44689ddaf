"""The oracle in million lattice updates a second, beside what the device's memory would allow.

A lattice update reads and writes nineteen populations, 152 bytes in single precision; the baseline copies that many bytes and
counts them as updates, so that the ratio is the part of the copy bandwidth that the step turns into fluid.
"""

from fishmj.bench import Work, benchmark

MEGA = 1e6


def _paper(quick: bool):
    """Device and cells: the paper's box on an accelerator, a part of it on the CPU."""
    from fishmj.lbm_oracle.device import device_of

    device = device_of("auto")
    return device, (200, 200, 50) if device.is_cuda else (48, 40, 30) if quick else (96, 80, 50)


def copied_bytes(quick: bool) -> Work:
    """A copy of one set of populations to another, counted as updates."""
    import warp as wp

    device, shape = _paper(quick)
    source, target = (wp.zeros((19, *shape), dtype=float, device=device) for _ in range(2))
    repeats = 100 if device.is_cuda else 4

    def run():
        for _ in range(repeats):
            wp.copy(target, source)
        wp.synchronize_device(device)

    run()
    return Work(run, repeats * shape[0] * shape[1] * shape[2] / MEGA, str(device))


def _updates(quick: bool, **options) -> Work:
    import warp as wp

    from fishmj.lbm_oracle.fluid import Fluid
    from fishmj.lbm_oracle.units import Lattice

    device, shape = _paper(quick)
    water = Fluid(Lattice(dx=0.02, dt=0.004), shape, device, **options)
    steps = 400 if device.is_cuda else 2 if quick else 6

    def run():
        water.run(steps)
        wp.synchronize_device(device)

    run()
    return Work(run, steps * water.cells / MEGA, f"{device}, {water.threads} slabs")


@benchmark("oracle_fluid", "MLUPS", baseline=copied_bytes)
def oracle_fluid(quick: bool) -> Work:
    """Pull, collide, store in a periodic box, no eddy viscosity."""
    return _updates(quick, subgrid="none", keep_velocity=False)


@benchmark("oracle_fluid_faces", "MLUPS", baseline=copied_bytes)
def oracle_fluid_faces(quick: bool) -> Work:
    """The same with eddy viscosity, open faces, sponge, free slip and a stream."""
    from fishmj.flow import Flow
    from fishmj.lbm_oracle.boundaries import channel

    return _updates(quick, boundaries=channel(), flow=Flow(speed=0.2, direction=0.5))


@benchmark("oracle_fluid_half", "MLUPS", baseline=copied_bytes)
def oracle_fluid_half(quick: bool) -> Work:
    """Populations stored in sixteen bits: 76 bytes an update, so that the ratio may pass one."""
    return _updates(quick, subgrid="none", keep_velocity=False, dtype="float16")
