"""`fishmj deploy flow-map`: measures the water's flow at each setting of the pump, from a probe or from drifting markers."""

from argparse import ArgumentTypeError
from math import radians
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.water.flow_map.drifters import turbulence_of_drifts
from fishmj.water.flow_map.flow_map import FlowMap, Setting
from fishmj.water.flow_map.probe_records import UNITS, read_drifts, read_probe
from fishmj.water.flow_map.turbulence_statistics import ValueInterval, turbulence_of

SAME = 0.02  # relative difference of sampling steps that files of one setting may have
EXAMPLES = """examples:
  fishmj deploy flow-map 20=adv_20.csv 25=adv_25.csv --time Time --velocity Vx,Vy,Vz --unit cm/s --out tank_flow.toml
  fishmj deploy flow-map 20=propeller_20.txt --rate 10 --velocity speed --pump-unit Hz --out tank_flow.toml
  fishmj deploy flow-map 20=runs/drifts_20 25=runs/drifts_25 --out tank_flow.toml        folders of fishmj deploy track"""


def options() -> console.Parser:
    """The arguments."""
    summary = "What a pump setting makes: mean speed, turbulence intensity, integral length scale."
    made = console.parser("deploy flow-map", summary, examples=EXAMPLES)
    add = made.add_argument
    about = "a pump setting and a record of it: a table of velocities, or a folder of drifts; one setting may have several"
    add("records", nargs="+", type=console.text, metavar="SETTING=FILE", help=about)
    out = "TOML for deploy trials, deploy swim and evaluate (default: only shown)"
    add("--out", type=console.out_file, metavar="FILE", help=out)
    add("--time", type=console.text, metavar="COLUMN", help="of the times, s (default: rows come evenly, at --rate)")
    add("--rate", type=console.number(0.1, 1e5), metavar="HZ", help="rows a second, of tables without times (default: --time)")
    velocity = "of tables: along x, and y, z (default: drifts alone)"
    add("--velocity", type=console.Listed(console.text), metavar="COLUMN,..", help=velocity)
    add("--unit", choices=tuple(UNITS), default="m/s", help="of the velocities")
    turn = "from the tank's x axis to the probe's, counter-clockwise, degrees"
    add("--axis", type=console.number(-360, 360), default=0.0, metavar="DEG", help=turn)
    add("--pump-unit", type=console.text, metavar="TEXT", help="of the settings, such as Hz or rpm (default none)")
    add("--synthetic", action="store_true", help="the records are simulated: said so in the file")
    return made


def main(argv: list[str]) -> int:
    """The command. Exit code 0: every setting has all three figures; 3: some record is too short for a length scale."""
    args = options().parse_args(argv)
    unit = args.pump_unit or ""
    by_setting: dict[float, list[Path]] = {}
    for setting, path in map(record, args.records):
        by_setting.setdefault(setting, []).append(path)
    settings = []
    with console.Progress(len(args.records), "flow-map", "records") as bar:
        for done, (setting, paths) in enumerate(sorted(by_setting.items()), 1):
            settings.append(measured(args, setting, paths))
            bar.update(min(done, len(args.records)))
    found = FlowMap(tuple(settings), unit, "synthetic" if args.synthetic else "measured")
    console.say(console.table([row(s, unit) for s in settings]), "intervals: 95 %, from independent groups of samples")
    for s in settings:
        if s.why:
            console.warn(f"setting {s.pump:g}: no length scale: {s.why}")
    if args.out:
        console.say(f"wrote {found.write(args.out)}")
    if args.json:
        console.emit_json({"out": args.out, "unit": unit, "settings": [setting_json(s) for s in settings]})
    short = [s for s in settings if s.length is None and s.method == "probe"]
    return console.CANNOT_TELL if short else console.OK


def measured(args, pump: float, paths: list[Path]) -> Setting:
    """Measures one setting of the pump.

    Raises ConfigError, LogError: a record that cannot be read, or is too short; names the setting.
    """
    drifts = [path.is_dir() for path in paths]
    names = tuple(path.name for path in paths)
    if any(drifts) and not all(drifts):
        raise ConfigError(f"flow-map: setting {pump:g} has tables and folders of drifts; measure it by one of them")
    try:
        if all(drifts):
            found = turbulence_of_drifts([track for path in paths for track in read_drifts(path)])
            direction = found.direction
        else:
            if not args.velocity or (args.time is None) == (args.rate is None):
                raise ConfigError("tables need --velocity COLUMN,.. and either --time COLUMN or --rate HZ")
            probes = [read_probe(p, args.time or "", args.velocity, UNITS[args.unit], args.rate) for p in paths]
            steps = [probe.dt for probe in probes]
            if max(steps) - min(steps) > SAME * max(steps):
                raise ConfigError(f"its tables are sampled every {min(steps):g} to {max(steps):g} s; give them one rate")
            if spikes := max(probe.spikes for probe in probes):
                console.warn(
                    f"setting {pump:g}: {100 * spikes:.2g} % of a table's rows were spikes, replaced by their neighbours"
                )
            found = turbulence_of([r for probe in probes for r in probe.records], float(np.mean(steps)))
            direction = found.direction + radians(args.axis)
    except ConfigError as error:
        raise ConfigError(f"setting {pump:g} ({', '.join(names)}): {str(error).removeprefix('flow-map: ')}") from error
    return Setting(
        pump=pump, speed=found.speed, intensity=found.intensity, length=found.length,
        direction=float(np.arctan2(np.sin(direction), np.cos(direction))), method="drifters" if all(drifts) else "probe",
        seconds=found.seconds, independent=found.independent, noise=found.noise, sources=names, why=found.why,
    )  # fmt: skip


def record(text: str) -> tuple[float, Path]:
    """Parses `20=adv.csv`: a pump setting and a path. Raises ArgumentTypeError."""
    setting, mark, path = text.partition("=")
    if not mark or not path:
        raise ArgumentTypeError(f"got {text[:60]!r}, expected SETTING=FILE such as 20=adv_20.csv")
    return console.number(-1e6, 1e6)(setting), console.path(path)


def row(s: Setting, unit: str) -> dict[str, object]:
    """A line of the table."""
    return {
        f"pump {unit}".strip(): s.pump,
        "U [m/s]": shown(s.speed, 4),
        "TI [%]": shown(s.intensity, 2, 100),
        "L [m]": shown(s.length, 3),
        "to [deg]": round(float(np.degrees(s.direction)), 1) + 0.0,  # never -0
        "by": s.method,
        "seconds": round(s.seconds),
        "independent samples": round(s.independent),
    }


def shown(found: ValueInterval | None, digits: int, factor: float = 1.0) -> str:
    """A figure with its interval: `0.2013 (0.1990 0.2036)`."""
    if found is None:
        return "-"
    value, low, high = (f"{factor * x:.{digits}f}" for x in found)
    return f"{value} ({low} {high})" if np.isfinite(found.low) else value


def setting_json(s: Setting) -> dict:
    """A setting as JSON."""
    spread = lambda found: None if found is None else found._asdict()
    return {**s._asdict(), **{name: spread(getattr(s, name)) for name in ("speed", "intensity", "length")}}
