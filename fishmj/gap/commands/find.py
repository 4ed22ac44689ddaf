"""`gap find DATA`: the effect that the model lacks, with its size, its rivals and the gap before and after.

    fishmj gap find DATA --model my_fish.toml --out report
    fishmj gap find LOGS --model robot.xml --out report        a robot in MJCF or URDF, or menagerie:NAME

LOGS of such a robot: a folder of CSV, Parquet, .npz, MCAP or rosbag2 files, one per log, or a LeRobot data set.

MAP.toml of --columns, for such a robot: time = "t"; [joint] elbow = { column = "q2", unit = "deg" }; [actuator] elbow = "tau2"

Exit codes: 0 an answer, 2 bad input, 3 records too few, too short or too quiet, or a gap too large for any effect.
"""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from fishmj.base import console, interrupt
from fishmj.base.calib import read_toml, resolve
from fishmj.base.compile_cache import cache_folder
from fishmj.base.errors import ConfigError, LogError
from fishmj.base.store import clear, left_out, shipped, write_json
from fishmj.engines import own_effects
from fishmj.gap import progress
from fishmj.gap.commands import admission, gap_options, model_version
from fishmj.gap.commands.apply import settle
from fishmj.gap.commands.check import measured
from fishmj.gap.localise.swimming_speed import speeds_text, steady_speeds
from fishmj.gap.models.robot_description import is_robot
from fishmj.gap.null.null_runs import null_of
from fishmj.gap.records import datasets
from fishmj.gap.search import healthy_swims
from fishmj.gap.search.likelihood import likelihood_of
from fishmj.gap.thresholds import frozen
from fishmj.gap.verdict import Verdict
from fishmj.gap.wording import level
from fishmj.gap.workflow import Inquiry, compile_kernel, investigate
from fishmj.log import Trial
from fishmj.log.dataset import Taken
from fishmj.log.trial import readings_sha256
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED, as_described


def main(argv: list[str]) -> int:
    """The command `gap find`. Returns the exit code."""
    parser = console.parser("gap find", __doc__)
    add = parser.add_argument
    forms = "a folder of trial folders (fishmj.log import makes one), or a bundle (.npz)"
    data = f"data set: {forms}; measurements.toml in it holds the weighings (docs/search/logs.md)"
    add("data", type=console.path, help=data)
    model = "the model to search: shipped name or TOML file of a fish (default fish); MJCF or URDF of a robot"
    add("--model", type=console.text, default="fish", help=model)
    gap_options.of_robot(add)
    water = "replace the model's water by a fitted one without a learnt force, such as swift-base (default structured: keep it)"
    add("--water", type=console.text, default="structured", help=water)
    nulls = "folder of recorded null sets, such as data/gap/lbm/nulls of the flow solver (default: simulate new null runs)"
    add("--null", type=console.path, metavar="FOLDER", help=nulls)
    swum = "the healthy swims that the water was calibrated to; their misfit sets the usual gap of this robot"
    add("--healthy", type=console.path, metavar="DATA", help=f"{swum} (default none)")
    out = "folder for report.html, verdict.json and model.patched.toml (or model.rejected-*.toml); default none"
    add("--out", type=console.out_folder, help=out)
    gap_options.of_mass(add)
    gap_options.of_null(add)
    most = f"largest number of effects to add, 1 to {gap_options.MOST_EFFECTS} (default {frozen().max_effects})"
    most += "; one kind at many joints counts once"
    add("--most", type=console.whole(1, gap_options.MOST_EFFECTS), default=None, metavar="N", help=most)
    add("--anyway", action="store_true", help="search although model and logs differ too much")
    gap_options.of_columns(add)
    gap_options.of_written_map(add)
    own_effects.option(parser)
    args = parser.parse_args(argv)
    if is_robot(args.model):
        from fishmj.gap.commands.find_robot import find

        gap_options.there(args.columns, args.data)
        return find(args)
    if args.write_map:
        raise ConfigError(f"gap find: --write-map is for robots in MJCF; for a fish ({args.model}) use fishmj log import")
    args.null = args.null and shipped(args.null)
    gap_options.there(args.null, args.healthy, args.data if left_out(args.data) else None)
    own_effects.join(args.effects)
    robot = as_described(load_robot(args.model), args.water)
    admission.searchable(robot, args.model)
    null = null_of(drawn_of(args))
    admission.null_fits(null, robot, args.model)
    given, notes = admission.admitted(args.data, robot, args.model, args.same_robot, args.anyway)
    healthy = swims(args, robot)
    refuse_shared(args, healthy, given)
    notes = (*notes, *absorbed(args, given))
    lacking = admission.insufficient_data(given, robot)
    if lacking is not None:
        console.say(lacking.text())
        if args.json:
            console.emit_json(asdict(lacking) | {"skipped": given.broken})
        return console.CANNOT_TELL

    def answered(inquiry: Inquiry) -> None:
        """Prints and writes the answer before any advice is computed."""
        first.append(inquiry.verdict.text())
        console.say(*first)
        if args.out:
            write_answer(inquiry.verdict, args.out, context_of(inquiry, args, given))

    first: list[str] = []
    try:
        with interrupt.keeping(words):
            inquiry = search(args, robot, given, notes, healthy, answered)
    except admission.TooDifferent as different:
        return different.report(args.json, skipped=given.broken)
    with interrupt.keeping(words):
        console.say(*added_lines(inquiry.verdict.text(), first), *speeds(inquiry))
        if args.out:
            console.say(f"written: {', '.join(write(inquiry, args.out, context_of(inquiry, args, given)))}")
    if args.json:
        console.emit_json(inquiry.verdict.plain() | {"skipped": given.broken, "notes": list(notes)})
    return console.OK


