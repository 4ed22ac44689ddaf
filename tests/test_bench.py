"""The benchmark harness: interleaved rounds, medians, ratios, honest skips; and each engine's benchmark runs."""

import json

import pytest

import studies.benchmarks as bench
from fishmj.base import console
from studies.benchmarks import Benchmark, BenchmarkWork, NotHere, measure
from studies.benchmarks import __main__ as command


class Clock:
    """Time that moves only when work is done."""

    def __init__(self):
        self.now, self.order = 0.0, []

    def __call__(self) -> float:
        return self.now

    def work(self, name: str, seconds: list[float]) -> BenchmarkWork:
        left = iter(seconds)

        def run():
            self.order.append(name)
            self.now += next(left)

        return BenchmarkWork(run, 10.0)


def test_a_figure_is_the_median_beside_its_baseline():
    clock = Clock()
    a, b = clock.work("a", [1, 5, 2]), clock.work("b", [10, 10, 40])
    found = measure(Benchmark("x", "things/s", lambda quick: a, lambda quick: b), rounds=3, clock=clock)
    assert clock.order == ["a", "b"] * 3
    assert (found["value"], found["baseline"], found["ratio"]) == (5.0, 1.0, 5.0)
    assert set(found) == {"name", "value", "unit", "baseline", "ratio", "machine"} and "cores" in found["machine"]


def test_a_figure_without_a_baseline_has_no_ratio():
    clock = Clock()
    work = clock.work("a", [2, 2])
    found = measure(Benchmark("x", "things/s", lambda quick: work, None), rounds=2, clock=clock)
    assert (found["value"], found["baseline"], found["ratio"]) == (5.0, None, None)


def test_what_cannot_run_is_skipped_with_the_reason():
    def absent(quick):
        raise NotHere("needs a tank")

    assert measure(Benchmark("x", "things/s", absent, None)) == {"name": "x", "skipped": "needs a tank"}


def test_a_fault_inside_a_benchmark_is_not_a_skip():
    with pytest.raises(ZeroDivisionError):
        measure(Benchmark("x", "things/s", lambda quick: 1 / 0, None))


def test_a_fault_in_one_benchmark_fails_the_command_and_spares_the_others(monkeypatch, capsys):
    clock = Clock()
    good = Benchmark("good", "things/s", lambda quick: clock.work("a", [1.0] * 9), None)
    monkeypatch.setattr(command, "pick", lambda names: [Benchmark("broken", "things/s", lambda quick: 1 / 0, None), good])
    assert console.run(command.main, ["--json"]) == 1
    out, err = capsys.readouterr()
    broken, fine = json.loads(out.splitlines()[-1])["benchmarks"]
    assert broken == {"name": "broken", "failed": "ZeroDivisionError: division by zero"} and "Traceback" in err
    assert fine["value"] > 0


def test_an_unknown_benchmark_is_bad_input(capsys):
    assert console.run(command.main, ["engine_plana"]) == 2
    assert "Did you mean 'engine_planar'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(bench.known()))
def test_every_benchmark_runs_quickly_or_says_why_not(name, capsys):
    assert console.run(command.main, [name, "--quick", "--json"]) == 0
    line, last = map(json.loads, capsys.readouterr().out.strip().splitlines())
    assert last == {"benchmarks": [line]} and line["name"] == name
    assert line.get("skipped") or line["value"] > 0 and line["ratio"] > 0


@pytest.mark.slow
def test_ways_of_the_learnt_force_are_timed_and_compared(monkeypatch, capsys):
    """On a CPU there is one way, whose single precision is 0.1 mm off after a second at most; an unknown one fails alone."""
    from studies.benchmarks import surrogate_speed
    from studies.fitted_water import residual_ways as residual

    for name, value in (
        ("FISH_CPU", surrogate_speed.FISH_QUICK),
        ("CHUNKS", 1),
    ):  # the programs of `surrogate --quick`, compiled once
        monkeypatch.setattr(surrogate_speed, name, value)
    monkeypatch.setattr(residual, "SECONDS", 1.0)
    monkeypatch.setattr(residual, "SWUM", 3)
    monkeypatch.setattr(
        residual, "ways", lambda gpu: {"products": {"kernel": False}, "none": {"kernel": False, "PRECISION": "no"}}
    )
    assert residual.main(["--rounds", "1"]) == 0
    strips, products, none = capsys.readouterr().out.splitlines()[1:]
    assert "way strips" in strips and "M steps/s" in strips
    assert 0 < float(products.split("off, mm ")[1].split(",")[0]) < 0.1
    assert "failed" in none
