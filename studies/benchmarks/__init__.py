"""Benchmarks: each runs alternately with a baseline, so that a busy machine slows both.

A benchmark is a function that prepares and returns a `BenchmarkWork`; other modules add their own:

    @benchmark("environment", "control steps/s", baseline=bare_mujoco)
    def environment(quick: bool) -> BenchmarkWork: ...

`BenchmarkWork.run()` does `BenchmarkWork.amount` units of work. Rounds alternate, A B A B ...; a result is their median.
"""

import platform
import time
from collections.abc import Callable
from statistics import median
from typing import NamedTuple

from fishmj.base.cores import usable_cores
from fishmj.base.doctor import processor
from fishmj.base.errors import MissingExtra, UnknownName
from fishmj.base.source import version


class BenchmarkWork(NamedTuple):
    """A prepared and warmed-up piece of work."""

    run: Callable[[], object]
    amount: float  # units done by one `run`
    where: str = "cpu"  # what it runs on


Prepare = Callable[[bool], BenchmarkWork]


class Benchmark(NamedTuple):
    """A named figure."""

    name: str
    unit: str
    prepare: Prepare
    baseline: Prepare | None
    summary: str = ""  # line for --list


REGISTRY: dict[str, Benchmark] = {}
SUITES = (
    "studies.benchmarks.engines",
    "studies.benchmarks.hydro",
    "studies.benchmarks.oracle",
    "studies.benchmarks.devices",
    "studies.benchmarks.surrogate_speed",
)  # modules that register benchmarks when imported


class NotHere(Exception):
    """Raised by a `prepare` that cannot run on this machine; the message is the reason."""


def add(name: str, unit: str, summary: str, prepare: Prepare, baseline: Prepare | None = None) -> None:
    """Registers `prepare(quick)` under a name; `baseline` is another `prepare` with the same unit."""
    REGISTRY[name] = Benchmark(name, unit, prepare, baseline, summary)


def benchmark(name: str, unit: str, baseline: Prepare | None = None) -> Callable[[Prepare], Prepare]:
    """Returns a decorator that registers a function as `add` does; the first line of its docstring is the summary."""

    def register(prepare: Prepare) -> Prepare:
        add(name, unit, (prepare.__doc__ or "").strip().partition("\n")[0], prepare, baseline)
        return prepare

    return register


def known() -> dict[str, Benchmark]:
    """All benchmarks, after importing the suites."""
    from importlib import import_module

    for suite in SUITES:
        import_module(suite)
    return REGISTRY


def pick(names: list[str]) -> list[Benchmark]:
    """Benchmarks of these names; all if none is given. Raises UnknownName."""
    table = known()
    for name in names:
        if name not in table:
            raise UnknownName("benchmark", name, table)
    return [table[name] for name in names or table]


def machine(where: str = "cpu") -> str:
    """Description of the machine in one line: processor, cores, device, versions."""
    parts = [processor(), f"{usable_cores()} cores", where, f"Python {platform.python_version()}"]
    return ", ".join([*parts, *(f"{name} {found}" for name in ("mujoco", "jax") if (found := version(name)))])


def rate(work: BenchmarkWork, clock: Callable[[], float]) -> float:
    """Units per second of one run."""
    start = clock()
    work.run()
    return work.amount / max(clock() - start, 1e-12)


def measure(bench: Benchmark, *, rounds: int = 5, quick: bool = False, clock: Callable[[], float] = time.perf_counter) -> dict:
    """Runs one benchmark alternately with its baseline.

    Returns:
        {"name", "value", "unit", "baseline", "ratio", "machine"}; baseline and ratio None without a baseline;
        {"name", "skipped"} with the reason if it cannot run here.
    """
    try:
        work = bench.prepare(quick)
        beside = bench.baseline(quick) if bench.baseline else None
    except (NotHere, MissingExtra) as reason:
        return {"name": bench.name, "skipped": str(reason)}
    values, baselines = [], []
    for _ in range(rounds):
        values.append(rate(work, clock))
        if beside:
            baselines.append(rate(beside, clock))
    value = median(values)
    base = median(baselines) if baselines else None
    return {
        "name": bench.name,
        "value": value,
        "unit": bench.unit,
        "baseline": base,
        "ratio": value / base if base else None,
        "machine": machine(work.where),
    }
