"""Rheotactic index from 0 to 0.14 m/s, from uniform start headings, beside a passive fish and a fish with random gaits."""

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.figures import GREY, ORANGE, VERMILION, canvas, png, style
from fishmj.base.pages import drawn
from fishmj.control.cpg import Cpg, Rates
from fishmj.evaluate import metrics
from fishmj.evaluate.experiments.experiment_figures import compared, error_bars, read, rounded
from fishmj.evaluate.experiments.paper_experiment import ExperimentFindings, ExperimentPart, ExperimentSetup, PaperExperiment, Row
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.plots import FAINT, STYLE
from fishmj.mjcf.description import Robot

START = 30.0  # s, start of the hold phase
ABOVE = 0.08  # m/s, least speed of the paper's plateau
RENEWED = 25  # control steps until a new random gait
RATES = Rates(frequency=4.0, amplitude=np.radians(90), bias=np.radians(240))  # of its changes


class RandomGait:
    """Null model: a CPG with new random frequency, amplitude and bias every five seconds, without feedback.

    The noisy first observation seeds each fish, so that its gaits do not depend on the batch.
    """

    name = "random-gait"

    def __init__(self, robot: Robot, seed: int):
        _, behind, *_ = np.radians(constant("baselines", "cpg_phase_deg"))
        self.cpg, self.seed = Cpg(robot, -behind * np.arange(robot.n_joints), RATES), seed

    def reset(self, n: int) -> None:
        """Starts n fish."""
        self.cpg.reset(n)
        self.count = 0

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        if self.count == 0:
            self.random = [np.random.default_rng([self.seed, *np.abs(1e6 * row).astype(int)]) for row in obs]
        if self.count % RENEWED == 0:
            f, a, bias = np.array([one.random(3) for one in self.random]).T
            fast, wide, most = (constant("baselines", key) for key in ("cpg_frequency", "cpg_amplitude_deg", "cpg_bias_deg"))
            self.gait = f * fast[1], np.radians(wide) * a, np.radians(most) * (2 * bias - 1)
        self.count += 1
        return self.cpg(*self.gait)


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """Policy and both nulls over the same starts and streams."""
    los, repeats = setup.of((range(0, 360, 45), 3), (range(0, 360, 90), 2))
    speeds, hold = constant("rheotaxis", "flows"), constant("rheotaxis", "hold")
    trials = setup.trials(speeds=speeds, los_deg=los, repeats=repeats, heading="uniform", duration=START + hold)
    row = lambda result: index_row(result, bounded=setup.solver is not None or result.controller == setup.leader)
    fish = ((setup.policy, setup.policy), ("passive", "drift"), ("random gait", RandomGait(setup.robot, setup.seed)))
    return [setup.part(key, brain, trials, row) for key, brain in fish]


def index_row(result: Result, bounded: bool) -> Row:
    """Indices of every trial over the hold phase; bounded: only until a fish leaves the tank."""
    window = START, START + constant("rheotaxis", "hold")
    cosine, linear = metrics.rheotaxis(result, window, bounded)
    return {"speed": rounded(result.trials.speed, 3), "cosine": rounded(cosine, 4), "linear": rounded(linear, 4)}


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Index at each speed, and over all speeds of the plateau."""
    leader, *nulls = rows
    low, high = constant("rheotaxis", "plateau")
    speeds, found = np.array(rows[leader]["speed"]), []
    for speed in np.unique(speeds):
        paper = f"{low:g} to {high:g}" if speed >= ABOVE else "rising from 0"
        values = read(rows[leader]["cosine"])[speeds == speed]
        found.append(compared(f"rheotactic index at {speed:g} m/s", paper, values))
    for name in nulls:
        values = read(rows[name]["cosine"])[speeds >= ABOVE]
        found.append(compared(f"{name}, from {ABOVE:g} m/s", "not shown", values))
    linear = read(rows[leader]["linear"])[speeds >= ABOVE]
    found.append(compared(f"linear index from {ABOVE:g} m/s", "definition not given", linear))
    notes = [
        "Index: mean cosine of the heading from upstream, heading averaged over 1 s, 60 s of hold phase, start heading uniform.",
        "Passive fish and random gaits drift out of the tank. "
        + ("The fitted water has no walls: their headings still count." if setup.solver is None else "Then they have no index."),
    ]
    return ExperimentFindings(found, [(picture(rows), "Rheotactic index over flow speed, 95 % intervals.")], notes=notes)


@style(STYLE)
def picture(rows: dict[str, Row]) -> bytes:
    """Index over flow speed with the paper's plateau."""
    figure, axes = canvas(1, 1, (6.6, 4.2))
    axis, speeds = axes[0, 0], np.array(next(iter(rows.values()))["speed"])
    axis.axhspan(*constant("rheotaxis", "plateau"), color=FAINT, alpha=0.5, label="plateau of the paper", linewidth=0)
    for (name, row), colour in zip(rows.items(), (VERMILION, GREY, ORANGE), strict=True):
        middle, ends = error_bars([read(row["cosine"])[speeds == speed] for speed in np.unique(speeds)])
        axis.errorbar(100 * np.unique(speeds), middle, ends, color=colour, marker="o", capsize=3, linewidth=2, label=drawn(name))
    axis.set(xlabel="flow speed [cm/s]", ylabel="rheotactic index", ylim=(-1, 1.05))
    axis.legend(frameon=False, loc="lower right")
    return png(figure)


EXPERIMENT = PaperExperiment(
    "rheotaxis",
    "18, rheotaxis beside that of fishes",
    "rheotactic index from 0 to 0.14 m/s, uniform start headings, two nulls",
    "the same index in the tank; the fishes' data of the paper's figure are Coombs et al. 2020",
    parts,
    findings,
)
