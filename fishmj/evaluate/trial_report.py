"""Report of an evaluation: tables, results.json, trials.csv, plots, trial folders, one self-contained report.html.

Tables in the terminal and on the page have the same rows, with units, intervals and conditions.
"""

import csv
import io
import json
import shlex
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import chain
from math import isfinite
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.base.errors import FishmjError, StoreError
from fishmj.base.pages import Section, figure, part, report, table
from fishmj.base.store import clear, write_text
from fishmj.engines.hybrid.online_correction import KINDS
from fishmj.evaluate.metrics import APART, LEADING, MEDIANS, Result, compare, estimate, failed, figures, rms, too_few, too_short
from fishmj.evaluate.plots import PICTURES
from fishmj.evaluate.protocol import ANGLE, EIGHT, HOLD, Trials
from fishmj.evaluate.trial_logs import MARKS, corrections, name_of, trial_of, write_logs
from fishmj.log import Trial
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import robot_line
from fishmj.water.choice import HYBRID, LBM
from fishmj.water.water_identity import water_identity

SHORT = {  # key -> heading, digits
    "arrival": ("arrival", 3),
    "approach_time": ("approach [s]", 1),
    "rmse_after_arrival": ("rmse after [m]", 3),
    "rmse_last20": ("rmse last 20 s [m]", 3),
    "rmse_total": ("rmse total [m]", 3),
    "power": ("power [W]", 2),
    "energy_per_metre": ("energy [J/m]", 1),
    "cost_of_transport": ("CoT", 2),
    "rheotactic_index": ("RI cos", 3),
    "rheotactic_index_linear": ("RI lin", 3),
    "settled": ("settled", 3),
    "settling_time": ("settling [s]", 1),
    "furthest": ("furthest [m]", 3),
    "cross_track": ("cross-track [m]", 3),
    "on_path": ("on path", 3),
    "tracking_rmse": ("rmse target [m]", 3),
}
CORRECTED = "what the flow solver corrected, standard deviations in brackets (of a factor: of its logarithm)"
STARRED = f"* = the interval excludes 0, of {APART} pairs or more"
FIRST = ("arrival", "settled", "on_path")  # of each task
MAIN = (
    *FIRST, "approach_time", "settling_time", "cross_track", "tracking_rmse", "furthest", "rmse_after_arrival", "rmse_last20",
    "rmse_total", "power", "rheotactic_index",
)  # fmt: skip
REST = ("energy_per_metre", "cost_of_transport", "rheotactic_index_linear")
ReplayWriter = Callable[[list[Trial], Path, Robot, str], Path]  # (trials, page, robot, title) -> page
WORST = "worst.html"  # the replay of the first controller's worst trial, beside the report
# parts of an older report that may be missing in a new one
EARLIER = ("report.html", WORST, *PICTURES, "logs/manifest.json", "logs/*_u*_los[0-9][0-9][0-9]_r*")
BASELINE = "drift"  # the controller that does nothing
FORMULA = tuple("=+-@\t\r")  # what a spreadsheet takes for the start of one
MEANING = {
    "arrival": "share of trials that enter 0.1 m within 30 s",
    "approach": "time of first entry, median over the n trials that arrive",
    "rmse after": "RMS distance from first entry to 30 s; a trial without arrival counts with 10 to 30 s",
    "rmse last 20 s": "RMS distance over 40 to 60 s, all trials",
    "rmse total": "RMS distance over 0 to 30 s",
    "settled": "share of trials within 0.1 m for the last 5 s",
    "settling": "time from which on the fish stays within 0.1 m, median over the n trials that settle",
    "furthest": "largest distance from the target",
    "on path": "share of the time within 0.1 m of the figure eight",
    "cross-track": "RMS distance to the figure eight, near the moving target",
    "rmse target": "RMS distance to the moving target",
    "power": "mean electrical power, idle included",
    "RI": "rheotactic index over 30 to 60 s, heading averaged over a beat; 1 = always upstream; not defined (-) at 0 m/s",
}


