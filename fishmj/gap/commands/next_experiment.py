"""`gap next REPORT|DATA`: the experiment that best separates the remaining explanations.

REPORT is the output of `gap find --out`; DATA a data set, which is searched first. Every experiment of the library is simulated
with each explanation at its fitted values, and ranked by separation per second.

    fishmj gap next report --runs hinted
    fishmj gap next report --out experiment.csv          of a robot in MJCF: commands within its limits, safe in simulation
    fishmj gap next robot.xml --out experiment.csv       the same, to identify friction, damping, armature, gains, delay, bodies
    fishmj gap next LOGS --model robot.xml               the same, in addition to existing logs
"""

from fishmj.base import console
from fishmj.base.errors import ConfigError, LogError
from fishmj.engines import own_effects
from fishmj.gap import progress
from fishmj.gap.commands import admission, gap_options, model_version, reported
from fishmj.gap.experiment import (
    LEFT,
    OPEN,
    Hypothesis,
    advice,
    experiment_scores,
    from_plain,
    hinted_experiments,
    hypotheses_of,
    normalise_weights,
)
from fishmj.gap.models.robot_description import is_robot
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.records.datasets import BUNDLE, page_in
from fishmj.gap.records.records import record_of
from fishmj.gap.workflow import compile_kernel, investigate
from fishmj.log import excitation
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED, as_described


def main(argv: list[str]) -> int:
    """The command `gap next`. Returns the exit code."""
    parser = console.parser("gap next", __doc__)
    add = parser.add_argument
    add("source", type=console.path, metavar="REPORT|DATA", help="folder or verdict.json of `gap find --out`, or a data set")
    add(
        "--out",
        type=console.out_file,
        metavar="FILE.csv",
        help="CSV for the best experiment's commands, for a robot in MJCF (default none)",
    )
    seconds, speed = console.number(2, 600), console.number(0.001, 1000)
    add("--seconds", type=seconds, default=10.0, metavar="S", help="length for a robot in MJCF, 2 to 600 s (default 10)")
    add("--speed", type=speed, default=3.0, metavar="V", help="largest joint speed for a robot in MJCF, rad/s or m/s (default 3)")
    gap_options.of_columns(add)
    add("--model", type=console.text, help="the searched model (default: the one that the report names, else fish)")
    gap_options.of_robot(add)
    which = "experiments: ids, designed, casual, dry, all, or hinted for a quick try (default all)"
    add("--runs", type=console.text, default="all", metavar="ID,..", help=which)
    add("--top", type=console.whole(1, 1000), default=5, metavar="N", help="number of experiments to list, 1 to 1000 (default 5)")
    gap_options.of_mass(add)
    gap_options.of_null(add)
    add("--anyway", action="store_true", help="of a data set: search although model and logs differ too much")
    own_effects.option(parser)
    args = parser.parse_args(argv)
    own_effects.join(args.effects)
    gap_options.there(args.source, args.columns)
    if is_robot(args.source) or is_robot(args.model or "") or reported.is_of_robot(args.source):
        from fishmj.gap.commands.next_robot import next_robot

        return next_robot(args)
    null = SimulatedNull(runs=args.null_runs, noise=args.noise, seed=args.seed)
    try:
        answer, model, sides, like, advised = _opened(args, null)
    except admission.TooDifferent as different:
        return different.report(args.json)
    if len(sides) < 2:
        console.say(f"{answer}: {advised or 'fewer than two explanations are left, so there is nothing to separate'}")
        if args.json:
            console.emit_json({"answer": answer, "experiments": []} | ({"advice": advised} if advised else {}))
        return console.OK
    runs = _runs(args.runs, sides)
    compile_kernel(model, console.say)
    found = experiment_scores(model, sides, like, runs, null, bars=progress.terminal_bar)
    console.say(console.table([{"experiment": p.excitation, "s": p.seconds, "sigma": p.sigma} for p in found[: args.top]]))
    advised = advice(model, found, sides)
    console.say(advised)
    if args.json:
        console.emit_json({"answer": answer, "advice": advised, "experiments": [p._asdict() for p in found]})
    return console.OK


def _opened(args, null: SimulatedNull):
    """(answer, model, hypotheses, a record, the search's own advice) of a report or a data set."""
    report = reported.verdict_file(args.source)
    if report.is_file() and report.suffix != BUNDLE:
        from fishmj.gap.laboratory.virtual_robot import generate

        verdict = reported.verdict(report, context=False)
        context = verdict.get("context", {})
        model = _questioned(args.model or _model_of(context), context.get("water", STRUCTURED))
        usual = record_of(generate({}, ["idle"], 0, robot=model.robot)[0], model.dt)  # has the usual sensors of this robot
        sides = normalise_weights(_reported(model, verdict))
        return verdict["answer"], model, sides, usual, verdict["next_experiment"]
    name = args.model or "fish"
    model = _questioned(name, STRUCTURED)
    given, _ = admission.admitted(args.source, model.robot, name, args.same_robot, args.anyway)
    inquiry = investigate(
        model,
        list(given.trials.values()),
        null=null,
        page=page_in(args.source),
        mass_known=not args.mass_unknown,
        seed=args.seed,
        say=console.say,
        bars=progress.terminal_bar,
        admit=lambda e: admission.admit(e, args.anyway),
    )
    found = inquiry.verdict
    if found.answer not in OPEN:
        return found.answer, model, [], inquiry.records[0], ""
    sides = normalise_weights(hypotheses_of(inquiry.found, found))
    return found.answer, model, sides, inquiry.records[0], found.next_experiment


def _model_of(context: dict) -> str:
    """The model of a report. Raises ConfigError: it is missing, or changed since the report."""
    if not context:
        return "fish"
    if model_version.digest(context["model"]) != context["model_sha256"]:
        raise ConfigError(f"{context['model']}: changed since the search; name the model with --model, or search again")
    return context["model"]


def _questioned(name: str, water: str):
    """A searchable model, by its name or file."""
    from fishmj.gap.models.swimming_fish import SwimmingFish

    robot = as_described(load_robot(name), water)
    admission.searchable(robot, name)
    return SwimmingFish(robot)


def _reported(model, verdict: dict) -> list[Hypothesis]:
    """Hypotheses of a verdict.json."""
    if verdict["answer"] not in OPEN:
        return []
    if len(given := verdict["explanations"]) > 1:
        return [from_plain(model, one["values"], one["weight"]) for one in given[:LEFT]]
    ours = {e["name"]: {k: [v["value"], v["low"], v["high"]] for k, v in e["parameters"].items()} for e in verdict["effects"]}
    rivals = [r for r in verdict["rivals"] if "values" in r]
    if not rivals:
        if verdict["next_experiment"]:
            return []
        raise LogError("gap next: the report lists no rival with values; give the data set itself: gap next DATA")
    best = min([1.0, *(e["p_best"] for e in verdict["effects"])])
    return [from_plain(model, ours, best), *(from_plain(model, r["values"], r["p_best"]) for r in rivals[: LEFT - 1])]


def _runs(text: str, sides: list[Hypothesis]) -> tuple[str, ...]:
    """Ids of the experiments to consider."""
    if text == "hinted":
        return hinted_experiments(sides)
    return excitation.listed(text)
