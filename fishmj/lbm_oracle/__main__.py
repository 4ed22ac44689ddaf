"""The flow solver: known answers, gaits, force maps and drifts."""

from fishmj.base import console
from fishmj.base.console import Command

main = console.CommandGroup(
    "lbm_oracle",
    __doc__ or "",
    {
        "cases": Command(
            "fishmj.lbm_oracle.cases", "known answers, each beside its reference", "fishmj lbm_oracle cases poiseuille cavity"
        ),
        "swim": Command(
            "fishmj.lbm_oracle.run.swim",
            "a gait, free or tethered; writes a trial folder",
            "fishmj lbm_oracle swim --preset laptop --beats 5 --out runs/a --fields runs/a_fields",
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
