"""What is asked of a model and of logs before anything is computed: that a search can take the model, and that the logs are its.

The search traces the model's links into one compiled step and repeats every record with `virtual_robot`; both are built for the
planar fish of four links. What goes by another name may still be the same robot: that is the user's to say.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

from fishmj import console
from fishmj.errors import ConfigError, LogError
from fishmj.excitation import PERIOD
from fishmj.gap.null.null_runs import RecordedNull, SimulatedNull, trials_of
from fishmj.log import Trial
from fishmj.mjcf.description import Robot, load_robot

LINKS = 4
SHIPPED = "fish"  # what the null sets swam as, which say a name only
MEANWHILE = "what works meanwhile: fishmj calibrate, train and replay take any number of links"


def searchable(robot: Robot, model: object) -> None:
    """Raise ConfigError when the search cannot take this robot. model: what the user called it."""
    if len(robot.links) != LINKS:
        has = f"{model} has {len(robot.links)} links"
        raise ConfigError(f"the search so far takes fish of four links and three joints; {has} ({MEANWHILE})")
    ticks = PERIOD / robot.timing.physics_dt
    if abs(ticks - round(ticks)) > 1e-6:
        step = f"{model} has physics_dt = {robot.timing.physics_dt:g} s"
        raise ConfigError(f"the search repeats commands every {PERIOD:g} s, a whole number of physics steps; {step}; take 0.004")


def of_this_robot(trials: Iterable[Trial], robot: Robot, model: object, agreed: bool = False) -> list[str]:
    """Notes on whose the trials are.

    Args:
        model: what the user called the robot. agreed: logs of another name are meant (`--same-robot`).
    Raises:
        LogError: another number of joints, or another robot's name that nobody agreed to.
    """
    said: Counter[str] = Counter()
    for trial in trials:
        joints = joints_of(trial)
        name = str(trial.value("robot", "") or "")[:64]
        said[name] += 1
        if joints and joints != robot.n_joints:
            whose = f"trial {trial.name} ({name or 'no robot named'}) has {joints} joints"
            raise LogError(
                f"{whose}, the model {model} ({robot.name}) {robot.n_joints}; name the model of that robot with --model"
            )
    others = sorted(name for name in said if name and name != robot.name)
    if others:
        differ = f"the logs are of {', '.join(map(repr, others))}, the model {model} is {robot.name!r}"
        if not agreed and not console.confirmed(f"{differ}. Is it the same robot?"):
            raise LogError(f"{differ}; name its own model with --model, or pass --same-robot if it is the same robot")
        return [f"{differ}: taken for the same robot"]
    return [f"{said['']} of {said.total()} trials name no robot; taken for {robot.name!r}"] if said[""] else []


def joints_of(trial: Trial) -> int:
    """Joints that were commanded, or else measured; 0 where neither table is there."""
    for table, letter in (("cmd", "c"), ("joint", "j")):
        columns = trial.tables.get(table, {})
        if columns:
            return sum(1 for name in columns if name[0] == letter and name[1:].isdigit())
    return 0


def null_fits(null: SimulatedNull, robot: Robot, model: object) -> None:
    """Raise ConfigError when null sets were swum by another robot than the questioned model's."""
    if not isinstance(null, RecordedNull):
        return
    trial = trials_of(null.bundles[0])[0]
    name, joints = str(trial.value("robot", "") or "")[:64], joints_of(trial)
    if joints != robot.n_joints or (name and name != robot.name):
        swum = f"{null.folder}: null sets of {name or 'no robot named'!r} with {joints} joints"
        raise ConfigError(
            f"{swum}; the model {model} is {robot.name!r} with {robot.n_joints}. Leave --null out: runs are made anew"
        )
    differs = differences(load_robot(SHIPPED), robot)
    if differs:
        swum = f"{null.folder}: its null sets swam as the shipped fish, and {model} differs from it in {', '.join(differs)}"
        raise ConfigError(f"{swum}; leave --null out: runs of this model are made anew")


def differences(one: Robot, other: Robot) -> list[str]:
    """Fields in which two descriptions differ, water, effects and names apart."""
    bare = [replace(r, effects=(), water={}, name="", title="") for r in (one, other)]
    out = []
    for key in ("links", "fins", "density_water"):
        out += [key] if getattr(bare[0], key) != getattr(bare[1], key) else []
    for table in ("servo", "timing"):
        a, b = (vars(getattr(r, table)) for r in bare)
        out += [
            f"{table}.{key} ({a[key]:g}, {b[key]:g})" if isinstance(a[key], float) else f"{table}.{key}"
            for key in a
            if a[key] != b[key]
        ]
    return out
