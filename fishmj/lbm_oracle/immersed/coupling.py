"""The coupled step: one linear system gives the common velocity of fish and water.

    place_markers      X_k, n_k, J_k from the body's pose                                   host -> device
    assemble_response  K, b0: the impulse of the body on the water is K v + b0              device
    solve              (M + dt D + K) v+ = (M + dt D) v + dt f - b0 + I                     device, the left side from the host
    push_water         F -> G (spread_force), then the fluid's step (stream_collide)        device
    advance            MuJoCo's own step to v+                                              host

Strong coupling without sub-iterations: K is exact, because the direct forcing is linear in v. It is stable for a body as light as
water and for a thin, light tail. The explicit scheme uses the water's response to the old velocity and diverges
(docs/solver/coupling.md). Host and device work in parallel: the device assembles K while the host assembles M, and it steps the
water while MuJoCo steps.

`FluidStructure.stepping` is the only loop body: `step` and the ticks of a `Run` use it. `device_steps.py` queues the same step
without the host.
"""

from collections.abc import Callable, Generator, Hashable
from contextlib import nullcontext
from functools import partial
from typing import Literal, NamedTuple, Protocol

import numpy as np
import warp as wp

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import checked_kind
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.guard import MACH, StabilityMonitor, check_speed, numbers
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.boundary import Boundary
from fishmj.lbm_oracle.immersed.early_water import EarlyWater
from fishmj.lbm_oracle.immersed.markers import Markers

SCHEMES = ("implicit", "explicit")
# parts of a step: device work between two actions of the host; or several steps without the host (device_steps.py)
Part = Literal["response", "solution", "water", "steps"]
MOST_GRAPHS = 64  # kept of one fluid
NEXT, LAST = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])  # a x b: the first less the second half of a_next b_last


class StepDriver(Protocol):
    """Drives the body through steps of one time step each."""

    def actuate(self, step: int) -> tuple:
        """Sets the joints' torque in this step; returns `fixed` and `value` of `FluidStructure.solve`."""

    def record(self) -> None:
        """Called when the step's equation is assembled and its launches are under way."""

    def follow(self) -> None:
        """Called after MuJoCo has done the step."""


class Prescribed(NamedTuple):
    """Driver that prescribes velocities and leaves the torques of `body.data.ctrl`; None: no velocity is prescribed."""

    fixed: object = None
    value: object = None

    def actuate(self, step: int) -> tuple:
        """Returns `fixed` and `value`."""
        return self.fixed, self.value

    def record(self) -> None:
        """Does nothing."""

    def follow(self) -> None:
        """Does nothing."""


