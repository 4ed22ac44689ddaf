"""A finer box in coarser water: waves across its faces, and a sphere in it compared with the same sphere in fine water.

    shear wave   u_y = U exp(-nu k^2 t) sin k x, across both levels: viscosity of each, and error against the wave
    vortices     Taylor and Green's, carried by a stream across the faces of the box
    pulse        a plane pulse of sound through the box: what returns, over its height
    sphere       C_D of a held sphere at Re 20, eight fine cells across
    fish         the audit of `coupled_fish` with the fish in a finer box that follows it

A wave of 32 coarse cells; lengths in coarse cells, the box takes half of each axis that it does not fill.
"""

from collections.abc import Callable

import numpy as np

from fishmj.lbm_oracle.cases import about, below, register, reported
from fishmj.lbm_oracle.cases.coupled_fish import LAG, drift, momentum
from fishmj.lbm_oracle.cases.sphere import STREAM, ball, clift
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import CS, Lattice
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.link_dynamics import Corners
from fishmj.lbm_oracle.immersed.markers import fish_markers, sphere_markers
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid, fine_lattice, lowest
from fishmj.lbm_oracle.refined.refined_structure import RefinedStructure
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.setup import LOOK, DomainWatch
from fishmj.water.flow import Flow

N, SPEED, DRIFT, HEIGHT = 32, 0.03, (0.05, 0.03), 1e-3  # coarse cells a wave; lattice units
POND = (80, 36, 20)  # coarse cells: from 0.3 m behind the middle, room for three beats ahead

Field = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # places (..., 3) m -> velocity (..., 3) m/s, pressure (...) Pa


def places(water: Fluid) -> np.ndarray:
    """Positions of the nodes, (nx, ny, nz, 3) m."""
    return water.lattice.to_si(np.moveaxis(np.indices(water.shape), 0, -1) + water.origin_lu)


def water_and_box(shape, low, size, field: Field, *, nu=0.02, device="cpu", subgrid="none", linear=True) -> RefinedFluid:
    """Periodic water of cells and steps of 1, a finer box in it, and a field on both."""
    outer = Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0, nu=nu), shape, device, subgrid=subgrid)
    box = RefinedFluid(outer, low, size, linear=linear)
    for level in (outer, box):
        level.impose(*field(places(level)))
    box.restrict()
    return box


def shear(nu: float, t: float = 0.0, n: int = N) -> Field:
    """Shear wave at time t, n coarse cells long; its speed, and the Mach number, are proportional to 1 / n."""
    k, speed = 2 * np.pi / n, SPEED * N / n

    def field(x):
        u = np.zeros(x.shape)
        u[..., 1] = speed * np.exp(-nu * k * k * t) * np.sin(k * x[..., 0])
        return u, np.zeros(x.shape[:-1])

    return field


def vortices(nu: float, t: float = 0.0, n: int = N) -> Field:
    """Taylor-Green vortices at time t, in a stream, n coarse cells long; speeds proportional to 1 / n."""
    k, drift = 2 * np.pi / n, np.array(DRIFT) * N / n

    def field(x):
        a, b = k * (x[..., 0] - drift[0] * t), k * (x[..., 1] - drift[1] * t)
        height = SPEED * N / n * np.exp(-2 * nu * k * k * t)
        u = np.zeros(x.shape)
        u[..., 0], u[..., 1] = drift[0] + height * np.sin(a) * np.cos(b), drift[1] - height * np.cos(a) * np.sin(b)
        return u, height**2 / 4 * (np.cos(2 * a) + np.cos(2 * b))

    return field


def shear_viscosity(device: str = "cpu", nu: float = 0.02, steps: int = 600) -> tuple[float, float]:
    """Viscosity measured from the wave on the coarse and on the fine level, divided by `nu`."""
    box = water_and_box((N, 8, 1), (8, 2, 0), (16, 4, 1), shear(nu), nu=nu, device=device)
    box.run(2 * steps)
    box.complete()
    found = []
    for level, where in ((box.outer, ...), (box, box.box_slices())):
        x, u = places(level)[where][..., 0], level.velocity()[where][..., 1]
        s = np.sin(2 * np.pi / N * x)
        found.append(float(-np.log((u * s).sum() / (s * s).sum() / SPEED) / ((2 * np.pi / N) ** 2 * steps * nu)))
    return found[0], found[1]


def error(level: Fluid, expected: Field, where=...) -> float:
    """Root mean square of the velocity's error, divided by that of the velocity."""
    u = expected(places(level)[where])[0]
    return float(np.sqrt(((level.velocity()[where] - u) ** 2).mean() / (u**2).mean()))