def condition(result: Result) -> str:
    """Line with all conditions on which the results depend."""
    t = result.trials
    speeds = "/".join(f"{u:g}" for u in sorted(set(t.speed)))
    switch = lambda on: "on" if on else "off"
    dt = result.robot.timing.control_dt
    step = f", control step {dt:g} s" if dt != constant("task", "control_dt") else ""
    without = f", without the effects {', '.join(result.left_out)}" if result.left_out else ""
    course = "" if t.task == HOLD else f", task {t.task}"
    drawn = f", effects {', '.join(t.effects)} drawn" if t.effects else ""
    return (
        f"{len(t)} trials of {t.duration:g} s{course}, flow {speeds} m/s, {t.turbulence_said}, water {result.water}, "
        f"engine {result.engine}, command path {result.robot.timing.command_path}{step}, {start_of(t)}, "
        f"randomisation {switch(t.randomisation)}{drawn}, noise {switch(t.noise)}, seeds {t.box} {t.items[0].seed[0]}{without}"
    )


def start_of(trials: Trials) -> str:
    """Initial heading as text; for angle_of_attack, its angles from upstream."""
    if trials.task == EIGHT:
        return "start heading along the path"
    if trials.task != ANGLE:
        return f"start heading {trials.heading}"
    angles = sorted(set(np.round(np.degrees(trials.los), 2).tolist()))
    return f"start heading {'/'.join(f'{angle:g}' for angle in angles)} deg from upstream"


def overall(summaries: list[dict], keys=MAIN) -> list[dict]:
    """Rows, one for each controller: value and 95 % interval over trials; for a policy also the differences from training."""
    rows: list[dict] = [{"controller": s["controller"]} for s in summaries]
    if not_as_trained(summaries):
        for row, s in zip(rows, summaries, strict=True):
            row["not as trained"] = ", ".join((s["policy"] or {}).get("differs", ())) or "-"
    there = lambda s: {SHORT[k][0]: cell(k, s["overall"][k]) for k in keys if k in s["overall"]}
    return [row | there(s) for row, s in zip(rows, summaries, strict=True)]


def energy_rows(summaries: list[dict]) -> list[list[dict]]:
    """Rows of the second table; none if the task has no such figures."""
    return [overall(summaries, (*FIRST, *REST))] if any(key in summaries[0]["overall"] for key in REST) else []


def not_as_trained(summaries: list[dict]) -> list[str]:
    """Lines, one for each policy judged with another robot, other constants or draws, another water or command path."""
    told = [(s["controller"], s["policy"]["said"]) for s in summaries if s["policy"]]
    return [f"{name} is not judged as trained: {said}" for name, said in told if said]


def cell(key: str, e: dict, interval: bool = True) -> str:
    """Text of an estimate, `0.052 (0.048 0.057)`; a median over arrivals includes their number."""
    digits = SHORT[key][1]
    if e["n"] == 0:
        return "-"
    text = f"{e['value']:.{digits}f}"
    if interval and not e["why"]:
        text += f" ({e['low']:.{digits}f} {e['high']:.{digits}f})"
    return f"{text} n={e['n']}" if key in MEDIANS else text


def unbounded(summaries: list[dict]) -> list[str]:
    """Controllers' figures without an interval, with the reason: one line for each reason."""
    found: dict[tuple[str, str], list[str]] = {}
    for s in summaries:
        for key, e in s["overall"].items():
            if e["why"] and (e["n"] or e["why"] != too_few(0)):
                found.setdefault((s["controller"], e["why"]), []).append(SHORT[key][0])
    return [f"{name}: {', '.join(heads)}: {why}" for (name, why), heads in found.items()]


def failures(results: list[Result]) -> list[str]:
    """Lines, one for each controller in whose trials the flow solver failed."""
    lines = []
    for r in results:
        if (lost := failed(r)).any():
            times = r.t[r.left[lost]]
            words = f"the flow solver failed in {lost.sum()} of {len(lost)} trials"
            when = f"after {times.min():.1f} to {times.max():.1f} s"
            lines.append(f"{r.controller}: {words}, {when}: figures over later times are of the other trials alone")
    return lines


