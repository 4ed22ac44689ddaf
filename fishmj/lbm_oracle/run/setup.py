"""A fish in a box of water: movement, domain, flow, markers, coupling, and the action at the edge of the box."""

from dataclasses import dataclass, field, replace
from math import inf, pi, radians
from typing import Any

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_kind, number, setting, text, whole
from fishmj.lbm_oracle.fluid.fluid import Fluid, blend_at
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.link_dynamics import Corners
from fishmj.lbm_oracle.immersed.markers import PLAIN, Sharpness, fish_markers
from fishmj.lbm_oracle.refined.exchange import GHOST
from fishmj.lbm_oracle.refined.refined_fluid import RATIO, RefinedFluid, lowest
from fishmj.lbm_oracle.refined.refined_structure import RefinedStructure
from fishmj.lbm_oracle.run import stability
from fishmj.lbm_oracle.run.domain import Domain, Follower, margin, preset
from fishmj.lbm_oracle.run.run import LeftDomain, Run
from fishmj.lbm_oracle.run.solver_water import boundary_name
from fishmj.mjcf import Robot, load_robot
from fishmj.mjcf.model import reference_pose, reference_qpos
from fishmj.water.flow import Flow

OFFSET = "retraction of the markers; the measured one by default"
LOOK = 4  # steps between two looks at fish and faces; a fish moves less than a cell meanwhile


@dataclass(frozen=True, kw_only=True)
class Gait:
    """Prescribed joint angles, j_i(t) = bias_i + r(t) A_i sin(2 pi f t - i lag), r = (3 - 2 x) x^2, x = min(t / ramp, 1).

    A travelling wave over J joints: frequency Hz, amplitude, lag from joint to joint and bias in rad, ramp s.

    amplitude and bias are one number, or one for each joint.
    """

    joints: int = 3
    frequency: float = 1.0
    amplitude: float | tuple[float, ...] = radians(30.0)
    lag: float = radians(60.0)
    bias: float | tuple[float, ...] = 0.0
    ramp: float = 1.0

    def __post_init__(self):
        """Raises ConfigError for an invalid number, or not one number for each joint."""
        whole_numbers("gait: joints", self.joints, low=1)
        for name, low in (("frequency", 1e-300), ("ramp", 0.0), ("lag", -inf)):
            numbers(f"gait: {name}", getattr(self, name), low=low)
        for name in ("amplitude", "bias"):
            size = np.size(value := getattr(self, name))
            if size not in (1, self.joints):
                raise ConfigError(f"gait: {name} has {size} values; expected 1 or {self.joints}")
            numbers(f"gait: {name}", value, np.shape(value))

    @classmethod
    def of_the_paper(cls, joints: int = 3) -> "Gait":
        """Calibration swim of the paper: 1 Hz, 30 deg on all joints, 60 deg lag."""
        lag = constant("calibration", "phase_lag_second_deg")[0]
        amplitude = radians(constant("calibration", "amplitude_deg"))
        return cls(joints=joints, frequency=constant("calibration", "frequency"), amplitude=amplitude, lag=radians(lag))

    def __call__(self, t: float) -> np.ndarray:
        """Joint angles (J,) at time t, rad."""
        x = min(t / self.ramp, 1.0) if self.ramp > 0 else 1.0
        wave = np.sin(2 * pi * self.frequency * t - self.lag * np.arange(self.joints))
        return np.broadcast_to(self.bias, self.joints) + x * x * (3 - 2 * x) * np.broadcast_to(self.amplitude, self.joints) * wave


