"""Measures the structural error of the search: residuals of healthy robots in other waters under their calibrated models.

    python -m studies.structural_error --robots 8 --out runs/structural_error      then copy structural_error.toml

Every robot of every family (half of them the shipped fish, half drawn chains) is calibrated to free swims of its own and does the
twelve designed experiments, with nothing hidden. A fish of the flow solver is calibrated to six of them and compared on the
others. The most likely scales for all families, and without each in turn, go into OUT/structural_error.toml; data/calib has the
shipped one. No robot belongs to a benchmark.
"""

import hashlib
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import combinations, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.cores import usable_cores
from fishmj.base.store import read_json, write_json, write_text
from fishmj.base.workers import ask_all
from fishmj.gap import progress
from fishmj.gap.bench.drawn_robots import BenchRobot, every
from fishmj.gap.bench.family_command import precompile
from fishmj.gap.laboratory import generators
from fishmj.gap.null import structural_error
from fishmj.gap.null.structural_error import StructuralErrorScales
from fishmj.gap.null.variances import Sample, VarianceScore, score_variances
from studies.structural_error.most_likely import VarianceFit, most_likely
from studies.structural_error.sample import (
    BEGIN,
    CHANNELS,
    EFFECTS,
    NUMBERS,
    SOLVER,
    WHITE,
    SolverFish,
    measured,
    own_left,
    sample,
    solver_fish,
    stage_gains,
)
from studies.structural_error.unseen_family import level

Left = tuple[str, ...]  # families that a fit has not seen
NAMES = (*generators.NAMES, SOLVER)
SEED = 40  # no benchmark's
HEALTHY = 0.95  # share of healthy robots of a family left out that agree
LEFT_OUT = [(), *((name,) for name in NAMES), *combinations(NAMES, 2)]
ABOUT = ("from record to record", f"every {structural_error.SPACING:g} s")
FLOOR = 1e-3  # of where a variance begins, when it begins from that of all families
DROP = 1e-2  # of where a width begins: one that fell below it is none


def main(argv: list[str]) -> int:
    """Measures the missing robots, fits the scales and writes the file; returns the exit code."""
    parser = console.parser("studies.structural_error", __doc__)
    add = parser.add_argument
    add("--robots", type=console.whole(2, 1000), default=8, metavar="N", help="of each family (default 8)")
    add("--seed", type=console.whole(0, 499), default=SEED, metavar="N", help=f"of the robots (default {SEED})")
    add("--rounds", type=console.whole(1, 10_000), default=24, metavar="N", help="of the algorithm (default 24)")
    add("--jobs", type=console.whole(0, 1024), default=0, metavar="N", help="processes; 0: one a core (default 0)")
    add("--out", type=console.out_folder, required=True, help="folder; the same command goes on where it stopped")
    args = parser.parse_args(argv)
    jobs, todo = args.jobs or usable_cores(), chosen(args.seed, args.robots)
    args.out.mkdir(parents=True, exist_ok=True)
    precompile(set(generators.NAMES))
    rows = []
    with progress.terminal_bar(len(todo), "robots", "robots") as bar:
        for row in ask_all(todo, partial(measured, folder=args.out), jobs):
            rows.append(row)
            bar.update(len(rows))
    refused = [f"{row['robot']}: {row['reason']}" for row in rows if "reason" in row]
    robots = {row["robot"]: row["family"] for row in sorted(rows, key=lambda row: row["robot"]) if "reason" not in row}
    console.say(f"{len(robots)} robots in {args.out}", *refused)
    samples = {name: sample(args.out / f"{name}.npz") for name in robots}
    found: dict[Left, VarianceFit] = {}
    with ThreadPoolExecutor(jobs) as pool, progress.terminal_bar(args.rounds * len(LEFT_OUT), "widths", "rounds") as bar:
        for turn, out in enumerate(LEFT_OUT):
            seen = {name: samples[name] for name, family in robots.items() if family not in out}
            done = lambda rounds, before=turn * args.rounds: bar.update(before + rounds)
            search = partial(most_likely, asker(list(seen.values()), pool), *begin(found.get(())), args.rounds, done)
            found[out] = read_or_fit(args.out, [*seen, str(args.rounds), *NUMBERS, *EFFECTS], search)
    left_over = [one for one in todo if one.id in robots]
    gains = by_widths(left_over, found, args.out, jobs, "gains", stage_gains)
    free = [one for one in left_over if one.family != SOLVER]
    owns = by_widths(free, found, args.out, jobs, "own", own_left)
    healthy: dict[Left, Healthy] = {}
    for out in LEFT_OUT[: 1 + len(NAMES)]:
        # by fits that used neither their family nor the one left out
        unseen = [(name, both(out, family)) for name, family in robots.items() if family not in out]
        left = [score_variances(samples[name], found[told].u, found[told].p).adequacy for name, told in unseen]
        own = [owns[name][key(told)] if name in owns else np.nan for name, told in unseen]
        healthy[out] = Healthy([robots[name] for name, _ in unseen], left, own, [gains[name][key(told)] for name, told in unseen])
    write_text(args.out / structural_error.FILE, toml({out: found[out] for out in healthy}, healthy))
    lines = [line(out, found[out], one) for out, one in healthy.items()]
    console.say(console.table(lines))
    if args.json:
        console.emit_json({"table": lines, "robots": len(robots), "refused": refused})
    return console.OK


