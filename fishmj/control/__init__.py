"""Controllers for station holding behind one interface: egocentric, all trials at once.

    controller = make("dob", robot)             a name of NAMES, a shipped policy, a policy file, or the folder of a training
    controller.reset(n)
    commands = controller(obs)                  obs (B, 11) every 0.2 s -> bus commands (B, 10, 3) rad

A controller sees only the 11 observations, with noise and latency: no flow, no pose. `privileged` also gets the true flow, and
works only where `set_flow` is called (tasks.episode). Gains are in data/calib/controllers.toml. The classical controllers
measure the gaits of their fish in its surrogate (gait_table.py).

A new one is a file with `build(robot, name, gains)`, and a line in `CONTROLLERS`.

`chosen` also loads your own code, as `module:Name` (docs/simulate/your_own_code.md). Use it only for text that a user typed,
never for a name from a file.
"""

import argparse
import shlex
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from fishmj.base import plugins
from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import Number
from fishmj.control.policy import SHIPPED, is_policy
from fishmj.control.policy import shipped as shipped_policies
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water


class Controller(Protocol):
    """Interface of the object that `make` returns."""

    name: str

    def reset(self, n: int) -> None:
        """Starts n trials."""

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Returns the control step's bus commands (B, T, J), rad, for obs (B, 5 + 2 J)."""


class Entry(NamedTuple):
    """One controller: `fishmj.control.<module>.build(robot, name, gains)` makes it.

    Attributes:
        about: one line. tuned: its gains are the section of its name in controllers.toml.
    """

    module: str
    about: str
    tuned: bool = True


CONTROLLERS = {
    "drift": Entry("passive", "joints at zero", tuned=False),
    "pd": Entry("line_of_sight", "CPG + PD on the line of sight"),
    "pi": Entry("line_of_sight", "CPG + PI on the position vector"),
    "dob": Entry("observer", "CPG + flow observer: the baseline to beat"),
    "pnl": Entry("adrc", "proportional navigation alone"),
    "adrc-c1": Entry("adrc", "proportional navigation + ADRC"),
    "adrc-c2": Entry("adrc", "the same with other gains"),
    "adrc-c3": Entry("adrc", "the same with other gains"),
    "koopman": Entry("koopman", "Koopman-LQR of still water"),
    "koopman-flow": Entry("koopman", "Koopman-LQR that estimates the flow"),
    "koopman-rls": Entry("koopman", "the same, adapting its model"),
    "mpc": Entry("mpc", "sampling MPC with a model of still water"),
    "mpc-flow": Entry("mpc", "sampling MPC that estimates the flow"),
    "privileged": Entry("mpc", "mpc-flow with the true flow, for simulations only"),
}
NAMES = tuple(CONTROLLERS)
GAINS = "controllers.toml"  # in data/calib
MOST = {"1/s": 50, "deg": 1500, "m/s": 20, "s": 1000, "m": 100, "rad/s": 200}  # largest gain by its unit; 1e4 for other units
DIVISORS = (
    "frequency", "amplitude_deg", "turn_error_deg", "speed_floor", "observer_time", "wc", "wo", "b0", "distance_wc",
    "distance_wo", "distance_b0", "horizon", "temperature", "weight_drive", "weight_turn", "forget",
)  # fmt: skip  # gains above 0


def largest_gain(unit: str) -> float:
    """Returns the largest gain of this unit that is accepted."""
    return MOST.get(unit, 1e4)


def anyway_option(parser: argparse.ArgumentParser) -> None:
    """Adds `--anyway`."""
    about = "allow policies on another command path than in training; policies for another structure are still refused"
    parser.add_argument("--anyway", action="store_true", help=about)


def shipped_lines() -> str:
    """List of the shipped policies, one line each, for the help of a verb."""
    wide = max(map(len, SHIPPED))
    rows = [f"  {name:<{wide}}  {about}" for name, about in SHIPPED.items()]
    return "\n".join(["shipped policies (figures: docs/train/controllers.md):", *rows])


def _swimming(robot: "Robot | str") -> Robot:
    """Returns a `Robot` unchanged; loads one by name or file in its default water."""
    return robot if isinstance(robot, Robot) else in_water(load_robot(robot))


def make(
    name: "str | Path",
    robot: "Robot | str" = "fish",
    *,
    anyway: bool = False,
    **options: Any,
) -> Controller:
    """Makes a controller by name, with gains of a file as FILE.toml:NAME, or from a policy by name, file or folder.

    Args:
        name: may come from a file, because only fishmj's code runs.
        anyway: accept a policy that was trained on another command path.
        options: gains to change, for example `make("dob", observer_time=1.0)`.

    Raises:
        UnknownName: no such controller, policy or gain.
        ConfigError: gains or policy do not fit the robot.
    """
    robot, name = _swimming(robot), str(name)
    file, name = _split(name)
    entry = CONTROLLERS.get(name)
    if entry is None and not is_policy(name) and Path(name).name == name:  # of a path `file_of` says what is missing
        raise UnknownName("controller", name, (*NAMES, *shipped_policies()))
    if file is not None and not (entry and entry.tuned):
        raise ConfigError(f"{file}: {name} has no gains; expected one of {', '.join(tuned_names())}")
    if options and not (entry and entry.tuned):
        raise ConfigError(f"controller {name}: has no gains, got {', '.join(options)}")
    if entry is None:
        from fishmj.control.learned import LearnedController

        return LearnedController(robot, name, anyway)
    gains = gains_of(name, options, file) if entry.tuned else {}
    made = import_module(f"fishmj.control.{entry.module}").build(robot, name, gains)
    if file is not None:
        made.sha256 = sha256(repr(gains).encode()).hexdigest()
    return made


