"""The five calibrations of the command line: fit, tables, report, fish file; and their errors on robots of known parameters.

The systematic part of every interval comes from these errors.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.base.errors import LogError
from fishmj.gap.calibrate import calibrated_model, fit_plots, mass, servo_fit, slip, water_fit
from fishmj.gap.calibrate.calibration_logs import Logs, read, smoothing
from fishmj.gap.calibrate.parameter_fit import ParameterEstimate, widened
from fishmj.gap.calibrate.water_plant import WaterPlant
from fishmj.gap.commands.admission import of_this_robot, surroundings, unphysical
from fishmj.gap.models.swimming_fish import ServoStand
from fishmj.gap.progress import terminal_bar
from fishmj.gap.records.records import record_of
from fishmj.gap.workflow import compile_kernel
from fishmj.log import physical_checks
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED

Answer = dict[str, Any]
Off = dict[str, list]  # number -> [error, true value, whether the 90 % interval holds it]


def rows(estimates: dict[str, ParameterEstimate]) -> list[dict]:
    """A table of estimates."""
    return [
        {
            **{"parameter": e.name, "value": e.value, "low": e.low, "high": e.high, "unit": e.unit, "width from": e.widest},
            "at bound": e.bound,
        }
        for e in estimates.values()
    ]


def source_lines(logs: Logs, more: str = "") -> list[str]:
    """Origin of the trials as lines of text."""
    origins = sorted({f"{t.value('origin', '?')} ({t.value('source', '?')})" for t in logs.trials.values()})
    return [f"{len(logs.trials)} trials in {logs.folder}, origin {', '.join(origins)}", *([more] if more else [])]


def source(args) -> str:
    """The logs of a calibration, for the comments beside its numbers."""
    return Path(args.data).as_posix()


def open_logs(args, robot: Robot, only: Sequence[str] = ()) -> Logs:
    """The requested trials of this robot; problems of some of them are printed.

    Args:
        only: physical checks that matter; all by default.

    Raises LogError: none can be compared, another number of joints, another robot's name without agreement, or impossible motion
    (a joint against its command, a mirrored camera).
    """
    logs = read(args.data)
    broken = dict(logs.broken)
    for name, trial in logs.trials.items():
        try:
            record_of(trial, robot.timing.physics_dt)
        except LogError as error:
            broken[name] = str(error)
    trials = {name: trial for name, trial in logs.trials.items() if name not in broken}
    if not trials:
        raise LogError(f"{args.data}: no trial can be compared; {next(iter(broken.values()))}")
    whose = (*of_this_robot(trials.values(), robot, args.model, args.same_robot), *surroundings(trials.values(), robot))
    breaches, doubts = unphysical(trials.values(), only, robot.length)
    for note in (*logs.notes, *(f"{name} left out: {why}" for name, why in broken.items()), *whose, *doubts):
        console.warn(note)
    if breaches:
        raise LogError(f"{args.data}: {'; '.join(breaches)}")
    return Logs(logs.folder, trials, broken, (*logs.notes, *whose, *doubts))


def open_bench_logs(args, robot: Robot, verb: str = "servo") -> tuple[Logs, ServoStand]:
    """The trials and the plant for comparison; missing data are reported before anything is compiled."""
    logs, plant = open_logs(args, robot, physical_checks.JOINTS)._replace(verb=verb), ServoStand(robot)
    if note := smoothing([logs.trials[name] for name in logs.bench()]):
        console.warn(note)
    compile_kernel(plant, console.say)
    return logs, plant


def run_servo(args) -> Answer:
    """Servo gain, damping, friction and command latency from sine, square and impulse."""
    robot = load_robot(args.model)
    logs, plant = open_bench_logs(args, robot)
    found = servo_of(args, logs, plant)
    page, picture, answer = servo_report(args, logs, found)
    estimates = {name: widened(e) for name, e in found.estimates.items()}
    if args.out:
        text, s = calibrated_model.start(args.out, args.model), plant.robot.servo
        kp, kd = estimates["kp"].value, estimates["kd"].value
        values = {"kp": kp, "kd": kd, "speed_no_load": s.torque / (kd - s.kv)}
        short = {key: calibrated_model.short(value) for key, value in values.items()}
        text = calibrated_model.put(text, "servo", short, source=source(args))
        latency = calibrated_model.short(estimates["command_latency"].value)
        text = calibrated_model.put(text, "timing", {"command_latency": latency}, source=source(args))
        calibrated_model.write(args.out, text, "servo", estimates, {"coulomb_friction.torque": estimates["friction"]}, args.data)
    return {"estimates": plain(estimates), **answer, "report": page, "overlay": picture, "skipped": logs.broken}


def servo_of(args, logs: Logs, plant: ServoStand, *, alone: bool = True) -> servo_fit.ServoFit:
    """The servo's fit. Raises LogError if it must not be used, with the report that shows the reason."""
    try:
        return servo_fit.calibrate(logs, plant, alone=alone, bars=terminal_bar)
    except servo_fit.BadFit as bad:
        page, _, _ = servo_report(args, logs, bad.found, str(bad))
        raise LogError(f"{bad}. Nothing is written; the evidence is in {page}") from bad