def read_or_fit(folder: Path, of: list[str], search: Callable[[], VarianceFit]) -> VarianceFit:
    """Fit that is kept in the folder, or is made and kept there. of: all its inputs."""
    path = folder / f"fit-{hashlib.sha256(' '.join(of).encode()).hexdigest()[:12]}.json"
    if not path.is_file():
        made = search()
        write_json(path, made._asdict() | {"u": made.u.tolist(), "p": made.p.tolist()})
    told = read_json(path)
    return VarianceFit(**told | {"u": np.array(told["u"]), "p": np.array(told["p"])})


class Healthy(NamedTuple):
    """Misfits of healthy robots of families that a fit did not use, by robot.

    Their families; |z|^2 / m of new experiments, and of the free swims to which their water was calibrated (NaN for a fish of the
    solver, which is calibrated to designed experiments); and the fall of |z|^2 per record by the best effect of each stage.
    """

    families: list[str]
    adequacy: list[float]
    calibration_residual: list[float]
    gains: list[dict[str, float]]

    @property
    def beyond_own(self) -> float:
        """Ratio of |z|^2 / m of new experiments over own free swims that `HEALTHY` of an unseen family's robots stay below."""
        ratios: dict[str, list[float]] = {name: [] for name in self.families if name != SOLVER}  # it has no free swims
        for name, new, own in zip(self.families, self.adequacy, self.calibration_residual, strict=True):
            if name != SOLVER:
                ratios[name].append(new / own)
        return level(list(ratios.values()), HEALTHY)

    @property
    def most(self) -> dict[str, float]:
        """Largest gain by stage, over all robots."""
        return {stage: max(one[stage] for one in self.gains) for stage in self.gains[0]}


def both(out: Left, family: str) -> Left:
    """Families left out, and one more."""
    return tuple(name for name in NAMES if name in (*out, family))


def key(out: Left) -> str:
    """Name of a table."""
    return "-".join(out) or structural_error.ALL


def by_widths(
    todo: list, found: dict[Left, VarianceFit], folder: Path, jobs: int, what: str, of: Callable[..., dict]
) -> dict[str, dict[str, Any]]:
    """Results of `of` for each healthy robot, by all scales fitted without its family: robot -> name of scales -> result.

    Kept in `folder` under the scales' hash. what: `gains` or `own`, the key of the result.
    """
    text = toml(found, {})
    tables = {
        name: StructuralErrorScales.from_table(**table) for name, table in tomllib.loads(text).items() if isinstance(table, dict)
    }
    ask = partial(of, folder=folder, mark=hashlib.sha256(text.encode()).hexdigest()[:12])
    unseen = {name: {key(out): tables[key(out)] for out in LEFT_OUT if name in out} for name in NAMES}
    told: dict[str, dict[str, Any]] = {}
    with progress.terminal_bar(len(todo), what, "robots") as bar:
        for row in ask_all([(one, unseen[one.family]) for one in todo], ask, jobs):
            told[row["robot"]] = row[what]
            bar.update(len(told))
    return told


def chosen(seed: int, many: int) -> list[BenchRobot | SolverFish]:
    """`many` robots of each family, drawn as for a benchmark of that seed, and as many fish of the flow solver."""
    return [*islice(every(seed, generators.NAMES, 1), many * len(generators.NAMES)), *solver_fish(many)]