def number(x: float, form: str) -> str:
    """Text of a number, or `-` for NaN."""
    return format(x, form) if isfinite(x) else "-"


def by_condition(summary: dict, which: str) -> list[dict]:
    """Rows by speed (`by_speed`) or by direction (`by_los`) of one controller, values only."""
    head = {"by_speed": "flow [m/s]", "by_los": "los [deg]" if summary.get("task") != ANGLE else "angle [deg]"}[which]
    order, has = sorted(summary[which], key=float), [k for k in MAIN if k in summary["overall"]]
    return [{head: name, **{SHORT[k][0]: cell(k, summary[which][name][k], interval=False) for k in has}} for name in order]


def conditions_of(summary: dict) -> dict[str, str]:
    """Key and title of each table by condition."""
    task = summary.get("task", HOLD)
    by_los = {HOLD: "by direction (0 = target straight upstream)", ANGLE: "by the start's angle from upstream"}
    return {"by_speed": "by flow speed"} | ({"by_los": by_los[task]} if task in by_los else {})


def corrected(r: Result) -> list[dict]:
    """Rows, one for each trial of the water hybrid: the changes by its segments, and the uncertainty at its end."""
    rows = []
    for i, change in enumerate(corrections(r)):
        segments = change["segments"]
        seen = [row for row in segments if "before" in row]
        moved = [f"{row['applied']:.0f} s" for row in seen if row["moved"]]
        stream = [f"{u:+.3f} ({sd:.3f})" for u, sd in zip(change["stream"], change["stream_sd"], strict=True)]
        kinds = [*KINDS, *(f"tail {kind}" for kind in KINDS)]
        factors = zip(kinds, change["factors"], change["factors_sd"], strict=True)
        row = {"trial": name_of(r, i), "segments": len(segments), "moved at": ", ".join(moved) or "-"}
        row["miss before, after"] = "; ".join(f"{s['before']:.2f}, {s['after']:.2f}" for s in seen) or "-"
        row["stream [m/s]"] = ", ".join(stream)
        row["factors"] = ", ".join(f"{kind} {f:.2f} ({sd:.2f})" for kind, f, sd in factors if f != 1.0) or "-"
        rows.append(row)
    return rows


def paired(first: Result, second: Result, keys=MAIN) -> list[dict]:
    """Rows second minus first, trial by trial: mean difference, its interval or the reason for its absence, Welch's t-test."""
    rows = []
    for d in compare(first, second):
        if d.key not in keys:
            continue
        head, digits = SHORT[d.key]
        value = f"{d.value:+.{digits}f}" if d.n else "-"
        row: dict[str, object] = {"key": head, f"{second.controller} - {first.controller}": value}
        row["95 % interval"] = d.interval(digits)
        row |= {"pairs": d.n, "Welch t": number(d.welch_t, ".2f"), "Welch p": number(d.welch_p, ".2g")}
        rows.append(row)
    return rows


def paired_entries(results: list[Result]) -> list[dict]:
    """Differences of all figures between the first controller and each of the others, for results.json."""
    a = results[0]
    return [{"a": a.controller, "b": b.controller, **d._asdict()} for b in results[1:] for d in compare(a, b)]


def say_tables(results: list[Result], summaries: list[dict], head: Sequence[str], in_detail: Sequence[dict]) -> None:
    """Prints lines above, the figures of all controllers, those `in_detail` by condition, and differences from the first."""
    console.say("", *head, "value (95 % bootstrap interval over trials)", "")
    console.say(console.table(overall(summaries)), "")
    console.say(*map(console.table, energy_rows(summaries)), *unbounded(summaries))
    for s in in_detail:
        for which, what in conditions_of(s).items():
            console.say("", f"{s['controller']} {what}", console.table(by_condition(s, which)))
    for r in results:
        if r.corrections is not None:
            console.say("", f"{r.controller}: {CORRECTED}", console.table(corrected(r)))
    for other in results[1:]:
        what = f"{other.controller} minus {results[0].controller}"
        console.say("", f"paired over the same trials: {what}; {STARRED}", console.table(paired(results[0], other)))


