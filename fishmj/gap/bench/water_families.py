"""Errors of a water calibration in waters unlike the strips: robots of every generator, free swims, and their truth.

    fishmj calibrate families --robots 3 --seed 1 --jobs 2 --json

Each robot of a family (constants drawn from its seed, nothing hidden) swims `SWIMS`; `calibrate_trials` sees the trials and the
shipped description, never the generator. The result is compared with swims left out of the fit, and with the forces of the
generator's own law in prescribed motions (`generators.prescribed`). The second robot has no such figures, only its speeds.
"""

import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.workers import ask_all
from fishmj.gap.calibrate.calibration_logs import Logs
from fishmj.gap.calibrate.water_fit import HeldOutSwim, WaterFit, calibrate_trials, predicted
from fishmj.gap.laboratory import generators
from fishmj.gap.laboratory.generators.prescribed import prescribed
from fishmj.gap.progress import terminal_bar
from fishmj.log import Trial, excitation
from fishmj.log.excitation import Excitation

SECOND = "second"
FAMILIES = (*generators.NAMES, SECOND)
DRIVEN = ("gait", "gait_slow", "gait_fast", "gait_small", "turn_left", "turn_right", "out_and_back", "burst_and_coast", "chirp")
SWIMS = (*DRIVEN, "ramps", "tow_ahead", "tow_sideways", "tow_oblique", "twirl")
_deg = np.radians
UNSEEN = {  # swims between those, which no fit of a robot sees at all
    "1.3 Hz, 25 deg": (1.3, _deg(25.0), _deg(60.0), 0.0),
    "0.8 Hz, 20 deg": (0.8, _deg(20.0), _deg(60.0), 0.0),
    "1.2 Hz, 25 deg, lag 45": (1.2, _deg(25.0), _deg(45.0), 0.0),
    "1 Hz, 25 deg, bias 10": (1.0, _deg(25.0), _deg(60.0), _deg(10.0)),
    "0.8 Hz, 30 deg, bias -15": (0.8, _deg(30.0), _deg(60.0), _deg(-15.0)),
}
START = (-1.2, 0.0, 0.0)  # m, m, rad
TURNING = 0.2  # rad/s: above it a yaw rate has a relative error


def study(case: tuple[str, int], model: str = "fish") -> dict:
    """One robot: (family, seed). Speed and yaw-rate errors are relative; `physical`: value, low, high, truth.

    `swims` are those left out of a fit, `fitted` the same swims in the fit to all, `unseen` others, predicted by the fit to all.
    """
    family, seed = case
    trials = swim_robot(family, SWIMS, seed, model)
    begin = time.process_time()
    _, found = calibrate_trials(trials, model)
    spent = time.process_time() - begin
    truth = {} if family == SECOND else prescribed(family, seed, robot=model)
    row = {"family": family, "seed": seed, "cpu_s": spent, "swims": {swim.kind: errors(swim) for swim in found.after}}
    row["fitted"] = {swim.kind: errors(swim) for swim in predicted(found.plant, found.records, found.theta)}
    row |= {"unseen": {swim.kind: errors(swim) for swim in predict_unseen(found, family, seed, model)}}
    row["described"] = float(np.nanmean([swim.speed_error for swim in found.before]))
    return row | {"physical": physical_rows(found, truth)}


def swim_robot(family: str, swims: Iterable["str | Excitation"], seed: int, model: str) -> list[Trial]:
    """Trials of one robot of a family."""
    if family != SECOND:
        return generators.generate(family, {}, swims, seed, robot=model)
    from fishmj.gap.laboratory import virtual_robot

    return virtual_robot.generate({}, list(swims), seed, robot=model)


def predict_unseen(found: WaterFit, family: str, seed: int, model: str) -> list[HeldOutSwim]:
    """The same robot's swims of `UNSEEN`, predicted by the fit to all of its swims."""
    made = [
        Excitation(id=name, commands=excitation.gait(*beat), about="between the swims that are fitted to", start=START)
        for name, beat in UNSEEN.items()
    ]
    trials = {trial.name: trial for trial in swim_robot(family, made, seed, model)}
    return predicted(found.plant, Logs(Path("unseen"), trials).records(found.plant.dt), found.theta)


def errors(swim: HeldOutSwim) -> dict[str, float | None]:
    """Signed relative errors of one swim left out; None if the fish hardly swims, or hardly turns."""
    speed = swim.simulated / swim.speed - 1.0 if np.isfinite(swim.speed_error) else None
    turn = swim.simulated_yaw_rate / swim.yaw_rate - 1.0 if abs(swim.yaw_rate) > TURNING else None
    return {"speed": speed, "yaw_rate": turn}


