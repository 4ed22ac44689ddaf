"""Writes calibrated numbers into a fish TOML, with their origin beside them.

    servo     [servo] kp, kd, speed_no_load = torque / (kd - kv);  [[effect]] coulomb_friction;  [timing] command_latency
    latency   [timing] command_latency, camera_latency
    water     [water] every coefficient, model = "structured"
    mass      [[link]] mass, com;  [body] mass_total;  [[effect]] yaw_inertia if its interval excludes zero
    slip      [calibration.slip] only: the strip water has no slip ratio, the flow solver takes it as --slip

Lines are replaced one by one. A comment beside a new number names the calibration and its logs. Everything else stays.
"""

import re
from pathlib import Path
from uuid import uuid4

from fishmj.base.calib import resolve
from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.store import sha256, write_text
from fishmj.effects import effect_calibration
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.gap.calibrate.parameter_fit import ParameterEstimate
from fishmj.log.limits import bare
from fishmj.mjcf.reading import load_robot


def start(out: Path, model: str) -> str:
    """The text to change: `out` if it exists, else the model's."""
    return (out if out.is_file() else resolve(model)).read_text(encoding="utf-8")


def write(
    out: Path,
    text: str,
    verb: str,
    estimates: dict[str, ParameterEstimate],
    effects: dict[str, ParameterEstimate],
    data: "str | Path",
) -> Path:
    """Records the estimates, inserts the effects, reads the fish back, and only then writes the file.

    Args:
        effects: {"coulomb_friction.torque": estimate}; an existing one is replaced. data: folder of the logs.

    Raises ConfigError: the file would not be a valid fish.
    """
    manifest = Path(data) / "manifest.json"
    source, evidence = Path(data).as_posix(), sha256(manifest) if manifest.is_file() else ""
    trial = out.with_name(f".{out.stem}.{uuid4().hex[:8]}.toml")  # beside it: the files that a fish names lie beside the fish
    try:
        write_text(trial, recorded(text, verb, estimates, source, evidence))
        kept = {f.name: f for f in effect_calibration.read(trial)}
        for key, e in effects.items():
            name, parameter = key.split(".")
            fitted = {parameter: Interval(e.value, e.low, e.high)}
            kept[name] = FittedEffect(name, fitted, f"fishmj calibrate {verb}: {source}", evidence)
        effect_calibration.write(trial, tuple(kept.values()))
        load_robot(trial)
        write_text(out, trial.read_text(encoding="utf-8"))
    except FishmjError as error:
        raise ConfigError(str(error).replace(str(trial), str(out)).replace(trial.name, out.name)) from error
    finally:
        trial.unlink(missing_ok=True)
    return out


def put(text: str, table: str, values: dict, name: str = "", *, source: str = "", new: bool = False) -> str:
    """Replaces numbers of one table, `[servo]` or the `[[link]]` block called `name`, and their stated origin.

    Args:
        source: of the new numbers, for the comments beside them. new: add missing lines.

    Raises ConfigError: no such table or key.
    """
    lines, inside, left = text.splitlines(), False, dict(values)
    block, last, heads = -1, -1, []
    for i, line in enumerate(lines):
        head = line.split("#")[0].strip()
        if head.startswith("["):
            inside, block = head in (f"[{table}]", f"[[{table}]]"), i
        elif inside and name and re.fullmatch(r'name\s*=\s*"(.*)"', head):
            inside = head.split('"')[1] == name
        last = i if inside and head else last
        match = re.match(r"(\w+)\s*=\s*(\[[^]]*\]|[^#\s]+)(.*)", line)
        if inside and block != i and match and match[1] in left:
            lines[i] = f"{match[1]} = {_number(match[2], left.pop(match[1]))}{_comment(match[3], source)}"
            heads.append(block)
    if source and heads:
        _relabel(lines, heads[0], list(values), source, whole=new)
    if new and left:
        more = [f"{key} = {_number('', value)}" for key, value in left.items()]
        lines, last = (lines, last) if last >= 0 else ([*lines, "", f"[{table}]"], len(lines) + 1)
        return "\n".join([*lines[: last + 1], *more, *lines[last + 1 :]]) + "\n"
    if left:
        raise ConfigError(f"[{table}] {name}: no line for {', '.join(left)}; the fish file must have one to be replaced")
    return "\n".join(lines) + "\n"


GUESSED = re.compile(r"guess|prior|literature|not fitted|fitted to no", re.IGNORECASE)  # words that mark an unmeasured number


def _comment(comment: str, source: str) -> str:
    """The comment of a replaced number: its unit or meaning stays, its origin is the calibration."""
    if not source:
        return comment
    meaning = re.split(r"[,;(]", comment.partition("#")[2])[0].strip()
    kept = (
        ""
        if not meaning or GUESSED.search(meaning) or meaning.split()[0] in ("paper", "derived", "calibrated")
        else f"{meaning}, "
    )
    return f"  # {kept}calibrated from {bare(source, 120)}"


def _relabel(lines: list[str], head: int, names: list[str], source: str, *, whole: bool) -> None:
    """Removes the words that mark fitted numbers of a block as guesses: in its header and in comments before its first key.

    whole: all numbers of the block were fitted.
    """
    message = f"calibrated from {bare(source, 120)}"
    for i in range(head, len(lines)):
        text, mark, comment = lines[i].partition("#")
        if i > head and (text.strip() or not mark):
            break
        if mark and GUESSED.search(comment):
            rest = "" if whole else f"; the rest {comment.rsplit('; the rest ', 1)[-1].strip()}"
            lines[i] = f"{text}# {'' if whole else ', '.join(names) + ' '}{message}{rest}"


def _number(old: str, value: "float | list | str") -> str:
    """Text of the new number: in a list, its first entry is replaced; a new list or text replaces the whole value."""
    if isinstance(value, list):
        return f"[{', '.join(f'{entry:.6g}' for entry in value)}]"
    if isinstance(value, str):
        return f'"{value}"'
    return re.sub(r"\[\s*[^,\]]+", f"[{value:.9g}", old, count=1) if old.startswith("[") else f"{value:.9g}"


def short(value: float) -> float:
    """The value rounded to six digits, since more were not measured."""
    return float(f"{value:.6g}")


def recorded(text: str, verb: str, estimates: dict[str, ParameterEstimate], source: str, evidence: str) -> str:
    """The text with a block [calibration.<verb>], in place of an older one."""
    kept = effect_calibration.without_tables(text, f"[calibration.{verb}]")
    rows = [f"[calibration.{verb}]", f'source = "{source}"', f'manifest_sha256 = "{evidence}"']
    for name, e in estimates.items():
        rows.append(f'{name} = {{ value = {e.value:.6g}, low = {e.low:.6g}, high = {e.high:.6g}, unit = "{e.unit}" }}')
    return "\n".join([kept, "", *rows, ""])
