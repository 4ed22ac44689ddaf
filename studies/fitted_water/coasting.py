"""Distance that a fish goes in the solver and in a fitted water under the same commands, from rest to its target and past it.

    fishmj evaluate station-family --water lbm --reference --device cuda --tanks 24 --repeats 1 --seed 9 --speeds 0 --out still
    python -m studies.fitted_water.coasting still --water swift-reference            20 s on one core; --json: one JSON object

Trials in still water only. The bus commands of each trial swim again in the fitted water from the same start. The fitted fish is
the nominal one; the trials draw mass, servo gains and latency around it. *synthetic*
"""

import argparse
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.engines import at_rest, make, nominal_params
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water
from fishmj.water.flow import Flow, stack

TIMES = (1, 2, 3, 4, 5, 6, 8)  # s
MEAN = 0.5  # s, over which a speed is a mean
NEAR = 0.1  # m, of the target


def solved_trials(folder: Path) -> list[dict]:
    """Arrays of each trial in still water. Raises ConfigError: there is none."""
    files = sorted((folder / "lbm").glob("*_u0_*.npz"))
    if not files:
        raise ConfigError(f"{folder}/lbm: no trials at 0 m/s; make them with evaluate --water lbm --speeds 0")
    return [dict(np.load(file)) for file in files]


def distances_and_speeds(trials: list[dict], water: str) -> list[dict]:
    """Mean distance from the start [m] and speed [m/s] at each of TIMES, in the solver and in the fitted water."""
    robot = in_water(load_robot("fish"), water, who="this study")
    tick, n = robot.timing.bus_dt, len(trials)
    ticks = round(max(TIMES) / tick)
    start = at_rest(robot, [trial["pose"][0] for trial in trials])
    commands = np.array([trial["command"][:ticks] for trial in trials])
    still = stack([Flow(speed=0.0, turbulence="none")] * n)
    _, trace = make("planar", robot).advance(start, commands, nominal_params(robot, n), still, np.zeros(n, int))
    solved = np.array([trial["pose"][: ticks + 1, :2] for trial in trials])
    fitted = np.concatenate([solved[:, :1], np.asarray(trace.pose)[..., :2]], 1)
    rows: list[dict] = []
    back = round(MEAN / tick)
    for at in TIMES:
        k = round(at / tick)
        row: dict[str, float] = {"t": at, "n": n}
        for name, path in (("solver", solved), ("fitted", fitted)):
            row[f"{name}_path"] = float(np.linalg.norm(path[:, k] - path[:, 0], axis=-1).mean())
            row[f"{name}_speed"] = float(np.linalg.norm(path[:, k] - path[:, k - back], axis=-1).mean() / MEAN)
        rows.append(row)
    return rows


def overshoot(trials: list[dict]) -> dict[str, float]:
    """Medians in the solver: largest distance after a fish is near its target [m], and time until it stays near [s]."""
    farthest, settling = [], []
    for trial in trials:
        first, last = (int(np.flatnonzero(at)[k]) for at, k in ((trial["distance"] < NEAR, 0), (trial["distance"] >= NEAR, -1)))
        farthest.append(trial["distance"][first:].max())
        settling.append(max(trial["t"][last] - trial["t"][first], 0.0))
    return {"farthest": float(np.median(farthest)), "settling": float(np.median(settling)), "n": len(trials)}


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="--out of evaluate --water lbm")
    parser.add_argument("--water", default="swift-reference", help="fitted water (default: swift-reference)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args(argv)
    trials = solved_trials(given.folder)
    rows, after = distances_and_speeds(trials, given.water), overshoot(trials)
    if given.json:
        console.emit_json({"water": given.water, "rows": rows, "overshoot": after})
        return 0
    for r in rows:
        console.say(
            f"{r['t']} s: {r['solver_path']:.3f} m at {r['solver_speed']:.3f} m/s in the solver,"
            f" {r['fitted_path']:.3f} m at {r['fitted_speed']:.3f} m/s in {given.water}"
        )
    console.say(
        f"after it is within {NEAR} m in the solver: {after['farthest']:.2f} m at most, within {NEAR} m for good"
        f" {after['settling']:.1f} s later (medians of {after['n']})"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(console.run(main))
