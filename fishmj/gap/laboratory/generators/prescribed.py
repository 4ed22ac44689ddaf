"""Forces of a generator's water in prescribed motions, as in a towing tank: true values for a fit.

    prescribed("foil", seed=7) -> {"drag": 0.035, ..}       of the robot that `generate` simulates with this seed

    drag, side_drag  N      of the straight fish towed ahead, and to its left, at `SPEED`
    yaw_drag         N m    of the straight fish turned about its reference point at `RATE`
    thrust           N      mean force ahead over a beat of the fish towed ahead at `SPEED`, all joints following `BEAT`
                            exactly, head held straight: the tail's thrust minus the body's drag
    surge, sway mass kg     force over acceleration of the straight fish at rest, ahead and to the left
    yaw_mass         kg m2  moment over angular acceleration about the reference point, likewise

Only the force law of this package is used (`family.Family.step`): Q(q, q', memory) - J^T A J q''. Steady motions run until the
memory of the start has decayed.
"""

from collections.abc import Mapping

import numpy as np

from fishmj.gap.laboratory.generators.generator_trials import robot_of
from fishmj.gap.laboratory.generators.mujoco_robot import STEP, RobotSimulation
from fishmj.gap.laboratory.generators.robot_parameters import RobotParameters
from fishmj.gap.laboratory.session import Effects
from fishmj.mjcf.description import Robot

SPEED, RATE = 0.2, 1.0  # m/s, rad/s
BEAT = (1.0, np.radians(30.0), np.radians(60.0))  # Hz, rad, lag from joint to joint
SETTLE = 15_000  # steps of a steady motion: Wagner's slow lag needs half a minute at these speeds
BEATS = 2  # beats before the averaged one
UNITS = {
    "drag": "N",
    "side_drag": "N",
    "yaw_drag": "N m",
    "thrust": "N",
    "surge_mass": "kg",
    "sway_mass": "kg",
    "yaw_mass": "kg m2",
}


def prescribed(
    family: str, seed: int, effects: Effects | None = None, *, nuisance: float = 0.1, robot: "str | Robot" = "fish"
) -> dict[str, float]:
    """Quantities above by name, units in `UNITS`. Arguments and errors as in `generate`."""
    return of_fish(robot_of(family, effects or {}, seed, nuisance=nuisance, robot=robot))


def of_fish(fish: RobotParameters) -> dict[str, float]:
    """Quantities of one robot. Joints added by a fault are held at zero."""
    ahead, left = steady(fish, {0: SPEED}), steady(fish, {1: SPEED})
    run = RobotSimulation(fish)
    still = np.zeros(run.model.nv)
    water_at(run, still, still)
    added = run.work.mass.copy()
    return {
        "drag": -float(ahead[0]),
        "side_drag": -float(left[1]),
        "yaw_drag": -float(steady(fish, {2: RATE})[2]),
        "thrust": thrust(fish, *BEAT),
        "surge_mass": float(added[0, 0]),
        "sway_mass": float(added[1, 1]),
        "yaw_mass": float(added[2, 2]),
    }


def steady(fish: RobotParameters, rates: Mapping[int, float]) -> np.ndarray:
    """(3,) force in x, y and moment on the straight fish at the origin, heading along x, at constant rates."""
    run = RobotSimulation(fish)
    rate = np.zeros(run.model.nv)
    for freedom, value in rates.items():
        rate[freedom] = value
    for _ in range(SETTLE):
        force = water_at(run, np.zeros(run.model.nv), rate)
    return force[:3].copy()


def thrust(fish: RobotParameters, frequency: float, amplitude: float, lag: float) -> float:
    """Mean force ahead, N, over one beat of the fish towed at `SPEED`; its joints follow a sine of the given Hz, rad, rad."""
    run = RobotSimulation(fish)
    steps, omega = round(1.0 / frequency / STEP), 2 * np.pi * frequency
    phase = -lag * np.arange(fish.joints)
    q, rate, acceleration = (np.zeros(run.model.nv) for _ in range(3))
    rate[0], total = SPEED, 0.0
    for i in range((BEATS + 1) * steps):
        wave = omega * i * STEP + phase
        q[run.hinges] = amplitude * np.sin(wave)
        rate[run.hinges] = amplitude * omega * np.cos(wave)
        acceleration[run.hinges] = -amplitude * omega**2 * np.sin(wave)
        force = water_at(run, q, rate)
        if i >= BEATS * steps:
            added = run.work.mass + np.tril(run.work.mass, -1).T
            total += float(force[0] - added[0] @ acceleration)
    return total / steps


def water_at(run: RobotSimulation, q: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """(nv,) generalised force of the water at a state without acceleration; leaves the added mass in `run.work.mass`."""
    force, sparse = np.zeros(run.model.nv), np.zeros(len(run.chain.rows))
    fish = run.fish
    fish.family.step(run.chain, run.law, q, rate, run.flow, fish.drag, fish.tether, run.memory, run.step, force, sparse, run.work)
    return force
