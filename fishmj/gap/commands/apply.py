"""`gap apply REPORT`: the next version of the model, from what a search found; `--revert MODEL` goes back.

REPORT is the folder (or verdict.json) of gap find --out. The command writes <fish>.v<N>.toml (the effects, their intervals, the
data's hash, gates and rivals), a copy of its parent beside it, and a .diff of the MJCF if MuJoCo has an attribute for an effect.
It overwrites nothing. Only a NAMED effect that closes the gap on the judging records becomes a version. Any other candidate
is kept as model.rejected-<hash>.toml with its scores, and the exit code is 1.

For a robot in MJCF, <robot>.v<N>.xml is the text of the description with changed attributes, for the effects that are NAMED
individually; gap check tests it. MuJoCo rewrites the file if the text cannot hold the effects: a URDF, parts of an included file.

    fishmj gap apply report --out my_fish.v2.toml
"""

import hashlib
import shlex
import tempfile
from pathlib import Path
from typing import NamedTuple

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.engines import own_effects
from fishmj.gap.commands import admission, gap_options, model_version
from fishmj.gap.commands.check import gaps
from fishmj.gap.models.robot_description import is_robot
from fishmj.gap.null.null_runs import null_of
from fishmj.gap.records.datasets import digest, trials_named
from fishmj.gap.wording import level, pair, title
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import STRUCTURED

UNSEEN = "records set aside"
HELD_OUT = "the first fold, which the last fit used: there were too few records to set some aside"


class ApplyOutcome(NamedTuple):
    """Outcome of applying a verdict. path: the version, the rejected candidate, or None without a candidate.

    gap_before, gap_after: the pair of the verdict.
    """

    path: "Path | None"
    accepted: bool
    reason: str
    gap_before: "float | None" = None
    gap_after: "float | None" = None
    mjcf: str = ""  # unified diff
    hooks: tuple[str, ...] = ()  # effects without an attribute in MJCF


def main(argv: list[str]) -> int:
    """The command `gap apply`. Returns the exit code."""
    parser = console.parser("gap apply", __doc__ or "")
    add = parser.add_argument
    add("report", nargs="?", type=console.path, help="folder or verdict.json of gap find --out")
    out = "new .toml file for the next version; default <fish>.v<N>.toml beside the report"
    add("--out", type=console.out_file, help=out)
    add("--data", type=console.path, help="the data set, if it was moved since the search (default: where the search read it)")
    add("--force", action="store_true", help="accept also an answer that is not NAMED, or a patch that does not close the gap")
    counted = "also apply effects that were fitted with the named ones but are too small to be named (default: no)"
    add("--counted-in", action="store_true", help=counted)
    back = "replace this version by its parent (default none)"
    add("--revert", type=console.path, metavar="MODEL", help=back)
    own_effects.option(parser)
    args = parser.parse_args(argv)
    own_effects.join(args.effects)
    gap_options.there(args.report, args.data, args.revert)
    if (args.report is None) == (args.revert is None):
        raise ConfigError("gap apply: give either a report or --revert MODEL")
    if args.revert and is_robot(args.revert):
        raise ConfigError(f"gap apply: {args.revert}: the searched description was not changed; there is nothing to revert")
    if args.revert:
        aside = model_version.revert(args.revert)
        console.say(f"{args.revert} is now its parent; the version is kept as {aside}")
        return console.OK
    from fishmj.gap.commands import reported

    if verdict := reported.robot_verdict(args.report):
        from fishmj.gap.commands.apply_robot import apply_robot, check_command

        written = ApplyOutcome(**apply_robot(args.report, verdict, args.out, args.force, args.counted_in))
    else:
        written = apply(args.report, args.out, args.data, args.force, args.counted_in)
    console.say(written.reason, *([f"written: {written.path}"] if written.path else []))
    if written.mjcf:
        console.say(written.mjcf.rstrip("\n"))
    if written.hooks:
        console.say(f"without an attribute in MJCF, only in fishmj: {', '.join(map(title, written.hooks))}")
    if written.accepted and written.path:
        words = ["fishmj", "gap", "check", str(written.path), "--data", str(args.data or "DATA")]
        words = check_command(args.report, verdict, written.path, args.data) if verdict else words
        console.say(f"{'compare it with its parent' if verdict else 'check it any time'}: {shlex.join(words)}")
    if args.json:
        console.emit_json(written._asdict())
    nothing = written.path is None and not (verdict and verdict["effects"])  # to add
    return console.OK if written.accepted or nothing else console.FAILED_CHECK


