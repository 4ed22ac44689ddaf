"""Throughput of the flow solver: the fluid relative to memory bandwidth, and fish in it relative to the fluid alone.

A lattice update reads and writes nineteen populations, 152 bytes in single precision. The baseline copies as many bytes and
counts them as updates, so the ratio is the achieved share of the copy bandwidth.
"""

import os
import shlex
import subprocess
import tempfile
import threading
import weakref
from math import prod
from pathlib import Path

from fishmj.base.compile_cache import cache_folder
from studies.benchmarks import BenchmarkWork, NotHere, benchmark

MEGA = 1e6


def _paper(quick: bool):
    """Device and cells: the paper's box on an accelerator, a part of it on the CPU."""
    from fishmj.lbm_oracle.fluid.device import device_of

    device = device_of("auto")
    return device, (200, 200, 50) if device.is_cuda else (48, 40, 30) if quick else (96, 80, 50)


def copied_bytes(quick: bool) -> BenchmarkWork:
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
    return BenchmarkWork(run, repeats * shape[0] * shape[1] * shape[2] / MEGA, str(device))


def _updates(quick: bool, **options) -> BenchmarkWork:
    from fishmj.lbm_oracle.fluid.fluid import Fluid
    from fishmj.lbm_oracle.fluid.lattice import Lattice

    device, shape = _paper(quick)
    water = Fluid(Lattice(dx=0.02, dt=0.004, nu=2e-5), shape, device, **options)  # at water's own tau WALE must be on
    return _stepped(water, 400 if device.is_cuda else 2 if quick else 6, device, water.cells / MEGA)


def _stepped(water, steps: int, device, unit: float) -> BenchmarkWork:
    """Steps of the water, after one warm-up run; `unit` of work each."""
    import warp as wp

    def run():
        water.run(steps)
        wp.synchronize_device(device)

    run()
    return BenchmarkWork(run, steps * unit, f"{device}, {water.threads} slabs")


@benchmark("oracle_fluid", "MLUPS", baseline=copied_bytes)
def oracle_fluid(quick: bool) -> BenchmarkWork:
    """Pull, collide, store in a periodic box, no eddy viscosity."""
    return _updates(quick, subgrid="none", keep_velocity=False)


@benchmark("oracle_fluid_faces", "MLUPS", baseline=copied_bytes)
def oracle_fluid_faces(quick: bool) -> BenchmarkWork:
    """The same with eddy viscosity, open faces, sponge, free slip and a stream."""
    from fishmj.lbm_oracle.fluid.domain_faces import channel
    from fishmj.water.flow import Flow

    return _updates(quick, boundaries=channel(), flow=Flow(speed=0.2, direction=0.5))


@benchmark("oracle_fluid_half", "MLUPS", baseline=copied_bytes)
def oracle_fluid_half(quick: bool) -> BenchmarkWork:
    """Populations stored in sixteen bits: 76 bytes an update, so that the ratio may pass one."""
    return _updates(quick, subgrid="none", keep_velocity=False, dtype="float16")


# with fish ----------------------------------------------------------------------------------------------------------

TANKS, TANKS_CPU = 12, 2  # side by side
TICKS, TICKS_CPU, TICKS_QUICK = 60, 6, 2  # a run of the benchmark
FINE_TICKS = 16  # of the same with finer cells round the fish


def _place(quick: bool):
    """Domain, device and ticks a run: the paper's tank on an accelerator, the small window on the CPU."""
    return _box(("paper", TICKS), ("laptop", TICKS_QUICK if quick else TICKS_CPU))


def _box(on_gpu: tuple[str, int], on_cpu: tuple[str, int]):
    from fishmj.lbm_oracle.fluid.device import device_of
    from fishmj.lbm_oracle.run.domain import preset

    device = device_of("auto")
    name, ticks = on_gpu if device.is_cuda else on_cpu
    return preset(name), device, ticks


def _emptied(domain, device, steps: int, unit: float = 1.0) -> BenchmarkWork:
    """Steps of the same water, all its levels, without a fish; `unit` of work each."""
    from fishmj.lbm_oracle.run.setup import SwimSetup

    return _stepped(SwimSetup(domain=domain, device=str(device)).coupled().fluid, steps, device, unit)


