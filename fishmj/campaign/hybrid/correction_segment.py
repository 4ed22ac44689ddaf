"""A short stretch in a better water: a fish led along a path until the water has got used to it, then swimming by its servos.

seen = Solver(robot, domain).stretch(path, past, commands)          the flow solver, kept from stretch to stretch
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from fishmj.errors import MissingExtra
from fishmj.flow import Flow
from fishmj.mjcf.description import Robot


class Path(NamedTuple):
    """A movement by physics steps of dt: states at its start and after each of m steps, (m + 1, 3 + J)."""

    q: np.ndarray
    v: np.ndarray
    dt: float

    def at(self, t: float) -> np.ndarray:
        """(3 + J,) t seconds after its start, in straight lines from step to step."""
        step = min(max(t / self.dt, 0.0), len(self.q) - 1.0)
        k = max(min(int(step), len(self.q) - 2), 0)
        return self.q[k] + (step - k) * (self.q[k + 1] - self.q[k])


class CorrectionSegment(NamedTuple):
    """n ticks of free swimming in the better water: states before the first and after each, (n + 1, 3 + J)."""

    q: np.ndarray
    v: np.ndarray


class Oracle(Protocol):
    """A better water."""

    def stretch(self, path: Path, past: list[np.ndarray], commands: np.ndarray) -> CorrectionSegment:
        """Along the path, then by `commands` (n, J) from its end; `past`: all commands on the bus before those, oldest first."""


class Solver:
    """The flow solver, set up at the first stretch and kept.

    Args:
        flow: a uniform stream. slip, device: of the solver.
    """

    def __init__(self, robot: Robot, domain, *, flow: Flow | None = None, slip: float = 1.0, device: str = "cpu"):
        self.robot, self.domain, self.flow, self.slip, self.device = robot, domain, flow or Flow(), slip, device
        self.run: Any = None

    def stretch(self, path: Path, past: list[np.ndarray], commands: np.ndarray) -> CorrectionSegment:
        """As `Oracle.stretch`.

        Raises:
            MissingExtra: the solver's packages are absent. LeftDomain, SimDiverged, OracleUnstable, ConfigError: it fails.
        """
        run = self.reseeded(path)
        self.tow(run, path)
        run.tethered, run.root, run.prescribed = False, None, None
        run.commands, run.ticks, first = [np.array(command) for command in past], len(past) - 1, len(run.rows)
        start = (np.concatenate([run.pose[:3], run.angles()]), np.concatenate([run.pose[3:], run.rates()]))
        for command in commands:
            run.tick(command)
        pose, joint, rate = (np.array([row[i] for row in run.rows[first:]]) for i in (3, 4, 5))
        after = np.concatenate([pose[:, :3], joint], 1), np.concatenate([pose[:, 3:], rate], 1)
        return CorrectionSegment(*(np.concatenate([[one], rows]) for one, rows in zip(start, after, strict=True)))

    def tow(self, run, path: Path) -> np.ndarray:
        """(n, N, 3) mean wrenches F_x, F_y, M_z over the ticks of a path that the fish follows to the letter."""
        run.tethered, run.root, run.prescribed = True, (lambda t: path.at(t)[:3]), (lambda t: path.at(t)[3:])
        for _ in range(round((len(path.q) - 1) * path.dt / self.robot.timing.bus_dt)):
            run.tick()
        return np.array([row[-1] for row in run.rows]).reshape(-1, len(self.robot.links), 6)[:, :, [0, 1, 5]]

    def reseeded(self, path: Path):
        """The run with its fish at the start of the path."""
        try:
            from fishmj.campaign.data.run_segments import Driven
            from fishmj.lbm_oracle.immersed.snapshot import reseed
            from fishmj.lbm_oracle.run.setup import DomainWatch, SwimSetup
            from fishmj.mjcf.model import reference_qpos
        except ModuleNotFoundError as error:
            raise MissingExtra(str(error.name), "oracle", "the flow solver") from error

        q, v = path.q[0], path.v[0]
        pose, joints = tuple(q[:3].tolist()), tuple(q[3:].tolist())
        if self.run is None:
            stage = SwimSetup(
                domain=self.domain, robot=self.robot, flow=self.flow, slip=self.slip, pose=pose, joints=joints, device=self.device
            )
            coupled = stage.coupled()
            self.run = Driven(coupled, self.robot, follow=DomainWatch(self.domain, pose[2]))
        run, edge = self.run, DomainWatch(self.domain, pose[2])
        reseed(run.coupled, reference_qpos(run.coupled.body.model, pose, joints), v)
        run.coupled.take_wrench(1.0)  # what is left of the stretch before
        while self.domain.follows and edge.follow(run.coupled):  # the window goes where the fish is
            pass
        run.follow = edge
        run.begin()
        return run
