"""Find where simulation and measurement disagree, name the missing effect, add it, show the gap shrink."""

import sys

from fishmj.base import console
from fishmj.base.console import Command

main = console.CommandGroup(
    "gap",
    __doc__ or "",
    {
        "find": Command(
            "fishmj.gap.commands.find",
            "the missing effect, with its size, its rivals and the gap before and after",
            "fishmj gap find logs --out report",
        ),
        "plant": Command(
            "fishmj.gap.commands.plant", "data in which an effect is hidden", "fishmj gap plant coulomb_friction=0.1 --out logs"
        ),
        "next": Command("fishmj.gap.commands.next_experiment", "the next most informative experiment", "fishmj gap next report"),
        "apply": Command("fishmj.gap.commands.apply", "the next version of the model, reversible", "fishmj gap apply report"),
        "check": Command(
            "fishmj.gap.commands.check",
            "test whether a version still closes its gap",
            "fishmj gap check model.toml --data logs",
        ),
        "bench": Command(
            "fishmj.gap.bench.bench_command", "the blind benchmark", "fishmj gap bench --cases 20 --small --out runs/blind"
        ),
        "fetch": Command(
            "fishmj.gap.measured.fetch",
            "download a public data set and check every file",
            "fishmj gap fetch tail_fish --out data/tail_fish",
        ),
        "measured": Command(
            "fishmj.gap.measured.measured_command",
            "missing effects of your own kind of machine, by groups of records; published data sets too",
            "fishmj gap measured --study my.toml --out report",
        ),
    },
)


if __name__ == "__main__":
    sys.exit(console.run(main))
