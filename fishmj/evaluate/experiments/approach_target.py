"""Approach of a target 1.4 m away, downstream (right rear) and upstream (left front), at 0.2 m/s."""

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.figures import BLUE, VERMILION, canvas, png, style
from fishmj.evaluate.experiments.experiment_figures import compared, counted, figures_row, read, series_row
from fishmj.evaluate.experiments.paper_experiment import ExperimentFindings, ExperimentPart, ExperimentSetup, PaperExperiment, Row
from fishmj.evaluate.plots import FAINT, INK, STYLE

SIDES = {"downstream": 225, "upstream": 45}  # line of sight, deg: right rear, left front
HOLD = 20.0  # s, start of the hold phase, when the fish has turned upstream
COLOURS = {"downstream": BLUE, "upstream": VERMILION}


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """Eight trials of each side."""
    row = lambda result: figures_row(result) | series_row(result, until=30.0)
    speed, n = constant("experiments", "transfer_speed"), constant("experiments", "stage_trials")
    trials = {side: setup.trials(speeds=[speed], los_deg=[los], repeats=n) for side, los in SIDES.items()}
    return [setup.part(side, setup.policy, some, row) for side, some in trials.items()]


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Times of approach, arrival and heading in the hold phase."""
    found = []
    limits = {side: constant("results", f"approach_{side}") for side in SIDES}
    for side, row in rows.items():
        about = f"at most {limits[side]:g} s" if side == "downstream" else f"about {limits[side]:g} s"
        found.append(compared(f"approach time, {side}", about, row["figures"]["approach_time"], "s", digits=1, median=True))
    found.append(counted("arrival", "all", np.concatenate([row["figures"]["arrival"] for row in rows.values()])))
    for side, row in rows.items():
        late = np.abs((read(row["heading"])[:, read(row["t"]) >= HOLD] + 180) % 360 - 180).mean(1)
        found.append(compared(f"heading off upstream after {HOLD:g} s, {side}", "turned upstream", late, "deg", digits=1))
    return ExperimentFindings(found, [(picture(rows), "Position and heading seen from the target: all trials, and the median.")])


@style(STYLE)
def picture(rows: dict[str, Row]) -> bytes:
    """x(t), y(t), heading(t) and tracks, as the paper's figures of the approach."""
    figure, axes = canvas(len(rows), 4, (14, 3.1 * len(rows)))
    panels = (("upstream", "upstream of the target [m]"), ("side", "left of it [m]"), ("heading", "heading from upstream [deg]"))
    for line, (side, row) in zip(axes, rows.items(), strict=True):
        t = read(row["t"])
        for axis, (key, label) in zip(line, panels, strict=False):
            values = read(row[key])
            axis.plot(t, values.T, color=COLOURS[side], linewidth=0.6, alpha=0.5)
            axis.plot(t, np.nanmedian(values, 0), color=COLOURS[side], linewidth=2.2)
            axis.axhline(0, color=FAINT, linewidth=1, zorder=0)
            axis.set(xlabel="time [s]", ylabel=label, title=side if axis is line[0] else "")
        line[3].plot(-read(row["side"]).T, read(row["upstream"]).T, color=COLOURS[side], linewidth=0.8, alpha=0.8)
        line[3].plot(0, 0, "+", color=INK, markersize=10)
        line[3].set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), aspect="equal", xlabel="right of it [m]", ylabel="upstream [m]")
    return png(figure)


EXPERIMENT = PaperExperiment(
    "approach",
    "9 and 10, simulated and real approaches",
    "approach from downstream and upstream at 0.2 m/s: x, y and heading over time",
    "the same curves of the real robot, and its snapshots",
    parts,
    findings,
)
