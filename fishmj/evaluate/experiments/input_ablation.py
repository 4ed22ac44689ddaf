"""Ablations by retraining: without friction calibration, without self-velocity, without joint information."""

from functools import partial
from typing import Any

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.figures import canvas, png, style
from fishmj.evaluate import metrics
from fishmj.evaluate.experiments.experiment_training import in_other_water, returns, settings_of, sim_seconds, train_stages
from fishmj.evaluate.experiments.paper_experiment import (
    Done,
    ExperimentFindings,
    ExperimentPart,
    ExperimentSetup,
    PaperExperiment,
    Row,
    compared,
    figures_row,
    read,
    rounded,
)
from fishmj.evaluate.plots import COLOURS, STYLE
from fishmj.train.settings import Settings
from fishmj.water.choice import STRUCTURED

VARIANTS: dict[str, dict[str, Any]] = {  # changes of the settings of the training
    "complete": {},
    "no friction calibration": {"water": STRUCTURED},
    "no self-velocity": {"task": {"hide": ("velocity", "yaw_rate")}},
    "no joint information": {"task": {"hide": ("joint", "joint_rate")}},
}
SAID = {"complete": "best", "no friction calibration": "good where trained, bad on the robot"}
PLACES = {"trained": "in the water of its training", "judged": "in the water of the judgement"}


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """One training for each variant and seed."""
    made = []
    for seed in range(setup.of(constant("training", "runs"), 1)):
        for name, changes in VARIANTS.items():
            settings = settings_of(setup, seed=setup.seed + seed, **changes)
            made.append(ExperimentPart(f"{name}, run {seed + 1}", sim_seconds(settings), partial(judged, setup, name, settings)))
    return made


def judged(setup: ExperimentSetup, name: str, settings: Settings, done: Done) -> Row:
    """Row of one training: returns and figures of 24 trials in both waters."""
    folder = f"{name.replace(' ', '-')}-{settings.seed}"
    _, files = train_stages(setup, folder, settings, (settings.steps,))
    trials = setup.trials(speeds=[constant("experiments", "transfer_speed")])
    own = in_other_water(setup, None if settings.water == "auto" else settings.water)
    row: Row = {}
    for place, one in (("trained", own), ("judged", setup)):
        result = one.judge(str(files[-1]), trials, lambda seconds: None)
        row[place] = figures_row(result) | {"return": rounded(returns(result), 3)}
    done(sim_seconds(settings))
    return row


def gathered(rows: dict[str, Row], name: str, place: str, key: str) -> np.ndarray:
    """Values of one variant over all its trainings and trials."""
    some = [row[place] for variant, row in rows.items() if variant.startswith(f"{name}, ")]
    return np.concatenate([read(one["return"] if key == "return" else one["figures"][key]) for one in some])


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Returns by variant and water, and their differences from the complete policy."""
    found, table = [], []
    for place, words in PLACES.items():
        for name in VARIANTS:
            values = gathered(rows, name, place, "return")
            found.append(compared(f"return, {name}, {words}", SAID.get(name, "clearly worse"), values, digits=1))
        rivals = [name for name in VARIANTS if name != "complete"]
        first = gathered(rows, "complete", place, "return")
        each = [metrics.difference("return", first, gathered(rows, name, place, "return")) for name in rivals]
        for name, d, p in zip(rivals, each, metrics.holm([d.welch_p for d in each]), strict=True):
            arrival = gathered(rows, name, place, "arrival")
            line = {"water": words, "variant minus complete": name, "return": d.text(1), "pairs": d.n, "Holm p": f"{p:.2g}"}
            table.append(line | {"arrival": f"{int(arrival.sum())} of {len(arrival)}"})
    notes = ["Return: sum of the reward over 30 s. Without friction calibration: trained in the description's own strips."]
    shown = [(picture(rows), "Return of each variant, mean and standard deviation.")]
    return ExperimentFindings(found, shown, [("Tests", table)], notes)


@style(STYLE)
def picture(rows: dict[str, Row]) -> bytes:
    """Bars of the returns, as in the paper."""
    figure, axes = canvas(1, 1, (8, 3.8))
    for k, (place, words) in enumerate(PLACES.items()):
        each = [gathered(rows, name, place, "return") for name in VARIANTS]
        where, spread = np.arange(len(each)) + 0.4 * k - 0.2, [x.std() for x in each]
        axes[0, 0].bar(where, [x.mean() for x in each], 0.38, yerr=spread, color=COLOURS[k], capsize=3, label=words)
    axes[0, 0].set_xticks(range(len(VARIANTS)), labels=list(VARIANTS))
    axes[0, 0].set(ylabel="return")
    axes[0, 0].legend(frameon=False)
    return png(figure)


EXPERIMENT = PaperExperiment(
    "ablations",
    "ablation",
    "retrained without friction calibration, self-velocity or joint information",
    "the returns on the robot, where the paper's uncalibrated policy fails",
    parts,
    findings,
)
