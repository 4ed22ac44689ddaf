"""Synthetic trials of a robot with hidden effects.

    from fishmj.gap.laboratory.virtual_robot import generate
    trials = generate({"command_latency": {"delay": 0.038}}, ["gait", "chirp"], seed=7)

A trial does not name the planted effects. A seed fixes the robot (nuisance draw) and the noise, whatever is planted.
"""

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.instruments import noise_sigmas, weighing_page
from fishmj.gap.laboratory.session import CLOCKS, Effects, experiments, place_by_hand, sent_commands, trial_meta
from fishmj.gap.laboratory.virtual_robot import network
from fishmj.gap.laboratory.virtual_robot import sensors as cameras
from fishmj.gap.laboratory.virtual_robot.catalogue import CATALOGUE, ODDITIES, CatalogueEntry
from fishmj.gap.laboratory.virtual_robot.loop import GUST
from fishmj.gap.laboratory.virtual_robot.robot_constants import AS_IT_IS, RobotConstants, WaterScales, buildable, nominal
from fishmj.gap.laboratory.virtual_robot.simulate import ChainState, StateRecording, at_rest, run
from fishmj.log import Trial
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

EFFECTS: dict[str, CatalogueEntry] = {**CATALOGUE, **ODDITIES}
MEDIA = ("water", "air")
SENSORS = ("joint", "power", "pose")
USUAL: Mapping[str, float] = MappingProxyType({})  # sensors of virtual_robot.toml
NOMINAL: Mapping[str, np.ndarray] = MappingProxyType({})  # every sensor at its own period


def plant(
    effects: Effects, seed: int = 0, *, nuisance: float = 0.1, robot: "str | Robot" = "fish", medium: str = "water",
    flow: tuple[float, float] = (0.0, 0.0), scales: WaterScales = AS_IT_IS,
) -> RobotConstants:  # fmt: skip
    """Constants of one robot: nominal, nuisance draw of `seed`, then the effects {name: {parameter: value}}.

    nuisance: relative half width. flow: speed [m/s] and direction [rad] of the set stream. scales: factors on the water.

    Raises UnknownName: an effect or parameter that does not exist; ConfigError: an impossible value, medium or robot.
    """
    if medium not in MEDIA:
        raise ConfigError(f"virtual robot: medium = {medium!r}; choose one of {', '.join(MEDIA)}")
    if not 0.0 <= nuisance < 1.0:
        raise ConfigError(f"virtual robot: nuisance = {nuisance}; a relative half width from 0 to below 1")
    described = load_robot(robot)
    buildable(described)
    made, (speed, direction) = nominal(described, medium, nuisance, random_streams.stream(seed, "nuisance"), scales), flow
    fields = {"tank.flow_x": speed * np.cos(direction), "tank.flow_y": speed * np.sin(direction)}
    for name, values in effects.items():
        if name not in EFFECTS:
            raise UnknownName("effect", name, EFFECTS)
        fields |= EFFECTS[name].fields(values)
    return made.with_fields(fields)


def generate(
    effects: Effects, excitations: Iterable[str | Excitation], seed: int, noise: float = 1.0, nuisance: float = 0.1,
    robot: "str | Robot" = "fish", medium: str = "water", *, flow: tuple[float, float] = (0.0, 0.0),
    sensors: Mapping[str, float] = USUAL, tick: Callable[[int], None] = lambda done: None,
) -> list[Trial]:  # fmt: skip
    """One trial per excitation, in order; a repeated one is a replicate with its own noise.

    Args:
        effects: {name: {parameter: value}}, SI; {} hides nothing.
        noise: factor on the noise of every sensor and of the placing; 0 leaves quantisation and latencies.
        nuisance: relative half width of the draw of unmeasured constants.
        medium: "water", or "air": hung on a thread, no camera.
        flow: speed [m/s] and direction [rad] of the set stream.
        sensors: replaced fields of network, camera and meter (constant_groups.py): {"camera.period": 1 / 30}.
        tick: receives the number of finished trials.
    """
    made = plant(effects, seed, nuisance=nuisance, robot=robot, medium=medium, flow=flow).with_fields(dict(sensors))
    trials: list[Trial] = []
    for what, index, name, first in experiments(excitations, made.robot.n_joints):
        trials.append(trial_of(made, what, seed, index, noise, name, first, flow))
        tick(len(trials))
    return trials


def start_state(made: RobotConstants, what: Excitation, seed: int, index: int, noise: float) -> tuple[np.ndarray, ChainState]:
    """Start pose (3,) of trial `index` with its placing error, and the state there, which holds the first command."""
    start = place_by_hand(what, *made.placing, random_streams.stream(seed, "placing", index), noise)
    state = at_rest(start, what.commands[0] + made.zero, made.motor.voltage, what.push)
    state.goal[:], state.aim[:], state.seen[:] = what.commands[0], what.commands[0], what.commands[0]
    state.ramp[:, :2] = what.commands[0][:, None]
    return start, state


