"""`gap find LOGS --model robot.xml`: the effects that the simulation of a robot in MJCF or URDF lacks.

LOGS has a column for each joint's position and each actuator's command (records/robot_logs.py).
"""

import hashlib
import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.calib import resolve
from fishmj.base.compile_cache import cache_folder
from fishmj.base.cores import one_blas_thread
from fishmj.base.errors import ConfigError, LogError, StoreError
from fishmj.base.store import read_npz, sha256, write_json, write_npz, write_text
from fishmj.effects.effect import kind_of
from fishmj.gap import progress
from fishmj.gap.commands.admit_robot import refuse_mistakes
from fishmj.gap.decide.implausible import OVERSIZED, with_oversized
from fishmj.gap.decide.indistinguishable import with_indistinguishable
from fishmj.gap.localise.robot_localisation import RobotLocalisation, localise_robot
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import RobotDescription, read_robot, robot_file
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.models.search_step import coarsest
from fishmj.gap.null.null_runs import cache_path, digest
from fishmj.gap.null.robot_null import RobotNull
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.records.robot_logs import (
    POSE,
    LogTable,
    RobotColumns,
    contents,
    guess_columns,
    in_parts,
    log_files,
    read_columns,
    read_robot_logs,
    read_sheet,
)
from fishmj.gap.records.shooting import RobotRecord, robot_records
from fishmj.gap.report.robot_page import write_robot_page
from fishmj.gap.search.shared_effects import at_many_joints, site_of
from fishmj.gap.search.unexplained_torque import with_measured_errors
from fishmj.gap.thresholds import Gates, frozen, thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import number, title
from fishmj.gap.workflow import Inquiry, investigate, set_aside
from fishmj.log import Trial, stacked
from fishmj.log.importers.column_map import Column, Stamp
from fishmj.log.limits import bare
from fishmj.log.trial import readings_sha256

FISH_ONLY = {"same_robot": False, "water": "structured", "null": None, "healthy": None, "mass_unknown": False, "effects": None}
GAINS = ("servo_gain", "servo_damping_gain")
SHOWN_AS_ZERO = 0.005  # a probability below it is printed as 0.00
MOST_SAID = 10  # largest number of printed notes on logs
HOLE = 10  # steps between two rows, in units of the usual one, from which rows are missing


def find(args: Any) -> int:
    """Answers the command. args: of `gap find`. Returns the exit code."""
    refuse_fish_options(args, "gap find")
    if getattr(args, "write_map", None):
        return write_map(args)
    robot, files, trials, broken = read_logs(args)
    if len(trials) < 2:
        raise LogError(f"{args.data}: {len(trials)} log can be read; at least two are needed: one to fit, one to validate")

    def answered(inquiry: Inquiry, place: RobotLocalisation | None = None) -> dict:
        """Writes the answer and returns it for JSON."""
        told = told_of(inquiry, place)
        if args.out:
            args.out.mkdir(parents=True, exist_ok=True)
            rest = dict(zip(robot.sites("joint"), inquiry.evidence.model.rest, strict=True))
            write_json(args.out / "verdict.json", told | {"context": context_of(args, robot, files, inquiry) | {"rest": rest}})
        return told

    with interrupt.keeping(words):
        inquiry = search(robot, trials, args, answered)
        console.say(inquiry.verdict.text())
        answered(inquiry)
        place = console.after_answer("the place of the gap", lambda: place_of(inquiry), None)
        told = answered(inquiry, place)
        console.say(*(f"  {title(name)}: {answer}" for name, answer in told["by_effect"].items()))
        none: list[str] = []
        console.say(*(f"  {line}" for line in console.after_answer("the servos' gains", lambda: servo_gains(inquiry), none)))
        if place is not None:
            console.say(console.after_answer("the place of the gap", lambda: f"  {place_text(inquiry.verdict, place)}", ""))
        if place is not None and args.out:
            page = lambda: write_robot_page(inquiry, place, told["by_effect"], args.out)
            console.say(f"written: verdict.json, {console.after_answer('the report', page, 'no report')}")
    if args.json:
        console.emit_json(told | {"skipped": broken, "notes": list(robot.notes)})
    return console.OK