def added_lines(text: str, before: Sequence[str]) -> list[str]:
    """Lines of `text` that were not printed before."""
    printed = {line for old in before for line in old.splitlines()}
    return [line for line in text.splitlines() if line not in printed]


def speeds(inquiry: Inquiry) -> list[str]:
    """Line on the swimming speeds of the searched records; empty without steady swims."""
    e = inquiry.evidence
    measure = lambda: speeds_text(steady_speeds(e.records, e.model.predict(e.records, inquiry.found.base.row)))
    text = console.after_answer("the comparison of swimming speeds", measure, "")
    return [f"  {text}"] if text else []


def words() -> str:
    """Message of an interrupted search."""
    return f"{cache_folder() / 'null'} holds the finished null runs; the same command continues from them"


def swims(args, robot: Robot) -> list[Trial]:
    """Trials of --healthy. Raises ConfigError if the model has no calibrated water, LogError if none can be compared."""
    if args.healthy is None:
        return []
    if robot.water.get("model") != STRUCTURED:
        todo = shlex.join(["fishmj", "calibrate", "water", str(args.healthy)])
        why = f"the water of {args.model} was not calibrated; {todo} calibrates it to these swims"
        raise ConfigError(f"gap find: --healthy {args.healthy}: {why}")
    return list(admission.admitted(args.healthy, robot, args.model, args.same_robot)[0].trials.values())


def refuse_shared(args, healthy: Sequence[Trial], given: Taken) -> None:
    """Raises LogError if swims of --healthy are among the searched trials: their gap would count as usual."""
    searched = {readings_sha256(trial): name for name, trial in given.trials.items()}
    both = [f"{t.name} ({searched[h]} of {args.data})" for t in healthy if (h := readings_sha256(t)) in searched]
    if both:
        number = f"{len(both)} of {len(healthy)} trials have the readings of searched ones: {', '.join(both[:3])}"
        more = ", .." if len(both) > 3 else ""
        raise LogError(
            f"gap find: --healthy {args.healthy}: {number}{more}; give swims recorded before"
            " anything was wrong, in a separate folder"
        )


def absorbed(args, given: Taken) -> tuple[str, ...]:
    """Warning, printed too, that the model's water was calibrated on the searched data; empty if it was not."""
    block = read_toml(resolve(args.model, robot=True)).get("calibration", {}).get("water", {})
    evidence, source = block.get("manifest_sha256", ""), block.get("source", "")
    same = evidence == given.sha256 if evidence else bool(source) and Path(str(source)).resolve() == args.data.resolve()
    if not same:
        return ()
    note = (
        f"the water of {args.model} was calibrated on the searched data ({args.data}): the calibration has absorbed part"
        " of a missing effect, and the search may name only the rest; search logs that it was not calibrated on"
    )
    console.warn(note)
    return (note,)


