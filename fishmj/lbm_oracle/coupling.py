"""The coupled step: fish and water find their common velocity together.

    body:    M, forces, interior water         ->  one block of numbers to the device
    device:  listen (K, b0), decide (v+)       ->  v+ to the host, while the device goes on with
             answer (force), fluid step
    host:    mj_step to v+                     ->  the next block

The solve is implicit in the velocity of the joints, so that a body as light as water, or a thin light tail, is stable; the
explicit scheme diverges there (docs/oracle_coupling.md). `Coupled.step` is the main loop.
"""

from contextlib import nullcontext

import numpy as np
import warp as wp

from fishmj.errors import ConfigError, UnknownName
from fishmj.lbm_oracle.body import Body
from fishmj.lbm_oracle.boundary import Boundary
from fishmj.lbm_oracle.fluid import Fluid
from fishmj.lbm_oracle.markers import Markers

SCHEMES = ("implicit", "explicit")
NEXT, LAST = [1, 2, 0, 2, 0, 1], [2, 0, 1, 1, 2, 0]  # of x, y, z: a x b is the first less the second half of a_next b_last


class Coupled:
    """One body in one fluid.

    Args:
        slip: ratio quoted at the paper's grid; 1 lets the water slide along the hull, 0 holds it.
        width, passes: of the immersed boundary.
        scheme: "implicit"; "explicit" is kept to show that it fails.
        interior: add the momentum of the water inside the hull; False is kept for the same reason.

    Raises:
        ConfigError: the two clocks differ, or a name is unknown.
    """

    def __init__(
        self, fluid: Fluid, body: Body, markers: Markers, *, slip=1.0, width=3, passes=2, scheme="implicit", interior=True
    ):
        if scheme not in SCHEMES:
            raise UnknownName("coupling scheme", scheme, SCHEMES)
        if abs(fluid.lattice.dt - body.dt) > 1e-12:
            raise ConfigError(f"coupled: the fluid steps {fluid.lattice.dt} s and the body {body.dt} s; give both the same dt")
        self.fluid, self.body, self.scheme, self.interior, self.slip = fluid, body, scheme, interior, slip
        self.boundary = Boundary(markers, body, fluid, width=width, passes=passes, slip=slip)
        self.steps = 0
        self.gain = np.zeros((body.links, 6))  # momentum of the inside water handed to the links since `take_wrench`
        self._graphs = _Graphs(self) if fluid.device.is_cuda else None

    @property
    def time(self) -> float:
        """s of the body's clock."""
        return float(self.body.data.time)

    def step(self, fixed=None, value=None) -> np.ndarray:
        """One time step; returns the new velocity of the body, (n,).

        Args:
            fixed: (n,) 1 where the velocity is prescribed. value: (n,) that velocity, m/s or rad/s.

        Raises:
            SimDiverged: the body's velocity is not finite.
        """
        self.begin(fixed, value)
        velocity = self.finish()
        self.join()
        return velocity

    def scope(self):
        """The stream of this tank: whatever else looks at its arrays or moves them does so inside."""
        return nullcontext() if self._graphs is None else wp.ScopedStream(self._graphs.stream)

    def join(self) -> None:
        """From here on, who looks at the arrays outside `scope` sees them after the step; the host does not wait."""
        if self._graphs is not None:
            self._graphs.join()

    def begin(self, fixed=None, value=None) -> None:
        """The host's half: the body's equation, and the launches of the whole step. Several tanks begin before one finishes."""
        system, right = self.body.equation(interior=self.interior)
        self.boundary.fill(self.body, system, right, fixed, value)
        if self._graphs is None:
            self.listen()
            self.answer()
        else:
            self._graphs.launch()
        if self.interior:  # what no launch waits for comes behind them
            self.gain += self.body.gain

    def finish(self) -> np.ndarray:
        """Wait for the velocity, (n,), and let MuJoCo take it."""
        if self._graphs is not None:
            self._graphs.wait()
        velocity = self.boundary.found.copy()
        self.body.advance(velocity)
        self.steps += 1
        return velocity

    def listen(self) -> None:
        """Queue the first half: up to the velocity on its way to the host."""
        fluid = self.fluid
        self.boundary.listen(fluid.f.flatten(), fluid.origin, fluid.box)
        self.boundary.decide(self.scheme == "implicit")

    def answer(self) -> None:
        """Queue the second half: the force, and the fluid's step under it."""
        self.boundary.answer(self.fluid.force)
        self.fluid.advance()
        self.boundary.clear(self.fluid.force)

    def take_wrench(self, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean wrench of the water on every link over the last `seconds` (since the last call), each (L, 6).

        World frame, N, and N m about the link's origin. First the impulse that the markers exchanged (raw), then with the
        momentum of the inside water added: the force of the real water on a hull that holds none.
        """
        raw = self.boundary.take_wrench() / seconds
        gain, self.gain = self.gain / seconds, np.zeros(self.gain.shape)
        turn = (self.body.centre - self.body.data.xpos[1:])[:, NEXT] * gain[:, LAST]
        gain[:, 3:] += turn[:, :3] - turn[:, 3:]
        return raw, raw + gain


class _Graphs:
    """Two captured halves for each parity of the fluid's copies, on a stream of their own."""

    def __init__(self, coupled: Coupled):
        self.coupled, self.device = coupled, coupled.fluid.device
        self.stream, self.decided = wp.Stream(self.device), wp.Event(self.device)
        self.here = wp.ScopedDevice(self.device)
        self.warm: set[int] = set()
        self.halves: dict[int, tuple] = {}
        self.flow, self.joined = coupled.fluid.flow, True
        wp.synchronize_device(self.device)  # the arrays were made on another stream

    def launch(self) -> None:
        fluid = self.coupled.fluid
        if fluid.flow is not self.flow:  # a new background flow has new launches
            self.flow, self.halves = fluid.flow, {}
        parity = fluid.parity
        if parity not in self.halves:
            with wp.ScopedStream(self.stream):
                if parity not in self.warm:  # loads the modules, which a capture must not
                    self.coupled.listen()
                    wp.record_event(self.decided)
                    self.coupled.answer()
                    self.warm.add(parity)
                    return
                self.halves[parity] = self._capture()
        first, second = self.halves[parity]
        with self.here:
            if self.joined:
                self.stream.wait_stream(self.device.stream)  # what was queued outside `scope` since
                self.joined = False
            wp.capture_launch(first, self.stream)
            self.stream.record_event(self.decided)
            wp.capture_launch(second, self.stream)
        fluid.parity, fluid.steps = 1 - parity, fluid.steps + 1

    def join(self) -> None:
        self.device.stream.wait_stream(self.stream)
        self.joined = True

    def wait(self) -> None:
        wp.synchronize_event(self.decided)

    def _capture(self) -> tuple:
        fluid = self.coupled.fluid
        parity, steps = fluid.parity, fluid.steps
        with wp.ScopedCapture(self.device, stream=self.stream) as first:
            self.coupled.listen()
        with wp.ScopedCapture(self.device, stream=self.stream) as second:
            self.coupled.answer()
        fluid.parity, fluid.steps = parity, steps
        return first.graph, second.graph
