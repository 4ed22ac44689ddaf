"""Builds the parts of a run from its settings: robot, engine, environment, algorithm, and the final policy."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from fishmj.base import plugins
from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, OwnCodeError, UnknownName
from fishmj.control.policy import Policy
from fishmj.engines import fastest, with_effects
from fishmj.mjcf.reading import load_robot, with_timing
from fishmj.tasks.reference import COURSES, course_of
from fishmj.tasks.station_hold import N_START, episode_steps
from fishmj.train.learner import METRICS, NEEDED, Learner, PolicyLayers
from fishmj.train.settings import ALGORITHMS, REWARD, Settings, change, hyperparameters, referred
from fishmj.water.choice import LBM, SELF_MADE, WaterChoice, chosen
from fishmj.water.flow import BOXES

CLOSE = 1e-4  # largest difference of actions in [-1, 1] between two float32 libraries


def pick_engine(settings: Settings) -> str:
    """Name of the engine; `auto`: MJX on a GPU, else compiled, or planar without numba."""
    if settings.engine != "auto":
        return settings.engine
    import jax

    if jax.default_backend() != "cpu":
        return "mjx"
    return fastest()


def robot_for(settings: Settings):
    """Robot in the run's water, with its command path, control step and the effects that it draws.

    Raises UnknownName, ConfigError: no such command path, or a control step that does not fit the bus.
    """
    return timed(with_effects(water_for(settings).robot, settings.task.get("effects", ())), settings)


def timed(robot, settings: Settings):
    """The robot with the control step and the command path of the settings, where they state them. Raises as `robot_for`."""
    return with_timing(robot, settings.control_dt or None, settings.command_path or None, "train --control-dt")


def water_for(settings: Settings) -> WaterChoice:
    """Water of a run. Raises ConfigError if its engine does not support it; further errors as `choice.chosen`."""
    if settings.engine == LBM:
        if settings.water not in ("auto", LBM):
            raise ConfigError(f"water {settings.water!r} with --engine lbm, which replaces the water; leave one of them out")
        return chosen(load_robot(settings.robot), LBM)
    water = None if settings.water == "auto" else settings.water
    return chosen(load_robot(settings.robot), water).within(SELF_MADE, "training")


def settled(settings: Settings) -> Settings:
    """Settings with all open values filled in: water by name, timing, hyperparameters, the task's options and reward.

    A run stores these, so that it resumes with them even if a default changes later.

    Raises UnknownName, ConfigError: an invalid setting; OwnCodeError: an error in the user's own algorithm or task.
    """
    from fishmj.tasks.env import Options

    water = water_for(settings).kind if settings.water == "auto" else settings.water
    task = _written(from_table("task option", Options, settings.task))
    del task["box"]  # a run uses two boxes, train and tune
    course = course_of(task["course"])
    if task["course"] in COURSES:
        ends = course.launch(np, np.array([[0.0] * N_START, [1.0] * N_START])).start.speed  # the speed is a draw between these
        task["flow_speed"] = tuple(map(float, ends)) if task["flow_speed"] is None else task["flow_speed"]
    reward = {} if getattr(course, "reward", None) else {key: constant("reward", key) for key in REWARD}
    robot = robot_for(settings)
    if task["seconds"] is not None or task["course"] in COURSES:
        task["seconds"] = round(episode_steps(task["seconds"], course, robot) * robot.timing.control_dt, 9)
    algorithm = _written(config_of(settings))
    return change(
        replace(settings, water=water),
        command_path=robot.timing.command_path,
        control_dt=float(robot.timing.control_dt),
        task=task,
        algorithm=algorithm,
        reward=reward | settings.reward,
    )


def _written(made: Any) -> dict:
    """Fields of a dataclass that a file of settings can hold."""
    table = {one.name: getattr(made, one.name) for one in fields(made)}
    return {key: value for key, value in table.items() if value is None or isinstance(value, bool | int | float | str | tuple)}


def environment(settings: Settings, box: str = "train"):
    """Training environment, or with box="tune" the one that picks the best policy."""
    from fishmj.engines import make
    from fishmj.tasks.env import Options, StationHold

    robot, name = robot_for(settings), pick_engine(settings)
    options = from_table("task option", Options, {**settings.task, "box": box})
    if name == LBM:
        from fishmj.engines.lbm_episodes import LbmEpisodes

        engine = LbmEpisodes(robot, options.turbulence, BOXES[box], **settings.solver)
    else:
        engine = make(name, robot)
    if not engine.jittable:
        raise ConfigError(f"engine {name} cannot run inside jax.jit; train on compiled, planar or mjx, or with --algo sb3-ppo")
    return StationHold(robot, engine, options, **settings.reward)


def algorithm(settings: Settings, env, devices: int = 1) -> Learner:
    """Learner named by settings.algo, on this number of devices. Raises ConfigError, UnknownName, OwnCodeError."""
    config = config_of(settings)
    check_devices(settings, devices)
    if devices > 1:
        return referred(ALGORITHMS[settings.algo].learner)(env, config, settings.steps, devices)
    if settings.algo in ALGORITHMS:
        return referred(ALGORITHMS[settings.algo].learner)(env, config, settings.steps)
    return OwnAlgorithm(settings.algo, env, config, settings.steps, settings)


def check_devices(settings: Settings, devices: int) -> None:
    """Raises ConfigError if the algorithm trains on one device only, devices are missing, or the fish do not divide equally."""
    if devices == 1:
        return
    from fishmj.train.sharding import Shards

    if settings.algo != "ppo":
        raise ConfigError(f"--devices {devices}: {settings.algo} trains on one device; leave --devices out, or take --algo ppo")
    Shards(devices)
    c = config_of(settings)
    if c.envs % devices or c.envs // devices * c.horizon % c.minibatches:
        rows = f"{devices} equal shares of {c.envs} fish x {c.horizon} steps, each in {c.minibatches} minibatches"
        raise ConfigError(f"--devices {devices}: expected {rows}; change --envs")


def config_of(settings: Settings) -> Any:
    """Hyperparameters of the algorithm. Raises UnknownName (no such algorithm, no such key), ConfigError, OwnCodeError."""
    if settings.algo in ALGORITHMS:
        kind = referred(ALGORITHMS[settings.algo].config)
    elif settings.algo in plugins.loaded("algorithm"):  # the user's own, if this process has loaded it
        kind = getattr(plugins.loaded("algorithm")[settings.algo], "Config", None)
        if not (isinstance(kind, type) and is_dataclass(kind)):
            what = "has no Config; give it a frozen dataclass of its settings, each with a default"
            raise OwnCodeError(f"algorithm {settings.algo}: {what}")
    else:
        raise UnknownName("algorithm", settings.algo, ALGORITHMS)
    for name in sorted(settings.algorithm.keys() - {one.name for one in fields(kind)}):
        if (other := hyperparameters().get(name)) is not None:
            algos = ", ".join(other.defaults)
            raise ConfigError(
                f"{other.option} is a setting of {algos}, not of {settings.algo}; leave it out, or take another --algo"
            )
    return from_table(f"setting of {settings.algo}", kind, settings.algorithm)


def from_table(what: str, kind, table: dict):
    """Frozen dataclass from a table. Raises UnknownName for a key that it does not have."""
    known = [f.name for f in fields(kind)]
    for key in table:
        if key not in known:
            raise UnknownName(what, key, known)
    return kind(**table)


def policy_of(network: PolicyLayers, settings: Settings, meta: dict) -> Policy:
    """NumPy policy from `Learner.policy_layers` of a trained actor."""
    return Policy.of(
        robot_for(settings),
        [(np.asarray(w).T, b) for w, b in network.layers],
        activation=network.activation,
        memory=settings.task.get("memory", 1),
        hide=settings.task.get("hide", ()),
        algorithm=settings.algo if settings.algo in ALGORITHMS else plugins.name_of(settings.algo),
        seed=settings.seed,
        **meta,
    )


class OwnAlgorithm:
    """Wraps the user's own learning algorithm in the interface of ppo.py and sac.py, and checks every result.

        class Mine:
            Config                                      frozen dataclass of its settings, all with defaults
            def __init__(self, env, config, steps): ..  steps: control steps of the whole run, all fish together
            steps_per_iteration: int                    control steps that one `iterate` takes
            def init(self, key): ..                     -> a NamedTuple of arrays, with actor: [(weights (in, out), bias), ..]
            def iterate(self, training): ..             -> (training, metrics): see learner.METRICS
            def act(self, actor, obs): ..               -> actions (B, J) in [-1, 1] for raw observations, in JAX
            def policy_layers(self, actor): ..          -> learner.PolicyLayers; left out: all of actor, Config.activation or tanh

    The trained actor must equal the written policy: a file holds tanh(MLP(observation / scale)), and `act` is compared with it.

    Raises OwnCodeError: the algorithm fails, or returns something else.
    """

    def __init__(self, text: str, env, config: Any, steps: int, settings: Settings):
        self.what = f"algorithm {text}"
        self.settings, self.env, self.config = settings, env, config
        made = plugins.loaded("algorithm")[text]
        plugins.takes(self.what, made, "Name(env, config, steps)", 3)
        self.mine = plugins.call(self.what, made, env, config, steps)
        self.name = plugins.name_of(text)
        for call, count in (("init(key)", 1), ("iterate(training)", 1), ("act(actor, obs)", 2)):
            plugins.takes(self.what, getattr(self.mine, call.partition("(")[0], None), call, count)
        self.steps_per_iteration: int = getattr(self.mine, "steps_per_iteration", 0)
        if not isinstance(self.steps_per_iteration, int) or self.steps_per_iteration < 1:
            raise OwnCodeError(
                f"{self.what}: steps_per_iteration = {self.steps_per_iteration!r}; expected a whole number, 1 or more"
            )

    def init(self, key):
        """Fresh train state; its actor and `act` are checked."""
        training = plugins.call(f"{self.what}: init", self.mine.init, key)
        self._check(training)
        return training

    def iterate(self, state):
        """Does one iteration; returns (train state, metrics)."""
        answer = plugins.call(f"{self.what}: iterate", self.mine.iterate, state)
        if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[1], Mapping)):
            raise OwnCodeError(f"{self.what}: iterate returned {type(answer).__name__}; expected (training, metrics as a dict)")
        if lacking := [name for name in NEEDED if name not in answer[1]]:
            raise OwnCodeError(
                f"{self.what}: its metrics lack {', '.join(lacking)}; expected {', '.join(METRICS)}, one number each"
            )
        for name, value in answer[1].items():
            if np.shape(value) != ():
                raise OwnCodeError(f"{self.what}: metric {name} has shape {np.shape(value)}; expected one number")
        return answer

    def act(self, actor, obs):
        """Actions (B, J) for raw observations."""
        return plugins.call(f"{self.what}: act", self.mine.act, actor, obs)

    def policy_layers(self, actor) -> PolicyLayers:
        """Layers and activation of the actor in the form of a policy file."""
        if mine := getattr(self.mine, "policy_layers", None):
            return PolicyLayers(*plugins.call(f"{self.what}: policy_layers", mine, actor))
        return PolicyLayers(actor, getattr(self.config, "activation", "tanh"))

    def _check(self, training) -> None:
        try:
            policy = policy_of(self.policy_layers(training.actor), self.settings, {})
        except Exception as error:
            message = " ".join(str(error).split())[:200]
            raise OwnCodeError(
                f"{self.what}: init returned an unusable `actor`; expected a list of (weights (in, out), bias (out,)) from "
                f"{self.env.n_input} inputs to {self.env.n_act} actions; transposed for the policy file: {message}"
            ) from error
        if self.settings.task.get("memory", 1) > 1 or self.settings.task.get("hide"):
            return  # with memory or trimmed weights, one observation does not determine one action
        obs = np.random.default_rng(0).normal(size=(16, self.env.n_obs)).astype(np.float32)
        ours, theirs = policy(obs), np.asarray(self.act(training.actor, obs))
        if theirs.shape != ours.shape or not np.abs(theirs - ours).max() < CLOSE:
            off = f"shape {theirs.shape}" if theirs.shape != ours.shape else f"differs by {np.abs(theirs - ours).max():.3g}"
            raise OwnCodeError(
                f"{self.what}: act differs from the policy that would be written ({off}): expected tanh(MLP(obs / scale)) with "
                f"activation {policy.meta['activation']!r}; use fishmj.train.networks.forward and env.input_scale"
            )
