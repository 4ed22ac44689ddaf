"""Flows beyond the paper: vortex street, shear, strong turbulence, a stream that changes within a trial, 0 to 0.4 m/s."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.figures import canvas, png, style
from fishmj.base.pages import drawn
from fishmj.evaluate.experiments.experiment_figures import compared, counted, error_bars, figures_row, read, series_row
from fishmj.evaluate.experiments.paper_experiment import ExperimentFindings, ExperimentPart, ExperimentSetup, PaperExperiment, Row
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.plots import COLOURS, FAINT, STYLE, plain_ticks
from fishmj.evaluate.protocol import Trials
from fishmj.water.flow import TICK, Current, shifted

RIVAL = "dob"  # controller with a flow observer
SPEED, STRONG = 0.2, 0.25  # m/s; turbulence intensity beside the default 5 %
KINDS: dict[str, dict[str, Any]] = {
    "turbulence 5 %": {},
    "turbulence 25 %": {"intensity": STRONG},
    "gusts 25 %": {"turbulence": "gust", "intensity": STRONG},
    "vortex street 25 %": {"turbulence": "vortex_street", "intensity": STRONG},
    "shear 25 %": {"turbulence": "shear", "intensity": STRONG},
}
CHANGES = {"0.2 to 0.3 m/s": (0.3, 0.0), "turns by 45 deg": (0.2, 45.0)}  # speed m/s and turn deg after the change
SPEEDS = (0.0, 0.02, 0.04, 0.08, 0.12, 0.16, 0.2, 0.24, 0.28, 0.32, 0.36, 0.4)
BEGINS, LASTS = 30.0, 5.0  # s


@dataclass(frozen=True, kw_only=True)
class ChangingTrials(Trials):
    """Trials whose mean stream ramps to `speed_after` [m/s], turned by `turn` [rad], from `begins` on within `lasts` s."""

    steady: ClassVar[bool] = False

    speed_after: float
    turn: float
    begins: float = BEGINS
    lasts: float = LASTS

    @classmethod
    def of(cls, some: Trials, speed: float, turn: float) -> "ChangingTrials":
        """The same trials with a change."""
        return cls(**{field.name: getattr(some, field.name) for field in fields(Trials)}, speed_after=speed, turn=turn)

    def mean(self, t: float) -> np.ndarray:
        """Mean stream (n, 2) m/s at time t [s]."""
        share = np.clip((t - self.begins) / self.lasts, 0.0, 1.0)
        heading = lambda angle: np.array([np.cos(angle), np.sin(angle)])
        before, after = heading(self.direction), heading(self.direction + self.turn)
        return (1 - share) * self.speed[:, None] * before + share * self.speed_after * after

    def stream(self, current: Current, t: float) -> Current:
        """Flow from time t [s] on; the eddies keep their positions at t."""
        by = self.mean(t) - current.mean
        return shifted(current, by, np.full(len(self), round(t / TICK))) if np.abs(by).max() > 1e-12 else current


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """Both controllers in every flow; a stream that changes runs in the fitted water only."""
    los, repeats = range(0, 360, 45), setup.of(3, 1)
    common = {"los_deg": los, "repeats": repeats}
    trials = {name: setup.trials(speeds=[SPEED], **common, **kind) for name, kind in KINDS.items()}
    trials["0 to 0.4 m/s"] = setup.trials(speeds=SPEEDS, los_deg=los, repeats=1)
    if setup.solver is None:
        calm = setup.trials(speeds=[SPEED], **common)
        trials |= {name: ChangingTrials.of(calm, u, np.radians(turn)) for name, (u, turn) in CHANGES.items()}
    brains = dict.fromkeys((setup.policy, RIVAL))
    return [setup.part(f"{name}, {brain}", brain, some, flow_row) for name, some in trials.items() for brain in brains]


def flow_row(result: Result) -> Row:
    """Metrics of each trial; for a changing stream also distances, but no energies, which need a constant mean stream."""
    row = figures_row(result)
    if result.trials.steady:
        return row
    for key in ("energy_per_metre", "cost_of_transport"):
        del row["figures"][key]
    seen = series_row(result)
    return row | {"t": seen["t"], "distance": seen["distance"]}


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Distances held in each flow, trials that leave, and the excursion after a change."""
    found, table, brains = [], [], list(dict.fromkeys((setup.policy, RIVAL)))
    for key, row in rows.items():
        name, brain = key.rsplit(", ", 1)
        mine = row["figures"]
        if name == "0 to 0.4 m/s":
            for speed in SPEEDS:
                some = np.isclose(row["speed"], speed)
                last = compared("", "", read(mine["rmse_last20"])[some], "m")
                arrived = counted("", "", read(mine["arrival"])[some])
                line = {"flow [m/s]": f"{speed:g}", "controller": brain, "arrival": arrived.measured}
                table.append(line | {"RMSE, last 20 s": last.measured})
            continue
        found.append(compared(f"last 20 s, {name}, {brain}", "not tested", mine["rmse_last20"], "m"))
        found.append(counted(f"leave the tank, {name}, {brain}", "not tested", np.arange(len(row["los"])) < row["left"]))
        if "t" in row:
            late = read(row["distance"])[:, read(row["t"]) >= BEGINS]
            found.append(compared(f"largest distance after the change, {name}, {brain}", "not tested", np.nanmax(late, 1), "m"))
    notes = [f"Trials of 60 s at {SPEED:g} m/s, eight directions. A change begins at {BEGINS:g} s and lasts {LASTS:g} s."]
    if setup.solver is not None:
        notes.append("The flow solver's stream is steady: the changing streams were not run.")
    shown = [(by_speed(rows, brains), "RMS distance of the last 20 s over flow speed, 95 % intervals.")]
    if any("t" in row for row in rows.values()):
        shown.append((changes(rows, brains), "Distance to the target in a stream that changes: median and middle half."))
    return ExperimentFindings(found, shown, [("0 to 0.4 m/s", table)], notes)


