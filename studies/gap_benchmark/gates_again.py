"""Decides the rows of a benchmark again with the gate that each robot's own healthy swims allow, without a search.

    R=studies/gap_benchmark/rows
    python -m studies.gap_benchmark.gates_again $R/solver_21.jsonl $R/solver_21_own.json

A search does not depend on the gate of agreement, nor on that of the residual; only the decision does. A row holds the gates'
inputs (`gates`, `steps`), so that `AGREES` and `UNEXPLAINED` follow from it. If the gates let a name pass, the later vetoes are
needed, and the answer is `SEARCH`: only `gap bench` itself can give it. `NAMED` and `CLASS` stay, since the gate only widens.
"""

from collections.abc import Mapping

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import read_json
from fishmj.gap.bench.bench_rows import read_rows
from fishmj.gap.bench.score import share
from fishmj.gap.null import structural_error
from fishmj.gap.search.model_error import misformed
from fishmj.gap.thresholds import Gates, frozen, residual_allowed

SEARCH = "SEARCH"
SAID = "UNEXPLAINED"  # the answer that another gate may change


def main(argv: list[str]) -> int:
    """Decides the rows again and prints the changed answers. Returns the exit code."""
    parser = console.parser("studies.gap_benchmark.gates_again", __doc__)
    parser.add_argument("rows", type=console.path, help="rows.jsonl of gap bench --generator")
    parser.add_argument("own", type=console.path, help="JSON: robot -> |z|^2 / m that its model leaves of its own free swims")
    args = parser.parse_args(argv)
    rows, residuals = read_rows(args.rows), read_json(args.own)
    if not rows:
        raise ConfigError(f"gates_again: {args.rows}: no rows in it; expected rows.jsonl of gap bench")
    found = [
        {"id": row["id"], "kind": row["kind"], "before": row["answer"], "now": redecide(row, gates_of(row, residuals))}
        for row in rows
        if row["robot"] in residuals and "gates" in row
    ]
    console.say(console.table([row for row in found if row["before"] != row["now"]]) or "no answer changes")
    none = [row for row in found if row["kind"] == "none"]
    for when in ("before", "now"):
        agrees = share(sum(row[when] == "AGREES" for row in none), len(none))
        console.say(f"AGREES {when}: {agrees['hits']} of {agrees['n']} (95 %: {agrees['low']:.1%} to {agrees['high']:.1%})")
    if args.json:
        console.emit_json({"rows": found})
    return console.OK


def gates_of(row: Mapping, calibration_residuals: Mapping[str, float]) -> Gates:
    """Gates of a row's robot, from structural error scales without its family."""
    residual = calibration_residuals.get(row["robot"], 0.0)
    return structural_error.allowed(frozen(), structural_error.widths(row["family"]), residual)


def redecide(row: Mapping, gates: Gates) -> str:
    """Answer with these gates, in the order of `decide.decide`; SEARCH if only a search can tell."""
    if row["answer"] != SAID:
        return row["answer"]
    checks, first = row["gates"], row["steps"][0] if row["steps"] else None
    within = checks["adequacy"] <= gates.adequacy
    if first is None or not first["accepted"] or "form" not in checks:  # nothing was found, chance, or as in healthy robots
        return "AGREES" if first is None or within else SAID
    held = checks["closure"] < gates.closure and checks["rest"] > (1.0 + gates.adequacy) / 2
    held = held or checks["rest"] > residual_allowed(checks, gates) or misformed(checks)
    held = held or checks["size"] > gates.size or checks["transfer"] < gates.transfer
    return SAID if held else SEARCH


if __name__ == "__main__":
    raise SystemExit(console.run(main))
