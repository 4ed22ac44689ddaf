"""Segments in the flow solver, several tanks side by side: the host works for one tank while the device steps another's water.

    for done in on_device(segments, device, setup=setup, tanks=12): write_record(folder, done.meta, done.arrays)

A segment whose water or fish is no longer finite, or whose fish reaches a wall, is kept as far as it was sound.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from fishmj import __version__
from fishmj.hydro_fit.campaign.data.segment import Drive, Segment, drive, ticks_of
from fishmj.hydro_fit.campaign.data.solver_hash import solver_sha256
from fishmj.hydro_fit.segment_dataset import fingerprint
from fishmj.lbm_oracle.immersed.markers import PLAIN, Sharpness
from fishmj.lbm_oracle.run.domain import PREVIEWS, Domain, preset
from fishmj.lbm_oracle.run.run import ConcurrentRuns, Run
from fishmj.lbm_oracle.run.run_log import flow_at_links
from fishmj.lbm_oracle.run.setup import DomainWatch, SwimSetup
from fishmj.lbm_oracle.run.solver_water import boundary_entry
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, never_stop, side_by_side
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import reference_qpos
from fishmj.mjcf.reading import load_robot

DOUBT = 1.5  # s before water fails that are not kept: a held fish's water left the measured speeds 1.3 s before it failed
SANE = 20.0  # m/s, rad/s: a faster fish was no longer sound
FEWEST = 10  # ticks; a shorter record is not kept


class Finished(NamedTuple):
    """A finished segment: metadata, and arrays as in `hydro_fit.record` (none if nothing was sound)."""

    segment: Segment
    meta: dict
    arrays: dict


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Common set-up of all segments of one campaign: fish, box of water, device, grid of the immersed boundary."""

    robot: Robot = field(default_factory=load_robot)
    domain: Domain = field(default_factory=lambda: preset("window"))
    device: str = "auto"
    width: int = 3
    passes: int = 2
    sharpness: Sharpness = PLAIN

    @property
    def about(self) -> dict:
        """Metadata for the fit, which must be equal on every machine; without the device."""
        domain, robot = self.domain, self.robot
        grid: dict[str, Any] = {"domain": domain.name, "dx": domain.dx, "dt": domain.dt, "shape": list(domain.shape)}
        if domain.fine is not None:  # cells at the fish
            grid |= {"fine": [{"dx": level.dx, "dt": level.dt, "shape": list(level.shape)} for level in domain.levels[1:]]}
        grid |= boundary_entry(self.sharpness)
        return {
            "robot": {"name": robot.name, "joints": robot.n_joints, "sha256": fingerprint(robot)},
            "solver": {"sha256": solver_sha256(domain, self.sharpness)},
            "grid": grid | {"kernel": self.width, "passes": self.passes, "preview": domain.name in PREVIEWS},
        }


