"""The free fish, as light as the water, with its thin light tail, in a periodic box.

The explicit scheme must fail within a tenth of a second and the implicit one must not. Momentum is conserved (`Momentum`), and
the force on the markers equals the force on the cells. Speed is not gated: a trailing fin makes thrust with a right or a wrong
coupling, so that swimming forwards proves little.

    grid + solid - displaced = constant            in a periodic box, nothing else pushing

grid = sum rho u over all cells, including the inside of the hull; solid = sum m_l u_l of the links; displaced = sum of the h_l
of the interior water and the layers on sheets (`immersed/__init__.py`), which the grid contains and a real fish does not.
`displaced` is the value of the step before, `ImmersedBody.momentum`, because at the end of a step the links have got back that
much. With the present value the balance would be off by the interior water's gain in one step. A coupling that loses I, its
Coriolis part or a sign drifts by the whole momentum of the fish within a few beats (docs/solver/coupling.md).

`fish_headings` swims in a following window and in a fixed tank, along the grid and across it. Velocities are those of the world
in a window that moves by whole cells, so only the faces and the grid's axes may change the result.
"""

from math import radians
from typing import NamedTuple

import numpy as np
import warp as wp

from fishmj.base.errors import OracleUnstable, SimDiverged
from fishmj.lbm_oracle.cases import about, below, register, reported
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import VELOCITIES, Lattice
from fishmj.lbm_oracle.immersed import kernels
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import fish_markers
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid
from fishmj.lbm_oracle.run.domain import Domain, preset, tank
from fishmj.lbm_oracle.run.setup import Gait, SwimSetup
from fishmj.lbm_oracle.run.swim import figures

SHAPE = (56, 32, 20)
LAG = np.radians(60.0) * np.arange(3)
HEADINGS = (0.0, 30.0, 90.0)  # deg


class Momentum(NamedTuple):
    """Linear momentum, (3,) kg m/s each."""

    grid: np.ndarray
    solid: np.ndarray
    displaced: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """Conserved momentum: grid + solid - displaced, (3,) kg m/s."""
        return self.grid + self.solid - self.displaced


def momentum(coupled: FluidStructure) -> Momentum:
    """Momenta after a step, of water on one level or on several."""
    fluid, body = coupled.fluid, coupled.body
    if isinstance(fluid, RefinedFluid):
        grid = fluid.totals()[1:]
    else:
        f = fluid.f.numpy().reshape(len(VELOCITIES), -1).sum(1, dtype=float)
        grid = f @ VELOCITIES * fluid.lattice.mass * fluid.lattice.velocity
    return Momentum(grid, body.solid_momentum()[:, :3].sum(0), (body.momentum + body.layer_momentum)[:, :3].sum(0))


def drift(history: list[Momentum]) -> float:
    """Largest change of the total over a run, over the largest momentum of the links."""
    total = np.array([m.total for m in history])
    largest = max(np.linalg.norm(m.solid) for m in history)
    return float(np.linalg.norm(total - total[0], axis=1).max() / largest)


def exchange(coupled: FluidStructure) -> tuple[np.ndarray, np.ndarray]:
    """(sum rho G over the cells, sum V F over the markers) of the last step, (3,) each in lattice units: equal to round-off."""
    edge = coupled.boundary
    field = wp.zeros(edge.shape, dtype=wp.vec3, device=edge.device)
    inputs = [edge.cell, edge.store, edge.volume, edge.final, edge.width, wp.vec3i(*edge.shape), edge.box_rho]
    wp.launch(kernels.spread_force, dim=(edge.count, edge.width), inputs=inputs, outputs=[field], device=edge.device)
    low = edge.view["box"].astype(int)
    nodes = np.ix_(*((low[a] + np.arange(edge.box_shape[a])) % edge.shape[a] for a in range(3)))
    pushed = field.numpy().astype(float)[nodes]
    given = edge.volume.numpy().astype(float) @ edge.final.numpy().astype(float)
    return np.einsum("xyz,xyza->a", edge.box_rho.numpy().astype(float), pushed), given


