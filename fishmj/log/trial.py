"""One trial in memory, and the schema `fishmj.log/1` of its tables, columns, units and meta keys.

A trial is a dictionary of meta data and event tables with their own stamps. A template such as `j#` stands for `j1, j2, .. jN`;
all templates of one table share N. Angles are radians, times seconds on the clock that `clock.<table>` names, positions metres
in the tank frame.
"""

import hashlib
import re
from dataclasses import dataclass, field, replace

import numpy as np

from fishmj.base.errors import ConfigError, LogError, UnknownName

SCHEMA = "fishmj.log/1"
ORIGINS = ("measured", "synthetic")
GAP = 0.1  # s; a longer pause in a measured table splits the trial
YEAR = 366 * 86_400.0  # s; a longer step is no pause: the clock was set


@dataclass(frozen=True, kw_only=True)
class TableSpec:
    """Columns of one table. `kinds` maps a template to the check of its values; `host`: further columns of fishmj's tank host."""

    about: str
    fixed: tuple[str, ...]
    numbered: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    host: tuple[str, ...] = ()
    kinds: dict[str, str]
    continuous: bool = False  # sampled without pauses: a gap splits the trial

    def describe(self) -> str:
        """The required columns in words, for messages."""
        return ", ".join([*self.fixed, *(f"{t.replace('#', '1')}..{t.replace('#', 'N')}" for t in self.numbered)])

    def kind(self, column: str) -> str:
        """The check of one column: angle, heading, rate, position, speed or "" for none."""
        return self.kinds.get(re.sub(r"\d+", "#", column), "")


_POSE = {"x": "position", "y": "position", "yaw": "heading"}
TABLES = {
    "cmd": TableSpec(
        about="commanded joint angles at the time of sending, rad",
        fixed=("t",),
        numbered=("c#",),
        optional=("seq", "t_rx", "on#"),  # on: 1 while the servo's torque is on
        host=("asked#", "state"),
        kinds={"c#": "angle"},
        continuous=True,
    ),
    "joint": TableSpec(
        about="measured joint angles, rad; w rad/s; load as the servo reports it",
        fixed=("t",),
        numbered=("j#",),
        optional=("w#", "load#", "temp#"),
        host=("seq", "echo", "t_robot", "t_rx"),
        kinds={"j#": "angle", "w#": "rate"},
        continuous=True,
    ),
    "pose": TableSpec(
        about="measured pose of the reference point, tank frame, m and rad",
        fixed=("t", "x", "y", "yaw"),
        optional=("quality",),
        host=("t_taken", "t_rx"),
        kinds=_POSE,
        continuous=True,
    ),
    "power": TableSpec(
        about="electrical supply, V and A; a bus that tells no current leaves I out",
        fixed=("t", "V"),
        optional=("I",),
        host=("t_rx", "t_robot"),
        kinds={},
    ),
    "gait": TableSpec(
        about="parameters of a tail beat that the robot makes by itself, rad and Hz; hold until the next row",
        fixed=("t", "amplitude", "bias"),
        optional=("frequency",),
        kinds={"amplitude": "angle", "bias": "angle"},
    ),
    "velocity": TableSpec(
        about="measured velocity over ground in the body frame, m/s and rad/s",
        fixed=("t", "surge"),
        optional=("sway", "yaw_rate"),
        kinds={"surge": "speed", "sway": "speed", "yaw_rate": "rate"},
        continuous=True,
    ),
    "imu": TableSpec(
        about="inertial sensor in its own frame, m/s^2 and rad/s; az, wx, wy, wz where the sensor has them",
        fixed=("t", "ax", "ay"),
        optional=("az", "wx", "wy", "wz"),
        kinds={"wx": "rate", "wy": "rate", "wz": "rate"},
        continuous=True,
    ),
    "markers": TableSpec(
        about="points tracked on the body, numbered from the nose, m",
        fixed=("t",),
        numbered=("p#x", "p#y"),
        kinds={"p#x": "position", "p#y": "position"},
        continuous=True,
    ),
    "truth": TableSpec(
        about="simulator's exact state: pose, its rates in the tank frame, joint angles j and rates k",
        fixed=("t", "x", "y", "yaw", "vx", "vy", "wz"),
        numbered=("j#", "k#"),
        kinds={**_POSE, "vx": "speed", "vy": "speed", "wz": "rate", "j#": "angle", "k#": "rate"},
        continuous=True,
    ),
    "obs": TableSpec(about="what the policy saw", fixed=("t",), numbered=("o#",), kinds={}),
    "action": TableSpec(about="what the policy answered, in [-1, 1]", fixed=("t",), numbered=("a#",), kinds={}),
    "target": TableSpec(
        about="where the fish should be, tank frame, m; holds until the next row",
        fixed=("t", "x", "y"),
        kinds={"x": "position", "y": "position"},
    ),
    "flow": TableSpec(
        about="water velocity at each link's centre without the fish, tank frame, m/s",
        fixed=("t",),
        numbered=("u#x", "u#y"),
        kinds={"u#x": "speed", "u#y": "speed"},
    ),
    "wrench": TableSpec(
        about="water force on each link in the tank frame, N, and moment about its front joint (head: reference point), N m",
        fixed=("t",),
        numbered=("f#x", "f#y", "m#"),
        optional=("r#x", "r#y", "n#"),  # the flow solver's raw exchange, the interior water's momentum not yet added
        kinds={},
    ),
}

