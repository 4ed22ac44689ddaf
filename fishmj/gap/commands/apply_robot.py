"""`gap apply REPORT` for a robot in MJCF: the named effects as fields of its next version, <robot>.v<N>.xml.

Effects that no field of MJCF holds go into <robot>_v<N>_effects.py beside it, a module with a callback for MuJoCo.
"""

import copy
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from fishmj import effects
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_bytes, write_text
from fishmj.gap.commands.find_robot import searched_model
from fishmj.gap.commands.reported import verdict_file
from fishmj.gap.models import joint_laws
from fishmj.gap.models.callback_module import BeyondFields, module_text, stem_of
from fishmj.gap.models.rigid_robot import AT
from fishmj.gap.models.robot_description import RobotDescription, read_robot
from fishmj.gap.models.robot_patch import next_mjcf
from fishmj.gap.wording import level, pair, title


def apply_robot(report: Path, verdict: dict, out: Path | None, force: bool, counted_in: bool = False) -> dict:
    """Writes the next version. verdict: of verdict.json with its context; others: as for `apply`. Returns the command's result.

    Raises:
        ConfigError: the description changed since the search, an effect of a sensor, or a file exists.
    """
    path = searched_model(verdict)
    answer, each = verdict["answer"], verdict["by_effect"]
    named = [e for e in verdict["effects"] if force or each.get(e["name"], answer) == "NAMED"]
    told = {"path": None, "accepted": False, "gap_before": verdict["gap_before"], "gap_after": verdict["gap_after"], "mjcf": ""}
    if not named:
        why = (
            "no effect certainly explains the gap; --force adds the tentative ones" if verdict["effects"] else "no effect to add"
        )
        return told | {"reason": f"{answer}: {why}; {path.name} stays as it is"}
    beside = verdict.get("tentative", []) if answer == "NAMED" else []  # fitted with the named ones
    named += beside if counted_in else []
    robot = read_robot(path)
    held = [held_by_mjcf(e) for e in named]
    m, delay, beyond = changed(robot, held)
    version = out or next_version(path, verdict_file(report).parent)
    module = version.with_name(f"{stem_of(version.name)}.py")
    if version.suffix != ".xml":
        raise ConfigError(f"{version}: a version of a robot is an .xml file; choose an .xml name with --out")
    for there in (version, *([module] if beyond.names else [])):
        if there.exists():
            raise ConfigError(f"{there}: exists and is not overwritten; choose another name with --out")
    names = ", ".join(title(e["name"]) for e in held)
    origin = f"{answer} by fishmj gap find, MuJoCo {mujoco.__version__}: {names}; parent {path.name}"
    written = next_mjcf(robot, m, delay, version, origin)
    write_bytes(version, written.data)
    if beyond.names:
        write_text(module, module_text(version.name, robot, m, beyond, verdict["context"].get("rest") or {}))
    if left := [e["name"] for e in (*verdict["effects"], *beside) if e not in named]:
        told |= {"gap_before": None, "gap_after": None}
        why = "counted in with --counted-in" if beside else "not certain"
        reason = f"without {', '.join(map(title, left))}, {why}: the gap without them was not measured; gap check does"
    else:
        reason = f"{pair(verdict['gap_before'], verdict['gap_after'])} on the records searched"
    if not left and (floors := verdict["over_floor"].get("searched")):
        reason += f"; the residual falls from {level(floors[0])} to {level(floors[1])} times the floor"
    for one, other in zip(named, held, strict=True):
        if one is not other:
            reason += f"; MJCF has no {title(one['name'])}: {title(other['name'])}, equivalent on this robot, is written"
    if beyond.names:
        reason += f"; {module.name} beside it adds {', '.join(map(title, beyond.names))}, for which MuJoCo has no field"
    return told | {"path": version, "accepted": True, "reason": f"{reason}; {written.how}", "mjcf": written.diff}


def check_command(report: Path, verdict: dict, version: Path, data: Path | None) -> list[str]:
    """Words of the command that compares a version with its parent; data: default, the logs of the search."""
    context = verdict["context"]
    words = ["fishmj", "gap", "check", str(version), "--data", str(data or context.get("data") or "LOGS")]
    beside = version.resolve().parent == verdict_file(report).parent.resolve()
    words += [] if beside else ["--parent", context["model"]]
    return words + (["--columns", context["columns"]] if context.get("columns") else ["--yes"])


def held_by_mjcf(effect: dict) -> dict:
    """The effect; for an error of a sensor or a clock, the first equivalent effect of the robot itself."""
    if not of_logs(effect["name"].partition(AT)[0]):
        return effect
    for name, values in effect.get("same", {}).items():
        form = effects.robot_catalogue()[kind := name.partition(AT)[0]].robot
        if form and not of_logs(kind):
            return {"name": name, "parameters": {p.name: values.get(p.name, {"value": p.null}) for p in form.parameters}}
    return effect


def of_logs(kind: str) -> bool:
    """Returns True for an error of a sensor or a clock, which must be corrected in the logs."""
    known = effects.robot_catalogue().get(kind)
    form = known.robot if known else None
    if known is None or form is None:
        return False
    acts = form.fields or form.law or form.command or "command" in known.delays
    return form.reading is not None or not acts


def changed(robot: RobotDescription, named: list[dict]) -> tuple[Any, float, BeyondFields]:
    """(MjModel with the effects, delay of the commands in s, effects that no field holds). Raises ConfigError for a sensor's."""
    m, delay, beyond = copy.copy(robot.model), 0.0, BeyondFields({}, [])
    for effect in named:
        name, _, site = effect["name"].partition(AT)
        known = effects.robot_catalogue().get(name)
        if known is None or known.robot is None:
            raise ConfigError(f"{name!r} is not an effect of a robot in MJCF; known: {', '.join(effects.robot_catalogue())}")
        if set(effect["parameters"]) != {p.name for p in known.robot.parameters} or site not in robot.sites(known.robot.site):
            raise ConfigError(f"{effect['name']!r}: not an effect of {robot.path.name} with its parameters; search again")
        p = SimpleNamespace(**{key: float(value["value"]) for key, value in effect["parameters"].items()})
        if of_logs(name):
            kind = "a sensor" if known.robot.reading is not None else "a clock"
            raise ConfigError(f"{title(effect['name'])}: an error of {kind} cannot be written into MJCF; correct it in the logs")
        if known.robot.law is not None:
            beyond.laws.setdefault(site, {})[name] = tuple(getattr(p, x.name) for x in known.robot.parameters)
        if known.robot.command is not None:
            where = tuple(robot.thrusters) if known.robot.site == "thrusters" else (site,)
            beyond.commands.extend((name_there, known, vars(p)) for name_there in where)
        if known.robot.fields is not None:
            known.robot.fields(robot.site(m, known.robot.site, site), p)
        delay += sum(getattr(p, parameter) for clock, parameter in known.delays.items() if clock == "command")
    mujoco.mj_setConst(m, mujoco.MjData(m))
    if beyond.laws:
        joint_laws.write(m, robot.joints, beyond.laws, [0.0] * len(robot.joints))
    return m, float(np.round(delay, 6)), beyond


def next_version(path: Path, folder: Path) -> Path:
    """<robot>.v<N>.xml in a folder: the version after the description's own."""
    stem, number = path.stem, 1
    if found := re.fullmatch(r"(.*)\.v(\d+)", stem):
        stem, number = found.group(1), int(found.group(2))
    return folder / f"{stem}.v{number + 1}.xml"