def servo_report(args, logs: Logs, found: servo_fit.ServoFit, refusal: str = "") -> tuple[Path, Path, Answer]:
    """Prints and writes a servo fit: (page, picture, tables by name). refusal: reason that the fit must not be used."""
    estimates = {name: widened(e) for name, e in found.estimates.items()}
    apart = [
        {"medium": m, **{name: fit.estimates[name].value for name in servo_fit.FREE}, "rounds": fit.rounds}
        for m, fit in found.alone.items()
    ]
    left = [
        {"signal": s, "medium": m, "trials": len(part), "RMS left [deg]": fit_plots.rms(found, part)}
        for s, m in sorted({(r.excitation, r.medium) for r in found.records})
        if (part := [r for r in found.records if (r.excitation, r.medium) == (s, m)])
    ]
    once = f"all in {found.records[0].medium}: record the same in the other medium to separate the hull's contribution"
    both = console.table(apart) if apart else once
    console.say(*source_lines(logs), console.table(rows(estimates)), "", both, "", console.table(left))
    console.say("", console.table(found.hull), *([found.words] if found.words else []))
    tables = {"Servo": rows(estimates), "Each medium alone": apart, "What is left": left, "Hull and water": found.hull}
    picture = fit_plots.draw(found, args.report / "overlay.png")
    page = fit_plots.report(
        args.report, "Servo calibration", tables, picture, source_lines(logs, f"{refusal} {found.words}".strip())
    )
    return page, picture, {"alone": apart, "left": left, "hull": found.hull}


def run_latency(args) -> Answer:
    """Command and camera latency, from the clocks and against the fitted servo."""
    robot = load_robot(args.model)
    logs, plant = open_bench_logs(args, robot, "latency")
    fitted = servo_of(args, logs, plant, alone=False)
    found = servo_fit.calibrate_latency(logs, fitted)
    estimates = {name: widened(e) for name, e in found.estimates.items()}
    lags = [{"trial": r.trial, "path": r.path, "measured [s]": r.measured, "model [s]": r.model} for r in found.rows]
    every = {finding for audit in found.audits.values() for finding in audit.findings}
    findings = sorted(f for f in every if not f.startswith("pose drifts"))  # a fish that speeds up recoils later and later
    console.say(*source_lines(logs), console.table(lags), "", *findings, console.table(rows(estimates)))
    tables = {"Latency": rows(estimates), "Lags": lags, "Clocks": [{"finding": finding} for finding in findings]}
    page = fit_plots.report(args.report, "Latency calibration", tables, None, source_lines(logs))
    if "camera_latency" not in estimates:
        needs = " and ".join(servo_fit.ABRUPT)
        console.warn(f"camera_latency was not identified and stays as described: no {needs} with joint and pose shows a lag")
    if args.out:
        values = {name: calibrated_model.short(e.value) for name, e in estimates.items()}
        text = calibrated_model.put(calibrated_model.start(args.out, args.model), "timing", values, source=source(args))
        calibrated_model.write(args.out, text, "latency", estimates, {}, args.data)
    return {"estimates": plain(estimates), "lags": lags, "findings": findings, "report": page, "skipped": logs.broken}