def words() -> str:
    """Message of an interrupted search."""
    done = "the finished null runs and measured torques"
    return f"{cache_folder() / 'null'} holds {done}; the same command continues from them and repeats the rounds of the search"


def read_logs(args: Any) -> tuple[RobotDescription, list[Path], list[Trial], dict[str, str]]:
    """(robot, files, readable trials, {file name: why it is unreadable}) of --model, the data and --columns."""
    robot = read_robot(robot_file(args.model))
    files = log_files(args.data)
    trials, broken = read_robot_logs(files, columns_of(args, robot, files))
    said = list(dict.fromkeys(note for trial in trials for note in trial.notes))
    more = [f"{len(said) - MOST_SAID} more notes on logs"] if len(said) > MOST_SAID else []
    for note in (*robot.notes, *(f"{name} left out: {why}" for name, why in broken.items()), *said[:MOST_SAID], *more):
        console.warn(note)
    if trials:
        console.say(ranges_of(robot, trials))
    if len(trials) == 1 and len(parts := in_parts(trials[0])) > 1:
        console.say(f"only one log: cut into {len(parts)} parts, to fit some and validate on the others")
        trials = parts
    return robot, files, trials, broken


def ranges_of(robot: RobotDescription, trials: list[Trial]) -> str:
    """Sentence on the length, step and gaps of the logs and on each channel's range, for the user to check."""
    steps = np.concatenate([np.diff(np.asarray(trial.tables["joint"]["t"], float)) for trial in trials])
    step = float(np.median(steps))
    holes = steps[steps > HOLE * step]
    long, word = steps.sum() - holes.sum(), "hole" if len(holes) == 1 else "holes"
    lost = f", {len(holes)} {word} of {holes.sum():.3g} s left out" if len(holes) else ""
    parts = []
    for j, name in enumerate(joint.name for joint in robot.joints):
        values = np.concatenate([stacked(trial.tables["joint"], "j#")[:, j] for trial in trials])
        parts.append(f"{name} {values.min():.4g} to {values.max():.4g}")
    read = f"read: {len(trials)} logs, {long:.4g} s{lost}, a row every {1e3 * step:.4g} ms"
    return f"{read}; rad or m: {', '.join(parts) or 'no joint'}"


def refuse_fish_options(args: Any, command: str) -> None:
    """Raises ConfigError for an option that applies to fish only."""
    for option, usual in FISH_ONLY.items():
        if getattr(args, option, usual) not in (usual, []):
            raise ConfigError(f"{command}: --{option.replace('_', '-')} is for fish only; leave it out with {args.model}")


def columns_of(args: Any, robot: RobotDescription, files: list[Path]) -> RobotColumns:
    """Columns of the map, or guessed, shown and confirmed. Raises LogError."""
    joints, actuators = tuple(j.name for j in robot.joints), robot.actuators
    if args.columns:
        found = read_columns(args.columns, joints, actuators, robot.base is not None, list(read_sheet(files[0]).columns))
        console.say("columns of the map:", *(f"  {row}" for row in found.rows()))
    else:
        sheet = read_sheet(files[0])
        try:
            found = guessed(robot, sheet, joints, actuators)
        except LogError as error:
            todo = shlex.join(["fishmj", "gap", "find", str(args.data), "--model", str(args.model), "--write-map", "MAP.toml"])
            raise LogError(f"{sheet.where}: {error}; write a map to complete with: {todo}") from error
        console.say("columns, guessed by name:", *(f"  {row}" for row in found.rows()))
        if not args.yes and not console.confirmed("Is that right?"):
            raise LogError("the columns were only guessed; accept them with --yes, or name them in a map, --columns MAP.toml")
    for doubt in found.doubts():
        console.warn(doubt)
    return found


