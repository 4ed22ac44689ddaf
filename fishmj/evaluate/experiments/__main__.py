"""Reproduce the paper's experiments: one report with the paper's values and those measured here."""

import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from fishmj import control
from fishmj.base import console, interrupt, store
from fishmj.base.errors import ConfigError
from fishmj.base.store.atomic import same_as_begun
from fishmj.control.policy import BEST
from fishmj.evaluate.experiments import MODULES, experiment_of
from fishmj.evaluate.experiments import experiments_report as report
from fishmj.evaluate.experiments.experiment_rows import ExperimentRows, identity_of, options_of
from fishmj.evaluate.experiments.paper_experiment import PAPER, ExperimentPart, ExperimentSetup, PaperExperiment
from fishmj.lbm_oracle.run.solver_water import PLAIN, asked_for, reference_option
from fishmj.mjcf import identity
from fishmj.mjcf.reading import load_robot
from fishmj.water import choice

ALL, RATE = "all", 1000.0  # simulated seconds in one second of CPU, without the flow solver; measured
TRAINED = ("stages", "ablations")  # experiments that train policies
OUT = "runs/experiments"
EXAMPLES = f"""examples:
  fishmj experiments                              list the experiments with their cost
  fishmj experiments approach --quick             one experiment, few trials
  fishmj experiments all --policy runs/quick-ppo-0 --out runs/mine
  fishmj experiments ablations --trained runs/ablation      policies that fishmj train made
  fishmj experiments approach comparison --water lbm --reference --tanks 24 --device cuda

Finished rows are saved in --out, and the same command continues after Ctrl-C. Another policy, water,
seed or size needs another --out. Default --out {OUT}, with --quick {OUT}-quick.
"""


def options() -> console.Parser:
    """Parser of the verb `experiments`."""
    parser = console.parser("experiments", f"{__doc__} The paper: {PAPER}.", examples=EXAMPLES)
    add = parser.add_argument
    names = f"{', '.join(MODULES)}, or {ALL}; without a name: the list"
    add("names", type=console.OneOf((*MODULES, ALL)), nargs="*", action=console.Distinct, metavar="NAME", help=names)
    add("--quick", action="store_true", help="fewer trials, short trainings: a preview of every part")
    policy = f"{', '.join(control.shipped_policies())}, a policy file or folder of a training; default {BEST}"
    add("--policy", type=console.text, default=BEST, help=policy)
    add("--robot", type=console.text, default="fish", help="shipped name or TOML file; another fish needs a --policy")
    solved = "lbm: the flow solver itself, which takes hours without a GPU"
    add("--water", type=console.text, help=f"{choice.HELP}; {solved}")
    reference_option(add, PLAIN.said)
    place = "device of --water lbm: auto, cpu, cuda, cuda:N or cuda:all; default auto"
    add("--device", type=console.devices, default="auto", help=place)
    add("--tanks", type=console.whole(1, 256), default=1, help="parallel trials of --water lbm on each device; default 1")
    trained = "folder of policies for ablations, in place of new trainings: complete, no-self-velocity, .. (default: none)"
    add("--trained", type=console.path, metavar="DIR", help=trained)
    add("--seed", type=console.SEED, default=0, help="seed of all draws")
    folder = f"folder of rows and report.html; default {OUT}, with --quick {OUT}-quick"
    add("--out", type=console.out_folder, metavar="DIR", help=folder)
    return parser


def main(argv: list[str]) -> int:
    """Runs the verb `experiments`; returns the exit code."""
    args = options().parse_args(argv)
    stated = {"--quick": args.quick, "--out": args.out, "--trained": args.trained}
    if not args.names and (unused := [option for option, value in stated.items() if value]):
        raise ConfigError(f"experiments: {unused[0]} without a NAME, which only lists the experiments; add names or {ALL}")
    if args.trained and not {TRAINED[1], ALL} & set(args.names):
        raise ConfigError(f"experiments: --trained has an effect with {TRAINED[1]} only; leave it out, or add {TRAINED[1]}")
    args.out = args.out or Path(f"{OUT}-quick" if args.quick else OUT)
    setup = setup_of(args)
    if not args.names:
        console.say(console.table(listed(setup)), "", "add names or all; --quick for a preview; compiling adds some 15 s of CPU")
        if args.json:
            console.emit_json({"experiments": listed(setup)})
        return console.OK
    names = possible(setup) if ALL in args.names else args.names
    parts = [(name, part) for name in names for part in experiment_of(name).parts(setup)]
    trains = TRAINED if setup.trained is None else TRAINED[:1]
    agree(setup, sum(part.seconds for name, part in parts if name not in trains))
    same_as_begun(args.out / "options.json", options_of(setup))
    kept = {name: ExperimentRows(args.out, name, identity_of(setup)) for name in MODULES}
    notes = [condition(setup), *getattr(setup.brain, "notes", ())]
    console.say(f"water: {notes[0]}")
    for note in notes[1:]:
        console.warn(note)
    with interrupt.keeping(lambda: f"{args.out} holds {sum(len(k.rows) for k in kept.values())} parts; {interrupt.again()}"):
        run_parts(setup, parts, kept)
        finished = [done for name in MODULES if (done := finish(setup, experiment_of(name), kept[name], name in names))]
        found = {"paper": PAPER, "policy": setup.leader, "robot": identity.robot_names(setup.robot), "condition": notes}
        found |= {"experiments": report.as_json(finished)}
        store.write_json(args.out / "experiments.json", console.plain(found))
        store.write_text(args.out / "report.html", report.page(finished, setup.leader, notes, identity.robot_line(setup.robot)))
    for one in finished:
        if one.experiment.name in names:
            console.say("", f"{one.experiment.name}: {one.experiment.about}", console.table(report.rows_of(one)))
    cpu = sum(one.cpu for one in finished if one.experiment.name in names)
    console.say("", f"the paper: {PAPER}", f"{cpu:.0f} s of CPU; wrote {args.out / 'report.html'}")
    if args.json:
        console.emit_json(found)
    return console.OK