def across(flow: Callable[..., Field] = shear, device: str = "cpu", nu: float = 0.02, linear: bool = True, n: int = N) -> float:
    """Error of a flow n coarse cells long on the worse of the two levels, after 400 coarse steps of the wave of 32 cells."""
    steps, q = 400 * n * n // N**2, n // 4
    box = water_and_box((n, n, 1), (q, q, 0), (2 * q, 2 * q, 1), flow(nu, n=n), nu=nu, device=device, linear=linear)
    box.run(2 * steps)
    box.complete()
    there = flow(nu, steps, n)
    return max(error(box.outer, there), error(box, there, box.box_slices()))


def error_on_one_level(flow: Callable[..., Field], device: str, nu: float, steps: int, fine: bool) -> float:
    """Error of the same flow in water of one level, of coarse or of fine cells."""
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=nu)
    factor = 2 if fine else 1
    water = Fluid(fine_lattice(lattice) if fine else lattice, (factor * N, factor * N, factor), device, subgrid="none")
    water.impose(*flow(nu)(places(water)))
    water.run(factor * steps)
    return error(water, flow(nu, steps))


def pulse_returned(device: str = "cpu", width: float = 4.0, n: int = 300, low: int = 130, size: int = 40) -> float:
    """Greatest pressure before the box once a plane pulse of that width has run through it, over its height."""

    def field(x):
        p = HEIGHT * np.exp(-((x[..., 0] - 80.0) ** 2) / (2 * width**2))
        u = np.zeros(x.shape)
        u[..., 0] = p / CS
        return u, p

    box = water_and_box((n, 1, 1), (low, 0, 0), (size, 1, 1), field, nu=1e-3, device=device)
    box.run(2 * round((low + size + 10 - 80 + 3 * width) / CS))
    return float(np.abs(box.outer.pressure()[5 : low - 2]).max() / HEIGHT)


def sphere_drag(level: str, device: str, reynolds: float = 20.0, cells: int = 8, towed: bool = False) -> float:
    """C_D of a sphere of `cells` fine cells, as in the case `sphere_drag`: in water that is `coarse`, `fine` or `refined`.

    The box reaches one diameter ahead of the sphere, one and a half behind it and three quarters beside it.
    """
    a, dimensions, times = (1.0 if level == "fine" else 2.0), np.array([9, 7, 7]), 4.0
    faces = Boundaries(x=Axis("open", "open"), y=Axis("slip", "slip"), z=Axis("slip", "slip"), sponge=round(8 / a))
    lattice = Lattice(dx=a, dt=a, rho=1.0, nu=STREAM * cells / reynolds)
    flow = Flow() if towed else Flow(speed=STREAM)
    nx, ny, nz = (int(n) for n in np.round(dimensions * cells / a))
    outer = water = Fluid(lattice, (nx, ny, nz), device, subgrid="none", boundaries=faces, flow=flow)
    at = dimensions * cells * [0.4, 0.5, 0.5] + [0.2, -0.3, -0.4]
    structure: type[FluidStructure] = FluidStructure
    if level == "refined":
        lx, ly, lz = (int(n) for n in np.ceil(np.array([3.5, 2.5, 2.5]) * cells / a) + 1)
        water, structure = (
            RefinedFluid(outer, lowest(outer, at + [0.25 * cells, 0, 0], (lx, ly, lz)), (lx, ly, lz)),
            RefinedStructure,
        )
    body, dx = ball(cells / 2, water.lattice, at=at), water.lattice.dx
    held = structure(water, body, sphere_markers(cells / 2, dx), slip=0.0)
    steps, tail = (round(share * times * cells / STREAM / dx) for share in (1.0, 0.2))
    gone = 0
    for n in range(steps):
        if n == steps - tail:
            held.take_wrench(1.0)
        held.step(np.ones(3), [-STREAM if towed else 0.0, 0.0, 0.0])
        if towed and n % 2 and at[0] - body.data.qpos[0] >= (gone + 1) * a:
            with held.scope():
                outer.shift((-1, 0, 0))
                if isinstance(water, RefinedFluid):
                    water.move((-1, 0, 0))
            gone += 1
    return float(held.take_wrench(tail * dx)[0][0, 0] / (STREAM**2 * np.pi * cells**2 / 8))