def guessed(robot: RobotDescription, sheet: LogTable, joints: Sequence[str], actuators: Sequence[str]) -> RobotColumns:
    """Columns of a log by name, of some joints and actuators. Raises LogError."""
    torques = not robot.model.actuator_biasprm[:, 1].any()
    units = {name: own.units.get(column, "") for name, (own, column) in sheet.columns.items()}
    of_actuator = {robot.actuators[j.actuator]: j.name for j in robot.joints if j.actuator >= 0}
    driven = [of_actuator[name] for name in actuators] if set(actuators) <= set(of_actuator) else ()
    return guess_columns(list(sheet.columns), joints, actuators, torques, units, robot.base is not None, driven)


def write_map(args: Any) -> int:
    """Writes --write-map: the guess of the first log, a commented line for each column without one. Returns the exit code."""
    path, robot = args.write_map, read_robot(robot_file(args.model))
    if path.exists():
        raise LogError(f"{path}: exists and may contain your edits; choose another name for the map, or remove it first")
    sheet = read_sheet(log_files(args.data)[0])
    sites = {"joint": tuple(j.name for j in robot.joints), "actuator": robot.actuators, "base": POSE if robot.base else ()}
    known, why = dict[str, dict[str, Column]](), dict[str, str]()
    time = ""
    for table in ("joint", "actuator"):
        try:
            found = guessed(robot, sheet, *(sites[t] if t == table else () for t in ("joint", "actuator")))
            known |= {table: getattr(found, table), "base": found.base}
            time = f"time = {_inline(found.time)}"
        except LogError as error:
            why[table] = str(error)
    lines = [f"# columns of {bare(sheet.where)}: {', '.join(map(bare, sheet.columns))}", time or '# time = "COLUMN"']
    for table, names in sites.items():
        lines += [f"[{table}]"] * bool(names)
        mine = known.get(table, {})
        lines += [f"{json.dumps(n)} = {_inline(mine[n])}" if n in mine else f'# {json.dumps(n)} = "COLUMN"' for n in names]
    write_text(path, "\n".join(lines) + "\n")
    for text in why.values():
        console.warn(text)
    left = sum(line.endswith('= "COLUMN"') for line in lines)
    todo = f"add the {left} columns that were not guessed, then" if left else "check it, then"
    command = shlex.join(["fishmj", "gap", "find", str(args.data), "--model", str(args.model), "--columns", str(path)])
    console.say(f"written: {path}; {todo}: {command}")
    if args.json:
        console.emit_json({"map": path, "open": left})
    return console.OK


def _inline(column: Column | Stamp) -> str:
    """A column in the notation of the map."""
    told = {key: getattr(column, key) for key in ("column", "unit", "scale")}
    kept = {key: value for key, value in told.items() if key == "column" or value not in ("", 1.0, None)}
    return f"{{ {', '.join(f'{key} = {json.dumps(value, ensure_ascii=False)}' for key, value in kept.items())} }}"


@one_blas_thread()
def search(
    robot: RobotDescription, trials: list, args: Any, answered: Callable[[Inquiry], Any] = lambda inquiry: None
) -> Inquiry:
    """Searches the logs. answered: as for `investigate`; equivalent effects are compared after it."""
    gates = robot_gates()
    null = RobotNull(args.null_runs, args.noise, args.seed)
    records = robot_records(trials, robot.dt, robot.channels)
    logged = sum(float(np.ptp(trial.tables["joint"]["t"])) for trial in trials)
    console.say(
        f"compared: {sum(len(r.starts) for r in records)} segments, {sum(r.seconds for r in records):.0f} of {logged:.0f} s,"
        " spread evenly"
    )
    seen = [r for r, aside in zip(records, set_aside(records, args.seed), strict=True) if not aside]
    robot.check_contact(seen)
    refuse_mistakes(robot, seen, args.anyway)
    sizes = sizes_of(robot, seen)
    inert = RigidRobot(robot, sizes).inert(seen)
    if inert:
        console.say(f"left out, because they change no reading by more than its noise: {', '.join(sorted(map(title, inert)))}")
    started = RigidRobot(robot, sizes, without=inert, stride=coarsest(robot, sizes, seen, inert))
    model = with_kept_errors(started, trials, seen, null)
    found = investigate(
        model,
        trials,
        gates=gates if args.most is None else replace(gates, max_effects=args.most),
        null=null,
        mass_known=False,
        seed=args.seed,
        say=console.say,
        bars=progress.terminal_bar,
        answered=answered,
        notes=robot.notes,
    )
    e = found.evidence
    compare = lambda: with_indistinguishable(found.verdict, e.model, e.records, found.gates, args.seed)
    verdict = console.after_answer("the comparison with equivalent effects", compare, found.verdict)
    return replace(found, verdict=without_stand_in(with_oversized(verdict, e.model.active)))


