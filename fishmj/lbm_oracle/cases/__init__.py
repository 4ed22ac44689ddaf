"""Known answers: problems with a published or exact solution, as objects that the command, the tests and CI all run.

A case is one small file in this folder:

    @register("poiseuille", rung=2, quick=True, grid="1 x 32 x 1", source="u = g y (H - y) / (2 nu)")
    def poiseuille(device):
        "Force-driven flow between two walls."
        ...
        yield about("profile error, H = 32", error, 0.0, 1e-3, absolute=True)

`rung` is its number on the validation ladder of docs/solver/results.md; `quick` puts it into `cases --quick`, three minutes in
all on two cores. `cost` is the expected time on two cores. On the CPU, `--all` leaves out a case marked `gpu`, which runs there
by name. A check whose reference was not read is `reported`, not gated. Such a function in a file of your own is a case, too:
`fishmj lbm_oracle cases my_case.py:poiseuille_3d`.
"""

import time
from collections.abc import Callable, Iterable
from importlib import import_module
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

from fishmj.base import console, plugins
from fishmj.base.errors import ConfigError, OwnCodeError
from fishmj.lbm_oracle.fluid.device import device_of


class Check(NamedTuple):
    """One quantity of a case, with the range in which it must lie."""

    quantity: str
    value: float
    low: float
    high: float
    reference: float = nan
    gated: bool = True

    @property
    def ok(self) -> bool:
        """Returns True if the value is in range; False for NaN."""
        return not self.gated or self.low <= self.value <= self.high


def about(quantity: str, value: float, reference: float, tolerance: float, *, absolute: bool = False) -> Check:
    """Check that the value is within `tolerance` of the reference, relative unless `absolute`."""
    room = tolerance if absolute else tolerance * abs(reference)
    return Check(quantity, float(value), reference - room, reference + room, reference)


def below(quantity: str, value: float, limit: float) -> Check:
    """Check that the value is at most `limit`."""
    return Check(quantity, float(value), -inf, limit)


def above(quantity: str, value: float, limit: float) -> Check:
    """Check that the value is at least `limit`."""
    return Check(quantity, float(value), limit, inf)


def reported(quantity: str, value: float, reference: float = nan) -> Check:
    """Check without limits: the value is reported only."""
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
        """First line of the docstring of `solve`."""
        return (self.solve.__doc__ or "").strip().partition("\n")[0]


class CaseResult(NamedTuple):
    """Checks and wall time of a case that was run."""

    case: Case
    checks: tuple[Check, ...]
    seconds: float

    @property
    def ok(self) -> bool:
        """Returns True if all checks passed."""
        return all(check.ok for check in self.checks)


REGISTRY: dict[str, Case] = {}


def register(
    name: str, *, rung: float, grid: str, source: str, quick: bool = False, cost: str = "", gpu: bool = False
) -> Callable[[Solve], Solve]:
    """Returns a decorator that adds `solve(device)` to the ladder. Raises ConfigError: another case has this name."""

    def keep(solve: Solve) -> Solve:
        if name in REGISTRY:
            raise ConfigError(f"case {name!r}: registered twice; give one of them another name")
        REGISTRY[name] = Case(name, rung, grid, source, quick, solve, cost, gpu)
        return solve

    return keep


def entry(name: str, summary: str, solve: Solve, **given: Any) -> None:
    """Adds a case that differs from others of its file in numbers alone. given: as of `register`."""

    def row(device: str) -> Iterable[Check]:
        return solve(device)

    row.__doc__ = summary
    register(name, **given)(row)


def known() -> dict[str, Case]:
    """All cases in the order of the ladder: every file of this folder registers its own."""
    for path in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        import_module(f"{__name__}.{path.stem}")
    return dict(sorted(REGISTRY.items(), key=lambda item: (item[1].rung, item[0])))