def physical_rows(found: WaterFit, truth: dict[str, float]) -> dict[str, list]:
    """Body-level estimates: value, low, high, truth (None without one)."""
    return {name: [e.value, e.low, e.high, truth.get(name)] for name, e in found.physical.items()}


def mean(values: list) -> float:
    """Mean magnitude of the known values, in percent; NaN if there are none."""
    known = [abs(v) for v in values if v is not None]
    return 100.0 * float(np.mean(known)) if known else float("nan")


def tables(rows: list[dict]) -> tuple[list[dict], list[dict], list[dict]]:
    """(families, kinds of swim, physical quantities) of studied robots, as tables in percent."""
    families, kinds, quantities = [], [], []
    named = list(dict.fromkeys(row["family"] for row in rows))
    of = lambda family: [row for row in rows if row["family"] == family]
    for family in named:
        mine = of(family)
        speeds = lambda some, mine=mine: mean([row["swims"][kind]["speed"] for row in mine for kind in some])
        turns = mean([swim["yaw_rate"] for row in mine for swim in row["swims"].values()])
        inside = [low <= true <= high for row in mine for _, low, high, true in row["physical"].values() if true is not None]
        one = {"family": family, "robots": len(mine), "described": 100 * float(np.mean([row["described"] for row in mine]))}
        one |= {"left out": speeds(SWIMS), "driven": speeds(DRIVEN), "yaw rate": turns}
        one |= {"unseen": mean([row["unseen"][name]["speed"] for row in mine for name in UNSEEN])}
        one |= {"unseen yaw": mean([row["unseen"][name]["yaw_rate"] for row in mine for name in UNSEEN])}
        one |= {"intervals hold": 100 * float(np.mean(inside)) if inside else float("nan"), "of": len(inside)}
        families.append(one | {"CPU s": float(np.mean([row["cpu_s"] for row in mine]))})
    for part, kind in (*(("swims", kind) for kind in SWIMS), *(("unseen", name) for name in UNSEEN)):
        kinds.append({"kind": kind, **{family: mean([row[part][kind]["speed"] for row in of(family)]) for family in named}})
    for name in rows[0]["physical"]:
        for family in named:
            known = [row["physical"][name] for row in of(family) if row["physical"][name][3] is not None]
            if known:
                off = [value / true - 1.0 for value, _, _, true in known]
                held = [low <= true <= high for _, low, high, true in known]
                width = [(high - low) / 2 / abs(true) for _, low, high, true in known]
                one = {"quantity": name, "family": family, "mean error": 100 * float(np.mean(off))}
                one |= {"RMS error": 100 * float(np.sqrt(np.mean(np.square(off))))}
                quantities.append(one | {"half width": 100 * float(np.mean(width)), "held": sum(held), "of": len(held)})
    return families, kinds, quantities


def main(argv: list[str]) -> int:
    """The command `calibrate families`. Returns the exit code."""
    parser = console.parser("calibrate families", "Calibrate the water of robots of every generator, whose water is known.")
    families = console.Listed(console.OneOf(FAMILIES), len(FAMILIES))
    parser.add_argument("--families", type=families, default=FAMILIES, metavar="A,..", help=f"default {','.join(FAMILIES)}")
    robots = "of each family; one takes 5 s of a core and more"
    parser.add_argument("--robots", type=console.whole(1, 1000), default=3, help=robots)
    parser.add_argument("--seed", type=console.SEED, default=1, help="of the first robot")
    parser.add_argument("--model", type=console.text, default="fish", help="the description that swims and is calibrated")
    parser.add_argument("--jobs", type=console.whole(1, 64), default=1, help="robots side by side, a core each")
    args = parser.parse_args(argv)
    todo = [(family, args.seed + i) for family in args.families for i in range(args.robots)]
    rows: list[dict] = []
    again = interrupt.again("start again")
    with interrupt.keeping(lambda: f"{len(rows)} of {len(todo)} robots were done; none is kept; {again}"):
        with terminal_bar(len(todo), "robots", "robots") as bar:
            for row in ask_all(todo, partial(study, model=args.model), args.jobs):
                rows.append(row)
                bar.update(len(rows))
    rows.sort(key=lambda row: todo.index((row["family"], row["seed"])))
    made = tables(rows)
    for table in made:
        console.say(console.table(table), "")
    console.say("errors in percent of the mean speed, or yaw rate, of swims that the fit has not seen; intervals are 90 %")
    console.say("driven: gaits, turns, bursts, chirp among them; unseen: further gaits and turns, predicted by the fit to all")
    if args.json:
        console.emit_json({"robots": rows, "families": made[0], "kinds": made[1], "physical": made[2]})
    return console.OK