def begin(of_all: VarianceFit | None) -> tuple[np.ndarray, np.ndarray]:
    """Initial variances: of the numbers, in units of their prior's, and of the effects, of `EFFECTS`; and of the channels.

    of_all: those of all families, if known, which are closer. None is zero, because a variance of zero would stay zero.
    """
    white = np.append(np.full(len(CHANNELS), WHITE**2), 0.0)
    u = np.append(np.full(2 * len(NUMBERS), BEGIN**2), np.ones(sum(map(len, EFFECTS.values()))))
    return (u, white) if of_all is None else (np.maximum(of_all.u, FLOOR * u), np.maximum(of_all.p, FLOOR * white))


def asker(samples: list[Sample], pool: ThreadPoolExecutor) -> Callable[[np.ndarray, np.ndarray], list[VarianceScore]]:
    """Function that evaluates every robot, side by side: nearly all of it is linear algebra, which releases Python's lock."""
    return lambda u, p: list(pool.map(lambda s: score_variances(s, u, p), samples))


def line(out: Left, found: VarianceFit, healthy: Healthy) -> dict:
    """Row of a table: misfit and gains of robots in the fit, and of robots of families outside it."""
    shown = lambda values: f"{np.mean(values):.2f} ({min(values):.2f} to {max(values):.2f})"
    return {
        "without": ", ".join(out) or "-",
        "robots": len(found.adequacy),
        "|z|^2 / m": shown(found.adequacy),
        "of a family left out": shown(healthy.adequacy),
        "of their own swims": shown([own for own in healthy.calibration_residual if np.isfinite(own)]),
        "new over own, of an unseen family": f"{healthy.beyond_own:.2f}",
        **{f"gain, {stage}": round(most) for stage, most in healthy.most.items()},
        "-2 log L a robot": round(found.loss / len(found.adequacy)),
    }


def toml(tables: dict[Left, VarianceFit], healthy: dict[Left, Healthy]) -> str:
    """Text of the search's file."""
    out = ["# Structural error of the search (fishmj/gap/null/structural_error.py): [all], and [FAMILY] without its robots."]
    out += ["# Measured on healthy robots of fishmj/gap/laboratory/generators and of the flow solver, *synthetic*:"]
    out += ["# python -m studies.structural_error --out DIR", f'schema = "{structural_error.SCHEMA}"']
    for left, found in tables.items():
        name, width, white = key(left), np.sqrt(found.u), np.sqrt(found.p)
        kept = lambda value, start: float(f"{value:.3g}") if value > DROP * start else 0.0
        out += ["", f"[{name}]"]
        if left in healthy:
            about = f"{HEALTHY:.0%} of healthy robots of a family left out are below"
            out += [f"adequacy = {float(np.quantile(healthy[left].adequacy, HEALTHY)):.3g}  # |z|^2 / m: {about}"]
            ratio = f"{healthy[left].beyond_own:.3g}  # |z|^2 / m of new experiments over that of the swims of the calibration"
            out += [f"beyond_own = {ratio}: {HEALTHY:.0%} of robots of an unseen family are below"]
            out += ["", f"[{name}.gains]  # |z|^2 a record that effects of a stage take off: of all of these at most"]
            out += [f"{stage} = {most:.3g}" for stage, most in healthy[left].most.items()]
        halves = width[: 2 * len(NUMBERS)].reshape(2, -1)
        for table, about, mine in zip(("numbers", "swings"), ABOUT, halves, strict=True):
            out += ["", f"[{name}.{table}]  # of one standard deviation of the prior, {about}"]
            out += [f"{number} = {kept(w, BEGIN)}" for number, w in zip(NUMBERS, mine, strict=True)]
        out += ["", f"[{name}.effects]  # one standard deviation among healthy robots, SI"]
        sizes = iter(width[2 * len(NUMBERS) :])
        for effect, values in EFFECTS.items():
            sizes_of = {parameter: kept(next(sizes), 1.0) * start for parameter, start in values.items()}
            if any(sizes_of.values()):
                out += [f"{effect} = {{ {', '.join(f'{parameter} = {v:.3g}' for parameter, v in sizes_of.items())} }}"]
        out += ["", f"[{name}.channels]  # of the null runs' root mean square"]
        out += [f"{channel} = {kept(r, WHITE)}" for channel, r in zip(CHANNELS, white, strict=False)]
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    raise SystemExit(console.run(main))
