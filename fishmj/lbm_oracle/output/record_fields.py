"""Fields of a run while it runs: every so often a slice with its picture, and, if asked for, the whole box for ParaView.

    recorder = Recorder("runs/a_fields", run, every=0.1)
    recorder.look(run)          between two ticks; does something when it is time to

Each file is whole or not there, and the list for ParaView names only finished ones: a run can be stopped at any time.
"""

from pathlib import Path
from typing import Any

import numpy as np

from fishmj.errors import ConfigError, StoreError
from fishmj.lbm_oracle.output import vtk
from fishmj.lbm_oracle.output.field_options import STRONG
from fishmj.lbm_oracle.output.slice_plots import SlicePicture
from fishmj.lbm_oracle.output.slices import INDEX, SCHEMA, write_slice
from fishmj.lbm_oracle.output.vorticity import plane_of, slice_of
from fishmj.lbm_oracle.run.run import Run
from fishmj.mjcf.skin import skin
from fishmj.store import write_json

KINDS = {"slices": ".npz", "vorticity": ".png", "volume": ".vti", "fish": ".vtp"}  # folder -> what lies in it
SERIES = "volume.pvd"


class FieldRecorder:
    """Writes the fields of one run into a folder.

    Args:
        every: s between two frames, a whole number of bus ticks.
        z: height of the slice, m; None: mid-depth.
        whole: the box and the fish for ParaView, too: 3 to 25 MB a frame.
        strong: vorticity at the ends of the pictures' colour scale, 1/s.
        overwrite: replace the frames of another run in that folder.

    Raises:
        ConfigError: `every` is no number of ticks, z is outside the water. StoreError: the folder holds another run's fields.
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
        about |= {"every_s": every, "z_m": z, "dx_m": fluid.lattice.dx, "dt_s": fluid.lattice.dt, "shape": list(fluid.shape)}
        about |= {"slip": run.coupled.slip, "flow": {"speed": flow.speed, "direction": flow.direction, "seed": flow.seed}}
        write_json(self.folder / INDEX, about)
        self.picture = SlicePicture(strong)
        self.skin = skin(run.robot, smooth=True)
        self.series: list[tuple[float, list[str]]] = []

    def _clear(self, overwrite: bool) -> None:
        """Frames of another run would mix with those of this one."""
        old = [path for kind, end in KINDS.items() for path in (self.folder / kind).glob(f"[0-9]*{end}")]
        old += [path for path in (self.folder / SERIES, self.folder / INDEX) if path.is_file()]
        if old and not overwrite:
            raise StoreError(f"{self.folder}: holds the fields of another run; choose another folder or pass --overwrite")
        for path in old:
            path.unlink()

    def look(self, run: Run) -> bool:
        """To be called between ticks; True when a frame was written."""
        if run.ticks != self.frames * self.ticks:
            return False
        one = slice_of(run, self.z)
        name = f"{self.frames:05d}"
        write_slice(self.folder / "slices" / f"{name}.npz", one)
        self.picture.write(self.folder / "vorticity" / f"{name}.png", one)
        if self.whole:
            self._volume(run, name)
        self.frames += 1
        return True

    def _volume(self, run: Run, name: str) -> None:
        coupled = run.coupled
        with coupled.scope():
            velocity = coupled.fluid.velocity()
        low = coupled.fluid.lattice.to_si(coupled.fluid.origin_lu)
        box, fish = f"volume/{name}.vti", f"fish/{name}.vtp"
        vtk.write_box(self.folder / box, velocity, coupled.fluid.lattice.dx, low, run.time)
        q = np.concatenate([run.pose[:3], run.angles()])
        vtk.write_fish(self.folder / fish, self.skin, q, float(coupled.body.data.xpos[1, 2]), run.time)
        self.series.append((run.time, [box, fish]))
        vtk.write_series(self.folder / SERIES, self.series)

    def close(self) -> None:
        """Let go of the figure."""
        self.picture.close()
