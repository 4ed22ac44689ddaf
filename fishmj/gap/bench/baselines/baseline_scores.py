"""The baselines on the cases of the benchmark: the same data, one row each, scored by the same function."""

import time
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import SimDiverged
from fishmj.base.workers import ask_all
from fishmj.gap.bench.baselines.baseline_answer import BaselineAnswer
from fishmj.gap.bench.bench_rows import keep, read_rows
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.bench.run_case import fish, records_of
from fishmj.gap.bench.score import score

NAMES = ("everything_free", "delta_bic", "e_sindy", "residual_correlation")
NEEDS = {"e_sindy": ("pysindy", "bench")}
COLUMNS = ("precision", "coverage", "class_top1", "false_alarm_rate", "misnamed_off_catalogue", "pairs_both_found")


def reason_absent(name: str) -> str:
    """Reason that a baseline cannot run here, "" if it can."""
    package, extra = NEEDS.get(name, ("", ""))
    if package and find_spec(package) is None:
        return f"{name} needs {package}: pip install 'fishmj[{extra}]'"
    return ""


GAPS = ("true_gap", "each_gap", "beyond_gap", "each_beyond")  # what a row knows of its case


def rows_of(plant, case: BenchCase, own: dict, names=NAMES) -> dict[str, dict]:
    """{baseline: row} of one case, in the form of `bench.run_case`. own: the search's row of the case, for its gaps."""
    row = {"id": case.id, "kind": case.kind, "truth": case.effects, "seed": case.seed}
    row |= {"noise": case.noise, "logs": len(case.logs)}
    row |= {key: own[key] for key in GAPS if key in own} | {"gap_before": 1.0, "gap_unseen": None, "rivals": []}
    try:
        records = records_of(plant, case, case.effects, case.noise)
    except SimDiverged as error:
        return {name: row | {"answer": "DIVERGED", "reason": str(error)} for name in names}
    out = {}
    for name in names:
        start = time.monotonic()
        with np.errstate(over="ignore", invalid="ignore"):  # a fit may try a fish that leaves the finite numbers
            found: BaselineAnswer = import_module(f"fishmj.gap.bench.baselines.{name}").answer(plant, records)
        said = [{"name": n, "p_best": 1.0, "values": {k: [v, v, v] for k, v in p.items()}} for n, p in found.effects.items()]
        out[name] = row | {"answer": found.word, "said": said, "reason": found.reason, "seconds": time.monotonic() - start}
    return out


def answers(one: tuple[BenchCase, dict, tuple[str, ...]]) -> dict[str, dict]:
    """{baseline: row} from a case, the search's row of it and the names of the pending baselines."""
    return rows_of(fish(), *one)


def beside(todo: list[BenchCase], rows: list[dict], out: Path | None, jobs: int = 1) -> dict[str, list[dict]]:
    """{baseline: rows} of the cases that the search has judged; kept in `out`, one file each. Absent ones give the reason."""
    absent = {n: reason_absent(n) for n in NAMES}
    for reason in filter(None, absent.values()):
        console.say(f"skipped: {reason}")
    names = tuple(n for n in NAMES if not absent[n])
    files = {n: out / f"{n}.jsonl" for n in names} if out else {}
    done = {n: {r["id"]: r for r in read_rows(files[n])} if files else {} for n in names}
    lacking = [(case, row, tuple(n for n in names if case.id not in done[n])) for case, row in zip(todo, rows, strict=True)]
    lacking = [one for one in lacking if one[2]]
    with console.Progress(len(todo), "baselines", unit="cases") as bar:
        for i, found in enumerate(ask_all(lacking, answers, jobs), len(todo) - len(lacking) + 1):
            for name, row in console.plain(found).items():
                done[name][row["id"]] = row
                if files:
                    keep(files[name], row)
            bar.update(i)
    return {n: [done[n][case.id] for case in todo] for n in names}


def compared(rows: list[dict], others: dict[str, list[dict]]) -> str:
    """Text table with one line for the search and one for each baseline."""
    lines = []
    for name, given in {"this search": rows, **others}.items():
        result = score(given)
        shares = {c: f"{result[c]['hits']}/{result[c]['n']}" for c in COLUMNS}
        lines.append({"method": name, **shares, "median s": result["seconds_median"]})
    return console.table(lines)
