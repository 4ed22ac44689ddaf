"""Logs of a robot in MJCF: tables and recordings with any names -> trials, by the model's joints and actuators.

    a folder of CSV, Parquet, .npz, .pt, MCAP, rosbag2    one a log; commands and positions may be topics with stamps of their own
    a LeRobot data set                                data/**/*.parquet, a log an episode; elements named by meta/info.json

A column of one of several topics is `/joint_states:joint.elbow`. Rates are estimated from positions; logged ones are not read.

MAP.toml says which column is which; without one the columns are guessed from their names, and the guess is shown:

    time = { column = "t_ms", unit = "ms" }
    [joint]                                                     # measured positions, by the model's joint
    shoulder = "pos_meas1"
    elbow = { column = "pos_meas2", unit = "deg", sign = -1, zero = 90 }
    [actuator]                                                  # commands, by the model's actuator
    shoulder = "tau_con1"
    elbow = { column = "current2", scale = 0.52 }               # N m / A
    [base]                                                      # of a free base: place, and each part of its quaternion
    x = { column = "mocap_x", unit = "mm" }
    y = ..  z = ..  qw = ..  qx = ..  qy = ..  qz = ..

value = sign (cell - zero) scale unit.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from fishmj.base.errors import FishmjError, LogError
from fishmj.gap.records.attitude import PLACE, QUATERNION, unit_quaternions
from fishmj.log import Trial, numbered
from fishmj.log.clock_alignment import in_common
from fishmj.log.importers import header, table_forms
from fishmj.log.importers.column_map import Column, Stamp, map_table
from fishmj.log.importers.column_units import SI, UNITS, measures, time_unit, unit_of
from fishmj.log.importers.gather import is_recording, read_sheets
from fishmj.log.importers.sheet import EPOCH, Sheet
from fishmj.log.limits import bare
from fishmj.log.trial import readings_sha256
from fishmj.log.trial_check import bounds_of
from fishmj.log.unread_rows import fresh_rows, is_coarse

INFO = Path("meta") / "info.json"  # of a LeRobot data set
SUFFIXES = (".csv", ".tsv", ".txt", ".parquet", ".npz", ".pt")
TIME = {"t", "time", "timestamp", "stamp", "seconds", "sec"}
POSITION = {"pos", "position", "q", "angle", "ang", "theta", "qpos", "deg", "rad", "state", "states", "observation"}
POSITION |= {"winkel", "phi", "posicion", "posizione"}
JOINT = {"joint", "joints", "gelenk", "articulation"}
ASKED = {"ctrl", "control", "con"} | header.COMMAND
TORQUE = {"tau", "torque", "effort", "nm", "drehmoment", "moment"}
OTHERS = {"dq", "qd", "qvel", "qacc", "fric", "voltage", "error"} | header.RATE | header.ACCELERATION
OTHERS |= header.TEMPERATURE | header.CURRENT
SMOOTHED = {"filt", "filtered", "smooth", "smoothed"}
MEASURED = {"meas", "measured", "actual", "act", "present", "state", "states", "ist", "gemessen", "mesure", "medido"}
CURRENT = {"currents", "load", "pwm", "i", "iq"} | header.CURRENT
GENERIC = {"joint", "actuator", "act", "drive", "link", "hinge", "axis"} | header.SERVO  # in a site's name, but not in a column's
MILLI = {"mN": 1e-3, "mN m": 1e-3}  # N, N m
POSE = (*PLACE, *QUATERNION)
PLACED = {"pos", "position", "base", "pose", "p", "translation", "mocap", "location"}
TURNED = {"q", "quat", "quaternion", "orientation", "rot", "rotation", "att", "attitude"}
TWIST = {"v", "twist", "linear", "angular", "gyro", "omega", "covariance"}
BLIND = 0.1  # s without joint readings, above which poses are dropped
PARTS, SHORTEST = 4, 2.0  # number of parts into which a single log is cut, and least length of each, s
SLOWEST = 0.4  # s from row to row; a larger step is in another unit
LARGEST, FASTEST, OVER = 60.0, 50.0, 0.02  # rad; rad/s averaged over s: above either a joint is not in rad


class RobotColumns(NamedTuple):
    """Map of the columns. joint, actuator: by the model's names, in its order. base: by POSE, empty if it is fixed."""

    time: Stamp
    joint: dict[str, Column]
    actuator: dict[str, Column]
    base: dict[str, Column] = {}

    def rows(self) -> list[str]:
        """One line a column, for a reader."""
        unit = lambda c, otherwise: f" [{c.unit or otherwise}]"
        out = [f"{self.time.column} -> time{unit(self.time, 's')}"]
        out += [f"{c.column} -> {name} of the base{unit(c, 'm') if name in PLACE else ''}" for name, c in self.base.items()]
        out += [f"{c.column} -> position of {name}{unit(c, 'rad or m')}" for name, c in self.joint.items()]
        scale = lambda c: f" times {c.scale:g}" if c.scale != 1 else ""
        asked = lambda c: unit(c, "") if c.unit else ""
        return out + [f"{c.column} -> command of {name}{asked(c)}{scale(c)}" for name, c in self.actuator.items()]

    def doubts(self) -> list[str]:
        """Warnings about commands computed from a measured current, whose gain has the error of the torque constant."""
        measured = [name for name, c in self.actuator.items() if _words(str(c.column)) & (MEASURED | CURRENT)]
        return [f"commands of {', '.join(measured)} are measured, not sent: their gain is that of a sensor"] if measured else []


