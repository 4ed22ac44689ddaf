"""`python -m fishmj.effects [NAME] [--json]`: the catalogue of imperfections, or one entry in full."""

import sys

from fishmj import effects
from fishmj.base import console
from fishmj.effects.effect import Effect, Parameter


def rows(chosen) -> list[dict]:
    """One table row an effect."""
    return [
        {
            "effect": e.name,
            "stage": e.stage,
            "formula": e.formula,
            "parameters": ", ".join(f"{p.name} [{p.unit}]" for p in e.parameters),
            "typical": ", ".join(f"{p.typical[0]:g} to {p.typical[1]:g}" for p in e.parameters),
            "null": ", ".join(f"{p.null:g}" for p in e.parameters),
            "shows in": ", ".join(e.shows) or "velocity",
        }
        for e in chosen
    ]


def record(e: Effect) -> dict:
    """One effect as plain data, for JSON."""
    kept = ("name", "stage", "about", "formula", "source", "shows", "native", "stochastic", "delays", "drifts", "stream", "sites")
    return {
        **{key: getattr(e, key) for key in kept},
        "parameters": [
            {key: getattr(p, key) for key in ("name", "unit", "null", "low", "high", "typical", "signed", "shape", "about")}
            for p in e.parameters
        ],
        "confusions": [{"other": c.other, "separates": c.separates, "excitations": c.excitations} for c in e.confusions],
    }


def enters(e: Effect) -> str:
    """Ways in which an effect enters the model: sites, clock delays, random streams, MuJoCo's own options."""
    ways = [f"site {site}" for site in e.sites]
    ways += [f"delay of the clock {clock}" for clock in dict.fromkeys((*e.delays, *e.drifts))]
    ways += [f"drawn once a run on the stream {e.stream}"] if e.stochastic else []
    return "; ".join(ways) + (f"; MuJoCo: {e.native}" if e.native else "")


def text(e: Effect) -> str:
    """Description of one effect in full."""
    lines = [f"{e.name} ({e.stage})", f"  {e.about}", f"  formula   {e.formula}", f"  source    {e.source}"]
    lines += [f"  shows in  {', '.join(e.shows) or 'velocity'}", f"  enters    {enters(e)}", "  parameters"]
    lines += [f"    {_parameter(p)}" for p in e.parameters]
    lines += ["  looks like"] if e.confusions else []
    for c in e.confusions:
        runs = f" ({', '.join(c.excitations)})" if c.excitations else ""
        lines.append(f"    {c.other}: {c.separates}{runs}")
    return "\n".join(lines)


def _parameter(p: Parameter) -> str:
    sides = ", either sign" if p.signed else ", shape only" if p.shape else ""
    size = f"typical {p.typical[0]:g} to {p.typical[1]:g}{sides}"
    about = f"; {p.about}" if p.about else ""
    return f"{p.name} [{p.unit}]: null {p.null:g}, bounds {p.low:g} to {p.high:g}, {size}{about}"


def options() -> console.Parser:
    """The arguments of `effects`."""
    summary = "The catalogue of imperfections: what each is, how large, where it shows, what looks like it."
    parser = console.parser("effects", summary, examples="example:\n  fishmj effects command_latency")
    parser.add_argument("name", type=console.text, nargs="?", help="one effect in full; by default the table of all")
    return parser


def main(argv: list[str]) -> int:
    """Prints the table, or one effect. Returns the exit code."""
    args = options().parse_args(argv)
    chosen = [effects.get(args.name)] if args.name else list(effects.catalogue().values())
    if args.json:
        records = [record(e) for e in chosen]
        console.emit_json(records[0] if args.name else {"effects": records, "n": len(records)})
    elif args.name:
        console.say(text(chosen[0]))
    else:
        console.say(console.table(rows(chosen)))
    return console.OK


if __name__ == "__main__":
    sys.exit(console.run(main))
