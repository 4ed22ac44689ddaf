"""Header of a policy file: its keys, their checks, and the comparison with a robot. Needs neither JAX nor MuJoCo.

    structure         {links, lengths, joints, servo_range, reference_point}, and its `structure_sha256`. Refused if count, order
                      or range differ, or a length or the reference point by more than 10 %
    observation       [{name, unit}, ..] in order, with the divisors `scale`. Refused if it differs
    control_dt        s between two decisions. Refused if it differs
    command_path      path of commands between two decisions. Refused if it differs, unless the user sets `--anyway`
    constants_sha256  hash of the rest of the description without its water. Warning if it differs, as for the next three
    constants         {name: number or text}, the single ones of these: the warning names those that differ
    water, robot      {name, kind, sha256} of the water, name of the robot
    seed, command     of the training; the command line, null if called from Python

Keys that an older file lacks are not compared, with a note; its servo range and joint count come from `action` and `joints`.
"""

import math
import re
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.names import is_name
from fishmj.base.store import json_sha256
from fishmj.water.water_identity import members_of

CLOSE = 0.10  # relative tolerance of lengths, which calibrations change
SAME = 1e-3  # relative tolerance of ranges and times, for rounding
NAMED = 8  # largest number of differing constants in one line
MOST = 1000  # plausible number of links or observations
LONGEST = 4000  # characters of a training command
KEYS = ("links", "lengths", "joints", "servo_range", "reference_point")  # of a structure; older files lack the last
HASHED = {  # part with another hash -> what may differ
    "structure": "lengths or reference point off by at most 10 %",
    "constants": "other masses, sections, servo, timing or effects",
}
NOT_STORED = "which is not stored"  # in a header without `constants`
UNNAMED = "other sections, centres of mass, fins or sizes of effects"  # what `constants` has not


class PolicyFit(NamedTuple):
    """Differences between a policy's header and a robot.

    Attributes:
        refused: reasons to refuse the policy. differs: tolerated differences, name -> (in training, here) as short texts.
        lacks: keys that its header does not have. constants: those that differ, `servo kp 8, here 9.5`; "" if none do.
    """

    refused: tuple[str, ...]
    differs: dict[str, tuple[str, str]]
    lacks: tuple[str, ...]
    constants: str = ""

    @property
    def said(self) -> str:
        """Differences as one clause; "" if there are none."""
        words = HASHED | ({"constants": self.constants} if self.constants else {})
        return "; ".join(words.get(key, f"{key} {there}, here {here}") for key, (there, here) in self.differs.items())

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: one line for differences, one for missing keys, if there are any."""
        differs = (f"not as trained: {self.said}",) if self.differs else ()
        lacks = (f"its header lacks {', '.join(self.lacks)}, not compared",) if self.lacks else ()
        return differs + lacks


def check_header(meta: Any, where: str) -> None:
    """Checks that every key of a header can be used. Raises ConfigError, one line."""
    if not isinstance(meta, dict):
        raise ConfigError(f"{where}: the header is {shown(meta)}; expected a table of keys: this is not a policy file")
    for key in ("robot", "name", "command_path", "algorithm"):
        if meta.get(key) is not None and not is_label(meta[key], key):
            raise ConfigError(f"{where}: {key} {shown(meta[key])}; expected 1 to 64 letters, digits, '_', '.' or '-'")
    control_dt, joints = meta.get("control_dt"), meta.get("joints")
    if control_dt is not None and not (is_number(control_dt) and 0 < control_dt <= 100):
        raise ConfigError(f"{where}: control_dt {shown(control_dt)}; expected seconds, above 0 to 100")
    if joints is not None and not (isinstance(joints, int) and not isinstance(joints, bool) and 1 <= joints <= MOST):
        raise ConfigError(f"{where}: joints {shown(joints)}; expected their number, 1 to {MOST}")
    for key in ("structure_sha256", "constants_sha256"):
        if meta.get(key) is not None and not _is_digest(meta[key]):
            raise ConfigError(f"{where}: {key} {shown(meta[key])}; expected 64 hex digits")
    constants = meta.get("constants", {})
    fine = lambda x: is_number(x) or (isinstance(x, str) and len(x) <= LONGEST and x.isprintable())
    if not (isinstance(constants, dict) and len(constants) <= MOST and all(map(fine, (*constants, *constants.values())))):
        raise ConfigError(f"{where}: constants {shown(constants)}; expected {{name: number or text}}")
    if (structure := meta.get("structure")) is not None:
        _check_structure(structure, where)
        if meta.get("structure_sha256") not in (None, structure_sha256(structure)):
            raise ConfigError(f"{where}: structure_sha256 is not the hash of structure; train or export it again")
    if meta.get("water") is not None:
        _check_water(meta["water"], where)
    command = meta.get("command")
    if command is not None and not (isinstance(command, str) and len(command) <= LONGEST and command.isprintable()):
        raise ConfigError(f"{where}: command {shown(command)}; expected one line of at most {LONGEST} printable characters")
    if meta.get("observation") is not None:
        _check_observation(meta["observation"], len(meta["scale"]), where)


def is_label(value: Any, key: str) -> bool:
    """Returns True for a name; an algorithm of the user's own is module:Name."""
    if not isinstance(value, str):
        return False
    return is_name(value) or (key == "algorithm" and re.fullmatch(r"[A-Za-z0-9_./:-]{1,200}", value) is not None)