def apply(
    report: Path, out: "Path | None" = None, data: "Path | None" = None, force: bool = False, counted_in: bool = False
) -> ApplyOutcome:
    """Makes the next version from a report on disk; measures both gaps on the records that the report names.

    counted_in: also apply minor effects: fitted jointly, below the naming threshold.

    Raises:
        ConfigError: not a report, model or data differ from those of the search, or a file of the version's name exists.
        LogError: a record for the measurement of the gap cannot be read.
    """
    from fishmj.gap.commands import reported

    verdict = reported.verdict(report, context=True)
    context, folder = verdict["context"], reported.verdict_file(report).parent
    if model_version.digest(context["model"]) != context["model_sha256"]:
        raise ConfigError(f"{context['model']}: changed since the search; search again, or restore the searched model")
    robot = load_robot(context["model"])
    admission.searchable(robot, context["model"])
    data = Path(context["data"]) if data is None else data
    if digest(data) != context["data_sha256"]:
        raise ConfigError(f"{data}: not the data set of the search; its manifest's sha256 differs from {context['data_sha256']}")
    out = model_version.next_name(context["model"], folder) if out is None else out
    if out.suffix != ".toml":
        raise ConfigError(f"{out}: a model is a .toml file; choose a .toml name with --out")
    for path in (out, model_version.beside(out)):
        if path.exists():
            raise ConfigError(f"{path}: exists and is not overwritten; choose another name with --out")
    null = null_of(context["null"])
    admission.null_fits(null, robot, context["model"])
    given = (trials_named(data, context["judged"]), null, context.get("water", STRUCTURED))
    measure = lambda versions: gaps(versions, *given)
    return settle(verdict, context, measure, out, folder, force, counted_in)


def settle(
    verdict: dict, context: dict, measure, out: Path, folder: Path, force: bool = False, counted_in: bool = False
) -> ApplyOutcome:
    """Writes the version to `out`, or the rejected candidate into `folder`.

    measure: [parent, candidate] -> result of `check.gaps` on the report's judging records. counted_in: as `apply`.
    """
    answer, parent = verdict["answer"], load_robot(context["model"])
    if not verdict["effects"]:
        return ApplyOutcome(None, False, f"{answer}: no effect to add; {context['model']} stays as it is")
    which = UNSEEN if verdict.get("gap_after_unseen") is not None else HELD_OUT
    seen = f"{len(context['judged'])} {which} of {context['data']}"
    provenance = f"{answer}: {seen}"
    effects = model_version.found(verdict, provenance, context["data_sha256"])
    beside = verdict.get("tentative", []) if answer == "NAMED" else []  # fitted with the named ones
    if counted_in:
        effects += model_version.found({"effects": beside}, f"counted in, not named: {seen}", context["data_sha256"])
    with tempfile.TemporaryDirectory() as scratch:
        table = {"effects": [e.name for e in effects], "answer": answer}
        table |= {key: context[key] for key in ("data", "data_sha256", "judged")}
        table |= {"null": context["null"], "water": context.get("water", STRUCTURED)}
        table |= {"gates": verdict.get("gates", {}), "rivals": verdict.get("rivals", [])}
        draft = model_version.write(context["model"], Path(scratch) / out.name, effects, table, keep=False)
        candidate = load_robot(draft)
        (judged, _, floor), (closed, _, left) = measure([parent, candidate])
        before, after = (float(verdict[key]) for key in ("gap_before", "gap_after"))
        table |= {"gap_before": before, "gap_after": after}
        table |= {"judged_gap": [float(judged), float(closed)], "over_floor": [float(floor), float(left)]}
        good, reason = verdict_on(answer, (before, after), (judged, closed), (floor, left), which)
        if beside and not counted_in:
            minor = " and ".join(title(e["name"]) for e in beside)
            reason += f"; the gap on the records searched includes {minor}, which --counted-in adds"
        if good or force:
            model_version.write(context["model"], out, effects, table)
            from fishmj.gap.commands.mjcf_patch import difference, hooked

            if diff := difference(parent, candidate):
                write_text(out.with_suffix(".diff"), diff)
            return ApplyOutcome(out, True, reason if good else f"forced: {reason}", before, after, diff, tuple(hooked(candidate)))
        draft = model_version.write(context["model"], draft, effects, table | {"rejected": reason}, keep=False)
        text = draft.read_text(encoding="utf-8")
    kept = folder / f"model.rejected-{hashlib.sha256(text.encode()).hexdigest()[:12]}.toml"
    write_text(kept, text)
    return ApplyOutcome(kept, False, f"{reason}; {context['model']} stays as it is", before, after)


def verdict_on(answer: str, told: tuple, judged: tuple, over_floor: tuple, which: str = UNSEEN) -> tuple[bool, str]:
    """(accepted, reason) for a candidate.

    Args:
        told: gap of the verdict; judged, over_floor: gap and residual on the judging records; each is (before, after).
        which: words for the judging records.
    """
    moved = f"{pair(*told)} on the records searched"
    if answer != "NAMED":
        return False, f"{answer}: no effect certainly explains the gap ({moved})"
    for what, (before, after) in (("residual", over_floor), ("gap", judged)):
        if not after < before:
            return False, f"the patch hurts: on {which} the {what} is {level(after / before)} times what it was"
    return True, f"{moved}; it shrinks on {which}, too"