def swim(made: RobotConstants, what: Excitation, seed: int, index: int, noise: float) -> StateRecording:
    """True motion of trial `index`: places the fish, sends the commands, simulates."""
    if what.commands.shape[1] != made.robot.n_joints:
        counts = f"{what.commands.shape[1]} joints, {made.robot.name} has {made.robot.n_joints}"
        raise ConfigError(f"virtual robot: experiment {what.id!r} commands {counts}; take excitation.get(name, joints)")
    _, state = start_state(made, what, seed, index, noise)
    queue = network.deliver(made.network, made.odd, what.t, what.commands, seed, index, noise)
    return run(made, state, queue.times, queue.commands, what.seconds, weather(made, what.seconds, seed, index))


def weather(made: RobotConstants, seconds: float, seed: int, index: int) -> np.ndarray:
    """Time-varying water velocity (G, 2), every GUST s: turbulence and an oscillating current."""
    tank, odd, n = made.tank, made.odd, int(seconds / GUST) + 3
    table = np.zeros((n, 2))
    if tank.sigma > 0.0:
        table += random_streams.gusts(random_streams.stream(seed, "turbulence", index), n, GUST, tank.sigma, tank.time)
    if odd.pulse != 0.0:
        phase = random_streams.stream(seed, "pulse", index).uniform(0.0, 2 * np.pi)
        table[:, 0] += odd.pulse * np.sin(2 * np.pi * np.arange(n) * GUST / odd.pulse_period + phase)
    return table


def trial_of(
    made: RobotConstants, what: Excitation, seed: int, index: int, noise: float, name: str, replicate_of: str,
    flow: tuple[float, float], stamps: Mapping[str, np.ndarray] = NOMINAL,
) -> Trial:  # fmt: skip
    """Simulates and measures one trial. stamps: as in `sense`."""
    record = swim(made, what, seed, index, noise)
    wet = made.water.active > 0.0
    tables = {"cmd": sent_commands(what.t, what.commands)}
    streams = {name: random_streams.stream(seed, name, index) for name in SENSORS}
    tables |= sense(made, record, streams, (0.0, record.t[-1]), noise, stamps)
    if "pose" in tables:
        tables["pose"] = cameras.on_its_clock(made.camera, cameras.track(made.camera, tables["pose"]))
    meta = trial_meta(
        made.robot.name, "virtual robot" if wet else "none", what, replicate_of, flow, medium="water" if wet else "air",
        sigma=sigmas(made, noise), clock={table: CLOCKS[table] for table in tables}, engine="numpy",
        source="fishmj.virtual_robot", notes=" by the second robot",
    )  # fmt: skip
    return Trial(meta, tables, name=name)


def sense(
    made: RobotConstants, record: StateRecording, streams: dict, span: tuple[float, float], noise: float,
    stamps: Mapping[str, np.ndarray] = NOMINAL,
) -> dict[str, dict]:  # fmt: skip
    """Tables joint, power and (in water) pose with the readings of span[0] <= t < span[1].

    stamps: sensor -> times (K,) s of its readings in place of its own period.
    """

    def due(sensor: str, period: float) -> np.ndarray:
        if sensor in stamps:
            return stamps[sensor]
        return np.arange(np.ceil(span[0] / period - 1e-9), np.ceil(span[1] / period - 1e-9)) * period

    network_, camera, meter = made.network, made.camera, made.meter
    tables = {
        "joint": network.telemetry(network_, made.zero, record, due("joint", network_.period), streams["joint"], noise),
        "power": cameras.metered(meter, record, due("power", meter.period), streams["power"], noise),
    }
    if made.water.active > 0.0:
        tables["pose"] = cameras.watch(camera, made.odd, record, due("pose", camera.period), streams["pose"], noise)
    return tables


def sigmas(made: RobotConstants, noise: float) -> dict[str, float]:
    """Standard deviations of each channel's noise, quantisation included, and of the placing, in their units."""
    return {
        **noise_sigmas(made.network, made.camera, made.meter, made.robot.n_joints, noise),
        "start": noise * made.placing.position,
        "start_yaw": noise * made.placing.heading,
    }


# ----------------------------------------------------------------------------------------------------------------------- weighing
THREAD, APART = 1.2, 0.30  # m


def masses(made: RobotConstants) -> dict[str, float]:
    """True values: mass [kg], com (balance point from the nose) [m], inertia (yaw, about the balance point) [kg m2]."""
    body, origin = made.body, np.concatenate([[0.0], np.cumsum(made.body.hinge[:-1])])
    first = float(np.sum(body.first + body.mass * origin))
    second = float(np.sum(body.second + 2 * origin * body.first + body.mass * origin**2))
    middle = first / body.total
    nose = float(body.hinge[0] + made.robot.links[0].length)
    return {"mass": body.total, "com": nose - middle, "inertia": second - body.total * middle**2}


def page(effects: Mapping, seed: int, nuisance: float = 0.1, robot: "str | Robot" = "fish") -> dict:
    """Weighing table of a seed's robot with hidden effects."""
    return weighings(plant(effects, seed, nuisance=nuisance, robot=robot), random_streams.stream(seed, "weighing"))


def weighings(made: RobotConstants, rng: np.random.Generator) -> dict:
    """Weighing table of a robot: three readings of each quantity."""
    truth, names = masses(made), [link.name for link in made.robot.links]
    links = dict(zip(names, made.body.mass, strict=True))
    return weighing_page("fishmj.virtual_robot", links, truth["com"], truth["inertia"], THREAD, APART, rng)
