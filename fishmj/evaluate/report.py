"""Files of a judgement: results.json, trials.csv, pictures, trial folders, and one self-contained report.html."""

import csv
import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from fishmj import console
from fishmj.errors import FishmjError, StoreError
from fishmj.evaluate import metrics, tables
from fishmj.evaluate.logs import write_logs
from fishmj.evaluate.result import Result
from fishmj.pages import as_html, document, escaped, picture
from fishmj.store import write_text

STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:1320px;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}
h1{font-size:1.6rem;margin:0 0 .3rem}h2{font-size:1.15rem;margin:2.2rem 0 .5rem}p{margin:.4rem 0}.quiet{color:#5a6270}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums;display:block;overflow-x:auto}
th,td{padding:.28rem .55rem;border-bottom:1px solid #e4e7ec;text-align:right;white-space:nowrap}
th{background:#f5f7fa;font-weight:600}
th:first-child,td:first-child{text-align:left}img{max-width:100%;height:auto;display:block;margin:.5rem 0}
figure{margin:1.2rem 0}figcaption{color:#5a6270}dt{font-weight:600}dd{margin:0 0 .4rem 1.2rem}"""
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
    part("report.html", lambda: write_text(folder / "report.html", page(results, found, shown)))
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


def page(results: list[Result], found: dict, shown: list[tuple[Path, str]]) -> str:
    """The report as one HTML text without outside references."""
    summaries = found["results"]
    parts = [
        f"<h1>Station holding: {escaped(', '.join(s['controller'] for s in summaries))}</h1>",
        f'<p class="quiet">{escaped(found["condition"])}</p>',
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
