"""A Dynamixel XL330 on a pendulum, as Rhoban's `bam` records it: one JSON file a log.

Top level: mass [kg], length [m], kp (firmware units), vin [V], trajectory. Each entry: timestamp [s], position, goal_position
[rad], speed [rad/s], load (PWM in thousandths of full scale), input_volts [V], temp [deg C], torque_enable.

`load` is a signed 16-bit register read as unsigned: 65 535 is -1. It must be unwrapped before anything is interpolated; the
source's own processed logs were not, and their load is broken. Here `load1` = PWM / 1000 in [-1, 1]: the duty cycle, no torque.

Source: github.com/Rhoban/bam, bam/data.bak/raw at af22604, Apache-2.0.
"""

import json
import math
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers.registry import renamed, trial_of
from fishmj.log.table_files import read_text
from fishmj.log.trial import Trial

HEADER = ("mass", "length", "kp", "vin", "trajectory", "entries")
ENTRY = ("position", "speed", "load", "input_volts", "temp", "timestamp", "goal_position", "torque_enable")
PWM = 1000.0  # counts of full duty cycle
ENCODER = 2 * math.pi / 4096  # rad, one count
_COLUMNS = {
    **{"t": "timestamp", "c1": "goal_position", "on1": "torque_enable", "j1": "position", "w1": "speed"},
    **{"load1": "load", "temp1": "temp", "V": "input_volts"},
}


def sniff(path: Path) -> bool:
    """Returns True for a JSON file (or a folder with some) whose text names an entry's keys."""
    files = [path] if path.is_file() and path.suffix == ".json" else sorted(path.glob("*.json")) if path.is_dir() else []
    return any(_looks_right(file) for file in files)


def _looks_right(path: Path) -> bool:
    with open(path, "rb") as file:
        start = file.read(2000)
    return b'"entries"' in start and b'"goal_position"' in start


def read(path: Path) -> dict[str, Trial]:
    """Trials by name, the file's stem."""
    files = [path] if path.is_file() else [p for p in sorted(path.glob("*.json")) if p.name != "manifest.json"]
    return {file.stem: _trial(file) for file in files}


def _trial(path: Path) -> Trial:
    text = read_text(path)
    log = _parse(path, text)

    def place(row: int, column: str) -> str:
        return _place(path, text, row, column)

    values = {key: np.array([_value(e, key, i, place) for i, e in enumerate(log["entries"])]) for key in ENTRY}
    raw = values["load"]
    if np.any((raw != np.round(raw)) | (raw < -32768) | (raw > 65535)):
        row = int(np.flatnonzero((raw != np.round(raw)) | (raw < -32768) | (raw > 65535))[0])
        raise LogError(
            f"{place(row, 'load')}: load = {raw[row]:g}; expected a 16-bit register, 0 to 65535. Read it as raw counts"
        )
    values["load"] = np.where(raw > 32767, raw - 65536, raw) / PWM
    named = {ours: values[theirs] for ours, theirs in _COLUMNS.items()}
    where = renamed(place, _COLUMNS)
    tables = {
        "cmd": ({c: named[c] for c in ("t", "c1", "on1")}, where),
        "joint": ({c: named[c] for c in ("t", "j1", "w1", "load1", "temp1")}, where),
        "power": ({c: named[c] for c in ("t", "V")}, where),
    }
    meta = {
        "robot": "xl330 pendulum",
        "medium": "air",
        "excitation": f"{log['trajectory']}_kp{log['kp']:g}",
        "controller": f"firmware P gain {log['kp']:g}",
        "rig": {**{key: log[key] for key in ("mass", "length", "kp", "vin", "trajectory")}, "motor": str(log.get("motor", ""))},
        "clock": dict.fromkeys(tables, "host, one stamp a read"),
        "sigma": {"j1": ENCODER / math.sqrt(12)},  # of rounding to a count; the encoder's own noise is not stated
        "licence": "Apache-2.0",
        "source": "github.com/Rhoban/bam bam/data.bak/raw at af22604",
    }
    notes = [
        "cmd and joint share one stamp (command written and state read in one bus cycle): a lag below one cycle is not seen",
        "load1 is the PWM duty cycle, not a torque; power has no current",
    ]
    return trial_of(path.stem, meta, tables, notes)


def _parse(path: Path, text: str) -> dict:
    try:
        log = json.loads(text)
    except json.JSONDecodeError as error:
        raise LogError(f"{path}:{error.lineno}:{error.colno}: not valid JSON: {error.msg}; is the file cut off?") from error
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}:1:1: not readable JSON: {error}; record it again") from error
    missing = [key for key in HEADER if not isinstance(log, dict) or key not in log]
    if missing:
        raise LogError(f"{path}:1:1: lacks {', '.join(missing)}; expected an object with {', '.join(HEADER)}")
    for key in ("mass", "length", "kp", "vin"):
        if isinstance(log[key], bool) or not isinstance(log[key], int | float) or not 0 < log[key] < 1e6:
            raise LogError(f"{_header_place(path, text, key)}: {key} = {str(log[key])[:30]!r}; expected a positive number")
    if not isinstance(log["trajectory"], str):
        raise LogError(f"{_header_place(path, text, 'trajectory')}: trajectory must be text")
    if not isinstance(log["entries"], list) or not log["entries"]:
        raise LogError(f"{_header_place(path, text, 'entries')}: entries is empty or no list; record it again")
    return log


def _value(entry, key: str, row: int, place) -> float:
    if not isinstance(entry, dict) or key not in entry:
        raise LogError(f"{place(row, '')}: entry {row + 1} lacks {key!r}; expected {', '.join(ENTRY)}")
    value = entry[key]
    if not isinstance(value, bool | int | float) or not abs(value) < 1e300:
        raise LogError(f"{place(row, key)}: {key} = {str(value)[:30]!r}; expected a finite number. Leave the entry out")
    return float(value)


def _header_place(path: Path, text: str, key: str) -> str:
    return _at(path, text, max(text.find(f'"{key}"'), 0))


def _place(path: Path, text: str, row: int, key: str) -> str:
    """file:line:column of a key of entry `row`, found by parsing the entries again up to it."""
    decoder, at = json.JSONDecoder(), text.find("[", text.find('"entries"')) + 1
    for _ in range(max(row, 0)):
        at = decoder.raw_decode(text, _skip(text, at))[1]
    start = _skip(text, at)
    end = decoder.raw_decode(text, start)[1]
    found = text.find(f'"{key}"', start, end) if key else -1
    return _at(path, text, found if found >= 0 else start)


def _skip(text: str, at: int) -> int:
    while at < len(text) and text[at] in " \t\r\n,":
        at += 1
    return at


def _at(path: Path, text: str, offset: int) -> str:
    line = text.count("\n", 0, offset) + 1
    return f"{path}:{line}:{offset - text.rfind(chr(10), 0, offset)}"
