"""Judgement of policies in fits of the solver, which names the one that the solver judges: `python -m studies.judged_fits`.

    python -m studies.judged_fits runs/S1 runs/S2 --family FAMILY.toml --jobs 2      80 s of a core for each policy

For each policy `rmse_after_arrival` in m, 72 trials each, and arrivals where not all arrive. `rest`: at 0 to 0.04 m/s in each
fit of the reference in the family. `streams`: at 0.1 to 0.3 m/s in the first of them, there also `late` commands (85 ms) and
`gusts` of 25 %. `slip 1`. `between`: a water with 0.2 of the fit at slip 0.95 and 0.8 of that at 0.98, for slip 0.97. The
score is the mean of `rest`, plus `streams`, plus 0.005 for each fish of `late` and `between` that does not arrive; the least is
named. *synthetic*
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import unflat
from fishmj.water.water_family import WaterFamily
from studies.judged_waters import robot_of

OUT = Path("runs") / "judged_fits"
REST, STREAMS = "0,0.02,0.04", "0.1,0.2,0.3"
WEAKER = 0.2  # share of the fit at slip 0.95
LOST = 0.005  # m, of the score for a fish that does not arrive


def between() -> str:
    """File of a water between the fits at slip 0.98 and 0.95, with the residual of the first."""
    strong, weak = HydroModel.load("swift-slip098"), HydroModel.load("swift-slip095")
    pair = WaterFamily("pair", [strong, weak], scatter=0.0, residual=(1.0, 1.0))
    mean = (1 - WEAKER) * pair.base[0] + WEAKER * pair.base[1]
    found = pair._coefficients(np, mean[None], np.array([pair.base[0, -1]]))
    return str(replace(strong, base=unflat(found[0].tolist()), name="between").save(OUT))


def cases(family: Path) -> dict[str, list[str]]:
    """Options of `fishmj evaluate` for each case."""
    members = dict.fromkeys(one.name for one in WaterFamily.load(family).members if "reference" in one.name)
    files = [str(path) if (path := family.with_name(f"{name}.toml")).exists() else name for name in members]
    made = {f"rest {k + 1}": ["--water", file, "--speeds", REST] for k, file in enumerate(files)}
    streams = ["--water", files[0], "--speeds", STREAMS]
    made |= {"streams": streams, "late": [*streams, *robot_of("late")], "slip 1": ["--water", "swift", "--speeds", STREAMS]}
    made |= {
        "gusts": [*streams, "--turbulence", "gust", "--intensity", "0.25"],
        "between": ["--water", between(), "--speeds", STREAMS],
    }
    return made


def judged(policy: str, options: list[str], folder: Path) -> tuple[float, int]:
    """RMSE after arrival in m, and how many of 72 fish do not arrive."""
    words = ["-m", "fishmj", "evaluate", policy, *options, "--engine", "compiled", "--repeats", "3", "--seed", "9"]
    subprocess.run([sys.executable, *words, "--out", str(folder)], check=True, capture_output=True, text=True)
    row = json.loads((folder / "results.json").read_text(encoding="utf-8"))["results"][0]
    return row["overall"]["rmse_after_arrival"]["value"], round(row["n"] * (1 - row["overall"]["arrival"]["value"]))


def score(found: dict[str, tuple[float, int]]) -> float:
    """Score of a policy from its cases, m; less is better."""
    rest = np.mean([rmse for name, (rmse, _) in found.items() if name.startswith("rest")])
    return float(rest) + found["streams"][0] + LOST * (found["late"][1] + found["between"][1])


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("policies", nargs="+", metavar="POLICY", help="name, file or folder of a training")
    add("--family", type=Path, required=True, help="the family's file")
    add("--jobs", type=int, default=2, help="trials of so many cases side by side (default: 2)")
    given = parser.parse_args(argv)
    OUT.mkdir(parents=True, exist_ok=True)
    made = cases(given.family)
    jobs = [(policy, name, OUT / f"{k}-{name.replace(' ', '-')}") for k, policy in enumerate(given.policies) for name in made]
    with ThreadPoolExecutor(given.jobs) as pool, console.Progress(len(jobs), "judge", "cases") as bar:
        results = []
        for job, result in zip(jobs, pool.map(lambda job: judged(job[0], made[job[1]], job[2]), jobs), strict=True):
            results.append((job[0], job[1], result))
            bar.update(len(results))
    by_policy = {policy: {name: result for of, name, result in results if of == policy} for policy in given.policies}
    scores = {policy: score(found) for policy, found in by_policy.items()}
    text = lambda rmse, lost: f"{rmse:.3f}" + (f" ({72 - lost} arrive)" if lost else "")
    rows = [{"policy": p, "score": scores[p]} | {name: text(*v) for name, v in found.items()} for p, found in by_policy.items()]
    console.say(console.table(rows), f"least: {min(scores, key=scores.__getitem__)}")
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
