"""Records fields during a run: at intervals a slice with its picture and, as an option, the whole box for ParaView.

    recorder = FieldRecorder("runs/a_fields", run, every=0.1)
    recorder.record(run)        between two ticks; writes a frame when one is due

    omega_z = dv/dx - du/dy        central differences, one-sided at the faces; times 1 / dt from cells to 1/s

A slice is copied from the device as one plane. Each file is complete or absent, and the list for ParaView names only finished
files: a run can be stopped at any time.
"""

from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import zoom

from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import write_json
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.in_kernels import wrap
from fishmj.lbm_oracle.fluid.lattice import RATIO
from fishmj.lbm_oracle.fluid.step import OPTIONS, Params
from fishmj.lbm_oracle.output import vtk
from fishmj.lbm_oracle.output.slice_plots import SlicePicture, outline
from fishmj.lbm_oracle.output.slices import INDEX, SCHEMA, STRONG, Slice, write_slice
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid
from fishmj.lbm_oracle.run.run import Run
from fishmj.mjcf.skin import Skin, skin

wp.set_module_options(OPTIONS)

KINDS = {"slices": ".npz", "vorticity": ".png", "volume": ".vti", "fish": ".vtp"}  # folder -> what lies in it
SERIES = "volume.pvd"


@wp.func
def _at(s: Params, u: wp.array3d(dtype=wp.vec3), origin: wp.vec3i, i: int, j: int, k: int, share: float):
    """Velocity of window node (i, j) between planes k and k + 1."""
    x, y = wrap(origin[0] + i, s.nx), wrap(origin[1] + j, s.ny)
    low = u[x, y, wrap(origin[2] + k, s.nz)]
    high = u[x, y, wrap(origin[2] + wp.min(k + 1, s.nz - 1), s.nz)]
    return (1.0 - share) * low + share * high


@wp.kernel
def cut(s: Params, u: wp.array3d(dtype=wp.vec3), origin: wp.vec3i, k: int, share: float, plane: wp.array2d(dtype=wp.vec3)):
    """Computes (u, v, omega_z) [lu] of every column of the window, low corner first."""
    i, j = wp.tid()
    w, e = wp.max(i - 1, 0), wp.min(i + 1, s.nx - 1)
    d, n = wp.max(j - 1, 0), wp.min(j + 1, s.ny - 1)
    here = _at(s, u, origin, i, j, k, share)
    dv = _at(s, u, origin, e, j, k, share)[1] - _at(s, u, origin, w, j, k, share)[1]
    du = _at(s, u, origin, i, n, k, share)[0] - _at(s, u, origin, i, d, k, share)[0]
    plane[i, j] = wp.vec3(here[0], here[1], dv / float(e - w) - du / float(n - d))


def plane_of(fluid, z: float | None = None) -> np.ndarray:
    """Plane (nx, ny, 3) of u, v in m/s and omega_z in 1/s at height z [m], linear between planes of nodes; None: mid-depth.

    Raises ConfigError: z lies outside the water.
    """
    lattice, (nx, ny, nz) = fluid.lattice, fluid.extent
    height = fluid.origin_lu[2] + (nz - 1) / 2 if z is None else lattice.to_lu((0.0, 0.0, z))[2]
    level = float(height - fluid.origin_lu[2])
    if not -1e-6 <= level <= nz - 1 + 1e-6:
        low, high = (lattice.to_si((0, 0, fluid.origin_lu[2] + k))[2] for k in (0, nz - 1))
        raise ConfigError(f"slice at z = {z} m lies outside the water; expected {low:.3f} to {high:.3f} m, or mid")
    k = int(np.clip(np.floor(level), 0, nz - 1))
    out = wp.empty((nx, ny), dtype=wp.vec3, device=fluid.device)
    inputs = [fluid.params, fluid.velocity_lu(), wp.vec3i(*map(int, fluid.origin_lu)), k, max(level - k, 0.0), out]
    wp.launch(cut, dim=(nx, ny), inputs=inputs, device=fluid.device)
    return out.numpy() * np.array([lattice.velocity, lattice.velocity, 1 / lattice.dt], np.float32)


def plane_of_levels(fluid: Fluid, z: float) -> np.ndarray:
    """Plane (nx, ny, 3) at height z [m] as `plane_of`, in cells of the finest level; coarser levels are interpolated linearly."""
    boxes = [box for box in fluid.boxes if _reaches(box, z)] if isinstance(fluid, RefinedFluid) else []
    planes = [plane_of(level, z) for level in (*boxes, fluid.levels[-1])]
    for k, box in enumerate(boxes):  # cells under a box are means of its cells: those beside it are interpolated from them
        (x, y, _), (i, j, _), (m, n, _) = box.box_slices(), box.low_lu - box.outer.origin_lu, box.size_lu
        planes[k + 1][i : i + m, j : j + n] = planes[k][x, y].reshape(m, RATIO, n, RATIO, 3).mean((1, 3))
    enlarged = lambda plane, r: zoom(plane, (r, r, 1), order=1, mode="nearest", grid_mode=True)
    made, at = enlarged(planes[-1], round(fluid.levels[-1].lattice.dx / fluid.lattice.dx)), np.zeros(3, int)
    for box, plane in zip(boxes[::-1], planes[-2::-1], strict=True):
        (x, y, _), r = box.box_slices(), round(box.lattice.dx / fluid.lattice.dx)
        at = at + RATIO * r * (box.low_lu - box.outer.origin_lu)
        m, n = r * (x.stop - x.start), r * (y.stop - y.start)
        made[at[0] : at[0] + m, at[1] : at[1] + n] = enlarged(plane, r)[r * x.start : r * x.stop, r * y.start : r * y.stop]
        at = at - r * np.array([x.start, y.start, 0])
    return made


