"""Station holding: swim to a target and keep it in a current that the fish cannot sense. Paper, RL-based Training.

    s = [q, v, w, J, K]                 11 numbers in the body frame: target, velocity over ground, yaw rate, joints, rates
    a in [-1, 1]^3 -> +-60 deg          desired joint angles every 0.2 s, no central pattern generator
    r = wG / (1 + wD d) - wS |K|^2      d distance to the target; |K|^2 averaged over the step's bus ticks, to include motion
                                        within a step
Random draws are arguments, so that NumPy, JAX and every engine share one definition.
"""

from math import ceil, pi, radians
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects import randomise
from fishmj.engines import Extensions, FishParams, nominal_params, ticks_per
from fishmj.mjcf.description import Robot, Timing
from fishmj.tasks.sensing import Sensors, delayed, estimate
from fishmj.water.choice import family_in

WEIGHTS = ("wG", "wD", "wS")  # of the reward, in the paper's symbols
GROUPS = ("target", "velocity", "yaw_rate", "joint", "joint_rate")
# divisors that bring observations to order one: target m, the same within reach m, velocity m/s, yaw rate rad/s, joint rad, rad/s
DIVISORS = {"target": 1.0, "near": 0.1, "velocity": 0.3, "yaw_rate": 1.5, "joint": 0.7, "joint_rate": 4.0}
LEAST_CAMERA_TICKS = 5  # camera frames remembered at least; 100 ms at 50 Hz
N_START, N_FLOW = 7, 4


class Start(NamedTuple):
    """Initial state and flow of B episodes."""

    pose: Any  # (B, 3) m, rad
    target: Any  # (B, 2) m
    speed: Any  # (B,) m/s
    direction: Any  # (B,) rad, where the water moves to


def draw_start(xp, uniforms) -> Start:
    """Initial state distribution of the paper, from uniforms (B, 7): positions in the arena, any heading and flow direction."""
    arena, (slow, fast) = constant("task", "arena"), constant("task", "flow_speed")
    u = uniforms
    return Start(
        pose=xp.stack([arena * (2 * u[:, 0] - 1), arena * (2 * u[:, 1] - 1), pi * (2 * u[:, 2] - 1)], -1),
        target=arena * (2 * u[:, 3:5] - 1),
        speed=slow + (fast - slow) * u[:, 5],
        direction=pi * (2 * u[:, 6] - 1),
    )


def skewed(xp, uniforms, exponent: float):
    """Uniforms (B, 7) for `draw_start` with that of the speed to this power; above 1 favours slow streams."""
    return uniforms if exponent == 1 else xp.concatenate([uniforms[:, :5], uniforms[:, 5:6] ** exponent, uniforms[:, 6:]], -1)


def n_fish(robot: Robot, effects=()) -> int:
    """Number of uniforms that `draw_fish` needs."""
    plain = len(robot.links) + 3 * robot.n_joints + 2
    active = Extensions.of(robot).active
    family = family_in(robot)
    return plain + (randomise.width(active, effects) if active is not None else 0) + (family.width if family else 0)


def draw_fish(xp, robot: Robot, uniforms, strength: float = 1.0, effects=(), stream=None) -> tuple[FishParams, Any]:
    """Randomised fish from uniforms (B, n_fish): masses, servo gains, joint zeros, both latencies, effects, a family's water.

    strength: 0 gives the nominal fish with nominal latencies, 1 the paper's ranges and effects of typical size. Other effects of
    the robot keep their calibrated values. stream: (B,) m/s; a family then draws waters in which the fish can hold station.

    Returns:
        (FishParams, camera delay in bus ticks (B,) int).
    """
    n, j, family = len(robot.links), robot.n_joints, family_in(robot)
    drawn = family.width if family else 0
    m = n_fish(robot) - drawn
    p = nominal_params(robot, 1)
    added = Extensions.of(robot)
    span = lambda a, b: 2 * uniforms[:, a:b] - 1
    get = lambda key: constant("randomisation", key)
    kd = 1 + strength * get("kd") * span(n + j, n + 2 * j)
    delay = _latency(robot.timing, "command_latency", uniforms[:, m - 2], strength)
    camera = _latency(robot.timing, "camera_latency", uniforms[:, m - 1], strength)
    like = xp.zeros_like(uniforms[:, :1])
    rows = like + p.effects
    if effects and added.active is not None:
        rows = randomise.drawn(xp, added.active, rows, effects, uniforms[:, m:], strength)
    delay = delay + added.late(xp, rows, "command")
    own = uniforms[:, uniforms.shape[1] - drawn :]
    fish = FishParams(
        mass=1 + strength * get("mass") * span(0, n),
        kp=p.kp * (1 + strength * get("kp") * span(n, n + j)),
        kv=p.kv * kd,
        kb=p.kb * kd,
        zero=strength * radians(get("zero_deg")) * span(n + 2 * j, n + 3 * j),
        water=family.draw(xp, own, strength, stream) if family else like + p.water,
        delay=xp.floor(delay / robot.timing.physics_dt + 0.5).astype("int32"),
        effects=rows,
        net=family.net_of(xp, own, strength) if family else (0 * like[:, 0]).astype("int32"),
    )
    sensors = Sensors(robot)
    most = camera_ticks(robot) + sensors.frames - sensors.slow
    return fish, xp.minimum(sensors.ticks(xp, camera, rows, "pose"), most)


