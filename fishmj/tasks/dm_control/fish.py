"""The fish domain of dm_control: `rl.control` tasks made from `fishmj.tasks`, one factory for each task.

    observation   target (2) m, velocity (2) m/s, yaw_rate (1) rad/s, joint (3) rad, joint_rate (3) rad/s, body frame, as the
                  camera and the encoders give them; `flat_observation=True` joins them in this order
    action        (3,) in [-1, 1]: desired joint angles over +-60 deg
    end           fish left the domain: LAST with discount 0. Time limit: LAST with discount 1, dm_env's mark of a truncation
                  (bootstrap there).

The flow is in `env.task.scenario` for logs; no observation has it.
"""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import containers
from dm_env import specs

from fishmj.base.errors import ConfigError
from fishmj.base.options import checked_array, checked_name, shown_value
from fishmj.engines import Trace
from fishmj.mjcf.model import ROOTS
from fishmj.mjcf.reading import load_robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.dm_control.physics import HybridPhysics, Physics, SolverPhysics
from fishmj.tasks.episode import EpisodeDraw, SensorWindow, TaskSpec, options_for
from fishmj.tasks.reference import StepTruth
from fishmj.water import choice

SUITE = containers.TaggedTasks()
DOMAIN = "fish"
OURS = ("time_limit", "control_timestep", "n_sub_steps")  # arguments of dm_control's Environment that the task sets itself
DM_OPTIONS = ("flat_observation", "legacy_step")  # the others
SOLVER = ("domain", "slip", "device", "finer", "width", "passes", "sharpness", "storage")  # options of `engines.lbm.LbmEngine`


@SUITE.add("benchmarking")
def station_hold(random=None, environment_kwargs=None, root="planar", **setting):
    """Swim to a target and keep it in a current that the fish cannot sense. Options: `tasks.episode.TaskOptions`."""
    return environment("station_hold", random, environment_kwargs, root, setting)


@SUITE.add("benchmarking")
def figure_eight(random=None, environment_kwargs=None, root="planar", **setting):
    """Follow a point on a figure eight at constant speed. Options: speed m/s, cycles, phase m (None: drawn), `TaskOptions`."""
    return environment("figure_eight", random, environment_kwargs, root, setting)


@SUITE.add()
def angle_of_attack(random=None, environment_kwargs=None, root="planar", **setting):
    """Start on the target, turned from upstream by `angle` rad (None draws one of the paper's four); and `TaskOptions`."""
    return environment("angle_of_attack", random, environment_kwargs, root, setting)


def environment(name: Any, random, environment_kwargs, root: str, setting: dict) -> control.Environment:
    """Makes one dm_control environment of a task by name, or of the user's own (tasks.reference).

    `setting` has the options of the task and of `TaskOptions`. Its `water` is as `fishmj.water.choice` names it; "lbm" is the
    flow solver, whose options (domain, slip, device, finer) are in `solver`; those of "hybrid" are in `hybrid`, a
    `fishmj.engines.hybrid.HybridOptions`. Raises ConfigError, UnknownName: an unknown or invalid option.
    """
    setting = dict(setting)
    solver, corrected = setting.pop("solver", None), setting.pop("hybrid", None)
    asked, course = options_for(name, setting, ("random", "root", "solver", "hybrid"))
    water = choice.chosen(load_robot(asked.robot), asked.water).announced()
    checked_name("root", root, ROOTS)
    if root == "free" and water.kind in choice.SOLVED:
        raise ConfigError(f"suite: water {water.kind!r} supports only a planar root; choose root = 'planar', or another water")
    for option, value, kind in (("solver", solver, choice.LBM), ("hybrid", corrected, choice.HYBRID)):
        if value is not None and water.kind != kind:
            raise ConfigError(f"suite: {option} has the options of water {kind!r}, got water {water.kind!r}; leave it out")
    rules = TaskSpec(name, replace(asked, robot=water.robot, water=None), **course)
    options = environment_options(environment_kwargs)
    fish_task = FishTask(rules, random)
    if water.kind == choice.LBM:
        physics = SolverPhysics.in_tank(rules, table_of("solver", solver or {}, SOLVER))
    else:
        hybrid = water.kind == choice.HYBRID
        physics = HybridPhysics.corrected(rules, corrected) if hybrid else Physics.of(rules.robot, root)
    return control.Environment(physics, fish_task, control_timestep=rules.dt, **options)


def environment_options(given: Any) -> dict:
    """Returns `environment_kwargs` for `dm_control.rl.control.Environment`. Raises ConfigError, UnknownName for other options."""
    options = dict(table_of("environment_kwargs", given or {}))
    for key in options:
        if key in OURS:
            raise ConfigError(f"suite: environment_kwargs has {key!r}; set `seconds` or `control_dt` in task_kwargs instead")
    return table_of("environment_kwargs", options, DM_OPTIONS)


