"""Builds a searchable `Study` from a study's file and its records: groups left out, baseline, candidates, floor.

built(read_study("my.toml"))
shipped("tail_fish")          a study that comes with fishmj, with its data in the folder FISHMJ_MEASURED
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.errors import LogError, UnknownName
from fishmj.effects.effect import Effect, Parameter
from fishmj.gap.measured import coast_down, study_body, study_servo
from fishmj.gap.measured.planar_body import Hull, PlanarBody
from fishmj.gap.measured.servo_model import OneServo, ServoMotor
from fishmj.gap.measured.study import Study
from fishmj.gap.measured.study_logs import Log, group_of, log_value, logs_of
from fishmj.gap.measured.study_schema import FOLDS, StudyInput, offered, read_study
from fishmj.gap.models.swimming_fish import Constant
from fishmj.log.limits import bare, quoted

SHIPPED = Path(__file__).resolve().parent / "shipped"
FAR = 1e4  # largest ratio of the nominal model's mean square error to the measured mean square
MASS, INERTIA, STALL = 0.725, 2.66e-3, 0.7  # kg, kg m2, N m: fish and servo of the sizes in the catalogue
TURN = 0.3  # prior of a constant, as a share of it


def shipped(name: str, changes: Mapping[str, Any] | None = None) -> StudyInput:
    """A study of a published set. changes: keys in place of its own, by block. Raises UnknownName: no study of this name."""
    known = sorted(path.stem for path in SHIPPED.glob("*.toml"))
    if name not in known:
        raise UnknownName("shipped study", name, known)
    return read_study(SHIPPED / f"{name}.toml", changes)


def deleted(name: str, constant: str) -> dict[str, Any]:
    """The changes that delete a constant from the baseline of a shipped study: it is zero, and no longer fitted."""
    fitted = shipped(name).given.baseline.fitted
    return {"nominal": {constant: 0.0}, "baseline": {"fitted": [c for c in fitted if c != constant]}}


def built(study: StudyInput) -> Study:
    """The study, ready for the search.

    Raises LogError: records that are missing or damaged, fewer than two groups, or none left to learn from.
    """
    logs = logs_of(study)
    groups = [group_of(log, study.given.groups.by) for log in logs]
    return {"body": _body, "servo": _servo, "coast": _coast}[study.given.plant](study, logs, groups)


def split(study: StudyInput, logs: Sequence[Log], records: Sequence[Any]) -> tuple[list, list, np.ndarray]:
    """(records to learn from, records kept aside, fold of each of the former)."""
    held = study.given.held_out
    groups = sorted({r.group for r in records})
    many = f"{study.where}: {len(records)} records"
    if len(groups) < 2:
        raise LogError(
            f"{many} of one group ({bare(groups[0])}), expected two at least: one validates the fit to the others. "
            'Record another condition, or let [groups] by distinguish the runs, such as by = ["file"]'
        )
    order = [groups[i] for i in np.random.default_rng(study.given.search.seed).permutation(len(groups))]
    if held.aside > len(groups) - 2:
        raise LogError(f"{many} of {len(groups)} groups, and [held_out] aside = {held.aside} leaves fewer than two; lower it")
    apart, rest = set(order[: held.aside]), order[held.aside :]
    where = {key: float(v) if isinstance(v, int) else v for key, v in held.where.items()}
    out = {log.name for log in logs if where and all(log_value(log, key) == value for key, value in where.items())}
    for key, value in where.items():
        if not out:
            seen = bare(", ".join(sorted({str(log_value(log, key)) for log in logs})), 120)
            raise LogError(f"{study.where} [held_out] where: no record has {quoted(key)} = {quoted(value)}; they have {seen}")
    # "name 3" is a run of the log "name"
    aside = [r for r in records if r.group in apart or {r.name, r.name.rpartition(" ")[0]} & out]
    taken = {id(r) for r in aside}
    learn = [r for r in records if id(r) not in taken]
    left = sorted({r.group for r in learn})
    if len(left) < 2:
        raise LogError(
            f"{many}, and {len(aside)} kept aside by [held_out] leave {len(left)} group(s), expected two; keep fewer aside"
        )
    if held.folds and held.folds > len(left):
        raise LogError(f"{study.where} [held_out] folds: {held.folds} of {len(left)} groups, expected at most so many, or 0")
    if held.folds == 1:
        raise LogError(f"{study.where} [held_out] folds: 1 leaves nothing to fit, expected 0 (each group in turn) or 2 and more")
    if not held.folds and len(left) > FOLDS:
        raise LogError(
            f"{study.where}: {len(left)} groups, expected at most {FOLDS} to leave out one by one; set [held_out] folds = 10"
        )
    fold = {g: i % held.folds for i, g in enumerate(rest)} if held.folds else {g: i for i, g in enumerate(left)}
    return learn, aside, np.array([fold[r.group] for r in learn])


def _terms(study: StudyInput, mass: float, length: float = 1.0) -> list[Effect]:
    """The candidates, with sizes scaled to this body."""
    c = study.given.candidates
    every = offered(study.given.plant)
    rivals = {e.name for e in every if e.source.startswith("none:")}
    chosen = [e for e in every if (c.only is None or e.name in c.only) and (c.rivals or e.name not in rivals)]
    chosen = [e for e in chosen if e.name not in c.leave_out]
    if len(chosen) < 2:
        raise LogError(f"{study.where} [candidates]: {len(chosen)} left, expected two at least, so that terms can be compared")
    return sized(chosen, mass, length)


def _constants(study: StudyInput) -> tuple[Constant, ...]:
    return tuple(Constant(name, TURN) for name in study.given.baseline.fitted)


def _protocol_text(study: StudyInput, records: Sequence[Any], what: str, error: str) -> tuple[str, ...]:
    """The protocol in words."""
    held, groups = study.given.held_out, {r.group for r in records}
    by = ", ".join(study.given.groups.by)
    aside = f"{held.aside} groups kept aside (seed {study.given.search.seed})" if held.aside else ""
    aside = aside or (
        f"records with {', '.join(f'{k} = {v}' for k, v in held.where.items())} kept aside" if held.where else "none kept aside"
    )
    folds = f"{held.folds} folds" if held.folds else "one group left out at a time"
    return (
        f"{what}, {len(groups)} groups (by {by}); {aside}, {folds}",
        error,
        f"baseline: {', '.join(study.given.baseline.fitted) or 'nothing'} fitted anew with every candidate",
    )


def _study(study: StudyInput, logs, records, plant, **more: Any) -> Study:
    learn, aside, fold = split(study, logs, records)
    search = study.given.search
    rest: dict[str, Any] = dict(ahead=search.ahead, rounds=search.rounds, origin=study.given.origin)
    rest["notes"] = tuple(note for log in logs for note in log.notes)
    ready = Study(name=study.given.name, plant=plant, learn=learn, aside=aside, fold=fold, **rest, **more)
    with np.errstate(all="ignore"):
        off = ready.error(learn, plant.null) / _size(ready)
    if not off < FAR:
        times = f"{np.sqrt(off):.3g} times the measured motion (rms)" if np.isfinite(off) else "infinite"
        raise LogError(
            f"{study.where} [nominal]: the guessed model's error is {times}, expected a guess right within a factor of ten; "
            "look for a unit in [columns] or [nominal], or a step too long for so light a body"
        )
    return ready


def _size(ready: Study) -> float:
    """Mean square of the measurements, in the units of `Study.error`."""
    sensors = [r.joint or r.pose for r in ready.learn]
    unit = [np.ones(s.values.shape[1]) if ready.unit else s.sigma for s in sensors]
    return float(np.mean([np.mean((s.values / u) ** 2) for s, u in zip(sensors, unit, strict=True)])) + ready.floor


def _body(study: StudyInput, logs: Sequence[Log], groups: Sequence[str]) -> Study:
    given, p = study.given, study.given.prediction
    records, dt = study_body.records(study, logs, groups)
    hull = Hull(**{name: given.nominal.get(name, 0.0) for name in Hull._fields})
    terms = _terms(study, *of_body(hull.mass, hull.inertia))
    plant = PlanarBody(hull, _constants(study), terms, dt, given.baseline.drive)
    noise = study_body.smoothed_noise(study, p.step or study_body.even_step(logs))
    records = study_body.with_scale(records, noise[0])
    scale = records[0].pose.sigma
    same = study_body.repeats(records, given.noise.near) if given.noise.replicates else 0.0
    if given.noise.replicates and not same and not noise[0].any():
        raise LogError(f"{study.where} [noise] replicates: no two runs of a group start alike; give position and heading instead")

    def floor(row: np.ndarray) -> tuple[float, str]:
        sensor = study_body.seen_noise(plant, records, row, noise) if noise[0].any() else 0.0
        alike = "runs of one group that start alike" if same > sensor else "the sensors' noise as stated"
        return max(sensor, same), alike

    nominal, of = floor(plant.null)
    told = _protocol_text(
        study,
        records,
        f"{len(records)} records, {sum(len(r.starts) for r in records)} runs of {p.horizon:g} s",
        f"error: mean of (ahead, left, turned)^2 / ({scale[0]:.3g} m, {scale[1]:.3g} m, {scale[2]:.3g} rad)^2 at a run's end",
    )
    return _study(
        study,
        logs,
        records,
        plant,
        error=partial(study_body.error, plant),
        floor=nominal,
        floor_of=of,
        floor_at=floor if noise[0].any() else None,
        replicates=same >= nominal,
        protocol=(*told, *(["stamps: corrected by the ratio of clocks that the trial states"] if p.clock else [])),
    )


def _mean_square(plant: Any, sensor: str, found: Sequence[Any], row: np.ndarray) -> float:
    """Mean over the records of the mean square error of a sensor, in its unit squared."""
    seen = plant.predict(list(found), row)
    return float(np.mean([np.mean((p[sensor][0] - getattr(r, sensor).values) ** 2) for p, r in zip(seen, found, strict=True)]))


def _servo(study: StudyInput, logs: Sequence[Log], groups: Sequence[str]) -> Study:
    nominal = study.given.nominal
    dt = study_servo.step(study, logs)
    records = study_servo.records(study, logs, groups, dt)
    motor = ServoMotor(**{name: nominal[name] for name in ServoMotor._fields})
    terms = _terms(study, motor.stall / STALL)
    centred = not study.given.prediction.as_logged
    plant = OneServo(motor, study_servo.rig(study), _constants(study), terms, dt, centred)
    whole = "whole logs" if not study.given.prediction.horizon else f"runs of {study.given.prediction.horizon:g} s"
    return _study(
        study,
        logs,
        records,
        plant,
        error=partial(_mean_square, plant, "joint"),
        floor=study_servo.noise(study)[1],
        floor_of="the encoder's noise and rounding as stated",
        replicates=False,
        unit="mrad",
        factor=1e3,
        protocol=_protocol_text(
            study,
            records,
            f"{len(logs)} logs, {len(records)} {whole}",
            "error: rms of measured minus simulated angle at the log's own stamps, free run from the first row",
        ),
    )


def _coast(study: StudyInput, logs: Sequence[Log], groups: Sequence[str]) -> Study:
    nominal = study.given.nominal
    longest = max(float(np.ptp(log.series["speed"].t)) for log in logs)
    longest = min(longest, study.given.prediction.horizon or longest)
    dt = float(np.clip(longest / 1500, 0.002, 0.2))
    records = coast_down.records(study, logs, groups, dt)
    rest = dict.fromkeys(Hull._fields, 0.0) | {"inertia": 1.0}
    hull = Hull(**(rest | {k: v for k, v in nominal.items() if k in rest}))
    mass = hull.mass / MASS
    terms = _terms(study, mass, mass ** (1 / 3))
    plant = coast_down.CoastDown(hull, _constants(study), terms, coast_down.range_of(records), dt)
    return _study(
        study,
        logs,
        records,
        plant,
        error=partial(_mean_square, plant, "pose"),
        floor=study.given.noise.speed**2,
        floor_of="the noise of the speed as stated",
        replicates=False,
        unit="m/s",
        protocol=_protocol_text(
            study,
            records,
            f"{len(records)} coasts, {sum(len(r.pose.t) for r in records)} speeds",
            "error: rms of measured minus simulated speed; the speed at the start of each coast is fitted to it under every law",
        ),
    )


def dimensions(unit: str) -> tuple[int, int]:
    """Powers of kg and m of a unit such as "N s2/m2"."""
    mass = length = 0
    top, _, bottom = unit.partition("/")
    for text, sign in ((top, 1), (bottom, -1)):
        for symbol, power in re.findall(r"(kg|N|m)(\d?)(?![a-z])", text):
            n = sign * int(power or 1)
            mass += n if symbol in ("kg", "N") else 0
            length += n if symbol in ("m", "N") else 0
    return mass, length


def sized(terms: Iterable[Effect], mass: float, length: float = 1.0) -> list[Effect]:
    """The same terms for a body `mass` times as heavy and `length` times as long: bounds and typical sizes scale, times stay.

    They scale by the powers in their units: N s2/m2 = kg/m times mass / length, N m s = kg m2/s times mass length^2.
    """
    if mass == length == 1.0:
        return list(terms)
    return [replace(e, parameters=tuple(_scaled(p, mass, length) for p in e.parameters)) for e in terms]


def _scaled(p: Parameter, mass: float, length: float) -> Parameter:
    if p.null:  # such as a torque that means "no limit": the formula knows it as a number
        return p
    kg, m = dimensions(p.unit)
    k = mass**kg * length**m
    return replace(p, low=k * p.low, high=k * p.high, typical=(k * p.typical[0], k * p.typical[1]))


def of_body(mass: float, inertia: float) -> tuple[float, float]:
    """(mass, length) over those of the fish."""
    return mass / MASS, math.sqrt((inertia / INERTIA) / (mass / MASS))
