"""Compares the ranking of controllers in a fitted water with that in the flow solver.

    fishmj hydro_fit rank --device cuda --tanks 24         24 trials of 60 s, all control, both waters
    fishmj hydro_fit rank --domain laptop --device cpu --trials 6 --seconds 10         a preview
    fishmj hydro_fit rank ... --model OTHER                trials in the solver are kept: seconds
    fishmj hydro_fit rank pd --again 3                     trials again: in the solver twice a part of a cell away and
                                                           once with half its time step, in the surrogate 8 times

A gap may be twice the change of the solver's own mean when it repeats the trials; for repeated trials it is between the means.

Exit code 1 if a tolerance is missed, 3 if the trials are too few to separate the controllers.
"""

from dataclasses import asdict, replace
from itertools import cycle
from pathlib import Path

import numpy as np

from fishmj import control, engines
from fishmj.base import console, interrupt
from fishmj.base.errors import ConfigError
from fishmj.base.figures import canvas, save, style
from fishmj.base.pages import drawn
from fishmj.base.store import clear, write_json
from fishmj.evaluate import protocol, run_trials
from fishmj.evaluate.plots import AROUND, COLOURS, FAINT, INK, STYLE, plain_ticks
from fishmj.hydro_fit.campaign.data.collect import GO, ON_GPU, tanks_on
from fishmj.hydro_fit.campaign.data.solver_hash import solver_sha256
from fishmj.lbm_oracle.fluid.device import device_of
from fishmj.lbm_oracle.run import solver_cost
from fishmj.lbm_oracle.run.domain import EVERY, PREVIEWS
from fishmj.lbm_oracle.run.solver_water import boundary_entry, water_of_fit
from fishmj.mjcf.reading import load_robot
from fishmj.water.hydro_model import HydroModel, shipped
from studies.rank_waters import compare_waters, rank
from studies.rank_waters.rank import GAP

DEFAULT = ("dob", "pi", "pd", "adrc-c1", "station-sac", "station", "drift")
MEANING = {
    "station": "PPO",
    "station-sac": "SAC",
    "dob": "flow observer",
    "pi": "vector PI",
    "pd": "PD",
    "adrc-c1": "PNL + ADRC-C1",
}
SAID = {True: "yes", False: "NO", None: "cannot be told"}


def options() -> console.Parser:
    """Parser of the verb `rank`."""
    parser = console.parser("hydro_fit rank", __doc__)
    add = parser.add_argument
    brains = f"controllers; default {' '.join(DEFAULT)}; drift is shown but not ranked; your own as module:Name"
    add("controllers", type=console.text, nargs="*", action=console.Distinct, metavar="CONTROLLER", help=brains)
    control.anyway_option(parser)
    add("--fish", type=console.text, default="fish", help="a shipped name or a description (.toml)")
    model = "surrogate: a fitted water by name or .toml, NAME-base for its strips; default the shipped one"
    add("--model", type=console.text, help=model)
    add("--engine", choices=engines.NAMES, default="batch", help="engine of the surrogate")
    add("--domain", choices=EVERY, help="box of the solver; by default that of the model's segments; laptop is a preview")
    add("--device", type=console.device, default="auto", help=f"device of the solver: {console.DEVICE_HELP}")
    tanks = f"parallel trials in the solver; by default {ON_GPU} on a GPU, else 1"
    add("--tanks", type=console.whole(1, 256), metavar="N", help=tanks)
    part = "number of the standard 72 trials, spread over speeds and directions"
    add("--trials", type=console.whole(1, 72), default=24, metavar="N", help=part)
    add("--seconds", type=console.number(1, 600), metavar="S", help="length of a trial; default 60")
    often = console.whole(0, len(compare_waters.AGAIN))
    add("--again", type=often, default=0, metavar="N", help="repeats in the solver, at most 3; with any, 8 in the surrogate")
    budget = "wall-clock time after which no further solver trial starts; by default no limit"
    add("--budget", type=console.number(0, 1e7), metavar="S", help=budget)
    add("--seed", type=console.SEED, default=0, help="seed of the trials")
    out = "folder of finished trials, which are not run again, and of rank.json and rank.png, which are replaced"
    add("--out", type=console.out_folder, default="runs/rank", metavar="DIR", help=out)
    return parser