def pond(
    device: str, *, slip: float = 1.0, root: str = "planar", dx=0.02, dt=0.004, dtype="float32", **options
) -> FluidStructure:
    """The default fish in the middle of a periodic box, at rest."""
    lattice = Lattice(dx=dx, dt=dt, corner=(0.0, 0.0, -SHAPE[2] * 0.01))
    body = ImmersedBody.of("fish", root, dt)
    water = Fluid(lattice, tuple(round(n * 0.02 / dx) for n in SHAPE), device, dtype=dtype)
    body.place(np.concatenate([[0.6, 0.32], body.data.qpos[2:]]))
    return FluidStructure(water, body, fish_markers("fish", dx, slip=slip), slip=slip, **options)


def beat(coupled: FluidStructure, seconds: float, *, frequency: float = 1.0, amplitude: float = np.radians(30.0), every: int = 5):
    """Drives a servo-driven travelling wave with a smooth start; returns the momenta every few steps."""
    history = [momentum(coupled)]
    for n in range(round(seconds / coupled.body.dt)):
        t = coupled.time
        coupled.body.data.ctrl[:] = min(1.0, t) * amplitude * np.sin(2 * np.pi * frequency * t - LAG)
        coupled.step()
        if n % every == every - 1:
            history.append(momentum(coupled))
    return history


def time_to_failure(device: str, scheme: str, seconds: float) -> float:
    """Time [s] for which a beating fish stays finite under a coupling scheme; `seconds` at most."""
    coupled = pond(device, scheme=scheme)
    try:
        beat(coupled, seconds)
    except (SimDiverged, OracleUnstable):
        return coupled.time
    return seconds


@register("coupled_fish", rung=15, quick=True, grid="56 x 32 x 20, dx = 2 cm", source="conservation of momentum")
def coupled_fish(device):
    """A neutral fish with a thin light tail: stability, momentum, exchange of force."""
    yield below("explicit coupling fails after, s", time_to_failure(device, "explicit", 0.5), 0.2)
    coupled = pond(device)
    history = beat(coupled, 3.0)
    largest = max(np.linalg.norm(m.solid) for m in history)
    yield below("momentum drift over max |p_solid|", drift(history), 0.03)
    cells, markers = exchange(coupled)
    yield below("sum rho G - sum V F, relative", np.abs(cells - markers).max() / np.abs(markers).max(), 2e-6)
    yield below("|mj_step - solve|", np.abs(coupled.body.data.qvel - coupled.boundary.velocity).max(), 1e-9)
    without = pond(device, interior=False)
    yield reported("drift without the inside water", drift(beat(without, 3.0)))
    yield reported("max |p_solid|, kg m/s", largest)
    yield reported("speed along x after 3 beats, m/s", float(coupled.body.data.qvel[0]))


def cruise(domain: Domain, device: str, *, heading: float = 0.0) -> float:
    """Speed over the last two of four beats of the paper's gait, m/s."""
    start = (-0.4 * np.cos(radians(heading)), -0.4 * np.sin(radians(heading)), radians(heading))
    run, gait = SwimSetup(domain=domain, device=device, pose=start).run(latency=0.0), Gait.of_the_paper()
    for _ in range(round(4 / gait.frequency / run.robot.timing.bus_dt)):
        run.tick(gait(run.time))
    return figures(run, gait.frequency)["speed_m_s"]


@register("fish_headings", rung=15.1, grid="80 x 56 x 30 window, 130 x 130 x 30 tank, dx = 2 cm", source="symmetry")
def fish_headings(device):
    """Cruise in a window and in a tank, three headings."""
    window, still = preset("laptop"), tank("pond", (2.6, 2.6, 0.6), 0.02, 0.004)
    speeds = {heading: cruise(window, device, heading=heading) for heading in HEADINGS}
    yield reported("speed in the window, heading 0, m/s", speeds[0.0])
    for heading in HEADINGS[1:]:
        yield about(f"speed at heading {heading:g} deg over that at 0", speeds[heading] / speeds[0.0], 1.0, 0.03)
    yield about("speed in the tank over that in the window", cruise(still, device) / speeds[0.0], 1.0, 0.03)
