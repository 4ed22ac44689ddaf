"""Logs of the flow solver in which effects or numbers are hidden (`hydro_fit collect` has what a water is fitted to)."""

from fishmj.base import console
from fishmj.base.console import Command

main = console.CommandGroup(
    "campaign",
    __doc__ or "",
    {
        "hidden": Command(
            "fishmj.gap.laboratory.hidden_lbm.hidden_lbm_command",
            "data sets in which effects are hidden",
            "fishmj campaign hidden --sets 2 --effects none command_latency=0.04 --out runs/hidden --truth truth.json",
        ),
        "hidden_trials": Command(
            "fishmj.gap.laboratory.hidden_lbm.calibration_trials",
            "calibration trials of a robot drawn anew, its numbers sealed",
            "fishmj campaign hidden_trials --water second --out runs/trials",
        ),
    },
)


if __name__ == "__main__":
    raise SystemExit(console.run(main))
