"""Rows of the tables in the terminal and in the report: with units and intervals, every condition named."""

from math import isfinite

from fishmj.evaluate.result import Result
from fishmj.evaluate.statistics import APART, compare

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
}
STARRED = f"* = the interval excludes 0, of {APART} pairs or more"
MAIN = ("arrival", "approach_time", "rmse_after_arrival", "rmse_last20", "rmse_total", "power", "rheotactic_index")
REST = ("energy_per_metre", "cost_of_transport", "rheotactic_index_linear")


def condition(result: Result) -> str:
    """One line that names everything that a figure depends on."""
    t = result.trials
    speeds = "/".join(f"{u:g}" for u in sorted(set(t.speed)))
    turbulence = "no turbulence" if t.turbulence == "none" else f"{t.turbulence} turbulence {100 * t.intensity:g} %"
    switch = lambda on: "on" if on else "off"
    return (
        f"{len(t)} trials of {t.duration:g} s, flow {speeds} m/s, {turbulence}, water {result.water}, engine {result.engine}, "
        f"command path {result.robot.timing.command_path}, start heading {t.heading}, "
        f"randomisation {switch(t.randomisation)}, noise {switch(t.noise)}, seeds {t.box} {t.items[0].seed[0]}"
    )


def overall(summaries: list[dict], keys=MAIN) -> list[dict]:
    """One row a controller: value and 95 % interval over trials."""
    return [{"controller": s["controller"], **{SHORT[k][0]: cell(k, s["overall"][k]) for k in keys}} for s in summaries]


def cell(key: str, e: dict, interval: bool = True) -> str:
    """`0.052 (0.048 0.057)`; the median over arrivals says their number."""
    digits = SHORT[key][1]
    if e["n"] == 0:
        return "-"
    text = f"{e['value']:.{digits}f}"
    if interval and not e["why"]:
        text += f" ({e['low']:.{digits}f} {e['high']:.{digits}f})"
    return f"{text} n={e['n']}" if key == "approach_time" else text


def unbounded(summaries: list[dict]) -> list[str]:
    """Which figures of which controller stand there without an interval, and why: a line a reason."""
    found: dict[tuple[str, str], list[str]] = {}
    for s in summaries:
        for key, e in s["overall"].items():
            if e["why"] and e["n"]:
                found.setdefault((s["controller"], e["why"]), []).append(SHORT[key][0])
    return [f"{name}: {', '.join(heads)}: {why}" for (name, why), heads in found.items()]


def number(x: float, form: str) -> str:
    """A number, or `-` where there is none."""
    return format(x, form) if isfinite(x) else "-"


def by_condition(summary: dict, which: str, keys=MAIN) -> list[dict]:
    """Rows by speed (`by_speed`) or by direction (`by_los`) of one controller, values only."""
    head = {"by_speed": "flow [m/s]", "by_los": "los [deg]"}[which]
    order = sorted(summary[which], key=float)
    return [{head: name, **{SHORT[k][0]: cell(k, summary[which][name][k], interval=False) for k in keys}} for name in order]


def paired(first: Result, second: Result, keys=MAIN) -> list[dict]:
    """second minus first, trial by trial: mean difference, its interval or why there is none, Welch's t-test."""
    rows = []
    for d in compare(first, second):
        if d.key not in keys:
            continue
        head, digits = SHORT[d.key]
        row: dict[str, object] = {
            "key": head,
            f"{second.controller} - {first.controller}": f"{d.value:+.{digits}f}" if d.n else "-",
        }
        row["95 % interval"] = d.why or f"({d.low:+.{digits}f} {d.high:+.{digits}f}){' *' if d.apart else ''}"
        row |= {"pairs": d.n, "Welch t": number(d.welch_t, ".2f"), "Welch p": number(d.welch_p, ".2g")}
        rows.append(row)
    return rows