def main(argv: list[str]) -> int:
    """Runs the missing trials, judges, prints and writes.

    Raises UnknownName, ConfigError: an unknown controller, water or box, or an invalid number.
    """
    args = options().parse_args(argv)
    robot, water = load_robot(args.fish), args.model or default_model(args.fish)
    model, fitted = HydroModel.load(water), engines.in_water(robot, water)
    solver = args.solver = water_of_fit(model.dataset, model.slip, args.domain)
    names = list(args.controllers) or list(DEFAULT)
    brains = control.several(names, run_trials.solved(robot), anyway=args.anyway)
    for note in (note for brain in brains for note in getattr(brain, "notes", ())):
        console.warn(note)
    trials = chosen(args)
    runs = (run_trials.UNCHANGED, *compare_waters.AGAIN[: args.again])
    total = trials.duration * len(trials) * len(brains) * len(runs)
    less = "--domain laptop --trials 6 --seconds 10 is a preview"
    work, asked = [(solver.box, total)], args.budget is not None
    solver_cost.agree("hydro_fit rank", args.device, work, instead=less, tanks=args.tanks or 1, flag=GO, asked=asked)
    device = str(device_of(args.device))
    tanks = tanks_on(device, args.tanks)
    waters = [compare_waters.in_solver(robot, args.out, solver, device=args.device, tanks=tanks, variation=run) for run in runs]
    beside = [(0.0, 0.0), *(compare_waters.shifts(args.seed, solver.box.dx) if args.again else ())]
    body = engines.make(args.engine, fitted)
    surrogates = [compare_waters.in_surrogate(fitted, body, shift) for shift in beside]
    with interrupt.keeping(lambda: kept_words(args.out)):
        with console.Progress(total, "rank in the solver", unit="sim s") as bar:
            trials, solved = in_turn(brains, trials, waters, tanks, args.budget, bar)
        each = trials.duration * len(trials) * len(brains)
        with console.Progress(each * len(surrogates), "rank in the surrogate", unit="sim s") as bar:
            reports = [report_after(bar, i * each) for i in range(len(surrogates))]
            swum = [
                compare_waters.swim(brains, trials, water, report=told) for water, told in zip(surrogates, reports, strict=True)
            ]
        return shown(verdict(trials, solved, swum, model, args), args)


def kept_words(folder: Path) -> str:
    """Text of an interrupted ranking."""
    swims = compare_waters.kept_in(folder)
    return f"{swims} holds {len(list(swims.glob('*.npz')))} finished trials of the solver; {interrupt.again()}"


def report_after(bar: console.Progress, before: float) -> compare_waters.Said:
    """Report function for the bar of a run that starts after `before` simulated seconds."""
    return lambda name, done: bar.update(before + done, controller=name)


def in_turn(brains, trials: protocol.Trials, waters: list, tanks: int, budget: float | None, bar) -> tuple:
    """Runs all trials in the solver, then its repeats: trials that all have finished, and the figures of every run."""
    found, before = [], 0.0
    for water in waters:
        report = report_after(bar, before)
        trials, figures = compare_waters.solve(brains, trials, water, group=tanks, budget=budget, report=report)
        found.append(figures)
        before += trials.duration * len(trials) * len(brains)
    return trials, [{name: {k: v[: len(trials)] for k, v in rows.items()} for name, rows in figures.items()} for figures in found]


def default_model(fish: str) -> str:
    """Fitted water of this fish, or the shipped one. Raises ConfigError: none comes with it."""
    name, known = load_robot(fish).name, shipped()
    if not known:
        raise ConfigError("rank: no fitted water is shipped with this build; fit one: fishmj hydro_fit fit")
    return name if name in known else known[0]