class SegmentRunner:
    """One segment while it runs."""

    def __init__(self, segment: Segment, setup: Setup):
        self.segment, self.setup, self.began = segment, setup, time.perf_counter()
        self.drive: Drive = drive(segment, setup.robot)
        self.before, self.end = ticks_of(segment, setup.robot)
        self.run = _run(segment, setup, self.drive)
        self.start = self._state()

    @property
    def done(self) -> bool:
        """Returns True if all ticks are done, or the run has stopped."""
        return self.run.ticks >= self.end or bool(self.run.stopped)

    @property
    def water(self) -> float:
        """Seconds of water so far, in steps of the domain."""
        return self.run.ticks * self.setup.robot.timing.bus_dt * self.segment.finer

    def command(self) -> np.ndarray:
        """Command (J,) rad for the next tick; zeros if the joints follow a path."""
        return self.drive.command(self.run.ticks, self.run)

    def ticking(self) -> Iterator[None]:
        """Does all ticks, pausing when other tanks can have their turn; the record begins after the settling."""
        tank = ConcurrentRuns([self.run])
        while not self.done:
            yield from tank.ticking(self.command()[None])
            if self.run.ticks == self.before:
                self.start = self._state()

    def finished(self) -> Finished:
        """Record, as far as it is sound."""
        run, rows = self.run, _sound(self.run, self.before)
        meta = self._meta(len(rows))
        if len(rows) < FEWEST:
            return Finished(self.segment, meta | {"stopped": run.stopped or f"{len(rows)} ticks; {FEWEST} are kept at least"}, {})
        _, _, command, pose, joint, rate, power, raw, whole = (np.array(column) for column in zip(*rows, strict=True))
        q, v = np.concatenate([pose[:, :3], joint], 1), np.concatenate([pose[:, 3:], rate], 1)
        planar = [0, 1, 5]
        before = np.concatenate([np.array(self.start["q"])[None], q[:-1]])
        arrays = {"q": q, "v": v, "command": command, "wrench": whole[:, :, planar], "raw": raw[:, :, planar]}
        arrays["flow"] = flow_at_links(self.segment.flow, self.setup.robot, before, np.array([row[0] for row in rows]))
        if self.drive.joints is None:
            arrays["power"] = power + self.setup.robot.servo.idle_power
        return Finished(self.segment, meta, arrays)

    def _state(self) -> dict:
        pose = self.run.pose
        q, v = np.concatenate([pose[:3], self.run.angles()]), np.concatenate([pose[3:], self.run.rates()])
        return {"q": q.tolist(), "v": v.tolist()}

    def _meta(self, rows: int) -> dict:
        segment, run, about = self.segment, self.run, self.setup.about
        tick = self.setup.robot.timing.bus_dt
        named = {key: getattr(segment, key) for key in ("id", "episode", "block", "split", "replicate_of")}
        grid = about["grid"] | {
            "slip": segment.slip,
            "dt": self.setup.domain.dt / segment.finer,
            "markers": run.coupled.boundary.count,
        }
        return named | {
            "segment": segment.table(),
            "robot": about["robot"],
            "solver": about["solver"],
            "grid": grid | {"device": str(run.coupled.fluid.device)},
            "origin": "synthetic",
            "start": self.start,
            "tick": tick,
            "latency": run.delay * run.coupled.body.dt,
            "command_path": self.setup.robot.timing.command_path,
            "prescribed": {"joints": self.drive.joints is not None, "root": self.drive.root is not None},
            "settle": segment.settle,
            "rows": rows,
            "seconds": rows * tick,
            "stopped": " ".join(run.stopped.split()),
            "refined_ticks": run.refined,
            "fastest_water": run.watch.fastest,
            "wall_s": time.perf_counter() - self.began,
            "versions": {"fishmj": __version__} | {name: version(name) for name in ("mujoco", "numpy", "warp-lang")},
        }


def on_device(waiting: Waiting, device: str, go_on: GoOn = never_stop, *, setup: Setup, tanks: int = 1) -> Iterator[Finished]:
    """Runs the waiting segments, `tanks` at a time, on one of several devices (`spread`).

    Raises ConfigError, OracleUnstable: a segment could not be set up.
    """
    return side_by_side(waiting, partial(SegmentRunner, setup=replace(setup, device=device)), tanks=tanks, go_on=go_on)


def _run(segment: Segment, setup: Setup, moved: Drive) -> Run:
    """Fish and water at the start of a segment."""
    domain, robot = setup.domain, setup.robot
    if segment.finer > 1:
        domain = replace(domain, dt=domain.dt / segment.finer)
    x, y, yaw = segment.pose
    pose = x + segment.nudge[0] * domain.dx, y + segment.nudge[1] * domain.dx, yaw
    stage = SwimSetup(
        domain=domain,
        robot=robot,
        flow=segment.flow,
        slip=segment.slip,
        pose=pose,
        joints=segment.joints,
        device=setup.device,
        width=setup.width,
        passes=setup.passes,
        sharpness=setup.sharpness,
    )
    coupled = stage.coupled()
    if segment.velocity:
        joints = segment.joints or (0.0,) * robot.n_joints
        coupled.body.place(reference_qpos(coupled.body.model, pose, joints), segment.velocity)
    edge = DomainWatch(domain, yaw)
    run = Run(coupled, robot, follow=edge, tethered=moved.root is not None, prescribed=moved.joints)
    if moved.root is not None:
        path, off = moved.root, np.array([pose[0] - x, pose[1] - y, 0.0])
        run.root = lambda t: path(t) + off
    return run


def _sound(run: Run, first: int) -> list[tuple]:
    """Rows of the recorded part without those that a failing fish or water had spoilt."""
    rows, tick = run.rows, run.robot.timing.bus_dt
    if run.stopped and not run.stopped.startswith("left_domain"):
        rows = rows[: max(0, len(rows) - ceil(DOUBT / tick))]
    for n, row in enumerate(rows):
        numbers = np.concatenate([np.ravel(value) for value in row[3:]])
        if not np.isfinite(numbers).all() or max(np.abs(row[3][3:]).max(), np.abs(row[5]).max()) > SANE:
            return rows[first:n]
    return rows[first:]
