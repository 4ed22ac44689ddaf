"""`gap next` for a robot in MJCF: the experiment that separates the effects of a CLASS, or identifies the open parameters.

    CLASS     smallest distance, in standard deviations, between what an effect does and the nearest that a rival can do instead,
              over the pairs of the report
    numbers   0.5 log2 det (1 + S (J J^T) S) in bits, of all numbers of search/free_numbers.py: J (K, m) of the whitened
              readings, S their priors; logs that are there already count on both sides

Readings: those of an encoder with a noise of NOISE, in segments as the search takes them. Errors of their starts and torques that
no model explains are integrated out, for a CLASS also the tolerances of the constants.
"""

import shlex
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import write_text
from fishmj.gap import progress
from fishmj.gap.commands import reported
from fishmj.gap.commands.find_robot import read_logs, refuse_fish_options, searched_model
from fishmj.gap.experiment import ENOUGH, OPEN
from fishmj.gap.models.rigid_robot import AT, RigidRobot
from fishmj.gap.models.robot_description import RobotDescription, is_robot, read_robot
from fishmj.gap.models.robot_excitation import FAMILIES, RobotExperiment, rest_of, safe_experiments
from fishmj.gap.models.robot_sizes import RobotSizes, sizes_of
from fishmj.gap.null.whitening import residual_and_tangents, whitening
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.shooting import RobotRecord, robot_record, robot_records, thinned
from fishmj.gap.search.fit import bounds
from fishmj.gap.search.free_numbers import KINDS, effects_of, free_numbers
from fishmj.gap.wording import number, percent, title
from fishmj.log import Trial, numbered

NOISE = 5e-4  # rad or m of an encoder
SEGMENTS = 24  # segments of an experiment that are compared
TOLD = 0.5  # a number is identified if its sd is below this share of the prior's, as in calibrate model


class Score(NamedTuple):
    """Score of one experiment: sigma for a CLASS, bits for parameters. identified: how many it and the logs identify."""

    value: float
    identified: int = 0


def next_robot(args: Any) -> int:
    """Answers the command. args: of `gap next`. Returns the exit code."""
    refuse_fish_options(args, "gap next")
    if args.out and (args.out.suffix != ".csv" or args.out.exists()):
        raise ConfigError(f"{args.out}: exists, or does not end in .csv; choose another name with --out")
    families = FAMILIES if args.runs == "all" else tuple(name.strip() for name in args.runs.split(","))
    for name in families:
        if name not in FAMILIES:
            raise UnknownName("experiment", name, FAMILIES)
    robot, verdict, logs = _asked(args)
    if robot.thrusters or robot.base:
        text = "experiments are available for robots with a fixed base only, and this one floats or has thrusters"
        raise ConfigError(f"gap next: {robot.path}: {text}; fly it by its controller, with faster turns and climbs")
    pairs = pairs_of(verdict) if verdict else []
    if verdict and not pairs:
        none = "fewer than two explanations are left, so there is nothing to separate"
        wide = f"for the most informative experiment: fishmj gap next {shlex.quote(str(robot.path))} --out experiment.csv"
        console.say(f"{verdict['answer']}: {none}; nothing is written. {wide}")
        if args.json:
            console.emit_json({"answer": verdict["answer"], "experiments": []})
        return console.OK
    others = [questioned(robot, verdict, RobotSizes(*np.ones((4, len(robot.joints)))))[1]] if verdict else []
    made = safe_experiments(
        robot, rest_of(robot, args.speed), families, args.seconds, args.speed, args.seed, others, progress.terminal_bar
    )
    if not made:
        text = f"no experiment is safe at {args.speed:g} rad/s or m/s; allow more with --speed, or begin at another key frame"
        raise ConfigError(f"{robot.path}: {text}")
    records = [record_of_experiment(robot, one, args.seed) for one in made]
    sizes = sizes_of(robot, logs or records)
    with progress.terminal_bar(len(records), "scores", "experiments") as bar:
        scores = (
            separations(robot, verdict, pairs, sizes, records, bar) if verdict else informations(robot, sizes, records, logs, bar)
        )
    order = sorted(range(len(made)), key=lambda k: -scores[k].value)
    unit = "sigma" if verdict else "bits"
    rows = [_row(made[k], scores[k], unit) for k in order]
    console.say(console.table(rows[: args.top]))
    advised = _advice(made[order[0]], scores[order[0]], pairs)
    console.say(advised)
    if args.out:
        write(made[order[0]], robot, args.out)
        console.say(f"written: {args.out}, commands of {', '.join(robot.actuators)}; start from the robot's rest position")
    if args.json:
        console.emit_json({"answer": verdict["answer"] if verdict else "", "advice": advised, "experiments": rows})
    return console.OK