def speed_error_of(model: str) -> float | None:
    """Mean relative speed error that `calibrate water` wrote into a description; None if it did not, or another wrote none."""
    block = read_toml(resolve(model, robot=True)).get("calibration", {}).get("water", {}).get("speed_error", {})
    value = block.get("value") if isinstance(block, dict) else None
    return float(value) if isinstance(value, int | float) and 0.0 < value < 10.0 else None


def search(
    args, robot: Robot, given: Taken, notes: tuple[str, ...] = (), healthy: Sequence[Trial] = (),
    answered: Callable[[Inquiry], None] = lambda inquiry: None,
) -> Inquiry:  # fmt: skip
    """Searches the admitted trials. healthy: swims of the water's calibration. answered: as for `investigate`.

    Raises TooDifferent: the gap is larger than any missing effect explains.
    """
    from fishmj.gap.models.swimming_fish import SwimmingFish

    model, null = SwimmingFish(robot), null_of(drawn_of(args))
    own = None
    if healthy:
        compile_kernel(model, console.say)
        own = healthy_swims.read_healthy_swims(model, healthy, null, progress.terminal_bar)
    if own:
        notes = (*notes, f"the model leaves {level(own.calibration_residual)} of the healthy swims in {args.healthy}")
    return investigate(
        model,
        list(given.trials.values()),
        gates=frozen() if args.most is None else replace(frozen(), max_effects=args.most),
        null=null,
        healthy=own,
        speed_error=speed_error_of(args.model),
        page=datasets.page_in(args.data),
        mass_known=not args.mass_unknown,
        seed=args.seed,
        further=True,
        say=console.say,
        bars=progress.terminal_bar,
        admit=lambda e: admission.admit(e, args.anyway),
        answered=answered,
        notes=notes,
    )


def drawn_of(args) -> dict:
    """Source of the null runs: settings of the second robot, or a folder."""
    made = {"runs": args.null_runs, "noise": args.noise, "seed": args.seed}
    return made | {"folder": str(args.null.resolve())} if args.null else made


def context_of(inquiry: Inquiry, args, given: Taken) -> dict:
    """Hashes of the search's inputs, and the records set aside (or else the first fold), for gap apply."""
    drawn = {"null": drawn_of(args), "water": args.water, "skipped": given.broken}
    hashes = {"model_sha256": model_version.digest(args.model), "data_sha256": given.sha256}
    model = str(Path(args.model).resolve()) if str(args.model).endswith(".toml") else str(args.model)
    return {"model": model, "data": str(args.data.resolve()), **hashes, "judged": inquiry.judged, **drawn}


def write_answer(verdict: Verdict, folder: Path, context: dict, patched: str = "") -> None:
    """Writes verdict.json. patched: name of the patched model. Models of an earlier search are removed."""
    folder.mkdir(parents=True, exist_ok=True)
    if not patched and Path(context["model"]).resolve().parent != folder.resolve():  # the searched model itself stays
        clear(folder, "model.patched.*", "model.rejected-*.toml")
    write_json(folder / "verdict.json", verdict.plain() | {"context": context, "patched_model": patched})


def write(inquiry: Inquiry, folder: Path, context: dict) -> list[str]:
    """Writes verdict.json, the patched (or the rejected) model, report.html and report.json. context: of the search."""
    from fishmj.gap import report

    write_answer(inquiry.verdict, folder, context)
    verdict, model = inquiry.verdict.plain(), inquiry.evidence.model
    some = [r for r in inquiry.records if r.name in context["judged"]]

    def measure(versions: list[Robot]) -> list[tuple[float, dict, float]]:
        evidence = likelihood_of(model, some, null_of(context["null"]))
        return measured(evidence, [model.row(version) for version in versions])

    patch = lambda: settle(verdict, context, measure, folder / "model.patched.toml", folder)
    done = console.after_answer("the patched model", patch, None)
    if done and done.path and done.accepted:
        write_answer(inquiry.verdict, folder, context, done.path.name)
    pages: list[str] = []
    pages = console.after_answer("the report", lambda: report.write(inquiry, folder), pages)
    return ["verdict.json", *pages, *([done.path.name] if done and done.path else [])]