def warn_of_streams(robot: Robot, course, bounds, strength: float = 1.0) -> None:
    """Warns once if the slowest stream leaves only one water of a family; bounds: (2,) m/s, None: those of the course."""
    if strength > 0 and (family := family_in(robot)) is not None:
        slowest = course.launch(np, np.zeros((1, N_START))).start.speed[0] if bounds is None else bounds[0]
        family.warn_beyond(float(slowest))


def _latency(timing: Timing, key: str, uniform, strength: float):
    """Nominal at strength 0, uniform in the drawn range at strength 1, s."""
    nominal = getattr(timing, key)
    low, high = (nominal + strength * (b - nominal) for b in timing.drawn_latency(key))
    return low + (high - low) * uniform


def spans(joints: int) -> dict[str, int]:
    """Name and width of each observation, in the order of the flat vector."""
    return {"target": 2, "velocity": 2, "yaw_rate": 1, "joint": joints, "joint_rate": joints}


def privileged_spans(joints: int) -> dict[str, int]:
    """Name and width of each group of the privileged critic's input (`tasks.env`), in order; no noise, no latency."""
    return {**spans(joints), "flow": 2, "time_left": 1, "near": 2}


def noise_scale(robot: Robot):
    """Standard deviation of each of the 5 + 2 J observations."""
    get = lambda key: constant("noise", key)
    each = [get("position"), get("velocity"), get("yaw_rate"), radians(get("joint_deg")), get("joint_rate")]
    return np.repeat(each, [*spans(robot.n_joints).values()])


def input_scale(joints: int, memory: int = 1) -> np.ndarray:
    """Divisors of a policy's whole input: observation, then `memory` - 1 pairs (action, observation)."""
    # constants instead of running statistics, so that a policy file can hold them, and the robot scales as in training
    one = np.repeat([DIVISORS[group] for group in GROUPS], [*spans(joints).values()])
    return np.concatenate([one] + [np.concatenate([np.ones(joints), one])] * (memory - 1))


def mirror_signs(joints: int, memory: int = 1) -> np.ndarray:
    """Signs that mirror a policy's whole input; the mirror image of an action is its negative."""
    side = {"target": [1.0, -1.0], "velocity": [1.0, -1.0]}
    one = np.concatenate([side.get(group, [-1.0] * width) for group, width in spans(joints).items()])
    return np.concatenate([one] + [np.concatenate([-np.ones(joints), one])] * (memory - 1))


def privileged_scale(joints: int) -> np.ndarray:
    """Divisors of a privileged critic's additional inputs: true observation, flow, share of time left, target within reach."""
    return np.concatenate([input_scale(joints), [DIVISORS["velocity"]] * 2, [1.0], [DIVISORS["near"]] * 2])


def visible(joints: int, hide=()) -> list[bool]:
    """Mask of the 5 + 2 J observations that remain when the groups `hide` are set to zero.

    Raises UnknownName: a group that does not exist.
    """
    for name in hide:
        if name not in GROUPS:
            raise UnknownName("observation group", name, GROUPS)
    return [group not in hide for group, width in spans(joints).items() for _ in range(width)]


def history_length(robot: Robot) -> int:
    """Number of past poses that the camera and its filter need, bus ticks."""
    return robot.timing.velocity_window + camera_ticks(robot) + Sensors(robot).frames


def camera_ticks(robot: Robot) -> int:
    """Longest camera latency of this robot, nominal or randomised, without effects, in bus ticks."""
    longest = robot.timing.drawn_latency("camera_latency")[1]
    return max(LEAST_CAMERA_TICKS, ceil(longest / robot.timing.bus_dt - 1e-6))