def write(
    folder: Path,
    results: list[Result],
    found: dict,
    *,
    plots: bool = False,
    logs: bool = False,
    replay: ReplayWriter | None = None,
    again: str = "",
) -> Path:
    """Writes the report into `folder`, the figures first, in place of an older one; returns the path of report.html.

    replay: writes the page that plays the worst trial; None: no such page.
    again: command that repeats the judgement with trial folders and the replay of the worst trial, for a page without them.

    Raises StoreError: some parts could not be written or drawn; names each with the reason. All other parts were written.
    """
    shown: list[tuple[Path, str]] = []
    failed: dict[str, Exception] = {}

    def attempt(name: str, make: Callable[[], object]) -> None:
        try:
            make()
        except (OSError, MemoryError, FishmjError) as error:
            failed[name] = error

    def draw() -> None:
        from fishmj.evaluate.plots import pictures

        shown.extend(pictures(results, folder))

    attempt("results.json, trials.csv", lambda: save(folder, results, found))
    if plots:
        attempt("pictures", draw)
    if logs:
        for r in results:
            attempt(f"logs of {r.controller}", partial(write_logs, r, folder / "logs"))
    if replay is not None:
        attempt(WORST, lambda: replay_of_worst(results[0], folder / WORST, replay))
    played = WORST if replay is not None and WORST not in failed else ""
    attempt("report.html", lambda: write_text(folder / "report.html", page(results, found, shown, played, again)))
    if failed:
        missing = "; ".join(f"{name}: {error or type(error).__name__}" for name, error in failed.items())
        raise StoreError(f"{folder}: not complete, everything else is there. Not written: {missing}")
    return folder / "report.html"


def save(folder: Path, results: list[Result], found: dict) -> None:
    """Writes the figures alone, results.json and trials.csv, each atomically; removes parts of an older report."""
    folder.mkdir(parents=True, exist_ok=True)
    clear(folder, *EARLIER)
    write_text(folder / "results.json", json.dumps(console.plain(found), indent=1) + "\n")
    write_text(folder / "trials.csv", trials_csv(results))