def _resting(domain, device, ticks: int, tanks: int, unit: float = 1.0) -> BenchmarkWork:
    """Fish at rest in still water with servos on, in independent tanks as in trials; `unit` of work for each step of a tank.

    Raises SimDiverged: a tank stopped, so that its steps must not be counted.
    """
    import numpy as np
    import warp as wp

    from fishmj.base.errors import SimDiverged
    from fishmj.lbm_oracle.run.run import ConcurrentRuns
    from fishmj.lbm_oracle.run.setup import SwimSetup

    stage = SwimSetup(domain=domain, device=str(device))
    side = [ConcurrentRuns([stage.run()], pipelined=True) for _ in range(tanks)]
    first = side[0].runs[0]
    commands = np.zeros((1, first.joints))

    def ticking(tank: ConcurrentRuns):
        for _ in range(ticks):
            yield from tank.ticking(commands)
            if not tank.swimming:
                raise SimDiverged(f"bench: {tank.runs[0].stopped}")

    def run():
        busy = [ticking(tank) for tank in side]
        while busy:
            busy = [one for one in busy if next(one, one) is None]
        wp.synchronize_device(device)

    run()
    water = first.coupled.fluid
    return BenchmarkWork(run, ticks * first.steps * tanks * unit, f"{device}, tanks: {tanks}, {water.threads} slabs")


def fluid_alone(quick: bool) -> BenchmarkWork:
    """The box of the tanks without fish."""
    domain, device, ticks = _place(quick)
    return _emptied(domain, device, 5 * ticks)


@benchmark("oracle_tank", "steps/s", baseline=fluid_alone)
def oracle_tank(quick: bool) -> BenchmarkWork:
    """One coupled fish by bus ticks: the paper's tank on an accelerator, the laptop's window on the CPU."""
    domain, device, ticks = _place(quick)
    return _resting(domain, device, ticks, 1)


@benchmark("oracle_tanks", "tank-steps/s", baseline=fluid_alone)
def oracle_tanks(quick: bool) -> BenchmarkWork:
    """Several of them side by side in one process, their steps added up."""
    domain, device, ticks = _place(quick)
    return _resting(domain, device, ticks, TANKS if device.is_cuda else TANKS_CPU)


def _fine_cells(quick: bool):
    """The same with 5 mm round the fish, on the CPU 1 cm."""
    return _box(("paper_refined_twice_small", FINE_TICKS), ("laptop_refined", 1 if quick else TICKS_QUICK))


def fine_alone(quick: bool) -> BenchmarkWork:
    """Water of one of those tanks without a fish."""
    domain, device, ticks = _fine_cells(quick)
    return _emptied(domain, device, 40 * ticks, domain.body_level.dt)


@benchmark("oracle_tanks_fine", "simulated s/s", baseline=fine_alone)
def oracle_tanks_fine(quick: bool) -> BenchmarkWork:
    """Tanks side by side with 5 mm round the fish, on the CPU 1 cm: simulated seconds a second, added up."""
    domain, device, ticks = _fine_cells(quick)
    return _resting(domain, device, ticks, TANKS if device.is_cuda else 1, domain.body_level.dt)


def _laptop():
    from fishmj.lbm_oracle.fluid.device import device_of
    from fishmj.lbm_oracle.run.domain import preset

    return preset("laptop"), device_of("cpu")


def laptop_alone(quick: bool) -> BenchmarkWork:
    """The laptop's window without a fish, on the CPU."""
    domain, device = _laptop()
    return _emptied(domain, device, 5 * (TICKS_QUICK if quick else TICKS_CPU), domain.dt)


@benchmark("oracle_window_cpu", "simulated s/s", baseline=laptop_alone)
def oracle_window_cpu(quick: bool) -> BenchmarkWork:
    """The laptop preset with its fish on the CPU, simulated seconds a second."""
    domain, device = _laptop()
    return _resting(domain, device, TICKS_QUICK if quick else TICKS_CPU, 1, domain.dt)


# beside the plain kernel ----------------------------------------------------------------------------------------------

LAPTOP_SHAPE = (80, 56, 30)


def _one_core(quick: bool, make, threads: int) -> BenchmarkWork:
    """The laptop's water without a fish on one core, by the kernel of `make` with `threads` threads a plane of x."""
    from unittest.mock import patch

    from fishmj.lbm_oracle.fluid import fluid
    from fishmj.lbm_oracle.fluid.domain_faces import channel
    from fishmj.lbm_oracle.fluid.lattice import Lattice

    with patch.object(fluid, "kernel_for", lambda shape, device: (make, threads)):
        water = fluid.Fluid(Lattice(dx=0.02, dt=0.004), LAPTOP_SHAPE, "cpu", boundaries=channel(), threads=1)
    steps = PEER_QUICK if quick else PEER_STEPS
    run = lambda: water.run(steps)
    run()
    return BenchmarkWork(run, steps * water.cells / MEGA, "cpu, 1 slab")


