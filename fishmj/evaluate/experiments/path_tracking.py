"""Figure eight: a target that moves along the path by arc length at 0.3 m/s, in 0.1, 0.2 and 0.3 m/s of stream."""

import numpy as np

from fishmj import control
from fishmj.base.calib import constant
from fishmj.base.figures import canvas, png, style
from fishmj.base.pages import drawn
from fishmj.evaluate import metrics
from fishmj.evaluate.experiments.experiment_figures import EVERY, compared, figures_row, read, rounded
from fishmj.evaluate.experiments.paper_experiment import ExperimentFindings, ExperimentPart, ExperimentSetup, PaperExperiment, Row
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.plots import COLOURS, STYLE, eight_panel
from fishmj.evaluate.protocol import EIGHT
from fishmj.tasks.reference import path_length

RIVALS = ("pnl", "adrc-c1")  # the paper's, as far as fishmj has them
BINS = 48  # bins of arc length in a cycle
SAID = {0.1: "precise; ADRC too, PNL deforms", 0.2: "nearly complete; ADRC drifts", 0.3: "recognisable; PNL and ADRC are lost"}


def controllers(setup: ExperimentSetup) -> list[str]:
    """Policy and rivals, as the user names them."""
    return [setup.policy, *(name for name in RIVALS if name in control.NAMES and name != setup.policy)]


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """One part for each controller."""
    trials = setup.trials(task=EIGHT, repeats=setup.of(8, 5))
    return [setup.part(name, name, trials, path_row) for name in controllers(setup)]


def path_row(result: Result) -> Row:
    """Figures; by speed the mean cross-track error (BINS,) over arc length, and the first track (T, 2) m in the tank."""
    off, tick = metrics.cross_track(result), round(EVERY / result.robot.timing.bus_dt)
    place = np.floor(constant("experiments", "figure8_speed") * result.t / path_length() % 1 * BINS).astype(int)
    row = figures_row(result) | {"by_arc": {}, "track": {}}
    for speed in np.unique(result.trials.speed):
        some = result.trials.speed == speed
        row["by_arc"][f"{speed:g}"] = rounded([off[some][:, place == k].mean() for k in range(BINS)], 4)
        first = int(np.argmax(some))
        row["track"][f"{speed:g}"] = rounded(result.pose[first, : result.left[first] : tick, :2], 3)
    return row


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Cross-track errors by speed, and the rivals' minus the policy's."""
    (leader, first), *others = rows.items()
    speeds, found, table = np.array(first["speed"]), [], []
    at = lambda row, speed: read(row["figures"]["cross_track"])[speeds == speed]
    for speed in np.unique(speeds):
        paper = SAID.get(round(float(speed), 3), "")
        found.append(compared(f"cross-track error at {speed:g} m/s, {leader}", paper, at(first, speed), "m"))
        for name, row in others:
            found.append(compared(f"cross-track error at {speed:g} m/s, {name}", "", at(row, speed), "m"))
            d = metrics.difference("cross_track", at(first, speed), at(row, speed))
            table.append({"flow [m/s]": f"{speed:g}", f"minus {leader}": name, "cross-track [m]": d.text(), "pairs": d.n})
    notes = [f"No controller of this name here: {', '.join(lacks)}."] if (lacks := set(RIVALS) - set(rows) - {leader}) else []
    tables = [(f"Paired differences (95 % interval), * = excludes 0, of {metrics.APART} pairs or more", table)]
    shown = [
        (tracks(rows), "Tracks over the path (grey); the water flows down the page."),
        (by_arc(rows), "Cross-track error along the path, mean over trials and cycles."),
    ]
    return ExperimentFindings(found, shown, tables, notes)


@style(STYLE)
def tracks(rows: dict[str, Row]) -> bytes:
    """First trial of every controller and speed over the path."""
    speeds = list(next(iter(rows.values()))["track"])
    figure, axes = canvas(len(rows), len(speeds), (3.4 * len(speeds), 3.0 * len(rows)), sharex=True, sharey=True)
    for line, (name, row), colour in zip(axes, rows.items(), COLOURS, strict=False):
        for axis, speed in zip(line, speeds, strict=True):
            eight_panel(axis, [read(row["track"][speed])], colour)
            axis.set_title(f"{drawn(name)}, {speed} m/s")
        line[0].set_ylabel("upstream [m]")
    for axis in axes[-1]:
        axis.set_xlabel("right, facing upstream [m]")
    return png(figure)


@style(STYLE)
def by_arc(rows: dict[str, Row]) -> bytes:
    """Cross-track error over arc length, one panel for each speed."""
    speeds = list(next(iter(rows.values()))["by_arc"])
    figure, axes = canvas(1, len(speeds), (4.2 * len(speeds), 3.2), sharey=True)
    arc = (np.arange(BINS) + 0.5) / BINS * path_length()
    for axis, speed in zip(axes[0], speeds, strict=True):
        for (name, row), colour in zip(rows.items(), COLOURS, strict=False):
            axis.plot(arc, read(row["by_arc"][speed]), color=colour, linewidth=2, label=drawn(name))
        axis.set(title=f"flow {speed} m/s", xlabel="arc length of the target [m]")
    axes[0, 0].set_ylim(bottom=0)
    axes[0, 0].set_ylabel("cross-track error [m]")
    axes[0, 0].legend(frameon=False)
    return png(figure)


EXPERIMENT = PaperExperiment(
    EIGHT,
    "14, a moving target",
    "a moving target on a figure eight: cross-track error beside PNL and ADRC",
    "the same paths in the tank",
    parts,
    findings,
)
