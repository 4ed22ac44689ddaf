"""Run a controller over all trials at once: observe -> controller -> engine -> record.

`run` is the whole judge's loop. The engine is batched MuJoCo unless another is asked for; all engines give the same swim.
"""

from collections.abc import Callable

import numpy as np

from fishmj import controllers
from fishmj.errors import ConfigError, SimDiverged
from fishmj.evaluate import protocol
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.result import Result
from fishmj.flow import stack
from fishmj.mjcf.description import Robot, load_robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.loop import ControlLoop, Scenario


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
    controller = controllers.make(controller, robot) if isinstance(controller, str) else controller
    loop = ControlLoop(robot, engine)
    n, steps = len(trials), task.control_steps(trials.duration, robot)
    params, camera = trials.fish(robot)
    (start, target), noise = trials.ends(), trials.sensor_noise(robot, steps)
    loop.start(start, Scenario(params, camera, stack(trials.flows())))
    loop.fish.q[:, :2] += shift
    rows: list[tuple] = []
    controller.reset(n)
    for k in range(steps):
        obs = loop.observe(target, noise[:, k])
        command = _checked(controller, controller(obs), (n, loop.ticks, robot.n_joints))
        try:
            trace = loop.act(command)
        except SimDiverged as error:
            raise _named(error, trials, k * robot.timing.control_dt) from error
        rows.append((*trace, command, obs[:, None], _action(controller)))
        progress(k + 1)
    return _result(controller, robot, trials, loop.engine, start, target, rows)


def _result(controller, robot, trials, engine, start, target, rows) -> Result:
    """Rows of control steps as arrays; the start is tick 0."""
    join = lambda i: np.concatenate([row[i] for row in rows], 1)
    first = lambda x, like: np.concatenate([np.broadcast_to(x, (len(start), like.shape[2]))[:, None], like], 1)
    pose, joint, rate, velocity = first(start, join(0)), first(0.0, join(1)), first(0.0, join(2)), first(0.0, join(3))
    out = task.outside(np, pose)
    left = np.where(out.any(1), out.argmax(1), pose.shape[1])
    distance = np.linalg.norm(pose[:, :, :2] - target[:, None], axis=-1)
    tick = np.minimum(np.arange(pose.shape[1]), left[:, None])
    return Result(
        controller=controller.name,
        policy_sha256=getattr(controller, "sha256", ""),
        robot=robot,
        trials=trials,
        engine=type(engine).__module__.rpartition(".")[2],
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


def _action(controller):
    action = getattr(controller, "action", None)
    return None if action is None else np.array(action)[:, None]


def _checked(controller, command, shape) -> np.ndarray:
    """The controller's answer, or one clear error; it belongs to somebody else."""
    command = np.asarray(command, float)
    if command.shape != shape or not np.isfinite(command).all():
        what = "" if np.isfinite(command).all() else " with values that are not finite"
        raise ConfigError(
            f"controller {controller.name}: gave an array of shape {command.shape}{what};"
            f" expected finite bus commands {shape} in rad"
        )
    return command


def _named(error: SimDiverged, trials: Trials, time: float) -> SimDiverged:
    """The same error with the first bad trial's condition."""
    bad = np.atleast_1d(error.states if error.states is not None else [0])
    trial = trials.items[int(bad[0])]
    where = f"{trial.speed} m/s, los {np.degrees(trial.los):.0f} deg, repeat {trial.repeat}, after {time:.1f} s"
    return SimDiverged(f"trial at {where}: {error}", time=time, term=error.term, states=error.states)
