"""The fish itself, free, as light as the water, with its thin light tail, in a periodic box.

The explicit scheme must fail within a tenth of a second and the implicit one must not; momentum is conserved
(`momentum_budget`), and the force that the markers exchange is the force that the cells feel. Speed is not gated: a fin that
trails makes thrust either way, so that swimming forwards proves little.
"""

import numpy as np

from fishmj.errors import SimDiverged
from fishmj.lbm_oracle.cases import below, register, reported
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice_units import Lattice
from fishmj.lbm_oracle.immersed import momentum_budget
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import fish_markers

SHAPE = (56, 32, 20)
LAG = np.radians(60.0) * np.arange(3)


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
    """Servo-driven travelling wave, smooth start; the momentum every few steps."""
    history = [momentum_budget.momentum(coupled)]
    for n in range(round(seconds / coupled.body.dt)):
        t = coupled.time
        coupled.body.data.ctrl[:] = min(1.0, t) * amplitude * np.sin(2 * np.pi * frequency * t - LAG)
        coupled.step()
        if n % every == every - 1:
            history.append(momentum_budget.momentum(coupled))
    return history


def lasts(device: str, scheme: str, seconds: float) -> float:
    """How long a beating fish keeps finite under a coupling scheme, s."""
    coupled = pond(device, scheme=scheme)
    try:
        beat(coupled, seconds)
    except SimDiverged:
        return coupled.time
    return seconds


@register("coupled_fish", rung=15, quick=True, grid="56 x 32 x 20, dx = 2 cm", source="conservation of momentum")
def coupled_fish(device):
    """A neutral fish with a thin light tail: stability, momentum, exchange of force."""
    yield below("explicit coupling fails after, s", lasts(device, "explicit", 0.5), 0.2)
    coupled = pond(device)
    history = beat(coupled, 3.0)
    largest = max(np.linalg.norm(m.solid) for m in history)
    yield below("momentum drift over max |p_solid|", momentum_budget.drift(history), 0.03)
    cells, markers = momentum_budget.exchange(coupled)
    yield below("sum rho G - sum V F, relative", np.abs(cells - markers).max() / np.abs(markers).max(), 2e-6)
    yield below("|mj_step - solve|", np.abs(coupled.body.data.qvel - coupled.boundary.velocity).max(), 1e-9)
    without = pond(device, interior=False)
    yield reported("drift without the inside water", momentum_budget.drift(beat(without, 3.0)))
    yield reported("max |p_solid|, kg m/s", largest)
    yield reported("speed along x after 3 beats, m/s", float(coupled.body.data.qvel[0]))
