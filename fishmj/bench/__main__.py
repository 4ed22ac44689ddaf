"""Throughput of this machine, one JSON line a benchmark, each beside its baseline."""

import json

from fishmj import console
from fishmj.bench import known, measure, pick


def _figure(value):
    """Four digits are more than a shared machine repeats."""
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main(argv: list[str]) -> int:
    parser = console.parser("bench", "Throughput of this machine, one JSON line a benchmark, each beside its baseline.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="default: all")
    parser.add_argument("--list", action="store_true", help="name the benchmarks and stop")
    parser.add_argument("--quick", action="store_true", help="small batches, three rounds: does it run at all")
    args = parser.parse_args(argv)
    if args.list:
        rows = [{"name": b.name, "unit": b.unit, "what": b.summary} for b in known().values()]
        console.say(console.table(rows))
        if args.json:
            console.emit_json({"benchmarks": rows})
        return console.OK
    results = []
    for bench in pick(args.names):
        found = measure(bench, rounds=3 if args.quick else 7, quick=args.quick)
        results.append({key: _figure(value) for key, value in found.items()})
        console.say(json.dumps(results[-1]))
    if args.json:
        console.emit_json({"benchmarks": results})
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
