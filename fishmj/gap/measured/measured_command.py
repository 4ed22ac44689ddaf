"""`gap measured`: finds the missing term in a model of a measured machine, by leaving out groups of records.

A fish, a boat, an ROV, a servo on a bench, a body that coasts to rest: no simulator is needed. A study groups the records. A
model is fitted without each group in turn. A term is named only if it lowers the error of groups outside its fit, by a bootstrap
and by an exact test over the groups.
"""

import shlex
from importlib import import_module
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName, UsageError
from fishmj.base.store import write_json, write_text
from fishmj.gap import progress
from fishmj.gap.measured import page
from fishmj.gap.measured.study import investigate
from fishmj.gap.measured.study_answer import TOO_FEW, round_row, solved
from fishmj.gap.measured.study_build import SHIPPED, built, shipped
from fishmj.gap.measured.study_schema import PLANTS, StudyInput, checked, merged, read_study, variants

# set -> module, of another form than a study: two laws; a swimming fish of two links
OWN_PROGRAM = {"usv_coastdown": "boat_drag", "tendon_fish": "tendon_fish"}
SETS = ("tail_fish", "servo_xl330", *OWN_PROGRAM)
TEMPLATES = Path(__file__).resolve().parent / "templates"
EXAMPLES = """examples:
  fishmj gap measured --new my.toml --plant body        a template with every key explained
  fishmj gap measured --study my.toml --out report      search; report.html, report.json
  fishmj gap measured tail_fish --leave-one-out         a study that comes with fishmj

exit codes: 0 an answer, 2 bad input (one line says what, where, got, expected), 3 too few groups to decide

A group is a condition of the experiment: a day, a setting, an amplitude, a run. Records of one group are never split between fit
and test. With n groups the smallest possible p is 1/2^n; with fewer than five groups all results are tentative."""


def main(argv: list[str]) -> int:
    """The command `gap measured`. Returns the exit code."""
    parser = console.parser("gap measured", __doc__ or "", examples=EXAMPLES)
    add = parser.add_argument
    add("name", nargs="?", help=f"{', '.join(SETS)}, or all; FISHMJ_MEASURED names the folder that holds them")
    add("--study", type=console.path, metavar="FILE", help="your study file (TOML), such as --new writes (default none)")
    add("--new", type=console.out_file, metavar="FILE", help="write a commented template and stop (default no)")
    add("--plant", choices=PLANTS, help="for --new: body (fish, boat, ROV), servo, coast (a coast-down); no default")
    add("--out", type=console.out_folder, metavar="FOLDER", help="folder for report.html and report.json (default none)")
    add("--seed", type=console.SEED, help="seed for groups set aside and for folds (default as in the study)")
    by = "names as in a study's [groups] by, such as rig.trajectory (default as the study says)"
    add("--groups", type=console.Listed(console.text, 6), metavar="NAME,..", help=by)
    once = "leave out every group in turn and set none aside: estimates the error in unseen conditions"
    add("--leave-one-out", action="store_true", help=once)
    args = parser.parse_args(argv)
    asked = [x for x in (args.name, args.study, args.new) if x is not None]
    if len(asked) != 1:
        raise UsageError(f"gap measured: got {len(asked)} of NAME, --study FILE, --new FILE; expected one")
    if args.new is not None:
        return new(args.new, args.plant, args.json)
    if args.plant:
        raise UsageError("gap measured: --plant goes with --new; a study names its plant in the file")
    if args.study is not None:
        words, figures, code = run(changed(read_study(args.study), args), args.out)
        console.say(words)
        if args.json:
            console.emit_json(figures)
        return code
    if args.name not in (*SETS, "all"):
        raise UnknownName("measured set", args.name, (*SETS, "all"))
    names = SETS if args.name == "all" else (args.name,)
    if (args.leave_one_out or args.groups or args.seed is not None or args.out) and set(names) & set(OWN_PROGRAM):
        raise UsageError(
            f"gap measured: --leave-one-out, --groups, --seed and --out are for studies; {args.name} is or holds another program"
        )
    reports = {}
    for name in names:
        if name in OWN_PROGRAM:
            said, reports[name] = import_module(f"fishmj.gap.measured.{OWN_PROGRAM[name]}").run(console.say)
        else:
            said, reports[name], _ = run(changed(shipped(name), args), args.out)
        console.say(said, "")
    if args.json:
        console.emit_json(reports if args.name == "all" else reports[args.name])
    return console.OK


def changed(study: StudyInput, args) -> StudyInput:
    """The study with the command line's settings in place of its own."""
    table = study.table
    if args.seed is not None:
        table = merged(table, {"search": {"seed": args.seed}})
    if args.groups:
        table = merged(table, {"groups": {"by": args.groups}})
    if args.leave_one_out:
        table = {key: value for key, value in table.items() if key not in ("held_out", "variant")}
    return study if table is study.table else checked(table, study.where, study.folder)


def run(study: StudyInput, out: Path | None = None) -> tuple[str, dict, int]:
    """(words, figures, exit code) of a study and its variants; writes the report's files if `out` is given."""
    words, figures, ready, found, verdict = solved(built(study), console.say, bars=progress.terminal_bar)
    lines = [words]
    figures["study"] = study.where if study.folder != SHIPPED else study.given.name
    others = variants(study)
    if others:
        lines.append("the same search with")
        figures["variants"] = {}
    for label, given in others.items():
        figures["variants"][label], line = variant(given)
        lines.append(f"  {label}: {line}")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / "report.html", page.html(study, ready, found, verdict, figures))
        write_json(out / "report.json", figures)
        lines.append(f"written: {out / 'report.html'}, {out / 'report.json'}")
    return "\n".join(lines), figures, console.CANNOT_TELL if verdict.answer == TOO_FEW else console.OK


def variant(given: StudyInput) -> tuple[dict, str]:
    """(figures, a line) of one round of a variant."""
    other = built(given)
    found = investigate(other, most=1, bars=progress.terminal_bar)
    other = other.settled(found.rows[-1])
    first = found.rounds[0]
    best = first.fitted.names[-1]
    kept = found.kept_aside or tuple(float(x) for x in found.unseen.mean(0))
    ratio = other.figure(kept[-1]) / other.figure(kept[0])
    figures = {
        "error_kept_aside": [other.figure(e) for e in kept],
        "ratio": ratio,
        "floor": other.figure(other.floor),
        "fitted": first.fitted.row[list(first.fitted.places[len(other.plant.constants) :])].tolist(),
        **round_row(first),
    }
    return figures, (
        f"{best} {'accepted' if first.accepted else 'rejected'}, best in {first.best.count(best)} of {len(first.best)} folds,"
        f" P(useful) = {first.useful:.2f}, P(best) = {first.p_best[best]:.2f}, exact p = {first.p_exact:.2g};"
        f" error {other.said(kept[0])} -> {other.said(kept[-1])} ({ratio:.2f})"
    )


def new(path: Path, plant: str | None, as_json: bool) -> int:
    """Writes the template of a plant. Returns the exit code."""
    if plant is None:
        raise UsageError(f"gap measured --new: got no --plant, expected one of {', '.join(PLANTS)}")
    if path.exists():
        raise ConfigError(f"{path}: exists; name another file, or remove it first")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, (TEMPLATES / f"{plant}.toml").read_text(encoding="utf-8"))
    console.say(f"written: {path}; fill it in, then fishmj gap measured --study {shlex.quote(str(path))} --out report")
    if as_json:
        console.emit_json({"written": str(path), "plant": plant})
    return console.OK