def plain_kernel(quick: bool) -> BenchmarkWork:
    """The same by the reference kernel, one cell at a time."""
    from fishmj.lbm_oracle.fluid.step import stream_collide

    return _one_core(quick, stream_collide, LAPTOP_SHAPE[1] * LAPTOP_SHAPE[2])


@benchmark("oracle_core_cpu", "MLUPS", baseline=plain_kernel)
def oracle_core_cpu(quick: bool) -> BenchmarkWork:
    """Updates of one core by blocks of rows, with eddy viscosity and open faces, beside a cell at a time."""
    from fishmj.lbm_oracle.fluid.rows import stream_collide_rows

    return _one_core(quick, stream_collide_rows, 1)


# beside another solver ------------------------------------------------------------------------------------------------

PEER = ("xlb==0.3.1", "warp-lang==1.10.0")  # the newest Warp tested with this XLB
PEER_SHAPE, PEER_STEPS, PEER_QUICK = LAPTOP_SHAPE, 20, 4
PEER_WAIT = 300.0  # s; it compiles when it starts


def peer_interpreter() -> Path:
    """Python of the environment that holds XLB: `FISHMJ_XLB_PYTHON`, or `xlb` in the cache folder.

    Raises NotHere: there is none; the message has the command that makes it.
    """
    chosen = os.environ.get("FISHMJ_XLB_PYTHON")
    home = cache_folder() / "xlb"
    python = Path(chosen) if chosen else home / "bin" / "python"
    if not python.is_file():
        make = f"{shlex.join(['python', '-m', 'venv', str(home)])} && {shlex.join([str(home / 'bin' / 'pip'), 'install', *PEER])}"
        raise NotHere(f"XLB: no interpreter at {python}; {make}")
    return python


def xlb(quick: bool) -> BenchmarkWork:
    """XLB's periodic step on the same box, on the CPU.

    Raises NotHere: it is not installed, or does not start; the message has its last output.
    """
    steps = PEER_QUICK if quick else PEER_STEPS
    command = [str(peer_interpreter()), str(Path(__file__).with_name("peer_xlb.py")), *map(str, PEER_SHAPE)]
    said = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115  lives as long as the worker
    worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said, text=True)
    watchdog = threading.Timer(PEER_WAIT, worker.kill)
    weakref.finalize(run := _StepRequest(worker, steps, said), worker.kill)
    watchdog.start()
    try:
        run()
    finally:
        watchdog.cancel()
    return BenchmarkWork(run, steps * prod(PEER_SHAPE) / MEGA, "cpu, XLB 0.3.1 in one thread")


class _StepRequest:
    """Run of the worker: requests a number of steps and waits for the answer."""

    def __init__(self, worker, steps: int, said):
        self.worker, self.steps, self.said = worker, steps, said

    def __call__(self) -> None:
        try:
            self.worker.stdin.write(f"{self.steps}\n")
            self.worker.stdin.flush()
        except BrokenPipeError:  # the reason is read below
            pass
        for line in self.worker.stdout:  # XLB may print other lines first
            if line.strip() == "done":
                return
        self.said.seek(0)
        last = self.said.read().strip().splitlines()[-1:] or [f"exit code {self.worker.wait()}"]
        raise NotHere(f"XLB: {last[0]}")


@benchmark("oracle_peer_cpu", "MLUPS", baseline=xlb)
def oracle_peer_cpu(quick: bool) -> BenchmarkWork:
    """The fluid alone in the laptop's box on the CPU, no eddy viscosity, beside XLB's."""
    from fishmj.lbm_oracle.fluid.fluid import Fluid
    from fishmj.lbm_oracle.fluid.lattice import Lattice

    water = Fluid(Lattice(dx=0.02, dt=0.004, nu=2e-5), PEER_SHAPE, "cpu", subgrid="none", keep_velocity=False)
    return _stepped(water, PEER_QUICK if quick else PEER_STEPS, "cpu", water.cells / MEGA)