def fish_audit(device: str, seconds: float = 3.0, slip: float = 1.0) -> tuple[float, float]:
    """Drift of the momentum of water, fish and its interior water over the fish's largest; speed at the end, m/s.

    The fish beats in a periodic box of 2 cm with 1 cm round it; the finer box follows.
    """
    domain = Domain(name="pond", shape=POND, dx=0.02, dt=0.004, fine=(0.72, 0.4, 0.28))
    level = domain.body_level
    outer = Fluid(domain.lattice, domain.shape, device)
    body, markers = ImmersedBody.of("fish", "planar", level.dt), fish_markers("fish", level.dx, slip=slip)
    start = body.data.qpos.copy()
    start[0] = -0.3
    body.place(start)
    middle = 0.5 * np.sum(body.bounds(Corners.of(markers, body.water.centre)), 0)
    box = RefinedFluid(outer, lowest(outer, middle, domain.fine_cells), domain.fine_cells)
    coupled = RefinedStructure(box, body, markers, slip=slip)
    edge, history = DomainWatch(domain), []
    for n in range(round(seconds / level.dt)):
        if n % 10 == 0:
            history.append(momentum(coupled))
        t = coupled.time
        body.data.ctrl[:] = min(1.0, t) * np.radians(30.0) * np.sin(2 * np.pi * t - LAG)
        coupled.step()
        if n % LOOK == LOOK - 1:
            with coupled.scope():
                edge.follow(coupled)
    return drift(history), float(body.data.qvel[0])


@register("refined_fish", rung=15.05, grid="80 x 36 x 20, 2 cm, with 1 cm round the fish", source="conservation", cost="2 min")
def refined_fish(device):
    """A beating fish in a finer box that follows it: momentum of both levels, the fish and its interior water."""
    found, speed = fish_audit(device)
    yield below("momentum drift over max |p_solid|", found, 0.03)
    yield reported("speed along x after 3 beats, m/s", speed)


@register("refined_waves", rung=2.6, quick=True, grid="32^2 with 16^2 of them halved", source="exact; one level of each cell")
def refined_waves(device):
    """A shear wave, vortices and a pulse of sound across the faces of a finer box."""
    for name, value in zip(("coarse", "fine"), shear_viscosity(device), strict=True):
        yield about(f"viscosity on the {name} level over what it is", value, 1.0, 0.01)
    for what, flow in (("shear wave", shear), ("vortices in a stream", vortices)):
        yield below(f"{what}: error", across(flow, device), 0.005)
        for fine in (False, True):
            yield reported(
                f"{what}: error of {'fine' if fine else 'coarse'} water all over",
                error_on_one_level(flow, device, 0.02, 400, fine),
            )
        yield reported(f"{what}: error with uniform explosion", across(flow, device, linear=False))
        yield about(f"{what}: order, 16 to 32 cells", np.log2(across(flow, device, n=16) / across(flow, device)), 2.0, 0.1)
    for width in (3.0, 8.0):
        yield below(f"pulse of width {width:g}: returned", pulse_returned(device, width), 0.003)


@register("refined_conserves", rung=2.7, quick=True, grid="24 x 20 x 16 with 8 x 7 x 6 halved", source="conservation")
def refined_conserves(device):
    """Mass and momentum of two levels in a periodic box, 500 coarse steps, WALE."""

    def stirred(x):
        a, b, c = (2 * np.pi * x[..., i] / n for i, n in enumerate((24, 20, 16)))
        return SPEED * np.stack([np.sin(b) + np.cos(c), np.sin(a) - np.cos(c), np.cos(a) * np.sin(b)], -1), 0 * a

    box = water_and_box((24, 20, 16), (6, 5, 4), (8, 7, 6), stirred, nu=1e-4, device=device, subgrid="wale")
    before = box.totals()
    box.run(1000)
    drift = np.abs(box.totals() - before) / box.outer.cells
    yield below("mass a cell, change", drift[0], 1e-8)
    yield below("momentum a cell, change over 0.03", drift[1:].max() / SPEED, 1e-6)


@register(
    "refined_sphere", rung=7.3, grid="36 x 28 x 28 with 15 x 11 x 11 halved, D = 8", source="fine water; Clift 1978", cost="1 min"
)
def refined_sphere(device):
    """A sphere at Re 20 in a finer box, held and towed."""
    found, whole = sphere_drag("refined", device), sphere_drag("fine", device)
    yield about("C_D in the box over that in fine water", found / whole, 1.0, 0.02)
    yield about("C_D towed, the box moving along, over held", sphere_drag("refined", device, towed=True) / found, 1.0, 0.03)
    yield about("C_D at Re 20", found, clift(20.0), 0.08)
    yield reported("C_D in coarse water over that in fine", sphere_drag("coarse", device) / whole, 1.0)