def pick(names: list[str], *, quick: bool = False, everything: bool = False, gpu: bool = True) -> list[Case]:
    """Cases of these names; without names the quick ones, or all. Those marked `gpu` are included only if there is a GPU.

    Args:
        names: of cases here, or the user's own as `plugins.load` finds them.
    Raises:
        UnknownName: a case that does not exist. OwnCodeError: the user's own fails, or is not a case.
    """
    table = known()
    if names:
        return [table[name] if name in table else _own(name, table) for name in names]
    return [case for case in table.values() if (everything and (gpu or not case.gpu)) or (case.quick and quick)]


def _own(text: str, table: dict[str, Case]) -> Case:
    """Case of the user's own; an error in its `solve` becomes one line with file and line."""
    what, given = f"case {text}", plugins.load("case", text, table)
    case = next((case for case in REGISTRY.values() if case.solve is given), None)
    if case is None:
        raise OwnCodeError(f"{what}: expected a function under @register(..) of fishmj.lbm_oracle.cases, got {given!r}")
    plugins.takes(what, given, f"{case.name}(device)", 1)

    def checked(device: str) -> tuple[Check, ...]:
        found = plugins.call(what, lambda: tuple(given(device)))
        if strange := [check for check in found if not isinstance(check, Check)]:
            raise OwnCodeError(f"{what}: expected it to yield checks (about, below, above, reported), got {strange[0]!r}")
        return found

    return case._replace(solve=checked)


def solve(case: Case, device: str) -> CaseResult:
    """Runs one case and measures its time."""
    start = time.perf_counter()
    checks = tuple(case.solve(device))
    return CaseResult(case, checks, time.perf_counter() - start)


def rows(outcome: CaseResult) -> list[dict]:
    """Rows of the validation table."""
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


def main(argv: list[str]) -> int:
    """The verb `cases`: the validation table; exit code 1 on a miss."""
    parser = console.parser("lbm_oracle cases", "Known answers, each beside its reference; exit 1 on a miss.")
    named = "a case, or module:name; default: the quick ones"
    parser.add_argument("names", type=console.text, nargs="*", metavar="NAME", help=named)
    parser.add_argument("--all", action="store_true", help="every case; on the CPU without those marked gpu")
    parser.add_argument("--quick", action="store_true", help="those that fit three minutes on two cores (the default)")
    parser.add_argument("--list", action="store_true", help="name the cases and stop")
    parser.add_argument("--device", type=console.device, default="cpu", help="cpu, cuda or auto")
    args = parser.parse_args(argv)
    if args.list:
        return _list(args.json)
    pick(args.names, quick=not args.all, everything=args.all, gpu=True)  # a wrong name fails before a device is looked for
    device = str(device_of(args.device))
    outcomes, table = [], []
    for case in pick(args.names, quick=not args.all, everything=args.all, gpu=device.startswith("cuda")):
        done = solve(case, device)
        outcomes.append(done)
        table += rows(done)
        console.say(console.table(rows(done)), f"{case.name}: {case.grid}, {console.duration(done.seconds)}; {case.source}", "")
    missed = [row for row in table if row["verdict"] == "MISS"]
    total = sum(done.seconds for done in outcomes)
    gated = sum(row["verdict"] != "reported" for row in table)
    console.say(f"{gated - len(missed)} of {gated} checks hold, {console.duration(total)} on {device}")
    if args.json:
        seconds = {done.case.name: done.seconds for done in outcomes}
        console.emit_json({"cases": table, "seconds": seconds, "device": device, "ok": not missed})
    return console.FAILED_CHECK if missed else console.OK


def _list(as_json: bool) -> int:
    table = [
        {"rung": case.rung, "case": case.name, "quick": case.quick, "gpu": case.gpu, "grid": case.grid, "cost": case.cost}
        | {"what": case.summary}
        for case in known().values()
    ]
    console.say(console.table(table))
    if as_json:
        console.emit_json({"cases": table})
    return console.OK
