"""Flow map: measured flow of a tank at each pump setting, a TOML file for options such as `--flow-map`.

    schema = "fishmj.flow_map/1"        [[setting]]  pump, speed [m/s], intensity (TI), length [m], direction [rad], intervals

Numbers are interpolated linearly between settings, and never extrapolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.calib import read_toml
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.log.toml import dumps
from fishmj.water.flow import LENGTH, TURN, Flow
from fishmj.water.flow_map.turbulence_statistics import ValueInterval

SCHEMA = "fishmj.flow_map/1"
SPATIAL = ("default", "fine")  # turbulence presets with a length scale
NEAR = 1e-9  # relative tolerance at the ends of the map


class Setting(NamedTuple):
    """One measured setting of the pump.

    Attributes:
        pump: setting in the map's unit. speed: m/s. intensity: TI.
        length: m, None if it was not measured; `why` then has the reason.
        direction: rad, towards which the water moves, tank frame. method: "probe" or "drifters". seconds: length of the record.
        independent: number of independent samples. noise: m/s, of the probe. sources: names of files.
    """

    pump: float
    speed: ValueInterval
    intensity: ValueInterval
    length: ValueInterval | None
    direction: float
    method: str
    seconds: float
    independent: float
    noise: float
    sources: tuple[str, ...]
    why: str = ""


class TankWater(NamedTuple):
    """Interpolated flow at a pump setting: m/s, TI, m (None: not measured), rad."""

    pump: float
    speed: float
    intensity: float
    length: float | None
    direction: float

    def flow(self, seed: int = 0, box: int = 0) -> Flow:
        """Simulated background flow with these numbers; its length scale is that of the nearest preset."""
        return Flow(
            speed=self.speed,
            direction=self.direction,
            turbulence=preset_for([self.length])[0],
            intensity=self.intensity,
            seed=seed,
            box=box,
        )


def preset_for(lengths: Sequence[float | None]) -> tuple[str, str]:
    """Turbulence preset with the length scale nearest by ratio to the measured ones [m], and a line that names both."""
    known = [length for length in lengths if length is not None]
    if not known:
        return SPATIAL[0], f"no length scale was measured; turbulence {SPATIAL[0]}, L {LENGTH[SPATIAL[0]]:g} m, is used"
    middle = exp(sum(map(log, known)) / len(known))
    name = min(SPATIAL, key=lambda preset: abs(log(LENGTH[preset] / middle)))
    return name, f"measured L {middle:.2f} m; the nearest turbulence is {name}, L {LENGTH[name]:g} m"


@dataclass(frozen=True)
class FlowMap:
    """Measured settings in ascending order. unit: of the pump setting. origin: "measured" or "synthetic"."""

    settings: tuple[Setting, ...]
    unit: str = ""
    origin: str = "measured"

    def __post_init__(self):
        pumps = [s.pump for s in self.settings]
        if not pumps or pumps != sorted(set(pumps)):
            raise ConfigError(f"flow map: settings {pumps}; expected one or more, distinct and ascending")

    @property
    def speeds(self) -> tuple[float, float]:
        """Mean speeds of the slowest and the fastest setting, m/s."""
        found = [s.speed.value for s in self.settings]
        return min(found), max(found)

    def at(self, pump: float) -> TankWater:
        """Flow at a pump setting. Raises ConfigError: it is outside the measured settings."""
        pumps = [s.pump for s in self.settings]
        if not _between(pump, pumps[0], pumps[-1]):
            span = f"{pumps[0]:g}" if len(pumps) == 1 else f"{pumps[0]:g} to {pumps[-1]:g}"
            raise ConfigError(
                f"flow map: pump setting {pump:g} {self.unit} is outside the measured {span}; measure it, or take another"
            )
        on = lambda values: float(np.interp(pump, pumps, values))
        lengths = [np.nan if s.length is None else s.length.value for s in self.settings]
        length = on(lengths)  # NaN if a neighbour has none
        direction = on(np.unwrap([s.direction for s in self.settings]))
        speed, intensity = (on([getattr(s, name).value for s in self.settings]) for name in ("speed", "intensity"))
        return TankWater(
            pump, speed, intensity, None if np.isnan(length) else length, float(np.arctan2(np.sin(direction), np.cos(direction)))
        )

    def for_speed(self, speed: float) -> TankWater:
        """Flow at the pump setting with this mean speed, m/s.

        Raises ConfigError: slower or faster than all measured settings, or the speed does not rise with the pump setting.
        """
        speeds = [s.speed.value for s in self.settings]
        if any(b <= a for a, b in zip(speeds, speeds[1:], strict=False)):
            text = ", ".join(f"{s.pump:g}: {s.speed.value:.3f} m/s" for s in self.settings)
            raise ConfigError(
                f"flow map: the speed does not rise with every setting ({text}), so the one for {speed:g} m/s is ambiguous"
            )
        if not _between(speed, speeds[0], speeds[-1]):
            raise ConfigError(
                f"flow map: {speed:g} m/s is outside the measured {speeds[0]:.3f} to {speeds[-1]:.3f} m/s; measure a setting with"
                " this speed, or take another"
            )
        return self.at(float(np.interp(speed, speeds, [s.pump for s in self.settings])))

    def write(self, path: str | Path) -> Path:
        """Writes the file atomically; returns its path."""
        rows = [_as_table(s) for s in self.settings]
        head = {"schema": SCHEMA, "origin": self.origin, "unit": self.unit}
        blocks = [dumps(head), *("[[setting]]\n" + dumps(row) for row in rows)]
        return write_text(path, "\n".join(blocks))

    @classmethod
    def read(cls, path: str | Path) -> "FlowMap":
        """Reads a map from a file.

        Raises ConfigError: no such file, not TOML, another schema, or a setting with a missing or invalid number.
        """
        table = read_toml(path)
        if table.get("schema") != SCHEMA:
            raise ConfigError(
                f"{path}: schema = {table.get('schema')!r}; expected {SCHEMA!r}, as fishmj deploy flow-map writes it"
            )
        rows = table.get("setting")
        if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
            raise ConfigError(f"{path}: no [[setting]]; expected one for each measured pump setting")
        settings = sorted((_setting(row, f"{path}: setting {k + 1}") for k, row in enumerate(rows)), key=lambda s: s.pump)
        try:
            return cls(tuple(settings), str(table.get("unit", "")), str(table.get("origin", "measured")))
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error


def _between(x: float, low: float, high: float) -> bool:
    slack = NEAR * max(abs(low), abs(high), 1.0)
    return low - slack <= x <= high + slack


def _as_table(s: Setting) -> dict[str, Any]:
    row: dict[str, Any] = {"pump": s.pump}
    for name in ("speed", "intensity", "length"):
        found: ValueInterval | None = getattr(s, name)
        if found is None:
            continue
        row[name] = _rounded(found.value)
        if np.isfinite([found.low, found.high]).all():
            row[f"{name}_interval"] = [_rounded(found.low), _rounded(found.high)]
    row |= {"direction": _rounded(s.direction), "method": s.method, "seconds": round(s.seconds, 2)}
    row["independent"] = round(s.independent, 1)
    row |= {"noise": _rounded(s.noise)} if np.isfinite(s.noise) else {}
    return row | {"sources": list(s.sources)} | ({"no_length": s.why} if s.why else {})


def _rounded(x: float) -> float:
    return float(f"{x:.5g}")


def _setting(row: dict, where: str) -> Setting:
    number = lambda key, low, high, default=None: _number(row, where, key, low, high, default)

    def measured(key: str, low: float, high: float) -> ValueInterval:
        bounds = row.get(f"{key}_interval", [np.nan, np.nan])
        if not isinstance(bounds, list) or len(bounds) != 2 or not all(isinstance(b, int | float) for b in bounds):
            raise ConfigError(f"{where}: {key}_interval = {bounds!r}; expected two numbers")
        return ValueInterval(number(key, low, high), float(bounds[0]), float(bounds[1]))

    return Setting(
        pump=number("pump", -inf, inf),
        speed=measured("speed", 0.0, 5.0),
        intensity=measured("intensity", 0.0, 1.0),
        length=measured("length", 1e-4, 100.0) if "length" in row else None,
        direction=number("direction", *TURN, 0.0),
        method=str(row.get("method", "")),
        seconds=number("seconds", 0.0, inf, 0.0),
        independent=number("independent", 0.0, inf, 0.0),
        noise=number("noise", 0.0, 5.0) if "noise" in row else float("nan"),
        sources=tuple(map(str, row.get("sources", []))),
        why=str(row.get("no_length", "")),
    )


def _number(row: dict, where: str, key: str, low: float, high: float, default: float | None) -> float:
    value = row.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high or not np.isfinite(value):
        raise ConfigError(f"{where}: {key} = {value!r}; expected a number from {low:g} to {high:g}")
    return float(value)
