"""Measures how often the right term is among the first two, on families that no catalogue holds.

python -m studies.gap_benchmark.free_terms --cases 70 --seed 51 --out runs/fallback

RIGHT lists the terms that count for each family; it is fixed before a seed is run. Families whose cause is no term of the library
(a draw of the current, a clock, a camera, ballast that slides, one tooth, a neighbour's drive) have none and are left out.
"""

import time
from pathlib import Path

from fishmj.base import console
from fishmj.base.errors import SimDiverged
from fishmj.gap.bench import bench_rows, cases
from fishmj.gap.bench.run_case import true_gap
from fishmj.gap.bench.score import DETECTABLE, share
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.terms.library import model_with_terms
from fishmj.gap.terms.select import terms_of
from fishmj.mjcf.reading import load_robot

RATE = (
    "tail rate squared",
    "tail rate squared, signed",
    "tail rate squared, signed x session time",
    "tail rate squared x session time",
)
SLIP = tuple(f.replace("tail rate", "tail speed sideways") for f in RATE)
THRUST = {"surge force ~ tail rate squared", "force along the tail ~ tail speed sideways squared"}
RIGHT: dict[str, frozenset[str]] = {
    "bouc_wen_skin": frozenset({"joint torque ~ hysteresis of the angle"}),
    "tail_yaw_cross_force": frozenset({"sway force ~ yaw rate x tail rate"}),
    "asymmetric_thrust": frozenset(THRUST | {f"{f}, signed" for f in THRUST}),
    "cubic_joint_spring": frozenset({"joint torque ~ angle cubed"}),
    "encoder_harmonic": frozenset({"servo reading ~ sine of 3 x angle"}),
    "tail_resonance": frozenset(THRUST),
    "weed_on_tail": frozenset(
        [f"{force} ~ {f}" for force in ("sway force", "yaw moment") for f in RATE]
        + [f"force across the tail ~ {f}" for f in SLIP]
    ),
}
FIRST = 2


def main(argv: list[str]) -> int:
    """Runs the cases and prints the shares. Returns the exit code."""
    parser = console.parser("studies.gap_benchmark.free_terms", __doc__)
    parser.add_argument("--cases", type=int, default=70, help="drawn over all families outside the catalogue")
    parser.add_argument("--seed", type=int, default=51)
    parser.add_argument("--out", type=Path, required=True, help="folder for rows.jsonl; continues where it stopped")
    args = parser.parse_args(argv)
    drawn = cases.draw(args.cases, args.seed, {"off": 1.0})
    todo = [c for c in drawn if next(iter(c.effects)) in RIGHT]
    result = summary(bench_rows.judge_cases(todo, args.out, judge_case, what="fallback"))
    console.say(console.table(result["families"]), f"right term in the first two: {result['right']}")
    if args.json:
        console.emit_json(result)
    return console.OK


def judge_case(case: cases.BenchCase) -> dict:
    """One case: its terms, and the rank of the first right one (0 = absent)."""
    from fishmj.gap.laboratory.virtual_robot import generate

    plant, start, family = model_with_terms(load_robot("fish")), time.monotonic(), next(iter(case.effects))
    row = {"id": case.id, "family": family, "truth": case.effects, "noise": case.noise, "logs": len(case.logs), "place": 0}
    try:
        records = [record_of(t, plant.dt) for t in generate(case.effects, case.logs, case.seed, case.noise)]
        row["true_gap"] = true_gap(plant, case, case.effects)
    except SimDiverged as error:
        return row | {"true_gap": 0.0, "reason": str(error)}
    null = SimulatedNull(noise=case.noise).residuals(plant, records, ResidualLayout(records))
    terms = terms_of(plant, records, null, case.seed)
    row["place"] = next((i + 1 for i, t in enumerate(terms) if t.name in RIGHT[family]), 0)
    row["terms"] = [[t.name, t.coefficient, t.closure, t.gain, t.q, t.stability, t.firm] for t in terms]
    return row | {"seconds": time.monotonic() - start}


def summary(rows: list[dict]) -> dict:
    """Shares over all detectable cases, and by family."""
    seen = [r for r in rows if r["true_gap"] > DETECTABLE]
    hit = lambda given: share(sum(0 < r["place"] <= FIRST for r in given), len(given))
    families = []
    for family in RIGHT:
        mine = [r for r in seen if r["family"] == family]
        first = sum(r["place"] == 1 for r in mine)
        families.append({"family": family, "n": len(mine), "first": first, "first two": hit(mine)["hits"]})
    return {"right": hit(seen), "families": families}


if __name__ == "__main__":
    raise SystemExit(console.run(main))
