"""The flow solver: known answers, convergence, gaits, force maps and drifts."""

from fishmj.base import console
from fishmj.base.console import Command

main = console.CommandGroup(
    "lbm_oracle",
    __doc__ or "",
    {
        "cases": Command(
            "fishmj.lbm_oracle.cases", "known answers, each beside its reference", "fishmj lbm_oracle cases poiseuille cavity"
        ),
        "converge": Command(
            "fishmj.lbm_oracle.grid_studies.converge",
            "order of convergence of the fluid on closed solutions",
            "fishmj lbm_oracle converge --device cpu",
        ),
        "converge fish": Command(
            "fishmj.lbm_oracle.grid_studies.converge_fish",
            "cruise speed, drag and broadside force of the fish over grid, time step and slip ratio",
            "fishmj lbm_oracle converge fish --what drag --grids 0.02 0.01 --out runs/converge",
        ),
        "swim": Command(
            "fishmj.lbm_oracle.run.swim",
            "a gait, free or tethered; writes a trial folder",
            "fishmj lbm_oracle swim --preset laptop --beats 5 --out runs/a --fields runs/a_fields",
        ),
        "speeds": Command(
            "fishmj.lbm_oracle.grid_studies.speeds",
            "speed of the free fish over beat frequency, slip ratio and depth",
            "fishmj lbm_oracle speeds --preset laptop --frequencies 1 --slips 1 --out runs/speeds",
        ),
        "real_fish": Command(
            "fishmj.lbm_oracle.grid_studies.real_fish",
            "slip ratio at which a real fish's swims come out, set by four of them and judged by four others",
            "fishmj lbm_oracle real_fish --domain laptop --slips 0.98 --beats 5 --swims 2 --out runs/real",
        ),
        "forcemap": Command(
            "fishmj.lbm_oracle.force_maps.forcemap",
            "steady forces on a held fish over joint angle and angle of attack",
            "fishmj lbm_oracle forcemap --domain laptop --what joint --speeds 0.3 --out runs/forcemap",
        ),
        "drift": Command(
            "fishmj.lbm_oracle.drifters.drift",
            "passive markers in a turbulent current: tracks, headings, spread",
            "fishmj lbm_oracle drift --water flow --n 4 --out runs/drift",
        ),
    },
)


if __name__ == "__main__":
    raise SystemExit(console.run(main))