def read_columns(
    path: Path, joints: Sequence[str], actuators: Sequence[str], free: bool = False, columns: Sequence[str] = ()
) -> RobotColumns:
    """The map of a file. free: the model has a free base. columns: of the log, for the message on what is missing.

    Raises LogError: not TOML, an unknown key, or a joint, an actuator or the base of the model without a column.
    """
    raw, tables = map_table(path), {}
    missing = [] if "time" in raw else ["time"]
    for table, names in (("joint", joints), ("actuator", actuators), ("base", POSE if free else ())):
        given = raw.get(table, {})
        known = set(given) if isinstance(given, dict) else set()
        if wrong := sorted(known - set(names)):
            raise LogError(f"{path}: [{table}] {bare(wrong[0])}: the model has none of that name; it has {', '.join(names)}")
        missing += [f"[{table}] {name}" for name in names if name not in known]
        tables[table] = {
            name: _in_its_unit(_column(given[name], f"{path}: [{table}] {name}", Column)) for name in names if name in known
        }
    if missing:
        are = f"{'is' if len(missing) == 1 else 'are'} missing; expected a column for each"
        raise LogError(f"{path}: {', '.join(missing)}: {are}{f', of {_listed(columns)}' if columns else ''}")
    if unknown := sorted(set(raw) - {"time", "joint", "actuator", "base"}):
        raise LogError(f"{path}: {bare(unknown[0])} is not a key; expected time, [joint], [actuator] and [base]")
    return RobotColumns(_column(raw.get("time"), f"{path}: time", Stamp), **tables)


def _in_its_unit(column: Column) -> Column:
    """The column in the angle's unit that its own name states, where the map states neither unit nor scale."""
    stated = column.unit or column.scale != 1.0 or (unit := _angle(str(column.column).rpartition(":")[2])) in ("", "rad")
    return column if stated else column.model_copy(update={"unit": unit})


def _column(given: Any, where: str, kind: Any) -> Any:
    try:
        found = kind.model_validate(given)
    except ValidationError as error:
        why = bare(error.errors(include_url=False)[0]["msg"], 160)
        raise LogError(f"{where}: {why}; expected the name of a column") from error
    if found.column is None:
        raise LogError(f"{where}: expected the name of a column")
    return found