def observe_with_sensors(xp, robot: Robot, sensors: Sensors, params: FishParams, history, camera, recent, target, noise):
    """`observe` through the robot's sensors; recent: (B, sensors.behind + 1, 2 J) encoder readings, newest last."""
    joint, rate = sensors.joints(xp, params.effects, recent)
    slow = sensors.ticks(xp, 0.0, params.effects, "velocity") if sensors.slow else None
    return observe(xp, robot, sensors.poses(xp, params.effects, history), camera, joint, rate, target, noise, slow)


def observe(xp, robot: Robot, history, camera, joint, rate, target, noise, slow=None):
    """The egocentric observation.

    Args:
        history: (B, H, 3) poses at bus ticks, newest last.
        camera: (B,) int, camera latency in ticks.
        joint, rate: (B, J) encoder angles and rates, rad, rad/s.
        target: (B, 2) m, world.
        noise: (B, 5 + 2 J) standard normal draws times the noise strength.
        slow: (B,) int, ticks by which velocities lag behind the poses; None for no lag.

    Returns:
        (B, 5 + 2 J): target in the body frame (2), velocity over ground in the body frame (2), yaw rate, J, K.
    """
    frames = delayed(xp, history, camera, robot.timing.velocity_window)
    pose, velocity = estimate(xp, frames, robot.timing.bus_dt)
    if slow is not None:
        _, velocity = estimate(xp, delayed(xp, history, camera + slow, robot.timing.velocity_window), robot.timing.bus_dt)
    c, s = xp.cos(pose[:, 2]), xp.sin(pose[:, 2])
    dx, dy = target[:, 0] - pose[:, 0], target[:, 1] - pose[:, 1]
    body = xp.stack(
        [c * dx + s * dy, c * dy - s * dx, c * velocity[:, 0] + s * velocity[:, 1], c * velocity[:, 1] - s * velocity[:, 0]], -1
    )
    clean = xp.concatenate([body, velocity[:, 2:], joint, rate], -1)
    return clean + noise * xp.asarray(noise_scale(robot), dtype=clean.dtype)


def reward(xp, distance, rates, wG=None, wD=None, wS=None):  # noqa: N803  (the paper's symbols)
    """Reward of one control step: distance (B,) at its end [m], joint rates (B, T, J) over its ticks [rad/s]."""
    wG, wD, wS = (constant("reward", k) if w is None else w for k, w in zip(WEIGHTS, (wG, wD, wS), strict=True))
    return wG / (1 + wD * distance) - wS * xp.mean(xp.sum(rates * rates, -1), -1)


def outside(xp, pose):
    """True if the reference point has left |x|, |y| <= bound."""
    bound = constant("task", "bound")
    return (xp.abs(pose[..., 0]) > bound) | (xp.abs(pose[..., 1]) > bound)


def chunk(xp, robot: Robot, previous, action):
    """Bus commands of one control step: previous (B, J) last command [rad], action (B, J), clipped to [-1, 1].

    `linear` interpolates over the step, `hold` sends the new angles at once, `move_time` sends the same commands as `linear`, and
    the servo also interpolates between them.

    Returns:
        (B, T, J) rad.
    """
    _, ticks = ticks_per(robot)
    goal = robot.servo.range * xp.clip(action, -1, 1)
    if robot.timing.command_path == "hold":
        return xp.repeat(goal[:, None], ticks, 1)
    share = (xp.arange(ticks) + 1)[None, :, None] / ticks
    return previous[:, None] + share * (goal - previous)[:, None]


def episode_steps(stated: float | None, course, robot: Robot) -> int:
    """Number of control steps of an episode of `stated` seconds; None: enough for the seconds of its course.

    Raises ConfigError: the stated time is not a multiple of the control step.
    """
    if stated is not None:
        whole_steps("task: seconds", stated, robot)
    return control_steps(course.seconds if stated is None else stated, robot)


def whole_steps(where: str, seconds: float, robot: Robot) -> None:
    """Raises ConfigError if `seconds` is not a multiple of the robot's control step; where: start of the message."""
    dt = robot.timing.control_dt
    if (steps := round(seconds / dt)) < 1 or abs(steps * dt - seconds) > 1e-6 * seconds:
        near = " or ".join(f"{k * dt:g}" for k in dict.fromkeys((max(1, int(seconds / dt)), int(seconds / dt) + 1)))
        raise ConfigError(f"{where} = {seconds:g} s; expected a multiple of the control step of {dt:g} s, such as {near}")


def control_steps(seconds: float, robot: Robot) -> int:
    """Number of control steps that cover `seconds`."""
    return ceil(seconds / robot.timing.control_dt - 1e-9)