def _reaches(box: RefinedFluid, z: float) -> bool:
    """Returns True if a box of finer cells holds the height z, m."""
    low, high = box.lattice.to_si(box.origin_lu - 0.5 + np.array([(one.start, one.stop) for one in box.box_slices()]).T)
    return bool(low[2] <= z <= high[2])


def slice_of(run, z: float | None = None) -> Slice:
    """Slice of a run's present water at height z [m]; None: mid-depth."""
    coupled = run.coupled
    fluid = coupled.fluid
    with coupled.scope():
        plane = plane_of(fluid, z)
    low = fluid.lattice.to_si(fluid.origin_lu)
    x, y = (low[axis] + fluid.lattice.dx * np.arange(fluid.extent[axis]) for axis in range(2))
    at = low[2] + (fluid.extent[2] - 1) / 2 * fluid.lattice.dx if z is None else z
    return Slice(run.time, float(at), x, y, plane[..., 0], plane[..., 1], plane[..., 2], outline(run))


def write_volume(run: Run, box: Path, fish: Path, hull: Skin) -> None:
    """Writes the whole water of a run, and the fish in it with the skin `hull`, for ParaView."""
    coupled = run.coupled
    lattice = coupled.fluid.lattice
    with coupled.scope():
        velocity = coupled.fluid.velocity()
    vtk.write_box(box, velocity, lattice.dx, lattice.to_si(coupled.fluid.origin_lu), run.time)
    q = np.concatenate([run.pose[:3], run.angles()])
    vtk.write_fish(fish, hull, q, float(coupled.body.data.xpos[1, 2]), run.time)


class FieldRecorder:
    """Writes the fields of one run into a folder.

    Args:
        every: s between two frames, a whole number of bus ticks.
        z: height of the slice, m; None: mid-depth.
        whole: also write the box and the fish for ParaView, 3 to 25 MB a frame.
        strong: vorticity at the ends of the pictures' colour scale, 1/s.
        overwrite: replace the frames of another run in that folder.

    Raises:
        ConfigError: `every` is not a whole number of ticks, or z is outside the water.
        StoreError: the folder holds another run's fields.
    """

    def __init__(self, folder, run: Run, *, every=0.1, z: float | None = None, whole=False, strong=STRONG, overwrite=False):
        tick = run.robot.timing.bus_dt
        self.ticks = round(every / tick)
        if self.ticks < 1 or abs(self.ticks * tick - every) > 1e-9:
            near = max(1, self.ticks) * tick
            raise ConfigError(f"fields: every = {every} s is no multiple of the bus tick of {tick} s; nearest: {near:g} s")
        self.folder, self.z, self.whole, self.frames = Path(folder), z, whole, 0
        plane_of(run.coupled.fluid, z)  # refuses a height outside the water before anything is written
        self._clear(overwrite)
        fluid, flow = run.coupled.fluid, run.coupled.fluid.flow
        about: dict[str, Any] = {"schema": SCHEMA, "origin": "synthetic", "source": "fishmj.lbm_oracle", "robot": run.robot.name}
        about |= {"every_s": every, "z_m": z, "dx_m": fluid.lattice.dx, "dt_s": fluid.lattice.dt, "shape": list(fluid.extent)}
        about |= {"slip": run.coupled.slip, "flow": {"speed": flow.speed, "direction": flow.direction, "seed": flow.seed}}
        write_json(self.folder / INDEX, about)
        self.picture = SlicePicture(strong)
        self.skin = skin(run.robot, smooth=True)
        self.series: list[tuple[float, list[str]]] = []

    def _clear(self, overwrite: bool) -> None:
        """Removes the frames of another run, which would mix with those of this one; raises StoreError without `overwrite`."""
        old = [path for kind, end in KINDS.items() for path in (self.folder / kind).glob(f"[0-9]*{end}")]
        old += [path for path in (self.folder / SERIES, self.folder / INDEX) if path.is_file()]
        if old and not overwrite:
            raise StoreError(f"{self.folder}: holds the fields of another run; choose another folder or pass --overwrite")
        for path in old:
            path.unlink()

    def record(self, run: Run) -> bool:
        """Writes a frame if one is due, and returns True then; call it between ticks."""
        if run.ticks != self.frames * self.ticks:
            return False
        one = slice_of(run, self.z)
        name = f"{self.frames:05d}"
        write_slice(self.folder / "slices" / f"{name}.npz", one)
        self.picture.write(self.folder / "vorticity" / f"{name}.png", one)
        if self.whole:
            box, fish = f"volume/{name}.vti", f"fish/{name}.vtp"
            write_volume(run, self.folder / box, self.folder / fish, self.skin)
            self.series.append((run.time, [box, fish]))
            vtk.write_series(self.folder / SERIES, self.series)
        self.frames += 1
        return True