def guess_columns(
    names: Sequence[str],
    joints: Sequence[str],
    actuators: Sequence[str],
    torques: bool,
    units: Mapping[str, str] | None = None,
    free: bool = False,
    driven: Sequence[str] = (),
) -> RobotColumns:
    """Columns by their names.

    Args:
        torques: True if the model's actuators take torques, not positions. units: stated by the file beside the names.
        free: the model has a free base. driven: joint that each actuator drives, whose name its commands may have.

    Raises LogError: no column fits, or two fit equally.
    """
    base = _pose_columns(names) if free else {}
    names = [n for n in names if n not in base.values()]
    last = {word for site in (*joints, *actuators) for word in header.words(site)[-1:]}  # pos_a of joint a is no ampere
    own = {n: n.rpartition(":")[2] for n in names}  # without the topic, whose words say less than the column's
    unit = {n: "" if last & set(header.words(o)[-1:]) and n[-1:].isalnum() else header.parse(o).unit for n, o in own.items()}
    unit = {n: u or (units or {}).get(n, "") or _angle(own[n]) for n, u in unit.items()}
    unit = {n: u or ("" if _words(own[n]) & TORQUE else _angle(n)) for n, u in unit.items()}
    moves, asks = ("angle", "length"), ("torque", "force") if torques else ("angle", "length")
    fits = lambda kinds: {n: measures(unit[n]) in ("", *kinds) for n in names}
    measured = _best("positions of the joints", "joint", fits(moves), joints, lambda w: _position_score(w)) if joints else {}
    if set(actuators) <= set(names) - set(joints):  # thrusters under their own names
        asked = {name: name for name in actuators}
    else:
        score = lambda w: _command_score(w, torques)
        asked = _best("commands of the actuators", "actuator", fits(asks), actuators, score, driven)
    return RobotColumns(
        _stamp(names, unit),
        {name: Column(column=c, unit="" if unit[c] in ("rad", "m") else unit[c]) for name, c in measured.items()},
        {
            name: Column(column=c, scale=MILLI.get(unit[c], 1.0)) if torques else Column(column=c, unit=unit[c])
            for name, c in asked.items()
        },
        {part: Column(column=column, unit=_length(column) if part in PLACE else "") for part, column in base.items()},
    )


def _pose_columns(names: Sequence[str]) -> dict[str, str]:
    """Column of each part of a base's pose, by a last letter after words for a place or a quaternion. Raises LogError."""
    found: dict[str, list[str]] = {part: [] for part in POSE}
    for name in names:
        words = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
        if not words or set(words) & (ASKED | OTHERS | TWIST):
            continue
        last, before = words[-1], set(words[:-1])
        if last in QUATERNION or (last in "wxyz" and len(last) == 1 and before & TURNED):
            found["q" + last[-1]].append(name)
        elif last in PLACE and (before & PLACED or not before) and not before & TURNED:
            found[last].append(name)
    for part, columns in found.items():
        if len(columns) != 1:
            what = f"{' or '.join(map(bare, columns))}?" if columns else f"no column among {_listed(names)};"
            each = " ".join(f"{p} = .." for p in POSE)
            hint = f"name the place and each part of the quaternion in a map, --columns MAP.toml, [base] {each}"
            fixed = "" if columns else "; if the base was held, weld it in the model"
            raise LogError(f"{part} of the free base: {what} {hint}{fixed}")
    return {part: columns[0] for part, columns in found.items()}


def _length(column: str) -> str:
    """Unit of a place that is a word of the name, of the column before the topic's; "" without one."""
    return next((u for name in (column.rpartition(":")[2], column) for u in ("mm", "cm") if u in _words(name)), "")


def _stamp(names: Sequence[str], units: Mapping[str, str]) -> Stamp:
    """The column of stamps and its unit. Raises LogError: none, or several."""
    found = [n for n in names if _words(n) & TIME and measures(units.get(n, "")) in ("", "time")]
    found = found or [n for n in names if header.role(header.parse(n), set()).places == ("t",)]  # in other languages
    plain = [n for n in found if _words(n) <= TIME | {units.get(n, "")} and not re.search(r"\d", n)]
    found = plain or found
    if len(found) != 1:
        why = f"stamps: {' or '.join(map(bare, found[:4]))}?" if found else f"no column of stamps among {_listed(names)};"
        raise LogError(f'{why} Name it in a map, --columns MAP.toml: time = "..."')
    return Stamp(column=found[0], unit=units.get(found[0], ""))


