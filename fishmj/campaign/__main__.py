"""Collect what a water is fitted to: segments of the flow solver; the same as `hydro_fit collect`."""

from fishmj import console
from fishmj.campaign import command


def main(argv: list[str]) -> int:
    parser = console.parser("hydro_fit collect", "Segments of the flow solver that a water is fitted to.")
    command.add_arguments(parser)
    return command.run(parser.parse_args(argv))


if __name__ == "__main__":
    raise SystemExit(console.run(main))
