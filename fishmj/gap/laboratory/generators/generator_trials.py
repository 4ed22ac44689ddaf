"""Trials of a generator's robot: like a lab's trials, labelled synthetic, without a trace of the hidden effects.

    from fishmj.gap.laboratory import generators
    trials = generators.generate("morison", {"command_latency": {"delay": 0.04}}, ["gait", "chirp"], seed=7)

A seed fixes the robot's constants and the noise, whatever is hidden and for any number of experiments.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.gap.laboratory.generators import effect_catalogue, lab_sensors
from fishmj.gap.laboratory.generators.family import family_named
from fishmj.gap.laboratory.generators.mujoco_robot import STEP, RobotSimulation, TrueMotion, swim
from fishmj.gap.laboratory.generators.robot_parameters import RobotParameters, healthy
from fishmj.gap.laboratory.instruments import weighing_page
from fishmj.gap.laboratory.random_streams import generators_stream
from fishmj.gap.laboratory.session import CLOCKS, Effects, experiments, place_by_hand, sent_commands, trial_meta
from fishmj.log import Trial, excitation
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.reading import load_robot

LINKS = (2, 8)  # fewest and most of a fish
PLACED = (0.0015, 0.005)  # m, rad, standard deviations of the start (chosen)


def robot_of(
    family: str, effects: Effects, seed: int, *, nuisance: float = 0.1, robot: "str | Robot" = "fish",
    flow: tuple[float, float] = (0.0, 0.0),
) -> RobotParameters:  # fmt: skip
    """One robot with hidden effects. flow: speed [m/s] and direction [rad] of the set stream.

    Raises:
        UnknownName: no such generator, effect or parameter. ConfigError: an impossible value, fewer than 2 or more than 8 links,
            or a nuisance outside 0 to 0.5.
    """
    if not 0.0 <= nuisance <= 0.5:
        raise ConfigError(f"generator {family}: nuisance = {nuisance}; expected a relative half width from 0 to 0.5")
    described = load_robot(robot)
    if not LINKS[0] <= len(described.links) <= LINKS[1]:
        has = f"{described.name} has {len(described.links)} links"
        raise ConfigError(f"generator {family}: {has}; expected {LINKS[0]} to {LINKS[1]}")
    stream = (flow[0] * np.cos(flow[1]), flow[0] * np.sin(flow[1]))
    fish = healthy(described, family_named(family), seed, nuisance, stream)
    known = effect_catalogue.hidden()
    for name, values in effects.items():
        if name not in known:
            raise UnknownName(f"effect of generator {family}", name, known)
        known[name].put(fish, values)
    return fish


def generate(
    family: str, effects: Effects, excitations: Iterable[str | Excitation], seed: int, noise: float = 1.0, nuisance: float = 0.1,
    robot: "str | Robot" = "fish", *, flow: tuple[float, float] = (0.0, 0.0), tick: Callable[[int], None] = lambda done: None,
) -> list[Trial]:  # fmt: skip
    """One trial per excitation, in order; a repeated one is a replicate with its own noise.

    Args:
        family: a name of `family.NAMES`. effects: {name: {parameter: value}}, SI; {} hides nothing.
        noise: factor on the noise of every sensor and of the placing; 0 leaves quantisation and latencies.
        nuisance: relative half width of unmeasured constants; 0.1 takes the tolerance of each.
        tick: receives the number of finished trials.

    Raises:
        as `robot_of`. SimDiverged: the robot left the finite numbers.
    """
    fish = robot_of(family, effects, seed, nuisance=nuisance, robot=robot, flow=flow)
    trials: list[Trial] = []
    for what, index, name, first in experiments(excitations, fish.joints):
        trials.append(trial_of(fish, what, seed, index, noise, name, first, flow))
        tick(len(trials))
    return trials


def laid_on(fish: RobotParameters, what: Excitation) -> np.ndarray:
    """Commands (T, J) of an experiment for the fish's joints."""
    commands = np.asarray(what.commands, float)
    return commands if commands.shape[1] == fish.joints else excitation.bent(commands, fish.joints)


def record(fish: RobotParameters, what: Excitation, seed: int, index: int, noise: float, step: float = STEP) -> TrueMotion:
    """Simulates trial `index`; returns the true motion."""
    commands = laid_on(fish, what)
    start = place_by_hand(what, *PLACED, generators_stream(seed, "placing", index), noise)
    radio = generators_stream(seed, "radio", index)
    times, rows = lab_sensors.arrivals(fish.network, what.t, radio, noise)
    return swim(fish, times, commands[rows], what.seconds, start, what.push, commands[0], step=step)


def trial_of(
    fish: RobotParameters, what: Excitation, seed: int, index: int, noise: float, name: str, replicate_of: str = "",
    flow: tuple[float, float] = (0.0, 0.0),
) -> Trial:  # fmt: skip
    """Simulates one trial; returns the sensors' readings."""
    motion, draw = record(fish, what, seed, index, noise), lambda purpose: generators_stream(seed, purpose, index)
    tables = {
        "cmd": sent_commands(what.t, laid_on(fish, what)),
        "joint": lab_sensors.joints(fish, motion, draw("joint"), noise),
        "power": lab_sensors.power(fish.meter, motion, draw("power"), noise),
        "pose": lab_sensors.poses(fish, motion, draw("camera"), noise),
    }
    meta = trial_meta(
        fish.robot.name, f"generator {fish.family.name}", what, replicate_of, flow, sigma=lab_sensors.sigmas(fish, noise),
        clock=CLOCKS | {"pose": "camera, received"}, engine="mujoco", source=f"fishmj.generators, {fish.family.name}",
        notes=" by a generator with another form of water",
    )  # fmt: skip
    return Trial(meta, tables, name=name)


# ----------------------------------------------------------------------------------------------------------------------- weighing
THREAD, APART = 1.0, 0.25  # m


class Weight(NamedTuple):
    """True values of the straight fish."""

    links: np.ndarray  # (N,) kg
    balance: float  # m from the nose
    inertia: float  # kg m2 in yaw, about the balance point


def weight(run: RobotSimulation) -> Weight:
    """Weight from MuJoCo's model; added sliding or hinged bodies count to the link that holds them."""
    model, data = run.model, run.data
    mujoco.mj_resetData(model, data)
    mujoco.mj_kinematics(model, data)
    mass, x = model.body_mass, data.xipos[:, 0]
    turned = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bi,bi->b", turned[:, 2] ** 2, model.body_inertia)
    names = [link.name for link in run.fish.robot.links]
    links = np.zeros(len(names))
    for body in range(1, model.nbody):
        holder = body if model.body(body).name in names else int(model.body_parentid[body])
        links[names.index(model.body(holder).name)] += mass[body]
    middle = float(mass @ x / mass.sum())
    inertia = float(np.sum(own + mass * (x - middle) ** 2))
    return Weight(links, float(geometry_of(run.fish.robot).span[0, 1]) - middle, inertia)


def page(family: str, effects: Mapping, seed: int, nuisance: float = 0.1, robot: "str | Robot" = "fish") -> dict:
    """Content of `measurements.toml` of a seed's robot, three readings per quantity. Raises as `generator_trials.robot_of`."""
    fish = robot_of(family, effects, seed, nuisance=nuisance, robot=robot)
    found, names = weight(RobotSimulation(fish)), [link.name for link in fish.robot.links]
    links, rng = dict(zip(names, found.links, strict=True)), generators_stream(seed, "weighing")
    return weighing_page(f"fishmj.generators, {family}", links, found.balance, found.inertia, THREAD, APART, rng)
