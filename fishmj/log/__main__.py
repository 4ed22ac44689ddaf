"""`python -m fishmj.log`: bring recordings in, check data sets, state what they hold, hand them to other programs."""

import sys

from fishmj import console
from fishmj.console import Command
from fishmj.log.look import check, state

main = console.CommandGroup(
    "log",
    "Bring recordings in, check data sets, state what they hold, hand them to other programs.",
    {
        "import": Command(
            "fishmj.log.bring",
            "recordings -> a data set of trial folders with a manifest",
            "fishmj log import commands.csv camera.csv battery.csv --out data/monday --robot swift",
        ),
        "check": Command(check, "read a data set or a trial, audit its clocks", "fishmj log check data/monday"),
        "manifest": Command(state, "write manifest.json into a folder of trial folders", "fishmj log manifest data/monday"),
        "export": Command(
            "fishmj.replay.export_command",
            "a trial or a data set -> MCAP (Foxglove), CSV or Parquet",
            "fishmj log export runs/trial_07 --to mcap --out trial_07.mcap",
        ),
    },
)


if __name__ == "__main__":
    sys.exit(console.run(main))