def _angle(column: str) -> str:
    """Unit of an angle that is a word of the name; "" without one."""
    return next((unit for word in ("deg", "degrees", "mrad", "rad") if word in _words(column) for unit in [unit_of(word)]), "")


def _words(name: str) -> set[str]:
    return {word for word in header.words(name) if not word.isdecimal()}


def _position_score(words: set[str]) -> int:
    if not words & (POSITION | JOINT) or words & (ASKED | TORQUE | OTHERS):
        return 0
    return 2 + bool(words & POSITION) + 2 * bool(words & MEASURED) - bool(words & SMOOTHED)


def _command_score(words: set[str], torques: bool) -> int:
    if not words & (ASKED | TORQUE) or words & OTHERS or (words & TORQUE and not torques):
        return 0
    if words & MEASURED or (torques and words & POSITION):
        return 0
    return 4 * bool(words & ASKED) + 2 * bool(words & (TORQUE if torques else POSITION))


OWN_NAME = "name of #"  # columns named as the joints alone: positions, if nothing else is


def _best(
    what: str, table: str, names: Mapping[str, bool], sites: Sequence[str], score, others: Sequence[str] = ()
) -> dict[str, str]:
    """Site -> column of the family with the highest score, by the sites' names, without their generic words, or by others.

    names: True for those whose unit fits. others: further names of the sites, such as those of the driven joints.

    Raises LogError: none, or two columns for one site.
    """
    for listed in (sites, _short(sites), others, _short(others)):
        if len(set(listed)) == len(sites) and (found := _best_named(what, table, names, listed, score)):
            return dict(zip(sites, found, strict=True))
    raise LogError(f"no columns for the {what} among {_listed(list(names))}; name them in a map, --columns MAP.toml, [{table}]")


def _short(sites: Sequence[str]) -> list[str]:
    """Names of sites without words such as servo or joint; as they are where nothing else is left."""
    return ["_".join(word for word in header.words(site) if word not in GENERIC) or site for site in sites]


def _best_named(what: str, table: str, names: Mapping[str, bool], sites: Sequence[str], score) -> list[str]:
    """Column of each site by one name of it; [] if there is none. Raises LogError: two columns for one site."""
    found: dict[str, dict[int, list[str]]] = {}
    for name in (name for name, fits in names.items() if fits):
        for place, key in _places(_plain(name), sites):
            found.setdefault(key, {}).setdefault(place, []).append(name)
    whole = {key: by for key, by in found.items() if set(by) == set(range(len(sites)))}
    ranked = sorted(((score(_words(key)) or (table == "joint" and key == OWN_NAME), key) for key in whole), reverse=True)
    if not ranked or ranked[0][0] <= 0:
        return []
    best = [whole[key] for points, key in ranked if points == ranked[0][0]]
    for i, site in enumerate(sites):
        if len(candidates := [name for by in best for name in by[i]]) > 1:
            raise LogError(f"{what}: {site}: {' or '.join(candidates)}? Name them in a map, --columns MAP.toml, [{table}]")
    return [best[0][i][0] for i in range(len(sites))]


def _places(name: str, sites: Sequence[str]) -> Iterator[tuple[int, str]]:
    """(number of the site, rest of the name) in which a column's name may be of a site: by the site's words, or by a number."""
    words = header.words(name)
    named = []
    for i, site in enumerate(sites):
        own = header.words(site)
        named += [(i, k, len(own)) for k in range(len(words) - len(own) + 1) if own and words[k : k + len(own)] == own]
    for i, k, n in named:
        if not any(m > n and j <= k and k + n <= j + m for _, j, m in named):  # hip in left_hip is no hip
            yield i, "name of " + " ".join([*words[:k], "#", *words[k + n :]])
    digits = list(re.finditer(r"\d+", name))
    if named:
        return
    if digits:
        last = digits[-1]
        for first in (0, 1):
            yield int(last.group()) - first, f"from {first} " + name[: last.start()] + "#" + name[last.end() :]
    elif len(sites) == 1:
        yield 0, name


def _plain(name: str) -> str:
    """Name of a column without the unit in its topic's name, which is of some of its columns only."""
    topic, mark, own = name.rpartition(":")
    return re.sub(r"(?<![A-Za-z])(?:deg|rad)(?![A-Za-z])", "", topic) + mark + own


