"""Throughput of this machine, one JSON line for each benchmark, with its baseline."""

import json
import traceback

from fishmj.base import console, interrupt
from fishmj.water import choice
from studies.benchmarks import Benchmark, engines, known, measure, pick


def _measured(bench: Benchmark, quick: bool) -> dict:
    """Result of one benchmark; an error is reported and does not stop the others."""
    try:
        return measure(bench, rounds=3 if quick else 7, quick=quick)
    except Exception as error:  # noqa: BLE001
        traceback.print_exc()
        return {"name": bench.name, "failed": f"{type(error).__name__}: {error}"}


def _words(todo: list[Benchmark], done: int) -> str:
    """Text for an interrupted run."""
    left = " ".join(bench.name for bench in todo[done:])
    return f"the lines above are {done} of {len(todo)} benchmarks; go on with: fishmj bench {left}"


EXAMPLES = """examples:
  fishmj bench --list                            list the benchmarks
  fishmj bench engine_compiled --quick           check that it runs
"""


def options() -> console.Parser:
    """Parser of the verb `bench`."""
    summary = "Throughput of this machine, one JSON line for each benchmark, with its baseline."
    parser = console.parser("bench", summary, examples=EXAMPLES)
    named = "of --list; default: all"
    parser.add_argument("names", type=console.text, nargs="*", action=console.Distinct, metavar="NAME", help=named)
    parser.add_argument("--list", action="store_true", help="name the benchmarks and stop")
    parser.add_argument("--water", type=console.text, help=f"for engines and environment. {choice.HELP}")
    parser.add_argument("--quick", action="store_true", help="small batches, three rounds, to check that it runs")
    return parser


def main(argv: list[str]) -> int:
    """Runs the verb `bench`; returns the exit code."""
    args = options().parse_args(argv)
    if args.list:
        rows = [{"name": b.name, "unit": b.unit, "what": b.summary} for b in known().values()]
        console.say(console.table(rows))
        if args.json:
            console.emit_json({"benchmarks": rows})
        return console.OK
    results, todo = [], pick(args.names)
    engines.WATER[:] = [args.water]
    engines.swimming()  # a wrong name fails before anything runs
    with interrupt.keeping(lambda: _words(todo, len(results))), console.Progress(len(todo), "bench", "benchmarks") as bar:
        for k, bench in enumerate(todo):
            bar.stage(f"{bench.name}, {k + 1} of {len(todo)}: compiling, then measuring")
            found = _measured(bench, args.quick)
            results.append({k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in found.items()})
            console.say(json.dumps(results[-1]))
    if args.json:
        console.emit_json({"benchmarks": results})
    return console.FAILED_CHECK if any("failed" in found for found in results) else console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