def is_number(value: Any) -> bool:
    """Returns True for a finite number that is not a bool."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300 and math.isfinite(value)


def shown(value: Any) -> str:
    """Text of a value from an untrusted file, shortened for one line of an error."""
    try:
        text = repr(value) if not isinstance(value, list) or len(value) <= 20 else f"a list of {len(value)}"
    except (ValueError, RecursionError):  # an integer of thousands of digits; a table nested too deeply
        text = f"a {type(value).__name__}"
    return text if len(text) <= 80 else text[:76] + "..."


class PolicyBody(NamedTuple):
    """Properties that a policy requires of a robot (mjcf.identity)."""

    name: str
    structure: dict
    constants_sha256: str
    constants: dict[str, float | str]
    water: dict  # {name, kind} and, where there is one, sha256
    observation: list[dict]
    command_path: str
    control_dt: float  # s


def effects_drawn(meta: dict) -> tuple[str, ...]:
    """Names of the effects that a training drew for each episode (`--randomise-effects`), from its header."""
    names = task.get("effects") if isinstance(task := meta.get("task"), dict) else None
    return tuple(name for name in names if is_name(name)) if isinstance(names, list | tuple) else ()


def structure_sha256(structure: dict) -> str:
    """Hex digest of a structure in the format of a header."""
    return json_sha256(structure)


def one_line(command: str) -> str:
    """Command line for a header: printable, and not too long."""
    return "".join(c if c.isprintable() else "?" for c in command)[:LONGEST]


def fit(meta: dict, robot: PolicyBody, *, anyway: bool, known: dict) -> PolicyFit:
    """Compares a checked header with a robot.

    Args:
        anyway: accept another command path than in training.
        known: structures by robot name, for older headers without a structure.
    """
    refused: list[str] = []
    differs: dict[str, tuple[str, str]] = {}
    said, name, theirs = meta.get("structure_sha256"), meta.get("robot"), structure_in(meta)
    if name in known and not said:
        theirs = known[name] | theirs
    ours = structure_sha256(robot.structure)
    refused += _differences(theirs, robot.structure)
    if said and "links" not in theirs and said != ours:
        refused.append(f"made for structure {said[:12]}, the robot's is {ours[:12]}")
    if isinstance(seen := meta.get("observation"), list) and seen != robot.observation:
        a, b = (", ".join(f"{row['name']} [{row['unit']}]" for row in rows)[:200] for rows in (seen, robot.observation))
        refused.append(f"sees {a}; the robot gives {b}")
    wanted, path = meta.get("command_path"), robot.command_path
    if wanted not in (None, path) and not anyway:
        todo = timing_advice("command_path", f'"{wanted}"') + (", or add --anyway" if console.offers("--anyway") else "")
        refused.append(f"trained on command path {wanted}, the robot's is {path}: {todo}")
    if (step := meta.get("control_dt")) is not None and abs(step / robot.control_dt - 1) > SAME:
        todo = timing_advice("control_dt", f"{step:g}")
        todo += ", apart from policies that decide at other times" if console.offers("--control-dt") else ""
        refused.append(f"decides every {step:g} s, the robot every {robot.control_dt:g} s: {todo}")
    for key, there, here in (("robot", name, robot.name), ("command path", wanted, path)):
        if there not in (None, here):
            differs[key] = there, here
    if "reference_point" in theirs:
        rounded = structure_sha256(theirs | {"servo_range": robot.structure["servo_range"]})  # another range is refused
        if rounded != ours:
            differs["structure"] = rounded[:12], ours[:12]
    if (constants := meta.get("constants_sha256")) not in (None, robot.constants_sha256):
        differs["constants"] = constants[:12], robot.constants_sha256[:12]
    if meta.get("water") and (words := _waters(meta["water"], robot.water)):
        differs["water"] = words
    has = {
        "robot": name, "links": "links" in theirs or said, "reference point": "reference_point" in theirs or said,
        "constants": constants, "water": meta.get("water"), "command path": wanted,
        "observations": isinstance(meta.get("observation"), list), "seed": meta.get("seed") is not None,
        "training command": "command" in meta,
    }  # fmt: skip
    changed = _constants(meta.get("constants"), robot.constants) if "constants" in differs else ""
    return PolicyFit(tuple(refused), differs, tuple(key for key, there in has.items() if not there), changed)


def robot_option() -> str:
    """Option of the running command for the robot's description; "" if it has none."""
    return next(filter(console.offers, ("--robot", "--fish")), "")