@style(STYLE)
def by_speed(rows: dict[str, Row], brains: list[str]) -> bytes:
    """RMS distance over flow speed."""
    figure, axes = canvas(1, 1, (7, 4))
    axis = axes[0, 0]
    for brain, colour in zip(brains, COLOURS, strict=False):
        row = rows[f"0 to 0.4 m/s, {brain}"]
        last = read(row["figures"]["rmse_last20"])
        middle, ends = error_bars([last[np.isclose(row["speed"], speed)] for speed in SPEEDS])
        axis.errorbar(SPEEDS, middle, ends, color=colour, marker="o", capsize=3, label=drawn(brain))
    axis.axvspan(*constant("task", "flow_speed"), color=FAINT, alpha=0.4, linewidth=0, label="speeds of the paper")
    axis.set(xlabel="flow speed [m/s]", ylabel="RMS distance, last 20 s [m]", yscale="log")
    plain_ticks(axis.yaxis)
    axis.legend(frameon=False)
    return png(figure)


@style(STYLE)
def changes(rows: dict[str, Row], brains: list[str]) -> bytes:
    """Distance over time in a stream that changes."""
    figure, axes = canvas(1, len(CHANGES), (5 * len(CHANGES), 3.4), sharey=True)
    for axis, name in zip(axes[0], CHANGES, strict=True):
        for brain, colour in zip(brains, COLOURS, strict=False):
            row = rows[f"{name}, {brain}"]
            low, middle, high = np.nanquantile(read(row["distance"]), [0.25, 0.5, 0.75], axis=0)
            axis.fill_between(read(row["t"]), low, high, color=colour, alpha=0.2, linewidth=0)
            axis.plot(read(row["t"]), middle, color=colour, label=drawn(brain))
        axis.axvspan(BEGINS, BEGINS + LASTS, color=FAINT, alpha=0.6, linewidth=0)
        axis.set(title=name, xlabel="time [s]", ylim=(0.005, 3), yscale="log")
    plain_ticks(axes[0, 0].yaxis)
    axes[0, 0].set_ylabel("distance [m]")
    axes[0, 0].legend(frameon=False)
    return png(figure)


EXPERIMENT = PaperExperiment(
    "flows",
    "none: what the paper leaves open",
    "vortex street, shear, strong turbulence, a stream that changes within a trial, 0 to 0.4 m/s",
    "the same flows in the tank",
    parts,
    findings,
)