class FluidStructure:
    """Couples one body with one fluid; a model of several bodies is one `ImmersedBody`.

    Args:
        slip: ratio quoted at the paper's grid; 1 is a frictionless hull, 0 no slip.
        width, passes: of the immersed boundary.
        scheme: "implicit"; "explicit" is kept to show that it fails.
        interior: add the momentum of the water inside the hull; False is kept to show that it fails.

    Raises ConfigError: the two time steps differ, a name is unknown, or the markers are not the body's.
    """

    def __init__(
        self, fluid: Fluid, body: ImmersedBody, markers: Markers, *, slip=1.0, width=3, passes=2, scheme="implicit", interior=True
    ):
        for name, value, kind in (("fluid", fluid, Fluid), ("body", body, ImmersedBody), ("markers", markers, Markers)):
            checked_kind(f"coupled: {name}", value, kind, needed=True)
        if len(fluid.levels) > 1 and type(self) is FluidStructure:
            raise ConfigError("coupled: the water has finer cells; take RefinedStructure, which keeps the body inside their box")
        if scheme not in SCHEMES:
            raise UnknownName("coupling scheme", scheme, SCHEMES)
        if abs(fluid.lattice.dt - body.dt) > 1e-12:
            raise ConfigError(f"coupled: the fluid steps {fluid.lattice.dt} s and the body {body.dt} s; give both the same dt")
        self.fluid, self.body, self.scheme, self.interior, self.slip = fluid, body, scheme, interior, slip
        self.boundary = Boundary(markers, body, fluid, width=width, passes=passes, slip=slip)
        body.carry_layers(markers.layer_inertia(body.links, body.water.centre, fluid.lattice.dx, fluid.lattice.rho))
        self.steps, self.watch = 0, StabilityMonitor()
        self.in_flight = False  # the device runs a next tick whose result the host has not read back (`DeviceSteps.queue_next`)
        self.steps_since_sync = 1  # steps between the last two times that the host read the body
        self.gain = np.zeros((body.links, 6))  # momentum of the interior water handed to the links since `take_wrench`
        self.graphs = Graphs(fluid) if fluid.device.is_cuda else None
        cores = not fluid.device.is_cuda and type(fluid) is Fluid and fluid.threads > 1
        self.early = EarlyWater(fluid) if cores else None

    @property
    def time(self) -> float:
        """Time of the body's clock, s."""
        return float(self.body.data.time)

    def step(self, fixed=None, value=None) -> np.ndarray:
        """Does one time step and returns the new velocity of the body, (n,).

        Args:
            fixed: (n,) 1 where the velocity is prescribed. value: (n,) that velocity, m/s or rad/s.

        Raises:
            SimDiverged: the body's velocity is not finite.
            OracleUnstable: a marker is too fast for the grid's time step, or the water left the limits of the watch, which checks
                every 50 steps (on a GPU one step later).
            ConfigError: as `place_markers` and `solve`.
        """
        for _ in self.stepping(Prescribed(fixed, value)):
            pass
        velocity = self.boundary.velocity.copy()
        self.watch.end()  # the survey begun after the step before: its copies lie behind the velocity just waited for
        if self.watch.due(self.fluid):
            with self.scope():
                self.watch.begin(self.fluid)
            if self.graphs is None:
                self.watch.end()
        self.join_stream()
        self._check_speed(velocity)
        return velocity

    def stepping(self, driver: StepDriver, step: int = 0) -> Generator[None, None, None]:
        """Does step number `step` of a driver; yields once, when the device has work and the host could serve another tank."""
        self.place_markers()
        self.assemble_response()
        fixed, value = driver.actuate(step)  # only now: the device is at K while the host works out the joints' torques
        self.solve(fixed, value)
        self.push_water()
        driver.record()
        yield
        self.advance()
        driver.follow()

    def _check_speed(self, velocity: np.ndarray) -> None:
        """Raises OracleUnstable if a marker is beyond the Mach limit at this velocity of the body, (n,)."""
        lattice = self.fluid.lattice
        if lattice.mach(self.body.fastest(self.boundary.corners)) > MACH:  # the boxes' corners: no marker is faster
            check_speed(lattice, self.boundary.fastest_marker(velocity), f"coupled: a marker at t = {self.time:.4g} s")

    def place_markers(self) -> None:
        """Writes the pose of the body into the block that the device reads.

        Raises ConfigError: a marker is so near to a face that its kernel would read beyond it.
        """
        self.boundary.place_markers(self.body, self.fluid.origin_lu)

    def assemble_response(self) -> None:
        """Starts the computation of K and b0, the water's response to any velocity of the body, on the device."""
        self._queue("response")

    def solve(self, fixed=None, value=None) -> None:
        """Assembles the body's side of the equation and launches its solution; arguments as `step`.

        Raises ConfigError: `fixed` or `value` of another shape or not finite, or a value without `fixed`.
        """
        body = self.body
        if fixed is not None:
            fixed = numbers("coupled: fixed", np.multiply(fixed, 1.0), (body.dofs,), low=0.0, high=1.0)
            value = numbers("coupled: value", np.zeros(body.dofs) if value is None else value, (body.dofs,))
        elif value is not None:
            raise ConfigError("coupled: a value and no `fixed`; expected fixed (n,), 1 where the velocity is prescribed")
        system, right = body.equation(interior=self.interior)
        self.boundary.set_equation(system, right, fixed, value)
        self._queue("solution")

    def push_water(self) -> None:
        """Launches the force and the fluid's step under it. Several tanks can reach this point before one of them waits."""
        self._queue("water")
        if self.interior:  # what no launch waits for comes behind them
            self.gain += self.body.gain

    def advance(self) -> np.ndarray:
        """Waits for the velocity, (n,), and steps MuJoCo to it."""
        if self.graphs is not None:
            self.graphs.wait()
        velocity = self.boundary.velocity.copy()  # the device writes there again in the next step
        if self.boundary.interior is not None:
            self.body.set_interior_speed(self.boundary.interior_speed)
        self.body.advance(velocity)
        self.steps, self.steps_since_sync = self.steps + 1, 1
        return velocity

    def scope(self):
        """Stream of this tank: all other code that reads or changes its arrays runs inside this context.

        Raises ConfigError: the device already computes the next tick (`Run.pipelined`), so that the water is ahead of the fish.
        """
        if self.in_flight:
            raise ConfigError(
                f"coupled: the water is ahead of the fish's t = {self.time:.4g} s; take a run with pipelined = False"
            )
        return self.ordered_scope()

    def ordered_scope(self):
        """Like `scope`, but without its check: code inside sees the water after all queued work, wherever the fish is."""
        return nullcontext() if self.graphs is None else wp.ScopedStream(self.graphs.stream)

    def wait_for_stream_of(self, other: "FluidStructure") -> None:
        """Makes later work of this tank wait for all that is queued for the other one; the host does not wait."""
        if self.graphs is not None and other.graphs is not None:
            self.graphs.stream.wait_stream(other.graphs.stream)

    def wait_for_water(self) -> None:
        """Waits until the device has done all that was queued for this tank."""
        if self.graphs is not None:
            wp.synchronize_stream(self.graphs.stream)

    def join_stream(self) -> None:
        """Makes readers outside `scope` see the arrays after the step; the host does not wait."""
        if self.graphs is not None:
            self.graphs.join_stream()

    def launch(self, part: Part) -> None:
        """Queues the kernels of one part of a step in their order. It does not wait for the host, so a graph can hold them."""
        if part == "response":
            if self.early is not None:
                self.early.begin(int(self.boundary.view["box"][0]), self.boundary.box_shape[0])
            self.boundary.fetch_pose()
            self.boundary.assemble_response(self.fluid.f.flatten(), self.fluid.origin, self.fluid.box)
        elif part == "solution":
            self.boundary.fetch_equation()
            self.boundary.solve(self.scheme == "implicit")
            self.boundary.sum_wrench()
        else:
            self.boundary.spread_force(self.fluid.f.flatten(), self.fluid.force)
            if self.early is None:
                self.fluid.stream_collide()
            else:
                self.early.finish()
            self.boundary.clear_force(self.fluid.force)

    def _queue(self, part: Part) -> None:
        """Launches a part of a step, from a graph if there are graphs."""
        if self.graphs is None:
            self.launch(part)
        else:
            self.graphs.launch(part, partial(self.launch, part))

    def take_wrench(self, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean wrench of the water on every link over the last `seconds` (since the last call), each (L, 6).

        World frame, N, and N m about the link's origin. The first is the impulse that the markers exchanged (raw). The second
        also has the momentum of the interior water: it is the force of real water on a hull without water inside.

        Raises ConfigError: no positive number of seconds.
        """
        numbers("coupled: seconds of a wrench", seconds, low=1e-300)
        raw = self.boundary.take_wrench() / seconds
        gain, self.gain = self.gain / seconds, np.zeros(self.gain.shape)
        turn = (self.body.centre - self.body.data.xpos[1:])[:, NEXT] * gain[:, LAST]
        gain[:, 3:] += turn[:, :3] - turn[:, 3:]
        return raw, raw + gain


class Graphs:
    """Parts of the steps of one fluid, captured for each of its phases, on a stream of their own."""

    def __init__(self, fluid: Fluid):
        self.fluid, self.device = fluid, fluid.device
        # higher priority than other streams: one tank waits for small kernels while the water of another fills the device
        self.stream, self.solved = wp.Stream(self.device, priority=-1), wp.Event(self.device)
        self.here = nullcontext() if wp.get_cuda_device_count() == 1 else wp.ScopedDevice(self.device)
        self.warm: set[tuple[Part, int]] = set()
        self.kept: dict[tuple[Part, int, Hashable], tuple[wp.Graph, int]] = {}  # and how many steps each moves the fluid on
        self.flow, self.joined = fluid.flow, True
        wp.synchronize_device(self.device)  # the arrays were made on another stream

    def launch(self, part: Part, queue: Callable[[], None], variant: Hashable = 0) -> None:
        """Queues a part: launch by launch the first time in a phase, which loads the modules, later from a graph.

        Args:
            queue: makes the launches. variant: key of everything besides the phase on which the launches depend.
        """
        fluid = self.fluid
        if fluid.flow is not self.flow:  # a new background flow has new launches
            self.flow, self.kept = fluid.flow, {}
        if self.joined:
            self.stream.wait_stream(self.device.stream)  # what was queued outside `scope` since
            self.joined = False
        first, key = (part, fluid.phase), (part, fluid.phase, variant)
        if key not in self.kept:
            with wp.ScopedStream(self.stream):
                if first in self.warm:
                    if len(self.kept) >= MOST_GRAPHS:
                        self.kept = {}
                    self.kept[key] = self._capture(queue)
                else:
                    queue()
        if key in self.kept:
            graph, moved = self.kept[key]
            with self.here:
                wp.capture_launch(graph, self.stream)
            fluid.skip(moved)
        self.warm.add(first)
        if part == "solution":
            self.stream.record_event(self.solved)

    def join_stream(self) -> None:
        """Makes the device's own stream wait for this one; the host does not wait."""
        self.device.stream.wait_stream(self.stream)
        self.joined = True

    def wait(self) -> None:
        """Waits until the velocity is on the host."""
        wp.synchronize_event(self.solved)

    def idle(self) -> bool:
        """Returns True if the device has done all that was queued here."""
        return bool(self.stream.is_complete)

    def _capture(self, queue: Callable[[], None]) -> tuple[wp.Graph, int]:
        fluid = self.fluid
        account, steps = fluid.account, fluid.steps
        with wp.ScopedCapture(self.device, stream=self.stream) as captured:
            queue()
        moved = fluid.steps - steps
        fluid.account = account
        return captured.graph, moved
