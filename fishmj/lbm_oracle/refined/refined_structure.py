"""A body in refined water: the coupled step of `FluidStructure` on the fine level, with graphs that know both levels.

On a GPU a part of a step is captured once for each phase of the two levels, four in all: which copy each level reads, and in
which half of a coarse step.
"""

from contextlib import nullcontext

import warp as wp

from fishmj.errors import ConfigError
from fishmj.lbm_oracle.immersed.coupling import FluidStructure, Part
from fishmj.lbm_oracle.refined.refined_fluid import RATIO, RefinedFluid


class RefinedStructure(FluidStructure):
    """One body in the box of finer cells; arguments as `FluidStructure`'s, the body's dt is the fine level's.

    Raises:
        ConfigError: the water is not refined, or in the middle of a coarse step.
    """

    fluid: RefinedFluid

    def __init__(self, fluid: RefinedFluid, body, markers, **options):
        if not isinstance(fluid, RefinedFluid) or not fluid.whole:
            raise ConfigError("refined: a body is put into refined water between two coarse steps; got other water or time")
        super().__init__(fluid, body, markers, **options)
        if self._graphs is not None:
            self._graphs = _PhaseGraphs(self)  # type: ignore[assignment]  # the same three calls, other phases

    def place_markers(self) -> None:
        """As `FluidStructure.place_markers`.

        Raises:
            ConfigError: a marker is so near to a face of the box that its kernel would read what no level knows.
        """
        fluid, found = self.fluid, self.body.corner_box(self.boundary.corners).tolist()
        lattice, first, size = fluid.lattice, (RATIO * fluid.low_lu).tolist(), (RATIO * fluid.size_lu).tolist()
        for a in fluid.embedded:
            low, high = ((found[a + 3 * k] - lattice.corner[a]) / lattice.dx - first[a] for k in (0, 1))
            room = min(low, size[a] - 1 - high)
            if room < self.boundary.width / 2:
                raise ConfigError(
                    f"refined: a marker is {room:.2f} cells from the end of the finer box on axis {'xyz'[a]}, its kernel reaches"
                    f" {self.boundary.width / 2:g}; let the box follow the body (`centre_on`), or make it larger"
                )
        super().place_markers()


class _PhaseGraphs:
    """The three parts of a step, captured for each phase of the two levels, on a stream of their own."""

    def __init__(self, coupled: RefinedStructure):
        self.coupled, self.device = coupled, coupled.fluid.device
        self.stream, self.solved = wp.Stream(self.device), wp.Event(self.device)
        self.here = nullcontext() if wp.get_cuda_device_count() == 1 else wp.ScopedDevice(self.device)
        self.warm: set[tuple[Part, int]] = set()
        self.graphs: dict[tuple[Part, int], wp.Graph] = {}
        self.flow, self.joined = coupled.fluid.flow, True
        wp.synchronize_device(self.device)  # the arrays were made on another stream

    def launch(self, part: Part) -> None:
        """Queue it: launch by launch through the first phases, which loads the modules, and from a graph ever after."""
        fluid = self.coupled.fluid
        if fluid.flow is not self.flow:  # a new background flow has new launches
            self.flow, self.graphs = fluid.flow, {}
        if self.joined:
            self.stream.wait_stream(self.device.stream)  # what was queued outside `scope` since
            self.joined = False
        key = part, fluid.phase
        if key not in self.graphs:
            with wp.ScopedStream(self.stream):
                if key in self.warm:
                    self.graphs[key] = self._capture(part)
                else:
                    self.coupled.launch(part)
        if key in self.graphs:
            with self.here:
                wp.capture_launch(self.graphs[key], self.stream)
            if part == "water":
                fluid.skip(1)
        self.warm.add(key)
        if part == "solution":
            self.stream.record_event(self.solved)

    def join_stream(self) -> None:
        self.device.stream.wait_stream(self.stream)
        self.joined = True

    def wait(self) -> None:
        """Until the velocity is on the host."""
        wp.synchronize_event(self.solved)

    def _capture(self, part: Part) -> wp.Graph:
        fluid = self.coupled.fluid
        account = fluid.account
        with wp.ScopedCapture(self.device, stream=self.stream) as captured:
            self.coupled.launch(part)
        fluid.account = account
        return captured.graph