def tuned_names() -> tuple[str, ...]:
    """Names of the controllers with gains."""
    return tuple(name for name, entry in CONTROLLERS.items() if entry.tuned)


def _split(text: str) -> tuple[Path | None, str]:
    """File of gains and name of `FILE.toml:NAME`; no file for any other text."""
    file, _, name = text.rpartition(":")
    return (Path(file), name) if file.endswith(".toml") else (None, text)


def chosen(text: "str | Path", robot: "Robot | str" = "fish", **policy: Any) -> Controller:
    """Makes a controller that the user named: as `make`, or from the user's own `module:Name`, `file.py:Name` or entry point.

    Args:
        policy: `anyway` of `make`.
    Raises:
        OwnCodeError: the user's own code is missing, fails, or is not a controller. Other errors as `make`.
    """
    robot, text = _swimming(robot), str(text)
    own = plugins.is_reference(text) or text in plugins.listed("controller")
    known = text in NAMES or is_policy(text) or _split(text)[0] is not None
    if known or not (own or ".py" in text or ":" in text):
        if not known and (extra := plugins.listed("controller")):
            raise UnknownName("controller", text, (*NAMES, *shipped_policies(), *extra))
        return make(text, robot, **policy)
    from fishmj.control.own_controller import Own

    names = (*NAMES, *shipped_policies())
    return Own(robot, plugins.load("controller", text, names), text, names)


def several(texts, robot: "Robot | str" = "fish", **policy: Any) -> list[Controller]:
    """Makes a list of controllers by `chosen`; if two have the same name, the second gets the suffix `-2` and a note."""
    words, found = list(texts), {}
    for i in sorted(
        range(len(words)), key=lambda i: words[i] in CONTROLLERS
    ):  # those that measure gaits last, so that a mistyped name fails at once
        found[i] = chosen(words[i], robot, **policy)
    made: list[Any] = [found[i] for i in range(len(words))]
    first, names = [controller.name for controller in made], []
    for word, controller in zip(words, made, strict=True):
        same = [f"{controller.name[:60]}-{k}" for k in range(2, len(made) + 1)]
        controller.name = next(name for name in (controller.name, *same) if name not in names)
        names.append(controller.name)
        if first.count(first[len(names) - 1]) > 1:
            controller.notes = (*getattr(controller, "notes", ()), f"{controller.name} is {word}")
    return made


@cache
def shipped_gains() -> dict[str, dict]:
    """Sections of data/calib/controllers.toml: {section: {gain: {value, unit, source}}}."""
    return {name: table for name, table in read_toml(calib_folder() / GAINS).items() if isinstance(table, dict)}


def gains_of(section: str, changes: dict | None = None, file: "Path | None" = None) -> dict:
    """Gains of one section, with `changes`.

    Args:
        file: output of `fishmj tune`; its gains replace the shipped ones.
    Raises:
        UnknownName: no such gain. ConfigError: the file has no such section, or a gain has the wrong type or is out of range.
    """
    values = {key: entry["value"] for key, entry in shipped_gains()[section].items()}
    if file is not None:
        table = read_toml(file).get(section)
        if not isinstance(table, dict):
            raise ConfigError(
                f"{file}: no section [{section}]; write it with fishmj tune {section} --out {shlex.quote(str(file))}"
            )
        stated = {key: entry.get("value") if isinstance(entry, dict) else entry for key, entry in table.items()}
        changes = {**stated, **(changes or {})}
    for key, value in (changes or {}).items():
        if key not in values:
            raise UnknownName(f"gain of {section}", key, values)
        if np.shape(value) != np.shape(values[key]) or not np.issubdtype(np.asarray(value).dtype, np.number):
            raise ConfigError(f"gain {key} of {section}: got {value!r:.80}, expected a value such as {values[key]!r}")
        kind, unit = type(values[key]) is int, shipped_gains()[section][key]["unit"]
        within = Number(2 if kind else 0, largest_gain(unit), above=key in DIVISORS, whole=kind)
        if not all(within.holds(part) for part in np.ravel(value).tolist()):
            raise ConfigError(f"gain {key} of {section}: got {value!r:.80}, expected {within.expected} {unit}".removesuffix(" 1"))
    return {**values, **(changes or {})}


__all__ = [
    "CONTROLLERS", "NAMES", "Controller", "anyway_option", "chosen", "make", "several", "shipped_lines", "shipped_policies",
]  # fmt: skip
