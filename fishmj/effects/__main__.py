"""`python -m fishmj.effects [NAME] [--json]`: the catalogue of imperfections, or one entry in full."""

import sys

from fishmj import console, effects
from fishmj.effects import effect_text


def options() -> console.Parser:
    """The arguments of `effects`."""
    summary = "The catalogue of imperfections: what each is, how large, where it shows, what looks like it."
    parser = console.parser("effects", summary, examples="example:\n  fishmj effects command_latency")
    parser.add_argument("name", type=console.text, nargs="?", help="one effect in full; by default the table of all")
    return parser


def main(argv: list[str]) -> int:
    """Print the table, or one effect."""
    args = options().parse_args(argv)
    chosen = [effects.get(args.name)] if args.name else list(effects.catalogue().values())
    if args.json:
        records = [effect_text.record(e) for e in chosen]
        console.emit_json(records[0] if args.name else {"effects": records, "n": len(records)})
    elif args.name:
        console.say(effect_text.text(chosen[0]))
    else:
        console.say(console.table(effect_text.rows(chosen)))
    return console.OK


if __name__ == "__main__":
    sys.exit(console.run(main))
