"""A body in refined water: the coupled step of `FluidStructure` on the fine level.

On a GPU a part of a step is captured once for each phase of the levels: the copy that each level reads, and the half of the
coarse step (`coupling.Graphs`). Two levels have four phases.
"""

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.refined.refined_fluid import RATIO, RefinedFluid


class RefinedStructure(FluidStructure):
    """Couples one body with the box of finer cells; arguments as `FluidStructure`. The body's dt is the fine level's.

    Raises:
        ConfigError: the water is not refined, or in the middle of a coarse step.
    """

    fluid: RefinedFluid

    def __init__(self, fluid: RefinedFluid, body, markers, **options):
        if not isinstance(fluid, RefinedFluid) or not fluid.whole:
            raise ConfigError("refined: a body is put into refined water between two coarse steps; got other water or time")
        super().__init__(fluid, body, markers, **options)

    def place_markers(self) -> None:
        """Writes the pose of the body into the block that the device reads, as `FluidStructure.place_markers`.

        Raises:
            ConfigError: a marker is so near to a face of the box that its kernel would read cells that no level fills.
        """
        fluid, found = self.fluid, self.body.corner_box(self.boundary.corners).tolist()
        lattice, first, size = fluid.lattice, fluid.first_lu.tolist(), (RATIO * fluid.size_lu).tolist()
        for a in fluid.embedded:
            low, high = ((found[a + 3 * k] - lattice.corner[a]) / lattice.dx - first[a] for k in (0, 1))
            room = min(low, size[a] - 1 - high)
            if room < self.boundary.reach:
                raise ConfigError(
                    f"refined: a marker is {room:.2f} cells from the end of the finer box on axis {'xyz'[a]}, its kernel or law"
                    f" reaches {self.boundary.reach:g}; make the box larger (`near` of a scene), or let it follow the body"
                    " (`centre_on`), and keep both inside the coarser water"
                )
        super().place_markers()