def _asked(args: Any) -> tuple[RobotDescription, dict | None, list[RobotRecord]]:
    """(robot, verdict of a report or None, existing logs)."""
    if is_robot(args.source):
        return read_robot(args.source), None, []
    if args.model is not None:
        given = SimpleNamespace(model=args.model, data=args.source, columns=args.columns, yes=args.yes)
        robot, _, trials, _ = read_logs(given)
        return robot, None, robot_records(trials, robot.dt, robot.channels)
    verdict = reported.robot_verdict(args.source) or {}
    return read_robot(searched_model(verdict)), verdict, []


def pairs_of(verdict: dict) -> list[tuple[str, str]]:
    """(effect, possible alternative) pairs of a verdict with alternatives."""
    known = effects.robot_catalogue()
    mine = {effect["name"] for effect in verdict["effects"]}
    rivals = [r for r in verdict["rivals"] if r["name"].partition(AT)[0] in known and r["instead_of"] in mine]
    return [(r["instead_of"], r["name"]) for r in rivals] if verdict["answer"] in OPEN else []


def record_of_experiment(robot: RobotDescription, one: RobotExperiment, seed: int) -> RobotRecord:
    """Record of an encoder with a noise of NOISE in an experiment."""
    noise = NOISE * np.random.default_rng([seed, 7]).standard_normal(one.q.shape)
    tables = {"cmd": {"t": one.t, **numbered("c#", one.commands)}, "joint": {"t": one.t, **numbered("j#", one.q + noise)}}
    trial = Trial({"origin": "synthetic"}, tables, name=one.family)
    return thinned([robot_record(trial, robot.dt, robot.channels)], SEGMENTS)[0]


def questioned(robot: RobotDescription, verdict: dict, sizes: RobotSizes) -> tuple[RigidRobot, Any, np.ndarray]:
    """(model with the effects of a verdict and their rivals, MjModel with the effects, parameter row with them)."""
    names = [effect["name"] for effect in verdict["effects"]] + [name for _, name in pairs_of(verdict)]
    kinds = dict.fromkeys(name.partition(AT)[0] for name in names)
    model = RigidRobot(robot, sizes, [e for e in effects.robot_catalogue().values() if e.name in kinds])
    row = model.nothing
    for effect in verdict["effects"]:
        for parameter, value in effect["parameters"].items():
            try:
                row[model.index(effect["name"], parameter)] = value["value"]
            except ValueError as error:
                raise ConfigError(f"{effect['name']!r}: not an effect of {robot.path.name} with its parameters") from error
    return model, model.model(row), row


def separations(
    robot: RobotDescription, verdict: dict, pairs: list, sizes: RobotSizes, records: Sequence[RobotRecord], bar
) -> list[Score]:
    """Score of each record for the pairs of a verdict."""
    model, _, row = questioned(robot, verdict, sizes)
    typical = bounds(model)[2]
    places = {e.name: [model.index(e.name, p.name) for p in e.parameters] for e in model.active.effects}
    out = []
    for k, record in enumerate(records):
        layout = ResidualLayout([record])
        _, tangents = residual_and_tangents(model, [record], layout, model.nothing)
        whiten = whitening(tangents, layout.noise(), model.record_errors([record], layout), layout.record)
        found = []
        for effect, rival in pairs:
            without = row.copy()
            without[places[effect]] = model.nothing[places[effect]]
            free = [p for e in (rival, *(x["name"] for x in verdict["effects"] if x["name"] != effect)) for p in places[e]]
            moved = np.tile(without, (len(free), 1))
            moved[np.arange(len(free)), free] += typical[free]
            rows = np.stack([without, row, *moved])
            z = whiten(layout.residuals(model.predict([record], rows)))
            change = z[1:] - z[0]
            found.append(_beyond(change[0], change[1:]))
        out.append(Score(min(found)))
        bar.update(k + 1)
    return out