def setup_of(args) -> ExperimentSetup:
    """Setting that the options select. Raises ConfigError, UnknownName."""
    water = choice.chosen(load_robot(args.robot), args.water).within((*choice.SELF_MADE, choice.LBM), "experiments")
    solved = water.kind == choice.LBM
    if args.reference and not solved:
        raise ConfigError("experiments: --reference: needs --water lbm; add it, or leave --reference out")
    solver = asked_for("experiments", args.reference, None, None) if solved else None
    common = {"robot": water.robot, "policy": args.policy, "seed": args.seed, "quick": args.quick, "out": Path(args.out)}
    common |= {"described": args.robot}
    return ExperimentSetup(**common, solver=solver, device=args.device, tanks=args.tanks, trained=args.trained)


def agree(setup: ExperimentSetup, seconds: float) -> None:
    """Asks the user if the flow solver would take too long on a CPU for `seconds` of trials. Raises TooMuch."""
    if setup.solver is not None:
        from fishmj.lbm_oracle.run import solver_cost

        work = [(setup.solver.box, seconds)]
        solver_cost.agree("experiments", setup.device, work, instead="--quick, or the fitted water", tanks=setup.tanks)


def condition(setup: ExperimentSetup) -> str:
    """Line that names water, seed and size."""
    water = choice.label(setup.robot) if setup.solver is None else f"flow solver, {setup.solver.said}"
    return f"{water}, seed {setup.seed}{', quick: few trials' if setup.quick else ''}"


def possible(setup: ExperimentSetup) -> list[str]:
    """Names of the experiments that this policy allows; warns of the others."""
    names = []
    for name in MODULES:
        try:
            experiment_of(name).parts(setup)
            names.append(name)
        except ConfigError as error:
            console.warn(f"left out: {error}")
    return names


def listed(setup: ExperimentSetup) -> list[dict]:
    """Rows of the list of experiments, with the estimated CPU time of the surrogate."""
    rows = []
    for name in possible(setup):
        one = experiment_of(name)
        seconds = lambda quick, one=one: sum(part.seconds for part in one.parts(replace(setup, quick=quick)))
        costs = {"CPU time": seconds(False), "--quick": seconds(True)}
        rows.append({"experiment": name, "about": one.about} | {key: console.duration(s / RATE) for key, s in costs.items()})
    return rows


def run_parts(setup: ExperimentSetup, parts: list[tuple[str, ExperimentPart]], kept: dict[str, ExperimentRows]) -> None:
    """Runs the parts whose rows are not kept, with one progress line in simulated seconds."""
    waiting = [(name, part) for name, part in parts if part.key not in kept[name].rows]
    if there := len(parts) - len(waiting):
        console.warn(f"{there} of {len(parts)} parts were run before under the same conditions; reusing {setup.out}")
    total, before = sum(part.seconds for _, part in waiting), 0.0
    with console.Progress(total, "experiments", "sim s") as bar:
        bar.stage("engines compile in the first step")
        for name, part in waiting:
            began = time.process_time()
            row = part.run(partial(_tell, bar, f"{name}, {part.key}", before))
            before += part.seconds
            kept[name].add(part.key, row, time.process_time() - began)
        bar.update(total)


def _tell(bar: console.Progress, part: str, before: float, done: float) -> None:
    """Shows a part under way."""
    bar.update(before + done, part=part)


def finish(setup: ExperimentSetup, one: PaperExperiment, kept: ExperimentRows, asked: bool) -> report.FinishedExperiment | None:
    """Findings of an experiment, if it was requested or finished before; None if rows are missing."""
    if not asked and not kept.rows:
        return None
    keys = [part.key for part in one.parts(setup)]
    if not all(key in kept.rows for key in keys):
        return None
    rows = {key: kept.rows[key] for key in keys}
    return report.FinishedExperiment(one, one.findings(setup, rows), sum(kept.cpu[key] for key in keys))


if __name__ == "__main__":
    raise SystemExit(console.run(main))
