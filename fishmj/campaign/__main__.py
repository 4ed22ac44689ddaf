"""Data by the flow solver: segments that a water is fitted to, and logs in which effects or numbers are hidden."""

from fishmj import console
from fishmj.console import Command

main = console.Group(
    "campaign",
    __doc__ or "",
    {
        "collect": Command(
            "fishmj.campaign.command",
            "segments that a water is fitted to (the same as fishmj hydro_fit collect)",
            "fishmj campaign collect --preview --out runs/preview",
        ),
        "hidden": Command(
            "fishmj.campaign.hidden_command",
            "data sets in which effects are hidden",
            "fishmj campaign hidden --sets 2 --effects none command_latency=0.04 --out runs/hidden --truth truth.json",
        ),
        "hidden_trials": Command(
            "fishmj.campaign.hidden_trials",
            "calibration trials of a robot drawn anew, its numbers sealed",
            "fishmj campaign hidden_trials --water second --out runs/trials",
        ),
    },
)


if __name__ == "__main__":
    raise SystemExit(console.run(main))