def _listed(names: Sequence[str]) -> str:
    return ", ".join(bare(n) for n in names[:12]) + (", .." if len(names) > 12 else "")


def log_files(data: Path) -> list[Path]:
    """Files of logs: of a folder, of a LeRobot data set, or the one file or bag itself. Raises LogError if there is none."""
    if not data.is_dir() or is_recording(data):
        return [data]
    if (data / INFO).is_file():
        if files := sorted((data / "data").rglob("*.parquet")):
            return files
        raise LogError(f"{data}: a LeRobot data set without data/**/*.parquet; download its data, too")
    files = sorted(p for p in data.iterdir() if p.suffix.lower() in SUFFIXES or is_recording(p))
    if not files:
        kinds = f"{', '.join(SUFFIXES)}, MCAP, rosbag2"
        raise LogError(f"{data}: no log; expected a folder of logs ({kinds}), one a log, or a LeRobot data set")
    return files


def contents(path: Path) -> bytes:
    """Bytes of a log, of all files of a bag."""
    return b"".join(p.read_bytes() for p in sorted(path.iterdir()) if p.is_file()) if path.is_dir() else path.read_bytes()


class LogTable(NamedTuple):
    """One log as read: the sheets of a table or the topics of a recording."""

    name: str
    sheets: tuple[Sheet, ...]

    @property
    def where(self) -> str:
        """The file, and what in it."""
        return self.sheets[0].where if len(self.sheets) == 1 else str(self.sheets[0].path)

    @property
    def columns(self) -> dict[str, tuple[Sheet, str]]:
        """Column -> its sheet and its name there. With several sheets a column has its sheet's name in front, stamps aside."""
        if len(self.sheets) == 1:
            return {name: (self.sheets[0], name) for name in self.sheets[0].columns}
        return {n if _words(n) & TIME else f"{s.name}:{n}": (s, n) for s in self.sheets for n in s.columns}

    def clock(self, stamp: Stamp, sheet: Sheet) -> Stamp:
        """Stamps of one sheet: those named, or those of its topic. Raises LogError: it has none."""
        if stamp.column not in sheet.columns and len(self.sheets) == 1:
            raise LogError(f"{sheet.where}: no column {stamp.column!r} of stamps; it has {_listed(list(sheet.columns))}")
        return stamp if stamp.column in sheet.columns else _stamp(list(sheet.columns), sheet.units)

    def read(self, stamp: Stamp, columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (T,) s and values (T, C) SI of columns of one sheet. Raises LogError: one is missing, or in another sheet."""
        known = self.columns
        missing = [c.column for c in columns if c.column not in known]
        if missing:
            raise LogError(f"{self.where}: no column {missing[0]!r}; it has {_listed(list(known))}")
        found = [known[str(c.column)] for c in columns]
        sheet = found[0][0]
        if any(other is not sheet for other, _ in found):
            topics = ", ".join(dict.fromkeys(other.name for other, _ in found))
            raise LogError(f"{self.where}: {topics}: columns of one table are in several topics; expected them in one")
        clock = self.clock(stamp, sheet)
        for c, (_, name) in zip(columns, found, strict=True):
            said = sheet.units.get(name, "")
            if c.scale == 1.0 and measures(said) in ("angle", "length") and UNITS[said][1] != abs(c.factor):
                told = f"the file says {said}, expected {c.unit or SI[measures(said)]}"
                raise LogError(f"{sheet.where}: column {name!r}: {told}; state its unit in a map, --columns MAP.toml")
        values = [c.factor * (sheet.columns[name] - c.zero) for c, (_, name) in zip(columns, found, strict=True)]
        return np.asarray(sheet.columns[clock.column], float) * clock.factor, np.stack(values, 1)


def log_tables(path: Path) -> list[LogTable]:
    """The logs of a file: one, or one for each episode. Raises LogError."""
    sheets = read_sheets(path)
    if any(sheet.episode is None for sheet in sheets):
        return [LogTable(path.stem, tuple(sheets))]
    alone = len(sheets) == 1
    return [LogTable(path.stem if alone else f"{path.stem}_episode_{sheet.episode}", (sheet,)) for sheet in sheets]


def read_sheet(path: Path) -> LogTable:
    """The first log of a file. Raises LogError."""
    return log_tables(path)[0]


def robot_trial(table: LogTable, columns: RobotColumns) -> Trial:
    """One log: commands by actuator (c#) and positions by joint (j#), SI; each value of a slow encoder once, at its first row.

    Raises LogError: a column is missing, stamps do not increase, or a joint seems to be in degrees.
    """
    tables, notes = {}, [note for sheet in table.sheets for note in sheet.notes]
    read = {str(c.column) for part in (columns.joint, columns.actuator, columns.base) for c in part.values()}
    for sheet in table.sheets:
        table_forms.refuse_several(sheet, {columns.time.column, *read})
        if read & {name for name, (of, _) in table.columns.items() if of is sheet}:
            table_forms.refuse_digits(sheet, table.clock(columns.time, sheet).column)
    for key, template, part in (("cmd", "c#", columns.actuator), ("joint", "j#", columns.joint)):
        if not part:
            continue
        t, values = table.read(columns.time, list(part.values()))
        if key == "joint":
            _refuse_degrees(table, columns, t, values)
        keep = np.isfinite(t) & np.isfinite(values).all(1)
        if keep.sum() < 2:
            raise LogError(f"{table.where}: {keep.sum()} rows have all of {_listed([str(c.column) for c in part.values()])}")
        if not np.all(np.diff(t[keep]) > 0):
            i = int(np.argmax(np.diff(t[keep]) <= 0))
            told = f"{t[keep][i + 1]:.10g} s after {t[keep][i]:.10g} s, row {np.flatnonzero(keep)[i + 1] + 1}"
            remedy = "sort the rows, remove duplicates, or split the file where the clock restarts"
            raise LogError(f"{table.where}: stamps {columns.time.column} do not increase: {told}; {remedy}")
        if (step := float(np.median(np.diff(t[keep])))) > SLOWEST and not columns.time.unit:
            line = f'time = {{ column = "{columns.time.column}", unit = "{time_unit(t[keep])[0] or "ms"}" }}'
            raise LogError(
                f"{table.where}: a row every {step:.4g} s; is it s? State the unit in a map, --columns MAP.toml: {line}"
            )
        found = {"t": t[keep], **numbered(template, values[keep])}
        rows, slow = fresh_rows(key, found) if not is_coarse(np.abs(np.diff(values[keep], axis=0)).T) else (slice(None), [])
        tables[key] = {name: column[rows] for name, column in found.items()}
        blank = f"{key}: {len(keep) - int(keep.sum())} of {len(keep)} rows left out, blank in one of the columns"
        notes += [f"{table.name}: {note}" for note in ([] if keep.all() else [blank]) + slow]
    if len(tables) == 2 and not columns.time.unit:
        _refuse_short(table, columns, tables["cmd"]["t"], tables["joint"]["t"])
    if columns.base:
        tables["joint"] = _posed(table, columns, tables.get("joint"))
    return Trial({}, tables, name=table.name, notes=tuple(notes))


def _refuse_short(table: LogTable, columns: RobotColumns, sent: np.ndarray, read: np.ndarray) -> None:
    """Raises LogError for commands and positions of two sheets, without a date, that share little of the longer one."""
    sheets = [table.columns[str(next(iter(part.values())).column)][0] for part in (columns.actuator, columns.joint)]
    both, share = in_common(sent, read)
    if sheets[0] is not sheets[1] and min(sent[0], read[0]) < EPOCH and share < (least := bounds_of({}, table.where).overlap):
        raise LogError(
            f"{table.where}: commands from {sent[0]:.6g} to {sent[-1]:.6g} s, positions from {read[0]:.6g} to {read[-1]:.6g} s:"
            f" they share {max(both, 0.0):.3g} s; expected at least {100 * least:g} % of the longer. Are the units equal?"
            f' Correct one, or state the unit of both in a map, --columns MAP.toml: time = {{ column = "..", unit = "s" }}'
        )


def _posed(table: LogTable, columns: RobotColumns, joint: dict | None) -> dict[str, np.ndarray]:
    """Table of a base's pose, with the joints (or None) as they are at its stamps. Raises LogError."""
    t, pose = table.read(columns.time, list(columns.base.values()))
    keep = np.isfinite(t) & np.isfinite(pose).all(1)
    t, pose = t[keep], pose[keep]
    if len(t) < 2 or not np.all(np.diff(t) > 0):
        raise LogError(f"{table.where}: fewer than two rows have the base's pose, or their stamps do not increase; sort the rows")
    pose[:, 3:] = unit_quaternions(pose[:, 3:], table.where)
    if joint is None:
        return {"t": t, **dict(zip(POSE, pose.T, strict=True))}
    stamps = joint["t"]
    after = np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1)
    known = (t >= stamps[0]) & (t <= stamps[-1]) & (stamps[after] - stamps[after - 1] <= BLIND)
    t, pose = t[known], pose[known]
    own = {name: np.interp(t, stamps, values) for name, values in joint.items() if name != "t"}
    return {"t": t, **dict(zip(POSE, pose.T, strict=True)), **own}


def in_parts(log: Trial) -> list[Trial]:
    """A log cut into PARTS logs; one shorter than PARTS times SHORTEST stays whole."""
    ends = [(t["t"][0], t["t"][-1]) for t in log.tables.values()]
    begin, end = max(a for a, _ in ends), min(b for _, b in ends)
    if end - begin < PARTS * SHORTEST:
        return [log]
    edges = np.linspace(begin, end, PARTS + 1)
    out = []
    for k in range(PARTS):
        tables = {}
        for name, table in log.tables.items():
            first, last = np.searchsorted(table["t"], edges[k : k + 2])
            tables[name] = {column: values[max(first - 1, 0) : last] for column, values in table.items()}
        out.append(Trial(log.meta, tables, name=f"{log.name}_part_{k + 1}", notes=log.notes))
    return out


def _refuse_degrees(table: LogTable, columns: RobotColumns, t: np.ndarray, moved: np.ndarray) -> None:
    """Raises LogError for a joint that turns too far or too fast for radians, unless a map states rad or m."""
    for (name, c), values in zip(columns.joint.items(), moved.T, strict=True):
        if c.unit in ("rad", "m"):
            continue
        rows = np.isfinite(t) & np.isfinite(values)
        clock, angle = t[rows], np.unwrap(values[rows])
        far = np.max(np.abs(values[rows]), initial=0.0)
        later = np.interp(clock + OVER, clock, angle) - angle if len(clock) else np.zeros(1)
        fast = float(np.quantile(np.abs(later), 0.9)) / OVER
        text = f"turns to {far:.3g} rad" if far > LARGEST else f"turns at {fast:.3g} rad/s" if fast > FASTEST else ""
        if text:
            unit = f"is {c.column} in degrees, of a motor before its gear, or in a scale of its own as -100 to 100"
            remedy = "State its unit (rad, if it is right) or scale in a map, --columns MAP.toml"
            raise LogError(f"{table.where}: joint {name} {text}; {unit}? {remedy}")


def read_robot_logs(files: Sequence[Path], columns: RobotColumns) -> tuple[list[Trial], dict[str, str]]:
    """(logs, name -> why it was left out). Raises LogError if none can be read."""
    logs, broken, first = [], {}, {}
    for path in files:
        try:
            tables = log_tables(path)
        except (FishmjError, OSError) as error:
            broken[path.name] = " ".join(str(error).split())
            continue
        for table in tables:
            try:
                trial = robot_trial(table, columns)
                if (other := first.setdefault(readings_sha256(trial), trial.name)) != trial.name:
                    raise LogError(f"{table.where}: has exactly the readings of {other}: one recording under two names")
                logs.append(trial)
            except FishmjError as error:
                broken[path.name if len(tables) == 1 else table.name] = " ".join(str(error).split())
    if not logs:
        raise LogError(next(iter(broken.values())))
    return logs, broken
