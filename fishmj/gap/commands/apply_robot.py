"""`gap apply REPORT` for a robot in MJCF: the named effects as fields of its next version, <robot>.v<N>.xml."""

import copy
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from fishmj import effects
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.gap.commands.find_robot import digest
from fishmj.gap.models.rigid_robot import AT
from fishmj.gap.models.robot_description import RobotDescription, read_robot
from fishmj.gap.models.robot_patch import difference, patched
from fishmj.gap.wording import level, pair, title


def apply_robot(report: Path, verdict: dict, out: Path | None, force: bool) -> dict:
    """Writes the next version. verdict: of verdict.json with its context. Returns what `gap apply` tells.

    Raises:
        ConfigError: the description changed since the search, an effect that no field of MJCF holds, or the file exists.
    """
    path = Path(verdict["context"]["model"])
    if not path.is_file() or digest(path) != verdict["context"]["model_sha256"]:
        raise ConfigError(f"{path}: changed since the search, or gone; search again, or restore the model it questioned")
    answer, each = verdict["answer"], verdict["by_effect"]
    named = [e for e in verdict["effects"] if force or each.get(e["name"], answer) == "NAMED"]
    told = {"path": None, "accepted": False, "gap_before": verdict["gap_before"], "gap_after": verdict["gap_after"], "mjcf": ""}
    if not named:
        why = (
            "no effect explains the gap for certain; --force adds the tentative ones"
            if verdict["effects"]
            else "no effect to add"
        )
        return told | {"reason": f"{answer}: {why}; {path.name} stays as it is"}
    robot = read_robot(path)
    text = patched(robot, *changed(robot, named))
    version = out or next_version(path, report if report.is_dir() else report.parent)
    if version.suffix != ".xml" or version.exists():
        raise ConfigError(f"{version}: exists, or does not end in .xml; choose another name with --out")
    names = ", ".join(title(e["name"]) for e in named)
    origin = f"<!-- {answer} by fishmj gap find, MuJoCo {mujoco.__version__}: {names}; parent {path.name} -->\n"
    write_text(version, text.replace("\n", "\n" + origin, 1) if text.startswith("<?xml") else origin + text)
    reason = f"{pair(verdict['gap_before'], verdict['gap_after'])} on the records searched"
    if floors := verdict["over_floor"].get("searched"):
        reason += f"; the residual falls from {level(floors[0])} to {level(floors[1])} floors"
    return told | {"path": version, "accepted": True, "reason": reason, "mjcf": difference(robot, text)}


def changed(robot: RobotDescription, named: list[dict]) -> tuple[Any, float]:
    """(MjModel with the effects, delay of the commands in s). Raises ConfigError for an effect that MJCF cannot hold."""
    m, delay = copy.copy(robot.model), 0.0
    for effect in named:
        name, _, site = effect["name"].partition(AT)
        known = effects.robot_catalogue().get(name)
        if known is None or known.robot is None:
            raise ConfigError(f"{name!r} is no effect of a robot in MJCF; known: {', '.join(effects.robot_catalogue())}")
        if set(effect["parameters"]) != {p.name for p in known.robot.parameters} or site not in robot.sites(known.robot.site):
            raise ConfigError(f"{effect['name']!r}: not an effect of {robot.path.name} with its parameters; search again")
        p = SimpleNamespace(**{key: float(value["value"]) for key, value in effect["parameters"].items()})
        if known.robot.reading is not None:
            told = "an error of a sensor belongs into the reading of the logs, not into MJCF"
            raise ConfigError(f"{title(effect['name'])}: {told}")
        if known.robot.fields is None and "command" not in known.delays:
            told = "no attribute of MJCF holds it; change the commands on their way instead"
            raise ConfigError(f"{title(effect['name'])}: {told}")
        if known.robot.fields is not None:
            known.robot.fields(robot.site(m, known.robot.site, site), p)
        delay += sum(getattr(p, parameter) for clock, parameter in known.delays.items() if clock == "command")
    mujoco.mj_setConst(m, mujoco.MjData(m))
    return m, float(np.round(delay, 6))


def next_version(path: Path, folder: Path) -> Path:
    """<robot>.v<N>.xml in a folder: the version after that of the description."""
    stem, number = path.stem, 1
    if found := re.fullmatch(r"(.*)\.v(\d+)", stem):
        stem, number = found.group(1), int(found.group(2))
    return folder / f"{stem}.v{number + 1}.xml"