def chosen(args) -> protocol.Trials:
    """First `--trials` of the standard trials, in their spread order."""
    every = compare_waters.spread(protocol.trials(seed=args.seed, duration=args.seconds))
    return replace(every, items=every.items[: args.trials])


def verdict(trials: protocol.Trials, solved: list[dict], swum: list[dict], model: HydroModel, args) -> dict:
    """Judgement of both figures in plain types, with all its inputs; `ok` is None if nothing can be decided.

    Args:
        solved, swum: controller -> key -> (n,) in solver and surrogate, of every run, the trials as drawn first.
    Returns:
        among others conditions: (m/s, line of sight in deg, repeat) of each trial, in the order of `by_trial`.
    """
    of = lambda runs, key: [{name: figures[key] for name, figures in run.items()} for run in runs]
    judged = {key: rank.judged(key, of(solved, key), of(swum, key)) for key in compare_waters.KEYS}
    return {
        "ok": rank.all_of(list(judged["rmse_after_arrival"]["passed"].values())),
        "preview": args.solver.domain in PREVIEWS,
        "origin": "synthetic",
        "model": model.name,
        "model_fitted_on": model.dataset.get("grid", ""),
        "model_dataset_sha256": model.dataset.get("sha256", ""),
        "slip": model.slip,
        "domain": args.solver.domain,
        **boundary_entry(args.solver.sharpness),
        "solver_sha256": solver_sha256(args.solver.box, args.solver.sharpness),
        "seed": args.seed,
        "trials": {"n": len(trials), "asked": args.trials} | {key: x for key, x in asdict(trials).items() if key != "items"},
        "conditions": [[item.speed, round(float(np.degrees(item.los)), 6), item.repeat] for item in trials.items],
        "by_trial": {"solver": solved, "surrogate": swum},
        **judged,
    }


def shown(found: dict, args) -> int:
    """Prints tables and writes files; returns the exit code."""
    t, judged = found["trials"], found["rmse_after_arrival"]
    head = f"{t['n']} trials of {t['duration']:g} s, {found['model']} against the solver on {found['domain']}"
    head = f"preview, not a judgement: {head}" if found["preview"] else head
    console.say("", head, "value (95 % bootstrap interval over trials); gap = surrogate - solver, paired", "")
    for key in compare_waters.KEYS:
        console.say(console.table([row_of(key, row) for row in found[key]["controllers"]]), "")
    console.say(*unbounded(found))
    if t["n"] < t["asked"]:
        console.warn(f"{t['n']} of {t['asked']} trials are finished; the same command goes on with the rest")
    if found["model_fitted_on"] not in ("", found["domain"]):
        console.warn(f"{found['model']} was fitted to the solver on {found['model_fitted_on']}, ranked on {found['domain']}")
    console.say(*verdict_lines(judged))
    clear(args.out, "rank.png")
    console.say(f"wrote {write_json(args.out / 'rank.json', found)}")
    console.say(f"wrote {picture(judged, args.out / 'rank.png', head)}")
    if args.json:
        console.emit_json(found)
    return {True: console.OK, False: console.FAILED_CHECK, None: console.CANNOT_TELL}[found["ok"]]


def unbounded(found: dict) -> list[str]:
    """Controllers' figures without an interval, with the reason: one line for each reason."""
    rows = [(key, row) for key in compare_waters.KEYS for row in found[key]["controllers"] if row["gap"]["why"]]
    reasons = dict.fromkeys((key, row["gap"]["why"]) for key, row in rows)
    named = lambda reason: [row["controller"] for key, row in rows if (key, row["gap"]["why"]) == reason]
    return [f"{reason[0]} of {', '.join(named(reason))}: {reason[1]}" for reason in reasons]