BY_KIND = {"angle": "rad", "heading": "rad", "rate": "rad/s", "position": "m", "speed": "m/s"}
BY_NAME = {
    **{"t": "s", "t_rx": "s", "t_robot": "s", "t_taken": "s", "asked#": "rad", "V": "V", "I": "A", "frequency": "Hz"},
    **{"ax": "m/s^2", "ay": "m/s^2", "az": "m/s^2"},
    **{"temp#": "deg C", "f#x": "N", "f#y": "N", "m#": "N m", "r#x": "N", "r#y": "N", "n#": "N m", "a#": "1"},
}
META = (  # dotted keys that a complete meta.toml has; sigma and clock are tables with one entry a channel or table
    *("schema", "origin", "robot", "medium", "flow.speed", "flow.direction", "flow.known", "excitation", "replicate_of"),
    *("sigma", "clock", "target", "controller", "policy_sha256", "water", "seed", "versions", "commit", "notes", "licence"),
    "source",
)


def table_spec(name: str) -> TableSpec:
    """Specification of table `name`; raises UnknownName with the known ones."""
    if name not in TABLES:
        raise UnknownName("table", name, TABLES)
    return TABLES[name]


def unit(table: str, column: str) -> str:
    """Unit of a column; "" where the schema names none (counts, qualities, observations, columns beyond the schema).

    Raises UnknownName: no such table.
    """
    return BY_KIND.get(table_spec(table).kind(column), "") or BY_NAME.get(re.sub(r"\d+", "#", column), "")


def look_up(meta: dict, key: str, default=None):
    """The value behind a dotted key such as `flow.speed`."""
    for part in key.split("."):
        if not isinstance(meta, dict) or part not in meta:
            return default
        meta = meta[part]
    return meta


Table = dict[str, np.ndarray]  # column name -> (T,) values; "t" is always there