def with_kept_errors(model: RigidRobot, trials: Sequence[Trial], seen: Sequence[RobotRecord], null: RobotNull) -> RigidRobot:
    """The model with the measured errors of its torques. These and the null runs are cached."""
    path = cache_path(search_key(model, trials, seen, null))
    try:
        kept = read_npz(path)
    except StoreError:
        kept = {}
    layout = ResidualLayout(list(seen))
    if "runs" in kept:
        null.kept[null.key(model, seen, layout)] = kept["runs"]
    else:
        kept["runs"] = null.residuals(model, list(seen), layout, progress.terminal_bar)
        write_npz(path, kept)
    if "torque" in kept:
        return model.with_errors(kept["torque"], kept["reference"])
    measured, _ = with_measured_errors(model, seen, null, progress.terminal_bar)
    write_npz(path, kept | {"torque": measured.torque_error, "reference": measured.reference})
    return measured


def search_key(model: RigidRobot, trials: Sequence[Trial], seen: Sequence[RobotRecord], null: RobotNull) -> str:
    """Hash of what null runs and torques depend on: robot, effects, logs, settings, code, tolerances."""
    compiled = np.empty(mujoco.mj_sizeModel(model.robot.model), np.uint8)
    mujoco.mj_saveModel(model.robot.model, None, compiled)
    effects = [(x.name, repr(x.parameters)) for x in model.active.effects]
    logs = [readings_sha256(trial) for trial in trials], [r.name for r in seen]
    made = digest("fishmj.gap.commands.find_robot"), sha256(resolve("robot")), sha256(resolve("gap"))
    told = [*made, model.fingerprint, model.dt, model.robot.delays.tolist(), effects, logs, null.runs, null.noise, null.seed]
    return hashlib.sha256(json.dumps(told).encode() + compiled.tobytes()).hexdigest()[:32]


def robot_gates() -> Gates:
    """The gates for a robot in MJCF, whose noise is estimated from its own logs."""
    own = thresholds().torques
    asked = dict(gain=own.gain, min_joint_gain=own.min_joint_gain, min_gain_per_sample=own.min_gain_per_sample)
    return replace(frozen(), rival_margin_abs=own.lead, **asked)


def searched_model(verdict: dict) -> Path:
    """The description that was searched. verdict: of verdict.json. Raises ConfigError: it changed since then."""
    path = Path(verdict["context"]["model"])
    if not path.is_file() or sha256(path) != verdict["context"]["model_sha256"]:
        raise ConfigError(f"{path}: missing or changed since the search; search again, or restore the searched model")
    return path


def logs_digest(files: list[Path]) -> str:
    """sha256 of the logs' contents."""
    return hashlib.sha256(b"".join(hashlib.sha256(contents(path)).digest() for path in files)).hexdigest()


def context_of(args: Any, robot: RobotDescription, files: list[Path], inquiry: Inquiry) -> dict:
    """Inputs of the search, and the logs set aside (or else the first fold), for gap apply and gap check."""
    return {
        "model": str(robot.path.resolve()),
        "model_sha256": sha256(robot.path),
        "data": str(args.data.resolve()),
        "columns": str(args.columns.resolve()) if args.columns else "",
        "data_sha256": logs_digest(files),
        "judged": inquiry.judged,
        "null": {"runs": args.null_runs, "noise": args.noise, "seed": args.seed},
    }


def doubted(verdict: Verdict) -> set[str]:
    """Effects of a verdict that have a rival or that are found together with an implausible one."""
    return beside_unbelievable(verdict) | {
        e.name for e in verdict.effects if len(verdict.standing(e)) > 1 or e.p_best < frozen().p_best
    }


