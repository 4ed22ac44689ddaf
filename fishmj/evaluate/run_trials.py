"""Run a controller over all trials at once: observe -> controller -> engine -> record.

`run` is the whole judge's loop. The engine is batched MuJoCo unless another is asked for; all engines give the same swim.
"""

from collections.abc import Callable

import numpy as np

from fishmj import controllers, engines
from fishmj.errors import ConfigError, SimDiverged
from fishmj.evaluate import protocol
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.result import Result
from fishmj.flow import stack
from fishmj.mjcf.description import Robot, load_robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.sensing import Sensors, readings


def run(
    controller,
    robot: "Robot | str" = "fish",
    trials: Trials | None = None,
    engine="batch",
    seed: int = 0,
    shift: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[int], None] = lambda step: None,
) -> Result:
    """Judge one controller.

    Args:
        controller: name, policy file, or an object with `reset` and `__call__` (see `fishmj.controllers`).
        trials: default, the 72 trials with `seed`.
        engine: name or engine.
        shift: m, by which every fish is let go beside where its trial says; its camera has not seen it yet.
        progress: called with the number of control steps done.

    Raises:
        SimDiverged: names the trial.
    """
    robot = load_robot(robot)
    trials = protocol.trials(seed=seed) if trials is None else trials
    brain = controllers.make(controller, robot) if isinstance(controller, str) else controller
    body = engines.make(engine, robot) if isinstance(engine, str) else engine
    n, steps = len(trials), task.control_steps(trials.duration, robot)
    ticks = engines.ticks_per(robot)[1]
    params, camera = trials.fish(robot)
    (start, target), noise = trials.ends(), trials.sensor_noise(robot, steps)
    current = stack(trials.flows())
    state = engines.at_rest(robot, start)
    state.q[:, :2] += shift
    state.q[:, 3:] = params.zero
    length, sensors = task.history_length(robot), Sensors(robot)
    history, recent = np.repeat(start[:, None], length, 1), np.zeros((n, sensors.behind + 1, 2 * robot.n_joints))
    rows: list[tuple] = []
    brain.reset(n)
    for k in range(steps):
        obs = task.observe_with_sensors(np, robot, sensors, params, history, camera, recent, target, noise[:, k])
        command = _checked(brain, brain(obs), (n, ticks, robot.n_joints))
        try:
            state, trace = body.advance(state, command, params, current, np.full(n, k * ticks))
        except SimDiverged as error:
            raise _named(error, trials, k * robot.timing.control_dt) from error
        trace = engines.Trace(*(np.asarray(a, float) for a in trace))
        history = np.concatenate([history, trace.pose], 1)[:, -length:]
        recent = np.concatenate([recent, readings(np, trace.joint, trace.rate)], 1)[:, -sensors.behind - 1 :]
        rows.append((*trace, command, obs[:, None], _action(brain)))
        progress(k + 1)
    return _result(brain, robot, trials, body, start, target, rows)


def _result(brain, robot, trials, body, start, target, rows) -> Result:
    """Rows of control steps as arrays; the start is tick 0."""
    join = lambda i: np.concatenate([row[i] for row in rows], 1)
    first = lambda x, like: np.concatenate([np.broadcast_to(x, (len(start), like.shape[2]))[:, None], like], 1)
    pose, joint, rate, velocity = first(start, join(0)), first(0.0, join(1)), first(0.0, join(2)), first(0.0, join(3))
    out = task.outside(np, pose)
    left = np.where(out.any(1), out.argmax(1), pose.shape[1])
    distance = np.linalg.norm(pose[:, :, :2] - target[:, None], axis=-1)
    tick = np.minimum(np.arange(pose.shape[1]), left[:, None])
    return Result(
        controller=brain.name,
        policy_sha256=getattr(brain, "sha256", ""),
        robot=robot,
        trials=trials,
        engine=type(body).__module__.rpartition(".")[2],
        t=np.arange(pose.shape[1]) * robot.timing.bus_dt,
        target=target,
        pose=pose,
        velocity=velocity,
        joint=joint,
        rate=rate,
        power=join(4) + robot.servo.idle_power,
        command=join(5),
        obs=join(6),
        action=None if rows[0][7] is None else join(7),
        distance=np.take_along_axis(distance, np.minimum(tick, pose.shape[1] - 1), 1),
        left=left,
    )


def _action(brain):
    action = getattr(brain, "action", None)
    return None if action is None else np.array(action)[:, None]


def _checked(brain, command, shape) -> np.ndarray:
    """The controller's answer, or one clear error; it belongs to somebody else."""
    command = np.asarray(command, float)
    if command.shape != shape or not np.isfinite(command).all():
        what = "" if np.isfinite(command).all() else " with values that are not finite"
        raise ConfigError(
            f"controller {brain.name}: gave an array of shape {command.shape}{what}; expected finite bus commands {shape} in rad"
        )
    return command


def _named(error: SimDiverged, trials: Trials, time: float) -> SimDiverged:
    """The same error with the first bad trial's condition."""
    bad = np.atleast_1d(error.states if error.states is not None else [0])
    trial = trials.items[int(bad[0])]
    where = f"{trial.speed} m/s, los {np.degrees(trial.los):.0f} deg, repeat {trial.repeat}, after {time:.1f} s"
    return SimDiverged(f"trial at {where}: {error}", time=time, term=error.term, states=error.states)