def run_slip(args) -> Answer:
    """Slip ratio of the hull from swims and a coast-down."""
    if args.recompute:
        return recompute_slip(args)
    logs = open_logs(args, load_robot(args.model))
    grid = slip.table_name({"grid": args.grid or slip.grid_of(logs.trials.values()), "boundary": args.boundary})
    swims = slip.measured(logs.trials.values())
    found = slip.profile(swims, grid)
    alone = {
        name: slip.profile({name: value}, grid).estimate._replace(name=name)
        for name, value in swims.items()
        if name in found.predicted
    }
    facts = [{"metric": k, "measured": v, "trials": n} for k, (v, n) in swims.items()]
    words = f"table of grid {grid}; J rises by {slip.RISE} at the ends of the interval"
    console.say(*source_lines(logs, words), console.table(facts), "", console.table(found.rows()), "", console.table(rows(alone)))
    console.say("", console.table(rows({"slip": found.estimate})), found.words)
    if found.doubt:
        needs = ", ".join(name for name in (*slip.SWIMS, slip.COAST) if name not in swims) or "other swims of this robot"
        raise LogError(
            f"{args.data}: slip: {found.doubt}. Nothing is written; record {needs} as well, or check the robot's masses"
        )
    tables = {"Slip ratio": rows({"slip": found.estimate}), "Profile": found.rows(), "Each alone": rows(alone), "Measured": facts}
    picture = fit_plots.draw_slip(found, args.report / "slip.png")
    page = fit_plots.report(
        args.report, "Slip calibration", tables, picture, source_lines(logs, f"{words}. {found.words}"), fit_plots.SLIP_WORDS
    )
    if args.out:
        text = calibrated_model.start(args.out, args.model)
        calibrated_model.write(args.out, text, "slip", {"slip": found.estimate}, {}, args.data)
    return {
        "estimates": plain({"slip": found.estimate}),
        "profile": found.rows(),
        "alone": plain(alone),
        "grid": grid,
        "words": found.words,
        "report": page,
        "skipped": logs.broken,
    }


def recompute_slip(args) -> Answer:
    """Computes one more entry for the table of solver swims."""
    grid, ratios = args.grid or "window_coarse", args.ratios
    entry = slip.recompute(grid, ratios, args.device, args.tanks, args.report / "swims", args.boundary)
    named = [f'{key} = "{value}"' for key, value in entry.items() if isinstance(value, str)]
    console.say(f"put this into data/calib/calibrate.toml, in place of grid {slip.table_name(entry)}:", "", "[[solver]]", *named)
    console.say(*(f"{key} = [{', '.join(f'{v:.4g}' for v in row)}]" for key, row in entry.items() if not isinstance(row, str)))
    return {"solver": entry}


def run_water(args) -> Answer:
    """Thrust, drag and added mass from free swims."""
    robot = load_robot(args.model)
    logs, plant = open_logs(args, robot), WaterPlant(robot)
    names = water_fit.swims(logs)
    for note in (unnamed := water_fit.unnamed(logs.trials[name] for name in names)):
        console.warn(note)
    compile_kernel(plant, console.say)
    found = water_fit.calibrate(logs, plant, bars=terminal_bar)
    left, begin = found.speed_error, [swim.speed_error for swim in found.before]
    words = (
        f"speed error on held-out swims: {100 * left.value:.1f} % on average,"
        f" {100 * left.high:.1f} % at worst; with the described water {100 * float(np.nanmean(begin)):.1f} % on average"
    )
    doubts, poor = water_fit.doubts(found), water_fit.too_poor(found)
    doubts += [*unnamed, *water_fit.unmeasured(args.model, args.out)]
    earlier = {swim.trial: swim for swim in found.before}
    swims = [
        {
            "trial": swim.trial,
            "kind": swim.kind,
            "speed [m/s]": swim.speed,
            "as described": earlier[swim.trial].simulated,
            "left out": swim.simulated,
            "yaw rate [rad/s]": swim.yaw_rate,
            "described": earlier[swim.trial].simulated_yaw_rate,
            "unseen": swim.simulated_yaw_rate,
            "place off [m]": swim.place,
        }
        for swim in sorted(found.after)
    ]
    turned = rows(found.coefficients)
    console.say(*source_lines(logs, f"{len(names)} of them are free swims"), console.table(swims), "", console.table(turned))
    console.say("", console.table(rows(found.physical)), words, *doubts)
    tables = {"What the body feels": rows(found.physical), "Swims left out": swims, "Coefficients": turned}
    picture = fit_plots.draw_water(found, args.report / "water.png")
    page = fit_plots.report(
        args.report,
        "Water calibration",
        tables,
        picture,
        source_lines(logs, ". ".join([words, *doubts, *([poor] if poor else [])])),
        fit_plots.WATER_WORDS,
    )
    if found.refusal:
        raise LogError(f"{args.data}: {found.refusal}. Nothing is written; the evidence is in {page}")
    if args.out:
        text = calibrated_model.start(args.out, args.model)
        text = calibrated_model.put(text, "water", found.water | {"model": STRUCTURED}, source=source(args), new=True)
        calibrated_model.write(args.out, text, "water", found.physical | {"speed_error": left}, {}, args.data)
    return {
        "estimates": plain(found.physical),
        "coefficients": plain(found.coefficients),
        "speed_error": left._asdict(),
        "swims": swims,
        "words": words,
        "doubts": doubts,
        "poor": poor,
        "report": page,
        "skipped": logs.broken,
    }