@dataclass(frozen=True)
class Trial:
    """Recording of a simulator, the evaluator or the robot. `notes` are the reader's remarks, one sentence each."""

    meta: dict
    tables: dict[str, Table]
    name: str = ""
    notes: tuple[str, ...] = field(default=())

    def value(self, key: str, default=None):
        """Meta value behind a dotted key: `trial.value("flow.speed")`."""
        return look_up(self.meta, key, default)

    def table(self, name: str) -> Table:
        """Table `name`; raises LogError with the existing tables if it is missing."""
        table_spec(name)
        if name not in self.tables:
            raise LogError(
                f"trial {self.name or '(in memory)'}: no table {name!r}; it has {', '.join(sorted(self.tables)) or 'none'}"
            )
        return self.tables[name]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time stamp over all tables, s."""
        times = [table["t"] for table in self.tables.values() if len(table["t"])]
        if not times:
            raise LogError(f"trial {self.name or '(in memory)'}: no table has a row")
        return float(min(t[0] for t in times)), float(max(t[-1] for t in times))


def numbered(template: str, values) -> Table:
    """Spreads `(T, N)` values over columns: `numbered("j#", q)` -> {"j1": (T,), .., "jN": (T,)}."""
    values = np.asarray(values)
    if values.ndim != 2 or template.count("#") != 1:
        raise ConfigError(f"numbered({template!r}): expected (T, N) values and one '#', got shape {values.shape}")
    return {template.replace("#", str(i + 1)): values[:, i] for i in range(values.shape[1])}


def stacked(table: Table, template: str) -> np.ndarray:
    """The inverse of `numbered`: columns j1..jN as one `(T, N)` float64 array; N = 0 when there are none."""
    pattern = re.compile(re.escape(template).replace(r"\#", r"([1-9]\d*)") + r"\Z")
    count = sum(bool(pattern.match(column)) for column in table)
    columns = [np.asarray(table[template.replace("#", str(i + 1))], float) for i in range(count)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(table["t"]), 0))


def repeats(table: Table) -> np.ndarray:
    """(T - 1,) True where all columns but the stamps and numbers equal the row before."""
    values = [np.asarray(v, float) for c, v in table.items() if c not in ("t", "t_rx", "seq")]
    if not values:
        return np.zeros(max(len(table["t"]) - 1, 0), bool)
    return np.all(np.diff(np.stack(values), axis=1) == 0, axis=0)


def gaps(t: np.ndarray, limit: float = GAP) -> np.ndarray:
    """Rows after which the table pauses: for longer than `limit` [s] and than 1.5 median steps (for slow cameras)."""
    step = np.diff(np.asarray(t, float))
    return np.flatnonzero(step > max(limit, 1.5 * float(np.median(step)) if len(step) else 0.0))


def segments(trial: Trial, limit: float = GAP, tables: tuple[str, ...] | None = None) -> list[Trial]:
    """Cuts a trial at every pause of more than `limit` s of a continuous table (cmd, joint, pose, truth; or `tables`).

    Each part holds the rows of all tables inside one stretch without a pause; target rows are carried over, since a
    target holds until the next one. A trial without a pause is returned unchanged.
    """
    watched = [n for n in trial.tables if (tables is None and table_spec(n).continuous) or n in (tables or ())]
    cuts = []
    for name in watched:
        t = trial.tables[name]["t"]
        cuts += [(float(t[i]), float(t[i + 1])) for i in gaps(t, limit)]
    if not cuts:
        return [trial]
    parts, start = [], -np.inf
    for pause, resume in [*_merged(cuts), (np.inf, np.inf)]:
        rows = {name: _between(name, table, start, pause) for name, table in trial.tables.items()}
        rows = {name: table for name, table in rows.items() if len(table["t"])}
        if any(name in rows for name in watched):
            name = f"{trial.name}.{len(parts) + 1}" if trial.name else ""
            parts.append(replace(trial, tables=rows, name=name))
        start = resume
    return parts


def _merged(cuts: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Overlapping pauses joined, in order of time."""
    out: list[tuple[float, float]] = []
    for pause, resume in sorted(cuts):
        if out and pause < out[-1][1]:
            out[-1] = (out[-1][0], max(out[-1][1], resume))
        else:
            out.append((pause, resume))
    return out


def _between(name: str, table: Table, start: float, end: float) -> Table:
    t = table["t"]
    keep = (t >= start) & (t <= end)
    if name == "target":  # the last target set before the stretch still holds in it
        before = np.flatnonzero(t < start)
        keep[before[-1:]] = True
    return {column: values[keep] for column, values in table.items()}


def readings_sha256(trial: Trial) -> str:
    """Hex digest of all tables of a trial but their commands; the same for a copy under another name."""
    total = hashlib.sha256()
    for name, table in sorted(trial.tables.items()):
        for column, values in sorted(table.items()) if name != "cmd" else ():
            total.update(f"\0{name}.{column}\0".encode() + np.ascontiguousarray(values, float).tobytes())
    return total.hexdigest()
