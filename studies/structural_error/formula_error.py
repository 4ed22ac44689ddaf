"""Error of an effect's size by a formula in another water, measured on effects that the search named right.

    R=studies/gap_benchmark/rows
    python -m studies.structural_error.formula_error $R/families_611.jsonl $R/solver_21.jsonl $R/solver_21_again.jsonl \\
        --out data/calib/formula_error.toml

    q_fr = (true - found) / (found - null)     effect r of a stage in family f of F, R of each; calibrated models
    V    = (1 + 1/F) B + (1 - 1/R) W           B: mean square of the families' means; W: mean variance within a family
    f    = t_(0.95, nu) V^1/2 / 1.645          nu by Satterthwaite (1946)

A current moves a fish by the coefficients of that water, so the errors of one family have one sign, and many effects of few
families say little about the next. The prediction limit is that of `unseen_family`, about zero, because the sign is not known.
t / 1.645 makes it the standard deviation of a normal distribution with that 90 % interval. Effects whose size is a vector are
left
out: a component may be near zero. A stage with two effects in fewer than three families is also left out.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import hmean
from scipy.stats import t as student

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.effects import STAGES
from fishmj.gap.bench.bench_rows import read_rows
from fishmj.gap.bench.score import has_values, names, share
from fishmj.gap.decide.decide import size_parameters
from fishmj.gap.laboratory.generators.detectability import BOUND
from fishmj.gap.null.structural_error import ALL
from fishmj.gap.thresholds import thresholds

FAMILIES, EFFECTS = 3, 2  # of a stage at least; of a family
SIDE = 0.95  # upper end of a 90 % interval


def main(argv: list[str]) -> int:
    """Measures the errors, prints the table and writes the file; returns the exit code."""
    parser = console.parser("studies.structural_error.formula_error", __doc__)
    parser.add_argument(
        "rows", nargs="+", type=console.path, help="rows.jsonl of gap bench --generator; of one id the last counts"
    )
    parser.add_argument("--out", type=console.out_file, help="TOML file to write (default none)")
    args = parser.parse_args(argv)
    rows = {row["id"]: row for path in args.rows for row in read_rows(path)}
    found = errors_of(list(rows.values()))
    if not found:
        raise ConfigError(f"formula_error: {args.rows[0]}: no right name in it; expected rows.jsonl of gap bench --generator")
    table = tables(found)
    if args.out:
        write_text(args.out, toml(table))
    console.say(console.table([{"without": name} | {s: f"{v:.3f}" for s, v in row.items()} for name, row in table.items()]))
    before, after = (held(list(rows.values()), given) for given in ({}, table))
    for family in (*sorted(after), ""):
        told = [share(*np.sum([one[f] for f in one if family in (f, "")], 0).tolist()) for one in (before, after)]
        what = f"{family or 'all'}: 90 % intervals hold {told[0]['hits']} of {told[0]['n']} with one error for all formulas"
        console.say(f"{what}, {told[1]['hits']} with those of the other families ({told[1]['low']:.0%} to {told[1]['high']:.0%})")
    if args.json:
        console.emit_json({"formula": table, "held": after})
    return console.OK


def named_right(row: dict) -> bool:
    """Returns True for a detectable single effect that was named right and alone."""
    right = row["answer"] == "NAMED" and row["kind"] == "single" and names(row) == set(row["truth"])
    return right and row.get("detectable", 0.0) > BOUND and has_values(row["said"][0])


def errors_of(rows: Sequence[dict]) -> dict[str, dict[str, list[float]]]:
    """Relative errors of the sizes of detectable singles that were named right: stage -> family -> errors."""
    out: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        if not named_right(row):
            continue
        (said,) = row["said"]
        effect = effects.get(said["name"])
        first = effect.parameters[0]
        if len(size_parameters(effect)) == 1:
            value = said["values"][first.name][0]
            if value != first.null:
                error = (row["truth"][effect.name][first.name] - value) / (value - first.null)
                out.setdefault(effect.stage, {}).setdefault(row["family"], []).append(error)
    return out


def limit(families: Sequence[Sequence[float]]) -> float:
    """Factor f from the relative errors of several families, each with at least two."""
    groups = [np.asarray(values, float) for values in families]
    count, many = len(groups), float(hmean([len(values) for values in groups]))
    between = (1.0 + 1.0 / count) * float(np.mean([values.mean() ** 2 for values in groups]))
    within = (1.0 - 1.0 / many) * float(np.mean([np.var(values, ddof=1) for values in groups]))
    variance = between + within
    if variance == 0.0:
        return 0.0
    nu = variance**2 / (between**2 / count + within**2 / sum(len(values) - 1 for values in groups))
    return float(student.ppf(SIDE, nu) * np.sqrt(variance) / thresholds().intervals.quantile)


def held(rows: Sequence[dict], table: Mapping[str, Mapping[str, float]]) -> dict[str, tuple[int, int]]:
    """Numbers of 90 % intervals that hold, and of all, by family; each is widened to the errors measured without its own family.

    rows: of a search by `formula_error` of [intervals] alone, whose part is removed.
    """
    limits, out = thresholds().intervals, {}
    for row in filter(named_right, rows):
        (said,) = row["said"]
        effect = effects.get(said["name"])
        first = effect.parameters[0]
        value, low, high = said["values"][first.name]
        error = max(table.get(row["family"], {}).get(effect.stage, 0.0), limits.formula_error)
        more = (limits.quantile * (value - first.null)) ** 2 * (error**2 - limits.formula_error**2)
        half = np.sqrt(max(high - value, value - low) ** 2 + more)
        hits, of = out.get(row["family"], (0, 0))
        out[row["family"]] = (hits + int(abs(row["truth"][effect.name][first.name] - value) <= half), of + 1)
    return out


def tables(found: Mapping[str, Mapping[str, list[float]]]) -> dict[str, dict[str, float]]:
    """Factors f by stage: of all families, and without each in turn."""
    every = sorted({family for mine in found.values() for family in mine})
    out = {}
    for without in ("", *every):
        seen = {
            stage: [values for family, values in found.get(stage, {}).items() if family != without and len(values) >= EFFECTS]
            for stage in STAGES
        }
        out[without or ALL] = {stage: limit(mine) for stage, mine in seen.items() if len(mine) >= FAMILIES}
    return out


def toml(table: Mapping[str, Mapping[str, float]]) -> str:
    """Text of the search's file."""
    lines = ["# Relative error of the size that an effect's formula asks for in a water that nobody has seen, by stage: of all"]
    lines += ["# families, and without each. Measured on right names of gap bench --generator, *synthetic*:"]
    lines += ["# python -m studies.structural_error.formula_error ROWS --out data/calib/formula_error.toml"]
    for name, row in table.items():
        lines += ["", f"[{name}]", *(f"{stage} = {value:.3g}" for stage, value in row.items())]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    raise SystemExit(console.run(main))
