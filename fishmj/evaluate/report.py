"""Files of a judgement: results.json, trials.csv, pictures, trial folders, and one self-contained report.html."""

import csv
import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from fishmj import console
from fishmj.calib import constant
from fishmj.errors import FishmjError, StoreError
from fishmj.evaluate import metrics, tables
from fishmj.evaluate.result import Result
from fishmj.evaluate.statistics import compare
from fishmj.evaluate.trial_logs import name_of, trial_of, write_logs
from fishmj.pages import as_html, document, escaped, picture
from fishmj.store import write_text

STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:1320px;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}
h1{font-size:1.6rem;margin:0 0 .3rem}h2{font-size:1.15rem;margin:2.2rem 0 .5rem}p{margin:.4rem 0}.quiet{color:#5a6270}
.headline{font-size:1.15rem;max-width:60rem}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums;display:block;overflow-x:auto}
th,td{padding:.28rem .55rem;border-bottom:1px solid #e4e7ec;text-align:right;white-space:nowrap}
th{background:#f5f7fa;font-weight:600}
th:first-child,td:first-child{text-align:left}img{max-width:100%;height:auto;display:block;margin:.5rem 0}
figure{margin:1.2rem 0}figcaption{color:#5a6270}dt{font-weight:600}dd{margin:0 0 .4rem 1.2rem}"""
WORST = "worst.html"  # the replay of the first controller's worst trial, beside the report
FORMULA = tuple("=+-@\t\r")  # what a spreadsheet takes for the start of one
MEANING = {
    "arrival": "share of trials that enter 0.1 m within 30 s",
    "approach": "time of first entry, median over the n trials that arrive",
    "rmse after": "RMS distance from first entry to 30 s; a trial without arrival counts with 10 to 30 s",
    "rmse last 20 s": "RMS distance over 40 to 60 s, all trials",
    "rmse total": "RMS distance over 0 to 30 s",
    "power": "mean electrical power, idle included",
    "RI": "rheotactic index over 30 to 60 s, heading averaged over a beat; 1 = always upstream",
}


def write(folder: Path, results: list[Result], found: dict, *, plots: bool = False, logs: bool = False) -> Path:
    """Write everything into `folder`, the figures first; returns the path of report.html.

    Raises:
        StoreError: some of it could not be written or drawn; names each part and why. Every other part was.
    """
    shown: list[tuple[Path, str]] = []
    failed: dict[str, Exception] = {}

    def part(name: str, make: Callable[[], object]) -> None:
        try:
            make()
        except (OSError, MemoryError, FishmjError) as error:
            failed[name] = error

    def draw() -> None:
        from fishmj.evaluate.plots import pictures

        shown.extend(pictures(results, folder))

    part("results.json, trials.csv", lambda: save(folder, results, found))
    if plots:
        part("pictures", draw)
    if logs:
        for r in results:
            part(f"logs of {r.controller}", partial(write_logs, r, folder / "logs"))
        part(WORST, lambda: replay_of_worst(results[0], folder / WORST))
    replay = WORST if logs and WORST not in failed else ""
    part("report.html", lambda: write_text(folder / "report.html", page(results, found, shown, replay)))
    if failed:
        missing = "; ".join(f"{name}: {error or type(error).__name__}" for name, error in failed.items())
        raise StoreError(f"{folder}: not complete, everything else is there. Not written: {missing}")
    return folder / "report.html"


def save(folder: Path, results: list[Result], found: dict) -> None:
    """The figures alone: results.json and trials.csv, each in one step."""
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "results.json", json.dumps(console.plain(found), indent=1) + "\n")
    write_text(folder / "trials.csv", trials_csv(results))


def trials_csv(results: list[Result]) -> str:
    """One row a trial and controller: condition, seed, every figure."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(["controller", "speed", "los_deg", "repeat", "seed", "flow_seed", "left_domain_at", *metrics.UNITS])
    for r in results:
        found, seeds = metrics.figures(r), [f.seed for f in r.trials.flows()]
        for i, t in enumerate(r.trials.items):
            left = f"{r.t[r.left[i]]:.2f}" if r.left[i] < len(r.t) else ""
            name = f"'{r.controller}" if r.controller[:1] in FORMULA else r.controller  # as spreadsheets mark text
            row = [name, f"{t.speed:g}", f"{np.degrees(t.los):g}", t.repeat, t.seed[0], seeds[i], left]
            out.writerow([*row, *(f"{found[key][i]:.6g}" if np.isfinite(found[key][i]) else "" for key in metrics.UNITS)])
    return text.getvalue()


def worst(r: Result) -> int:
    """Trial with the largest RMS distance after arrival; of a judgement too short for that, over all of it."""
    after = metrics.figures(r)["rmse_after_arrival"]
    return int(np.argmax(after if np.isfinite(after).all() else metrics.rms(r, 0.0, float(r.t[-1]))))


def replay_of_worst(r: Result, out: Path) -> Path:
    """The page that plays `worst`."""
    from fishmj.replay import write_html

    i = worst(r)
    return write_html([trial_of(r, i)], out, r.robot, f"worst of {len(r.trials)} trials: {name_of(r, i)}")


def headline(results: list[Result]) -> str:
    """The result in one sentence: how many trials the first controller holds, how closely, and against each other one."""
    first, radius = results[0], constant("protocol", "arrival_radius")
    found = metrics.figures(first)
    after, n = found["rmse_after_arrival"], len(first.trials)
    words = f"{first.controller} arrives in {int(found['arrival'].sum())} of {n} trials"
    if not np.isfinite(after).all():
        return f"{words}, which are too short to judge how it holds."
    held = int(np.sum((found["arrival"] > 0) & (after <= radius)))
    words += f" and holds station in {held} (stays within {radius:g} m RMS)"
    words += f", at {after.mean():.3f} m RMS on average"
    for other in results[1:]:
        d = next(d for d in compare(first, other) if d.key == "rmse_after_arrival")
        if not d.apart:
            words += f"; these trials do not tell it from {other.controller}"
            continue
        side = "nearer to the target than" if d.value > 0 else "farther from the target than"
        words += f"; {abs(d.value):.3f} m {side} {other.controller}"
    return words + "."


def page(results: list[Result], found: dict, shown: list[tuple[Path, str]], replay: str = "") -> str:
    """The report as one HTML text; its one reference is `replay`, the page of the worst trial beside it, where there is one."""
    summaries = found["results"]
    parts = [
        f"<h1>Station holding: {escaped(', '.join(s['controller'] for s in summaries))}</h1>",
        f'<p class="headline">{escaped(headline(results))}</p>',
        f'<p class="quiet">{escaped(found["condition"])}</p>',
        *(
            [f'<p><a href="{replay}">Replay of the worst trial</a>: {escaped(name_of(results[0], worst(results[0])))}</p>']
            if replay
            else []
        ),
        "<h2>All trials</h2><p class='quiet'>value (95 % bootstrap interval over trials)</p>",
        as_html(tables.overall(summaries)),
        as_html(tables.overall(summaries, ("arrival", *tables.REST))),
        *(f"<p class='quiet'>{escaped(line)}</p>" for line in tables.unbounded(summaries)),
    ]
    for other in results[1:]:
        parts.append(f"<h2>{escaped(other.controller)} minus {escaped(results[0].controller)}, paired by trial</h2>")
        parts.append(f"<p class='quiet'>{escaped(tables.STARRED)}</p>")
        parts.append(as_html(tables.paired(results[0], other)))
    for path, caption in shown:
        shown_as = picture(path.read_bytes(), caption)
        parts.append(f"<figure>{shown_as}<figcaption>{escaped(caption)}</figcaption></figure>")
    for s in summaries:
        parts.append(f"<h2>{escaped(s['controller'])} by condition</h2>")
        parts += [as_html(tables.by_condition(s, which)) for which in ("by_speed", "by_los")]
    parts.append("<h2>What the figures mean</h2><dl>")
    parts += [f"<dt>{escaped(k)}</dt><dd>{escaped(v)}</dd>" for k, v in MEANING.items()]
    return document("fishmj evaluate", "\n".join([*parts, "</dl>"]), STYLE)
