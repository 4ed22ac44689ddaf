"""Known answers: problems whose solution somebody else has, as objects that the command, the tests and CI all run.

A case is one small file in this folder:

    @register("poiseuille", rung=2, quick=True, grid="1 x 32 x 1", source="u = g y (H - y) / (2 nu)")
    def poiseuille(device):
        "Force-driven flow between two walls."
        ...
        yield about("profile error, H = 32", error, 0.0, 1e-3, absolute=True)

`rung` is its number on the validation ladder of docs/oracle.md; `quick` puts it into `cases --quick`, three minutes in all on
two cores. `cost` is the time expected on two cores; a case marked `gpu` is left out of `--all` on the CPU and runs there by name.
A check without a reference that was read is `reported`, not gated.
"""

import time
from collections.abc import Callable, Iterable
from importlib import import_module
from math import inf, nan
from pathlib import Path
from typing import NamedTuple

from fishmj.errors import UnknownName


class Check(NamedTuple):
    """One figure of a case beside what it must be."""

    quantity: str
    value: float
    low: float
    high: float
    reference: float = nan
    gated: bool = True

    @property
    def ok(self) -> bool:
        """NaN is never right."""
        return not self.gated or self.low <= self.value <= self.high


def about(quantity: str, value: float, reference: float, tolerance: float, *, absolute: bool = False) -> Check:
    """Within `tolerance` of the reference, relative unless `absolute`."""
    room = tolerance if absolute else tolerance * abs(reference)
    return Check(quantity, float(value), reference - room, reference + room, reference)


def below(quantity: str, value: float, limit: float) -> Check:
    return Check(quantity, float(value), -inf, limit)


def above(quantity: str, value: float, limit: float) -> Check:
    return Check(quantity, float(value), limit, inf)


def reported(quantity: str, value: float, reference: float = nan) -> Check:
    """A figure that nothing is held against."""
    return Check(quantity, float(value), -inf, inf, reference, gated=False)


Solve = Callable[[str], Iterable[Check]]


class Case(NamedTuple):
    """A named problem; `solve(device)` yields its checks."""

    name: str
    rung: float
    grid: str
    source: str
    quick: bool
    solve: Solve
    cost: str = ""
    gpu: bool = False

    @property
    def summary(self) -> str:
        return (self.solve.__doc__ or "").strip().partition("\n")[0]


class CaseResult(NamedTuple):
    """A case that was run."""

    case: Case
    checks: tuple[Check, ...]
    seconds: float

    @property
    def ok(self) -> bool:
        return all(check.ok for check in self.checks)


REGISTRY: dict[str, Case] = {}


def register(
    name: str, *, rung: float, grid: str, source: str, quick: bool = False, cost: str = "", gpu: bool = False
) -> Callable[[Solve], Solve]:
    """Put `solve(device)` on the ladder."""

    def keep(solve: Solve) -> Solve:
        REGISTRY[name] = Case(name, rung, grid, source, quick, solve, cost, gpu)
        return solve

    return keep


def known() -> dict[str, Case]:
    """All cases in the order of the ladder: every file of this folder registers its own."""
    for path in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        import_module(f"{__name__}.{path.stem}")
    return dict(sorted(REGISTRY.items(), key=lambda item: (item[1].rung, item[0])))


def pick(names: list[str], *, quick: bool = False, everything: bool = False, gpu: bool = True) -> list[Case]:
    """The cases of these names; without names the quick ones, or all, those marked `gpu` only where there is one.

    Raises:
        UnknownName: a case that does not exist.
    """
    table = known()
    for name in names:
        if name not in table:
            raise UnknownName("case", name, table)
    if names:
        return [table[name] for name in names]
    return [case for case in table.values() if (everything and (gpu or not case.gpu)) or (case.quick and quick)]


def solve(case: Case, device: str) -> CaseResult:
    """Run one case and take its time."""
    start = time.perf_counter()
    checks = tuple(case.solve(device))
    return CaseResult(case, checks, time.perf_counter() - start)


def rows(outcome: CaseResult) -> list[dict]:
    """The lines of the validation table."""
    return [
        {
            "rung": outcome.case.rung,
            "case": outcome.case.name,
            "quantity": check.quantity,
            "value": check.value,
            "reference": check.reference,
            "from": check.low if check.gated else nan,
            "to": check.high if check.gated else nan,
            "verdict": ("ok" if check.ok else "MISS") if check.gated else "reported",
        }
        for check in outcome.checks
    ]