def _beyond(change: np.ndarray, others: np.ndarray) -> float:
    """Norm of the part of a change (m,) orthogonal to the span of others (K, m)."""
    size = np.linalg.norm(others, axis=1, keepdims=True)
    basis = (others / np.maximum(size, 1e-12)).T
    weights, *_ = np.linalg.lstsq(basis, change, rcond=1e-6)
    return float(np.linalg.norm(change - basis @ weights))


def informations(
    robot: RobotDescription, sizes: RobotSizes, records: Sequence[RobotRecord], logs: Sequence[RobotRecord], bar
) -> list[Score]:
    """Score of each record for all open parameters of a description, in addition to the information of some logs."""
    model = RigidRobot(robot, sizes, effects_of(tuple(KINDS)))
    free = free_numbers(model, tuple(KINDS))
    sigma = np.array([n.sigma for n in free])
    rows = np.tile(model.nothing, (1 + len(free), 1))
    for k, n in enumerate(free):
        rows[1 + k, n.place] += n.step
    steps = np.array([n.step for n in free])[:, None]

    def information(record: RobotRecord) -> np.ndarray:
        layout = ResidualLayout([record])
        whiten = whitening(np.zeros((0, layout.size)), layout.noise(), model.record_errors([record], layout), layout.record)
        z = whiten(np.nan_to_num(layout.residuals(model.predict([record], rows))))
        slopes = (z[1:] - z[0]) / steps * sigma[:, None]
        return slopes @ slopes.T

    known = np.eye(len(free)) + sum((information(record) for record in logs), np.zeros((len(free), len(free))))
    before = np.linalg.slogdet(known)[1]
    out = []
    for k, record in enumerate(records):
        whole = known + information(record)
        count = int(np.sum(np.sqrt(np.diag(np.linalg.inv(whole))) < TOLD))
        out.append(Score(float(0.5 * (np.linalg.slogdet(whole)[1] - before) / np.log(2.0)), count))
        bar.update(k + 1)
    return out


def write(one: RobotExperiment, robot: RobotDescription, out: Path) -> None:
    """Writes the commands as CSV: t in s, then a column per actuator in the unit of its ctrl; each row holds until the next."""
    lines = [",".join(["t", *(f"cmd_{name}" for name in robot.actuators)])]
    lines += [",".join(f"{x:.6g}" for x in (t, *row)) for t, row in zip(one.t, one.commands, strict=True)]
    write_text(out, "\n".join(lines) + "\n")


def _row(one: RobotExperiment, score: Score, unit: str) -> dict:
    fast = {"fastest [rad/s or m/s]": float(np.abs(one.v).max()), "way [rad or m]": float(np.ptp(one.q, 0).max())}
    told = {"numbers told": score.identified} if unit == "bits" else {}
    return {"experiment": one.family, "size": percent(one.share), "s": float(one.t[-1]), unit: score.value} | told | fast


def _advice(best: RobotExperiment, score: Score, pairs: list[tuple[str, str]]) -> str:
    size = f"{best.family} at {percent(best.share)} of its span"
    if not pairs:
        return f"{size} is most informative: {number(score.value)} bits gained, {score.identified} parameters identified"
    which = "; ".join(f"{title(a)} or {title(b)}" for a, b in pairs)
    if score.value < ENOUGH:
        return f"no experiment decides between {which}: the best, {size}, reaches {number(score.value)} sigma; repeat it"
    return f"{size} decides between {which}: {number(score.value)} sigma apart"