@dataclass(frozen=True, kw_only=True)
class SwimSetup:
    """Set-up of a run in the flow solver.

    slip: ratio quoted at the paper's grid, 1 = frictionless hull. pose: (x, y, yaw) m, rad of the reference point.
    joints: (J,) rad. width, passes, hydro_offset, spacing, sharpness: of the immersed boundary. robot: description, path or name.
    storage: type of the populations, float32 or float16.
    """

    domain: Domain = field(default_factory=lambda: preset("window"))
    robot: "Robot | str" = setting("fish", text, "shipped name or TOML file")
    flow: Flow = field(default_factory=Flow)
    slip: float = setting(1.0, number(0, 1), "at the paper's grid: 1 slides, 0 sticks")
    root: str = setting("planar", ("planar", "free"), "how the root moves")
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joints: tuple[float, ...] = ()
    device: str = "cpu"
    width: int = setting(3, whole(3, 4), "points of the immersed boundary's kernel: 3 or 4", "--kernel")
    passes: int = setting(2, whole(1, 100), "of the direct forcing")
    hydro_offset: float | None = setting(None, number(-5, 5), OFFSET, metavar="CELLS")
    spacing: float = 1.0
    sharpness: Sharpness = PLAIN
    storage: str = "float32"

    def __post_init__(self):
        """Raises ConfigError for an object of another class, or for invalid numbers."""
        for name, kind in (("domain", Domain), ("flow", Flow), ("sharpness", Sharpness)):
            checked_kind(f"oracle: {name}", getattr(self, name), kind, needed=True)
        numbers("oracle: pose", self.pose, (3,))
        if np.size(self.joints):
            numbers("oracle: joints", self.joints, (None,), low=-pi, high=pi)

    def assembled(self, body: ImmersedBody) -> FluidStructure:
        """Fish and water at t = 0, undisturbed flow, the fish at rest over ground; does not check if the set-up would run."""
        robot, domain, slip, width = load_robot(self.robot), self.domain, self.slip, self.width
        level = domain.body_level
        if domain.fine and self.storage != "float32":
            raise ConfigError(f"oracle: storage {self.storage!r} in {domain.name}, which has finer cells; expected 'float32'")
        water: dict[str, Any] = {
            "boundaries": domain.boundaries,
            "flow": self.flow,
            "blend": blend_at(domain.lattice),
            "dtype": self.storage,
        }
        fluid = Fluid(domain.lattice, domain.shape, self.device, **water)
        joints = np.asarray(self.joints or np.zeros(robot.n_joints), float)
        if joints.shape != (robot.n_joints,):
            raise ConfigError(f"oracle: joints = {self.joints}; {robot.name} has {robot.n_joints}")
        body.place(reference_qpos(body.model, self.pose, joints))
        edge: dict[str, Any] = {"hydro_offset": self.hydro_offset, "spacing": self.spacing, "sharpness": self.sharpness}
        markers = fish_markers(robot, level.dx, slip=slip, width=width, **edge)
        options: dict[str, Any] = {"slip": slip, "width": width, "passes": self.passes}
        if domain.fine is None:
            made = FluidStructure(fluid, body, markers, **options)
        else:
            middle = 0.5 * np.sum(body.bounds(Corners.of(markers, body.water.centre)), 0)
            follower = Follower(domain, self.pose[2])
            while follower.follow(fluid, middle, self.pose[2]):
                pass
            box = RefinedFluid(fluid, lowest(fluid, middle, domain.boxes[0]), domain.boxes[0])
            for size in domain.boxes[1:]:
                box = RefinedFluid(box, lowest(box, middle, size), size)
            made = RefinedStructure(box, body, markers, **options)
        watch = DomainWatch(domain, self.pose[2])
        while watch.follow(made):  # a window starts round its fish
            pass
        return made

    def coupled(self, body: ImmersedBody | None = None) -> FluidStructure:
        """Fish and water as `assembled`, with the fish of the description unless another body of its links is given.

        Raises OracleUnstable: the set-up would not run, or the fish does not fit into the box with its margin.
        """
        domain = self.domain.body_level
        made = self.assembled(body or ImmersedBody.of(self.robot, self.root, domain.dt))
        room = margin(made.fluid, *made.body.bounds(made.boundary.corners))
        stability.check(domain, speed=max(self.flow.speed, stability.SLOW), spacing=self.spacing * domain.dx, clearance=room)
        return made

    def run(self, **options) -> Run:
        """Run by bus ticks of this set-up; options are those of `Run`."""
        made, edge = self.coupled(), DomainWatch(self.domain, self.pose[2])
        run = Run(made, self.robot, follow=edge, **options)
        run.boundary_name = boundary_name(self.sharpness)
        return run


class DomainWatch:
    """Action after a step, or after several in one: a window follows the fish, and a fish too close to a face ends the run."""

    def __init__(self, domain: Domain, heading: float = 0.0):
        self.every = max(LOOK, RATIO ** len(domain.boxes))  # steps: a box moves between two steps of the water round it
        self.domain, self.follower = domain, Follower(replace(domain, dt=self.every * domain.body_level.dt), heading)

    @property
    def moves_water(self) -> bool:
        """Returns True if a window, or a box of finer cells, follows the fish."""
        return self.domain.follows or bool(self.domain.fine)

    def __call__(self, coupled: FluidStructure) -> None:
        """Moves the water if needed. Raises LeftDomain if a marker is nearer to a face than the margin."""
        looks = coupled.steps // self.every - (coupled.steps - coupled.steps_since_sync) // self.every
        if not looks:
            return
        if self.moves_water:
            with coupled.scope():
                for _ in range(looks if self.domain.follows else 1):  # each turns a window's lead by so much at most
                    self.follow(coupled)
        body, fluid = coupled.body, coupled.fluid
        room = margin(fluid, *body.bounds(coupled.boundary.corners))
        ghosts = GHOST if isinstance(fluid, RefinedFluid) else 0  # cells of `room` that a marker may not read
        needed = max(stability.CLEARANCE, coupled.boundary.reach + ghosts + 1)  # and one that the fish swims until the next look
        if room < needed:
            at = ", ".join(f"{value:.3f}" for value in body.data.xpos[1])
            raise LeftDomain(
                f"left_domain at t = {coupled.time:.3f} s: the fish at ({at}) m is {room:.1f} cells from a face of the"
                f" {self.domain.name} domain; it needs {needed:g}. What was recorded before is kept"
            )

    def follow(self, coupled: FluidStructure) -> bool:
        """Moves a window so that the middle of the fish keeps its place in it, and boxes of finer cells; True if one moved."""
        body, fluid = coupled.body, coupled.fluid
        low, high = body.bounds(coupled.boundary.corners)
        middle, heading = 0.5 * (low + high), float(reference_pose(body.model, body.data)[2])
        if not isinstance(fluid, RefinedFluid):
            return self.follower.follow(fluid, middle, heading)
        moved = self.follower.follow(fluid.levels[-1], middle, heading)
        for box in reversed(fluid.boxes):  # the finest last: it stays inside the others
            moved = box.centre_on(middle) or moved
        return moved