def beside_unbelievable(verdict: Verdict) -> set[str]:
    """Effects of a verdict with an implausible value, and the effects that these may distort.

    Those are all effects; on a robot of many joints, only the ones at the same joint.
    """
    names = [e.name for e in (*verdict.effects, *verdict.tentative)]
    bad = {name for name in names if any(w.startswith(f"{title(name)}: ") for w in verdict.warnings)}
    if at_many_joints(names):
        return {name for name in names if any(site_of(b) in ("", site_of(name)) for b in bad)}
    return set(names) if bad else set()


def by_effect(verdict: Verdict) -> dict[str, str]:
    """{effect: NAMED or CLASS}, since one may be certain and another not; {} for other answers."""
    if verdict.answer not in ("NAMED", "CLASS"):
        return {}
    open_ones = doubted(verdict)
    return {e.name: "CLASS" if e.name in open_ones else "NAMED" for e in verdict.effects}


def without_stand_in(verdict: Verdict) -> Verdict:
    """The verdict, changed to UNEXPLAINED if an accepted value, also of an effect that is counted in, is implausible.

    An implausible value that is not too large is accepted beside a possible rival. On a robot of many joints, effects at other
    joints stay as they are.
    """
    possible = any(r["p_best"] >= SHOWN_AS_ZERO for r in verdict.rivals) or any(
        e.p_best < frozen().p_best for e in verdict.effects
    )
    oversized = any(OVERSIZED in w for w in verdict.warnings)
    if verdict.answer not in ("NAMED", "CLASS") or not oversized and (possible or verdict.answer == "NAMED"):
        return verdict
    doubtful = beside_unbelievable(verdict)
    if kept := tuple(e for e in verdict.effects if e.name not in doubtful):
        others = tuple(e for e in verdict.effects if e.name in doubtful)
        why = "explains records that it was not fitted to, and nothing else does; effects with an implausible value are tentative"
        answer, why = ("CLASS", verdict.reason) if possible else ("NAMED", why)
        return replace(verdict, answer=answer, reason=why, effects=kept, tentative=(*verdict.tentative, *others))
    why = "an accepted effect has an implausible value (see the warning) and probably imitates something else; it is tentative"
    return replace(verdict, answer="UNEXPLAINED", reason=why)


def servo_gains(inquiry: Inquiry) -> list[str]:
    """Lines of kp and kv as in MJCF, stated and fitted, of each servo with an effect on its gains."""
    e, verdict = inquiry.evidence, inquiry.verdict
    stated, fitted = e.model.robot.model, e.model.model(inquiry.found.best.row)
    sites = {site_of(x.name) for x in (*verdict.effects, *verdict.tentative) if kind_of(x.name) in GAINS}
    value = lambda m, a, k: number(-m.actuator_biasprm[a, k])
    return [
        f"{joint.name}: kp {value(stated, a, 1)} -> {value(fitted, a, 1)}, kv {value(stated, a, 2)} -> {value(fitted, a, 2)}"
        for joint in e.model.robot.joints
        if joint.name in sites and stated.actuator_biasprm[a := joint.actuator, 1]
    ]


def place_of(inquiry: Inquiry) -> RobotLocalisation:
    """Place of the gap of the model as it is."""
    e = inquiry.evidence
    residual = e.layout.residuals(e.model.predict(e.records, e.model.null))[0]
    rates = dict(zip(e.model.robot.channels, e.model.sizes.rate.tolist(), strict=True))
    return localise_robot(e.layout, residual, e.scale, rates)


def place_text(verdict: Verdict, place: RobotLocalisation) -> str:
    """Place of the gap in words; for AGREES, with a note that the stated tolerances explain the residual above the floor."""
    explained = verdict.answer == "AGREES" and any(place.joints.values())
    return f"{place.text}{'; the stated tolerances explain all of it' if explained else ''}"


def told_of(inquiry: Inquiry, place: RobotLocalisation | None) -> dict:
    """The answer for JSON: the verdict, the answer for each effect, and the place of the gap, once known."""
    where = {"localisation": place._asdict() | {"text": place.text}} if place else {}
    return inquiry.verdict.plain() | {"by_effect": by_effect(inquiry.verdict)} | where