def row_of(key: str, row: dict) -> dict:
    """Row of one controller for the terminal."""
    bounds = lambda e, sign: "" if e["why"] else f" ({e['low']:{sign}.3f} {e['high']:{sign}.3f})"
    cell = lambda e, sign="": f"{e['value']:{sign}.3f}{bounds(e, sign)}"
    name = row["controller"]
    about = {"controller": name, "is": MEANING.get(name, "") if row["ranked"] else "not ranked", "n": row["n"]}
    about |= {
        f"{key}, solver [m]": cell(row["solver"]),
        "surrogate [m]": cell(row["surrogate"]),
        "gap [m]": cell(row["gap"], "+"),
    }
    if row["repeats"]:
        about["solver again [m]"] = " ".join(f"{value:+.3f}" for value in row["repeats"])
    return about | {"allowed [m]": f"{row['allowed']:.3f}", "within": SAID[row["within"]] if row["ranked"] else ""}


def verdict_lines(judged: dict) -> list[str]:
    """Result of each tolerance, in words."""
    told, passed = judged["told_apart"], judged["passed"]
    return [
        f"largest gap {judged['gap_max']:.3f} m, each at most what is allowed: {SAID[passed['gap_max']]}",
        f"Kendall tau {judged['tau']:.2f}, at least {rank.TAU:g}: {SAID[passed['tau']]}; {judged['counted']} of {judged['of']}"
        f" pairs count, told apart in both waters ({told['solver']} in the solver, {told['surrogate']} in the surrogate);"
        f" over all pairs, counted or not: {judged['tau_all_pairs']:.2f}",
    ]


WORDS = {"rmse_after_arrival": "RMSE after arrival", "rmse_holding": "RMSE while holding"}


@style(STYLE)
def picture(found: dict, path: Path, title: str) -> Path:
    """Draws one figure's ranking. found: of `rank.judged`. title: the condition, shown above."""
    figure, axes = canvas(1, 1, (6.4, 6.0))
    ax = axes[0, 0]
    ax.set_title(drawn(title), fontsize=9, fontweight="normal", loc="left", color=INK)
    rows = [row for row in found["controllers"] if row["n"]]
    spans = [row[water][end] for row in rows for water in ("solver", "surrogate") for end in ("low", "high", "value")]
    ends = [end for end in spans if np.isfinite(end)]
    low, high = max(min(ends, default=0.05) / 1.4, 5e-3), max(ends, default=1.0) * 1.4
    line = np.geomspace(low, high, 200)
    ax.fill_between(line, np.maximum(line - GAP, low / 10), line + GAP, color=FAINT, alpha=0.5, lw=0, label=f"within {GAP:g} m")
    ax.plot(line, line, color=FAINT, lw=1)
    for row, colour in zip(rows, cycle(COLOURS), strict=False):
        x, y = ([row[w][key] for key in ("value", "low", "high")] for w in ("solver", "surrogate"))
        error = [[[a[0] - a[1]], [a[2] - a[0]]] for a in (x, y)]
        face = colour if row["ranked"] else "white"
        ax.errorbar(x[0], y[0], xerr=error[0], yerr=error[1], fmt="o", ms=6, mfc=face, mec=colour, color=colour, lw=1.2)
        name = drawn(row["controller"]) + ("" if row["ranked"] else " (not ranked)")
        side = {"xytext": (7, -12)} if x[0] ** 2 < low * high else {"xytext": (-7, 6), "ha": "right"}
        ax.annotate(name, (x[0], y[0]), textcoords="offset points", color=colour, fontsize=9, **side)
    ax.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high), aspect="equal")
    word = WORDS.get(found["key"], found["key"])
    ax.set(xlabel=f"{word} in the solver [m]", ylabel=f"{word} in the surrogate [m]")
    for axis in (ax.xaxis, ax.yaxis):
        plain_ticks(axis)
    ax.legend(loc="upper left", frameon=False)
    return save(figure, path, **AROUND)