def timing_advice(key: str, value: str) -> str:
    """Advice on how to give the robot the timing of a policy, with options of the running command."""
    option, named = f"--{key.replace('_', '-')}", robot_option()
    todo = f"put {key} = {value} into [timing] of its description, FILE.toml"
    todo += f", and use that file ({named} FILE.toml)" if named else ""
    return f"{todo}, or add {option} {value.strip(chr(34))}" if console.offers(option) else todo


def _constants(theirs: dict | None, ours: dict) -> str:
    """Constants that differ, in one clause."""
    if not theirs:
        return f"{HASHED['constants']}, {NOT_STORED}"
    text = lambda value: f"{value:g}" if is_number(value) else shown(value).strip("'") if value is not None else "none"
    found = [
        f"{key} {text(theirs.get(key))}, here {text(ours.get(key))}"
        for key in {**theirs, **ours}
        if theirs.get(key) != ours.get(key)
    ]
    more = [f"and {len(found) - NAMED} more"] if len(found) > NAMED else []
    return "; ".join([*found[:NAMED], *more]) or UNNAMED


def _waters(theirs: dict, ours: dict) -> tuple[str, str] | None:
    """Short names of two waters if they differ, else None; compares hashes if both have one, else names.

    A member of the family in which a policy was trained does not count as different.
    """
    a, b = theirs.get("sha256"), ours.get("sha256")
    named = theirs["name"] == ours["name"]
    if theirs["kind"] == ours["kind"] and (a == b if a and b else named):
        return None
    if ours["kind"] == "fitted" and ours in members_of(theirs):
        return None
    there, here = (f"{w['name']} ({w['kind']} {w.get('sha256', '')[:8]})" if named else w["name"] for w in (theirs, ours))
    return there, here


def structure_in(meta: dict) -> dict:
    """Structure in a checked header; for an older file the joint count as names, and the servo range."""
    if meta.get("structure") is not None:
        return dict(meta["structure"])
    found: dict[str, Any] = {}
    if meta.get("joints") is not None:
        found["joints"] = [f"j{i}" for i in range(1, meta["joints"] + 1)]
    said = re.fullmatch(r"joint angle over (\d{1,3}\.\d{1,9}) rad", str(meta.get("action", ""))[:80])
    if said:
        found["servo_range"] = float(said[1])
    return found


