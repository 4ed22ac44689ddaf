"""Commands that the studies add to verbs of fishmj: entry points `fishmj.verbs` of `studies/pyproject.toml` name these tables."""

from fishmj.base.console import Command

LBM_ORACLE = {
    "converge": Command(
        "studies.grid_studies.converge",
        "order of convergence of the fluid on closed solutions",
        "fishmj lbm_oracle converge --device cpu",
    ),
    "converge fish": Command(
        "studies.grid_studies.converge_fish",
        "cruise speed, drag and broadside force of the fish over grid, time step and slip ratio",
        "fishmj lbm_oracle converge fish --what drag --grids 0.02 0.01 --out runs/converge",
    ),
    "speeds": Command(
        "studies.grid_studies.speeds",
        "speed of the free fish over beat frequency, slip ratio and depth",
        "fishmj lbm_oracle speeds --preset laptop --frequencies 1 --slips 1 --out runs/speeds",
    ),
    "real_fish": Command(
        "studies.grid_studies.real_fish",
        "slip ratio at which a real fish's swims come out, set by four of them and judged by four others",
        "fishmj lbm_oracle real_fish --domain laptop --slips 0.98 --beats 5 --swims 2 --out runs/real",
    ),
}
HYDRO_FIT = {
    "ablation": Command(
        "studies.water_ablation.ablation_command",
        "what each part of the model is worth: fits without it, same held-out records",
        "fishmj hydro_fit ablation --data data/hydro/swift --seeds 0,1,2",
    ),
    "hybrid": Command(
        "studies.hybrid_trials.hybrid_trials_command",
        "MuJoCo's water corrected by the solver while it swims",
        "fishmj hydro_fit hybrid --wrong stream --domain laptop --episodes 1 --seconds 20",
    ),
    "rank": Command(
        "studies.rank_waters.rank_waters_command",
        "controllers in the solver and in the fitted water, on the same trials",
        "fishmj hydro_fit rank pd pi --domain laptop --device cpu --trials 6 --seconds 10",
    ),
}