def trials_csv(results: list[Result]) -> str:
    """CSV text, one row for each trial and controller: condition, seed, times of leaving and failing [s], figures."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    keys = list(figures(results[0]))
    out.writerow(["controller", "speed", "los_deg", "repeat", "seed", "flow_seed", "left_domain_at", "solver_failed_at", *keys])
    for r in results:
        found, seeds, lost = figures(r), r.trials.flow_seeds, failed(r)
        for i, t in enumerate(r.trials.items):
            end = f"{r.t[r.left[i]]:.2f}" if r.left[i] < len(r.t) else ""
            left, broke = ("", end) if lost[i] else (end, "")
            name = f"'{r.controller}" if r.controller[:1] in FORMULA else r.controller  # as spreadsheets mark text
            row = [name, f"{t.speed:g}", f"{np.degrees(t.los):g}", t.repeat, t.seed[0], seeds[i], left, broke]
            out.writerow([*row, *(f"{found[key][i]:.6g}" if np.isfinite(found[key][i]) else "" for key in keys)])
    return text.getvalue()


def worst(r: Result) -> int:
    """Index of the trial with the largest RMS distance, of `LEADING`; in a judgement too short for it, over all of it.

    A trial that has no figure since the solver failed in it is worse than any other.
    """
    key = LEADING[r.trials.task]
    far = rms(r, 0.0, float(r.t[-1])) if key in too_short(r.trials) else figures(r)[key]
    return int(np.argmax(np.nan_to_num(far, nan=np.inf)))


def holds(r: Result) -> np.ndarray | None:
    """Trials (B,) bool that arrive and stay within the arrival radius (RMS); None if too short to judge, or another task."""
    found = figures(r)
    if "rmse_after_arrival" not in found or "rmse_after_arrival" in too_short(r.trials):
        return None
    return (found["arrival"] > 0) & (found["rmse_after_arrival"] <= constant("protocol", "arrival_radius"))


def trials_held(r: Result) -> int | None:
    """Number of trials that hold; None as in `holds`."""
    return None if (within := holds(r)) is None else int(within.sum())


def held_by_speed(r: Result) -> dict[str, int] | None:
    """Number of trials that hold at each speed of the stream; None as in `holds`."""
    within, speeds = holds(r), r.trials.speed
    return None if within is None else {f"{u:g}": int(within[speeds == u].sum()) for u in np.unique(speeds)}


def provenance(r: Result, argv: Sequence[str], named: Sequence[str], k: int) -> dict:
    """Weights, water, engine and worst trial of a judgement, for results.json.

    Args:
        argv: words of `fishmj evaluate`. named: its controllers as the user gave them. k: number of this one.
    Returns:
        {"policy_sha256", "water": {name, kind, sha256}, "engine", "held", "held_by_speed",
        "worst": {trial, seed, the key of `LEADING`, replay}}
    """
    i = worst(r)
    item, key = r.trials.items[i], LEADING[r.trials.task]
    one = {
        "--speeds": f"{item.speed:g}",
        "--los": f"{np.degrees(item.los):g}",
        "--repeats": str(item.repeat + 1),
        "--out": f"runs/worst_{Path(r.controller).stem}",
    }
    replay = shlex.join(["fishmj", "evaluate", named[k], *_other_options(argv, named, one), *chain(*one.items()), "--log"])
    solved = {LBM: {"name": LBM, "kind": LBM}, HYBRID: {"kind": HYBRID}}.get(r.water, {})
    return {
        "policy_sha256": r.policy_sha256,
        "water": solved if r.water == LBM else water_identity(r.robot) | solved,
        "engine": r.engine,
        "held": trials_held(r),
        "held_by_speed": held_by_speed(r),
        "worst": {"trial": name_of(r, i), "seed": int(item.seed[0]), key: float(figures(r)[key][i]), "replay": replay},
    }


def _other_options(argv: Sequence[str], named: Sequence[str], replaced: Iterable[str]) -> list[str]:
    """Words of a command without its controllers, its flags for files, and options that are replaced, with their values."""
    words, n = list(argv), len(named)
    first = next((i for i in range(len(words)) if words[i : i + n] == list(named)), len(words))
    words, kept, skip = words[:first] + words[first + n :], [], False
    for word in words:
        if skip or word in ("--plots", "--log", "--json"):
            skip = False
        elif word in replaced:
            skip = True
        elif word.partition("=")[0] not in replaced:
            kept.append(word)
    return kept


def replay_of_worst(r: Result, out: Path, write_page: ReplayWriter) -> Path:
    """Writes the page that plays `worst`."""
    i = worst(r)
    return write_page([trial_of(r, i)], out, r.robot, f"worst of {len(r.trials)} trials: {name_of(r, i)}")


def headline(results: list[Result]) -> str:
    """Result in one sentence: number of trials held by the first controller, its distance, and the comparison with `baseline`."""
    first, radius = results[0], constant("protocol", "arrival_radius")
    found, task = figures(first), first.trials.task
    if task != HOLD:
        other, far = baseline(results), f"{estimate('', found[LEADING[task]]).value:.3f} m RMS"
        words = f"{first.controller} is {far} from the path on average"
        if task == ANGLE:
            words = (
                f"{first.controller} settles in {found['settled'].sum():.0f} of {len(first.trials)} trials, {far} from the target"
            )
        return f"{words}; {against(first, other)}." if other else f"{words}."
    after, n = found["rmse_after_arrival"], len(first.trials)
    words = f"{first.controller} arrives in {int(np.nansum(found['arrival']))} of {n} trials"
    if "rmse_after_arrival" in too_short(first.trials):
        return f"{words}, which are too short to judge how it holds."
    average = estimate(LEADING[HOLD], after).value
    words += f" and holds station in {trials_held(first)} (stays within {radius:g} m RMS), at {average:.3f} m RMS on average"
    other = baseline(results)
    return f"{words}; {against(first, other)}." if other else f"{words}."


def baseline(results: list[Result]) -> Result | None:
    """Result with which the first controller is compared: the nearest of the others; the one without control if it is alone."""
    rivals = [r for r in results[1:] if r.controller != BASELINE] or results[1:]
    key = LEADING[results[0].trials.task]
    far = lambda r: np.nan_to_num(estimate(key, figures(r)[key]).value, nan=np.inf)
    return min(rivals, key=far, default=None)


def against(first: Result, other: Result) -> str:
    """Clause on the difference in distance to the target between two controllers, or on its absence."""
    key = LEADING[first.trials.task]
    d = next(d for d in compare(first, other) if d.key == key)
    if not d.apart:
        return f"in {SHORT[key][0].partition(' [')[0]}, these trials do not tell it from {other.controller}"
    to = "the path" if first.trials.task == EIGHT else "the target"
    side = f"nearer to {to} than" if d.value > 0 else f"farther from {to} than"
    mean = estimate(key, figures(other)[key]).value
    without = "no control, " if other.controller == BASELINE else ""
    return f"{abs(d.value):.3f} m {side} {other.controller} ({without}{mean:.3f} m)"


ALONE = f"Name {BASELINE} (no control) or another controller behind it, and it is compared with that."


def page(
    results: list[Result], found: dict, shown: list[tuple[Path, str]], replay: str = "", again: str = "", alone: str = ALONE
) -> str:
    """Report as one HTML text; its only reference is `replay`, the page of the worst trial beside it, if there is one.

    alone: hint on how to add a comparison, if there is only one controller.
    """
    first, summaries, told = results[0], found["results"], baseline(results)
    mark = MARKS[first.trials.task]
    named = f"{', '.join(s['controller'] for s in summaries)}: {mark.lower()}"
    notes = [found["condition"], *not_as_trained(summaries), *failures(results)]
    if told is None:
        notes.append(f"Judged alone. {alone}")
    elif LEADING[first.trials.task] not in too_short(first.trials):
        notes += [f"Against {other.controller}: {against(first, other)}." for other in results[1:] if other is not told]
    worst_name = name_of(first, worst(first))
    if replay:
        notes.append(part("link", replay, "Replay of the worst trial", worst_name))
    elif again:
        notes.append(part("command", f"The worst trial is {worst_name}. Its replay is written by", again))
    every = [overall(summaries), *energy_rows(summaries)]
    about = "value (95 % bootstrap interval over trials)"
    sections = [Section("All trials", about, [*map(table, every), *unbounded(summaries)])]
    sections += [
        Section(f"{r.controller}: the water", CORRECTED, [table(corrected(r))]) for r in results if r.corrections is not None
    ]
    for other in results[1:]:
        title = f"{other.controller} minus {first.controller}, paired by trial"
        sections.append(Section(title, STARRED, [table(paired(first, other))]))
    sections.append(Section("", "", [figure(path.read_bytes(), caption) for path, caption in shown]))
    for s in summaries:
        conditions = [table(by_condition(s, which)) for which in conditions_of(s)]
        sections.append(Section(f"{s['controller']} by condition", "", conditions))
    heads = "".join(every[0][0])
    meant = [{"figure": key, "meaning": value} for key, value in MEANING.items() if key in heads]
    sections.append(Section("What the figures mean", "", [table(meant, left=2)]))
    return report(named, headline(results), sections, mark=mark, robot=robot_line(first.robot), notes=notes)