def _differences(theirs: dict, ours: dict) -> list[str]:
    """Differences between two structures, each as one clause with both."""
    found = []
    for key in ("joints", "links"):
        if key in theirs and list(theirs[key]) != list(ours[key]):
            a, b = (f"{len(x[key])} {key} ({', '.join(x[key][:8])}{', ..' if len(x[key]) > 8 else ''})" for x in (theirs, ours))
            found.append(f"made for {a}, the robot has {b}")
            break
    if not found and "lengths" in theirs:
        for link, a, b in zip(ours["links"], theirs["lengths"], ours["lengths"], strict=True):
            if abs(b / a - 1) > CLOSE + SAME:
                found.append(f"made for a {link} of {a:.3g} m, the robot's is {b:.3g} m")
    if not found and "reference_point" in theirs and abs(ours["reference_point"] / theirs["reference_point"] - 1) > CLOSE + SAME:
        a, b = theirs["reference_point"], ours["reference_point"]
        found.append(f"made for a reference point {a:.3g} m behind the nose, the robot's is {b:.3g} m")
    if "servo_range" in theirs and abs(theirs["servo_range"] / ours["servo_range"] - 1) > SAME:
        made_for, has = (np.degrees(of["servo_range"]) for of in (theirs, ours))
        found.append(f"made for servos of +-{made_for:.3g} deg, the robot's have +-{has:.3g} deg")
    return found


def _check_structure(table: Any, where: str) -> None:
    if not isinstance(table, dict) or not set(KEYS[:-1]) <= set(table) <= set(KEYS):
        raise ConfigError(f"{where}: structure {shown(table)}; expected {', '.join(KEYS)}")
    names = all(_list_of(table[key], is_name) for key in ("links", "joints"))
    positive = _list_of(table["lengths"], lambda x: is_number(x) and 0 < x < 1000)
    point = table.get("reference_point", 1.0)
    within = lambda x, most: is_number(x) and 0 < x < most
    if not (names and positive and within(table["servo_range"], 100) and within(point, 1000)):
        what = "names, positive lengths in m, a servo range in rad and a reference point in m"
        raise ConfigError(f"{where}: structure {shown(table)}; expected {what}")
    n = len(table["links"])
    if not (len(table["lengths"]) == n and len(table["joints"]) == n - 1):
        sizes = f"{n} links, {len(table['lengths'])} lengths and {len(table['joints'])} joints"
        raise ConfigError(f"{where}: structure has {sizes}; a chain of n links has n lengths and n - 1 joints")


def _check_water(table: Any, where: str) -> None:
    whole = isinstance(table, dict) and {"name", "kind"} <= set(table) <= {"name", "kind", "sha256"}
    if not (whole and is_name(table["name"]) and is_name(table["kind"]) and _is_digest(table.get("sha256", "0" * 64))):
        raise ConfigError(f"{where}: water {shown(table)}; expected {{name, kind}}, names both, and sha256 where there is one")


def _is_digest(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value) is not None


def _check_observation(rows: Any, count: int, where: str) -> None:
    if isinstance(rows, str) and len(rows) <= 1000:
        return  # an older file: a sentence, for people
    row = lambda x: isinstance(x, dict) and set(x) == {"name", "unit"} and is_name(x["name"]) and _is_unit(x["unit"])
    if not _list_of(rows, row) or len(rows) != count:
        raise ConfigError(
            f"{where}: observation {shown(rows)}; expected {count} rows {{name, unit}}, one for each divisor of scale"
        )


def _is_unit(text: Any) -> bool:
    return isinstance(text, str) and re.fullmatch(r"[A-Za-z0-9/^ ]{1,16}", text) is not None


def _list_of(value: Any, test) -> bool:
    return isinstance(value, list) and 1 <= len(value) <= MOST and all(test(item) for item in value)