def table_of(where: str, given: Any, known: Iterable[str] | None = None) -> dict:
    """Returns a table of keyword arguments. Raises ConfigError if it is not a dict, or a key is not known."""
    if not isinstance(given, dict):
        raise ConfigError(f"suite: {where} = {shown_value(given)}; expected a dict of options")
    for key in given if known is not None else ():
        checked_name(f"option in {where}", key, known or ())
    return given


class FishTask(base.Task):
    """dm_control task of one course: observation, reward, start and end.

    Attributes:
        scenario: draws of the running episode (batch of one): start, flow, fish, camera. Never observed.
        trace: bus ticks of the last control step; None at the start.
    """

    trace: Trace | None

    def __init__(self, rules: TaskSpec, random=None):
        try:
            super().__init__(random=random)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"suite: random = {shown_value(random)}; expected a seed, a RandomState or None") from error
        self.rules = rules
        self._start(rules.scenario(rules.draws(np.random.RandomState(0), 1)), np.zeros((1, rules.n_obs)))

    @property
    def input_scale(self) -> np.ndarray:
        """Divisors (n_obs,) of the flat observation in fishmj's own trainings; `Policy.of` expects them."""
        return task.input_scale(self.rules.n_act)

    def initialize_episode(self, physics: Physics) -> None:
        """Draws fish, flow, start and target; everything at rest over ground."""
        self.begin(physics, self.rules.scenario(self.rules.draws(self.random, 1)))
        super().initialize_episode(physics)

    def begin(self, physics: Physics, scenario: EpisodeDraw) -> None:
        """Starts a given episode instead of a drawn one; call inside `physics.reset_context()`."""
        self._start(scenario, self._draw_normals())
        physics.begin(scenario.launch.start.pose[0], scenario.params, scenario.current)
        physics.place_target(self._target())

    def before_step(self, action, physics: Physics) -> None:
        """Turns the action into the bus commands of one control step."""
        self.action = np.clip(checked_array("suite: action", action, (self.rules.n_act,)), -1.0, 1.0)[None]
        commands = task.chunk(np, self.rules.robot, self.command, self.action)
        self.command = commands[:, -1]
        physics.send(commands[0])

    def after_step(self, physics: Physics) -> None:
        """Moves the target, updates the camera, draws the sensors' noise, and sets colours if requested."""
        trace = physics.trace()
        if trace.pose.shape[1]:
            self.count += 1
            self.trace = trace
            self.window = self.window.after(trace.pose, trace.joint, trace.rate)
            self.normals = self._draw_normals()
            physics.place_target(self._target())
        super().after_step(physics)

    def get_observation(self, physics: Physics) -> OrderedDict:
        """The egocentric observation by name."""
        rules = self.rules
        senses = (self.window.pose, self.scenario.camera, self.window.joint)
        target = self._target()[None]
        noise = rules.setting.noise * self.normals
        obs = task.observe_with_sensors(np, rules.robot, rules.sensors, self.scenario.params, *senses, target, noise)[0]
        widths = task.spans(rules.n_act)
        parts = np.split(obs, np.cumsum([*widths.values()])[:-1])
        return OrderedDict((name, part.copy()) for name, part in zip(widths, parts, strict=True))

    def get_reward(self, physics: Physics) -> float:
        """Reward of the last control step."""
        pose = self.window.pose[:, -1]
        target = self._target()[None]
        trace = self.trace
        if trace is None:  # before the first step: at rest
            still = np.zeros((1, 1, self.rules.n_act))
            trace = Trace(pose[:, None], still, still, 0.0 * pose[:, None], np.zeros((1, 1)))
        distance = np.linalg.norm(pose[:, :2] - target, axis=-1)
        step = StepTruth(trace, target, distance, self.action, np.array([self.count * self.rules.dt]))
        return float(self.rules.reward(step)[0])

    def get_termination(self, physics: Physics) -> float | None:
        """0.0 outside the domain, 1.0 when time is up, else None."""
        if self.rules.outside(np, self.window.pose[:, -1])[0]:
            return 0.0
        return 1.0 if self.count >= self.rules.lengths(self.scenario)[0] else None

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """(J,) in [-1, 1], float64."""
        one = np.ones(self.rules.n_act)
        return specs.BoundedArray(one.shape, one.dtype, -one, one, name="action")

    def _start(self, scenario: EpisodeDraw, normals) -> None:
        self.scenario = scenario
        self.normals = normals
        self.count = 0
        self.trace = None
        self.window = SensorWindow.at_rest(self.rules.robot, self.rules.sensors, scenario.launch.start.pose)
        self.command = self.action = np.zeros((1, self.rules.n_act))

    def _draw_normals(self) -> np.ndarray:
        return self.random.standard_normal((1, self.rules.n_obs))

    def _target(self) -> np.ndarray:
        return self.rules.target(self.scenario, np.array([self.count]))[0]
