"""`gap check MODEL --data DATA`: tests whether a version of a model still closes its gap.

Replays the records of its stated gap with the version and with its parent. The exit code is 1 if the version is more than 5 %
worse than stated, or no better than its parent. On another data set all records are used, and only the parent is compared.

    fishmj gap check my_fish.v2.toml --data DATA
"""

from dataclasses import replace
from pathlib import Path

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError, LogError
from fishmj.engines import own_effects
from fishmj.gap.commands import admission, gap_options, model_version
from fishmj.gap.models.robot_description import is_robot
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull, null_of
from fishmj.gap.records.datasets import digest, trials_in, trials_named
from fishmj.gap.search.likelihood import Likelihood, likelihood_of
from fishmj.gap.wording import level
from fishmj.log import Trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED, as_described

SLACK = 1.05  # tolerated ratio to the stated gap: float32 files of null runs, another machine's round-off


def main(argv: list[str]) -> int:
    """The command `gap check`. Returns the exit code."""
    parser = console.parser("gap check", __doc__ or "")
    parser.add_argument("model", type=console.path, help="a version that gap apply or gap find wrote")
    parser.add_argument("--data", type=console.path, required=True, help="data set to replay (required)")
    gap_options.of_robot(parser.add_argument)
    parent = "for a robot in MJCF: the description of which it is a version (default: from verdict.json beside it)"
    parser.add_argument("--parent", type=console.path, metavar="ROBOT.xml", help=parent)
    gap_options.of_columns(parser.add_argument)
    own_effects.option(parser)
    args = parser.parse_args(argv)
    own_effects.join(args.effects)
    gap_options.there(args.model, args.data, args.parent, args.columns)
    if is_robot(args.model):
        from fishmj.gap.commands import check_robot

        found = check_robot.check_robot(args)
        console.say(*check_robot.printed_lines(found))
    else:
        found = check(args.model, args.data, args.same_robot)
        console.say(console.table([{k: v for k, v in found.items() if not isinstance(v, list | dict)}]))
    if found["worse"]:
        console.say(f"FAILED: {found['worse']}")
    if args.json:
        console.emit_json(found)
    return console.FAILED_CHECK if found["worse"] else console.OK


def check(model: Path, data: Path, agreed: bool = False) -> dict:
    """The gap of a version and of its parent on `data`, and the reason of a failure ("" without one).

    agreed: accept logs of another robot's name.

    Raises ConfigError: no version table, or the parent's text is missing; LogError: a record that cannot be read, another robot.
    """
    from fishmj.gap.commands import reported

    stated = model_version.facts(model)
    if not stated:
        raise ConfigError(f"{model}: no table [version]; gap check takes versions that gap apply wrote")
    stated = reported.version(stated, model)
    parent = model_version.parent_of(model, stated)
    if not parent.is_file() or model_version.digest(parent) != stated["parent_sha256"]:
        raise ConfigError(f"{model}: its parent {parent} is missing or changed; write the version again with gap apply")
    same = digest(data) == stated.get("data_sha256")
    robot, null = load_robot(model), null_of(stated["null"])
    admission.searchable(robot, model)
    admission.null_fits(null, robot, model)
    trials = trials_named(data, stated["judged"]) if same else trials_in(data)
    notes = admission.of_this_robot(trials, robot, model, agreed)
    given = (trials, null, stated.get("water", STRUCTURED))
    (before, _, floor), (after, channels, left) = gaps([load_robot(parent), robot], *given)
    was = stated["judged_gap"][1]
    limit, worse = SLACK * was, ""
    if same and after > limit:
        worse = f"gap {level(after)} on {len(trials)} records, more than the stated {level(was)}"
    elif after >= before:
        worse = f"gap {level(after)} on {len(trials)} records, no smaller than its parent's {level(before)}"
    elif left >= floor:
        worse = f"residual {level(left)} times the floor on {len(trials)} records, no smaller than its parent's {level(floor)}"
    return {
        "model": str(model), "records": len(trials), "same_data": same, "gap_parent": before, "gap": after,
        "stated": was, "by_channel": channels, "worse": worse, "notes": notes,
    }  # fmt: skip


def gaps(
    versions: list[Robot], trials: list[Trial], null: SimulatedNull, water: str = STRUCTURED
) -> list[tuple[float, dict, float]]:
    """(gap, gap by channel, residual over the floor) of each version over all trials. water: in which they swim.

    Raises ConfigError: the versions differ in more than their effects; LogError: no trials, or one that cannot be compared.
    """
    bare = [replace(robot, effects=(), name=versions[0].name) for robot in versions]
    if any(robot != bare[0] for robot in bare):
        raise ConfigError("gap check: the versions differ in more than their effects, so their gaps cannot be compared")
    if not trials:
        raise LogError("gap check: the data set has none of the judging records of the version; give that of its search")
    listed = dict.fromkeys(fitted.name for robot in versions for fitted in robot.effects)
    model = SwimmingFish(as_described(bare[0], water), [e for e in map(effects.get, listed) if not e.stochastic])
    evidence = likelihood_of(model, model.records(trials), null)
    return measured(evidence, [model.row(robot) for robot in versions])


def measured(e: Likelihood, rows: list) -> list[tuple[float, dict, float]]:
    """(gap, gap by channel, residual over the floor) of parameter rows.

    The covariance of the gap includes the model error of the formulas, the floor does not: both must shrink.
    """
    return [(*e.gap_there(row), e.over_floor(row)[0]) for row in rows]
