"""Controllers for station holding behind one interface: egocentric, all trials at once.

    controller = make("dob", robot)             a name of NAMES, a shipped policy, a policy file, or the folder of a training
    controller.reset(n)
    commands = controller(obs)                  obs (B, 11) every 0.2 s -> bus commands (B, 10, 3) rad

A controller sees the 11 observations only, noisy and late: no flow, no pose. What they know of the fish is
data/calib/controllers.toml; how their gains were found is docs/controllers.md.

    drift      joints at zero
    pd         CPG + PD on the line of sight
    pi         CPG + PI on the position vector
    dob        CPG + flow observer: the bar
    adrc-c1    proportional navigation + ADRC (also c2, c3)

`chosen` also takes one's own, as `module:Name` (docs/your_own_code.md): for what a user typed, never for a name from a file.
"""

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fishmj import plugins
from fishmj.controllers.gains import gains_of
from fishmj.errors import ConfigError, UnknownName
from fishmj.mjcf.description import Robot, load_robot
from fishmj.policy import is_policy
from fishmj.policy import shipped as shipped_policies

NAMES = ("drift", "pd", "pi", "dob", "adrc-c1", "adrc-c2", "adrc-c3")


class Controller(Protocol):
    """What `make` returns."""

    name: str

    def reset(self, n: int) -> None:
        """Start n trials."""

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """obs (B, 5 + 2 J) -> the control step's bus commands (B, T, J), rad."""


def make(name: "str | Path", robot: "Robot | str" = "fish", *, any_command_path: bool = False, **options: Any) -> Controller:
    """A controller by name, or a policy by name, file or folder. It runs no code but fishmj's, so the name may come from a file.

    Args:
        any_command_path: a policy may steer on another command path than it was trained on, because that was asked for.
        options: gains of controllers.toml to change, for example `make("dob", observer_time=1.0)`.

    Raises:
        UnknownName: no such controller, policy or gain. ConfigError: the robot has not the joints that the gains are for, or
            is not the one that the policy is for.
    """
    robot, name = load_robot(robot), str(name)
    learned = name not in NAMES and is_policy(name)
    if not learned and name not in NAMES:
        raise UnknownName("controller", name, (*NAMES, *shipped_policies()))
    if not learned and name != "drift":
        return _classical(robot, name, options)
    if options:
        raise ConfigError(f"controller {name}: has no gains, got {', '.join(options)}")
    if learned:
        from fishmj.controllers.learned import LearnedController

        return LearnedController(robot, name, any_command_path)
    from fishmj.controllers.passive import Passive

    return Passive(robot)


def chosen(text: "str | Path", robot: "Robot | str" = "fish", *, any_command_path: bool = False) -> Controller:
    """A controller that the user named: as `make`, or one's own by `module:Name`, `file.py:Name` or entry point. Runs that code.

    Raises:
        OwnCodeError: it is not there, fails, or is no controller. As `make` besides.
    """
    robot, text = load_robot(robot), str(text)
    own = plugins.is_reference(text) or text in plugins.listed("controller")
    known = text in NAMES or is_policy(text)
    if known or not (own or ".py" in text or ":" in text):
        if not known and (extra := plugins.listed("controller")):
            raise UnknownName("controller", text, (*NAMES, *shipped_policies(), *extra))
        return make(text, robot, any_command_path=any_command_path)
    from fishmj.controllers.own_controller import Own

    return Own(robot, plugins.load("controller", text, (*NAMES, *shipped_policies())), text)


def several(texts, robot: "Robot | str" = "fish", *, any_command_path: bool = False) -> list[Controller]:
    """`chosen` for a list; of two with one name (two files best.safetensors) the second gets `-2`: their files stay apart."""
    made = [chosen(text, robot, any_command_path=any_command_path) for text in texts]
    names: list[str] = []
    for brain in made:
        same = [f"{brain.name[:60]}-{k}" for k in range(2, len(made) + 1)]
        brain.name = next(name for name in (brain.name, *same) if name not in names)
        names.append(brain.name)
    return made


def _classical(robot: Robot, name: str, options: dict) -> Controller:
    from fishmj.controllers.adrc import Adrc
    from fishmj.controllers.cpg import Cpg, Rates
    from fishmj.controllers.estimator import StateEstimator
    from fishmj.controllers.gait_table import SpeedToGait
    from fishmj.controllers.heading_speed import HeadingSpeedController
    from fishmj.controllers.line_of_sight import LineOfSight
    from fishmj.controllers.observer import FlowObserver

    gait, k = gains_of("gait"), gains_of(name, options)
    lag = np.radians(gait["lag_deg"])
    if len(lag) != robot.n_joints:
        raise ConfigError(
            f"controller {name}: its gait is for {len(lag)} joints, {robot.name} has {robot.n_joints}; use drift or a policy"
        )
    quick, bend = np.radians(gait["amplitude_rate"]), np.radians(gait["bias_rate"])
    rates = Rates(frequency=gait["frequency_rate"], amplitude=quick, bias=bend)
    cpg, navigator = Cpg(robot, lag, rates), StateEstimator(robot, gait["wobble"], gait["sway"])
    if name.startswith("adrc"):
        low, high = ((f, np.radians(a)) for f, a in zip(k["frequency"], k["amplitude_deg"], strict=True))
        return Adrc(name, cpg, SpeedToGait(gait, low, high), navigator, k)
    helm = HeadingSpeedController(robot, gait, cpg, k)
    if name == "dob":
        return FlowObserver(helm, navigator, k, gait["glide"])
    return LineOfSight(name, helm, navigator, k)


__all__ = ["NAMES", "Controller", "chosen", "make", "several", "shipped_policies"]