def run_mass(args) -> Answer:
    """Masses, balance and yaw inertia from the page of weighings."""
    robot = load_robot(args.model)
    found = mass.calibrate(args.data, robot)
    links = [{"link": name, "mass [kg]": m, "com from its front [m]": c} for name, (m, c) in found.links.items()]
    console.say(console.table(rows(found.estimates)), "", console.table(links))
    if args.out:
        text = calibrated_model.start(args.out, args.model)
        for name, (m, c) in found.links.items():
            weighed = {"mass": calibrated_model.short(m), "com": calibrated_model.short(c)}
            text = calibrated_model.put(text, "link", weighed, name, source=source(args))
        total = sum(calibrated_model.short(m) for m, _ in found.links.values())
        text = calibrated_model.put(text, "body", {"mass_total": total}, source=source(args))
        extra = found.estimates["yaw_inertia"]
        beyond = {"yaw_inertia.inertia": extra} if extra.low > 0 or extra.high < 0 else {}
        calibrated_model.write(args.out, text, "mass", found.estimates, beyond, args.data)
    tables = {"Whole fish": rows(found.estimates), "Links": links}
    fit_plots.report(args.report, "Mass calibration", tables, None, [str(args.data)])
    return {"estimates": plain(found.estimates), "links": links}


def plain(estimates: dict[str, ParameterEstimate]) -> dict[str, dict]:
    """Estimates as plain data for JSON."""
    return {name: e._asdict() for name, e in estimates.items()}


VERBS = {"servo": run_servo, "latency": run_latency, "slip": run_slip, "water": run_water, "mass": run_mass}


def default_report(verb: str) -> Path:
    """Default folder of the report."""
    return Path("runs") / "calibrate" / verb


def check_one(true: dict[str, float], logs: Logs, plant: ServoStand) -> Off:
    """Calibrates servo and latencies of a robot with given numbers; returns the errors."""
    found = servo_fit.calibrate(logs, plant, alone=False)
    fitted = found.estimates | {"camera_latency": servo_fit.calibrate_latency(logs, found).estimates["camera_latency"]}
    wide = {name: widened(e) for name, e in fitted.items()}
    return {
        name: [e.value - true[name], true[name], bool(wide[name].low <= true[name] <= wide[name].high)]
        for name, e in fitted.items()
    }


def check_rows(robots: list[Off]) -> list[dict]:
    """Rows over all robots: mean and RMS error, share inside the 90 % interval."""
    off = {name: [robot[name] for robot in robots] for name in robots[0]}
    return [
        {
            "number": name,
            "robots": len(cases),
            "mean error": float(np.mean([a for a, _, _ in cases])),
            "RMS error": float(np.sqrt(np.mean([a * a for a, _, _ in cases]))),
            "RMS error %": float(100 * np.sqrt(np.mean([(a / b) ** 2 for a, b, _ in cases]))),
            "inside": float(np.mean([c for _, _, c in cases])),
        }
        for name, cases in off.items()
    ]
