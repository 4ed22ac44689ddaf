"""Ablations by retraining: without friction calibration, without self-velocity, without joint information.

The experiment trains its policies by itself, or judges those of `--trained DIR`, one or more of each variant:

    fishmj train --preset paper --engine planar --steps 60e6 --out DIR/complete
    fishmj train --preset paper --engine planar --steps 60e6 --water structured --out DIR/no-friction-calibration
    fishmj train --preset paper --engine planar --steps 60e6 --hide velocity,yaw_rate --out DIR/no-self-velocity
    fishmj train --preset paper --engine planar --steps 60e6 --hide joint,joint_rate --out DIR/no-joint-information
    fishmj experiments ablations --trained DIR

More seeds end in -NAME (DIR/complete-1). A policy file may stand for a run: DIR/complete.safetensors.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.figures import canvas, png, style
from fishmj.control import Controller
from fishmj.control.learned import LearnedController
from fishmj.control.policy import is_policy
from fishmj.evaluate import metrics
from fishmj.evaluate.experiments.experiment_figures import compared, counted, figures_row, read, rounded
from fishmj.evaluate.experiments.experiment_training import in_other_water, returns, settings_of, sim_seconds, train_stages
from fishmj.evaluate.experiments.paper_experiment import (
    Done,
    ExperimentFindings,
    ExperimentPart,
    ExperimentSetup,
    PaperExperiment,
    Row,
)
from fishmj.evaluate.plots import COLOURS, STYLE
from fishmj.tasks.station_hold import spans, visible
from fishmj.train.settings import Settings
from fishmj.water import choice

VARIANTS: dict[str, dict[str, Any]] = {  # changes of the settings of the training
    "complete": {},
    "no friction calibration": {"water": choice.STRUCTURED},
    "no self-velocity": {"task": {"hide": ("velocity", "yaw_rate")}},
    "no joint information": {"task": {"hide": ("joint", "joint_rate")}},
}
SAID = {"complete": "best", "no friction calibration": "good where trained, bad on the robot"}
SECONDS = 24 * 60.0  # of the judgement of one policy in one water
PLACES = {"trained": "in the water of its training", "judged": "in the water of the judgement"}


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """One training for each variant and seed, or one part for each policy of `trained`."""
    if setup.trained is not None:
        every = {name: found_policies(setup, setup.trained, name) for name in VARIANTS}
        if len({len(found) for found in every.values()}) > 1:
            counts = ", ".join(f"{name} {len(found)}" for name, found in every.items())
            raise ConfigError(
                f"{setup.trained}: {counts} policies; expected as many of each variant, because they are compared in pairs"
            )
        return [
            ExperimentPart(f"{name}, {path.stem} {brain.sha256[:8]}", SECONDS, partial(judged, setup, brain, water))
            for name, found in every.items()
            for path, brain, water in found
        ]
    made = []
    for seed in range(setup.of(constant("training", "runs"), 1)):
        for name, changes in VARIANTS.items():
            settings = settings_of(setup, seed=setup.seed + seed, **changes)
            made.append(ExperimentPart(f"{name}, run {seed + 1}", sim_seconds(settings), partial(trained, setup, name, settings)))
    return made


def found_policies(setup: ExperimentSetup, folder: Path, name: str) -> list[tuple[Path, LearnedController, str]]:
    """Policies of a variant in a folder: place, controller and water of the training.

    Raises ConfigError: there is none, or one that was trained with other inputs.
    """
    slug = name.replace(" ", "-")
    paths = [path for path in sorted(folder.glob(f"{slug}*")) if path.stem == slug or path.stem.startswith(f"{slug}-")]
    paths = [path for path in paths if is_policy(path)]
    if not paths:
        raise ConfigError(
            f"{folder}: no policy of the variant {name!r}; expected {slug}.safetensors or a folder {slug} of a training"
        )
    keys = [key for key, width in spans(setup.robot.n_joints).items() for _ in range(width)]
    hidden = ~np.array(visible(setup.robot.n_joints, VARIANTS[name].get("task", {}).get("hide", ())))
    made = []
    for path in paths:
        brain = LearnedController(setup.robot, str(path))
        unused = ~brain.policy.weights[0][0][:, : len(hidden)].any(0)
        if not np.array_equal(unused, hidden):
            there, expected = (", ".join(dict.fromkeys(np.array(keys)[mask])) or "nothing" for mask in (unused, hidden))
            raise ConfigError(f"{path}: a policy with --hide {there}; expected {expected} hidden for the variant {name!r}")
        made.append((path, brain, brain.policy.meta.get("water", {}).get("name", choice.FITTED)))
    return made


def trained(setup: ExperimentSetup, name: str, settings: Settings, done: Done) -> Row:
    """Trains a policy, and returns its row."""
    folder = f"{name.replace(' ', '-')}-{settings.seed}"
    _, files = train_stages(setup, folder, settings, (settings.steps,))
    row = judged(setup, str(files[-1]), settings.water, lambda seconds: None)
    done(sim_seconds(settings))
    return row


def judged(setup: ExperimentSetup, brain: Controller | str, water: str, done: Done) -> Row:
    """Returns and figures of 24 trials, in the water of the training and in that of the judgement."""
    trials = setup.trials(speeds=[constant("experiments", "transfer_speed")])
    own = in_other_water(setup, None if water == "auto" else water)
    row: Row = {}
    for place, one in (("trained", own), ("judged", setup)):
        result = one.judge(brain, trials, lambda seconds: None)
        row[place] = figures_row(result) | {"return": rounded(returns(result), 3)}
    done(SECONDS)
    return row


def gathered(rows: dict[str, Row], name: str, place: str, key: str) -> np.ndarray:
    """Values of one variant over all its trainings and trials."""
    some = [row[place] for variant, row in rows.items() if variant.startswith(f"{name}, ")]
    return np.concatenate([read(one["return"] if key == "return" else one["figures"][key]) for one in some])


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Returns by variant and water, and differences from the complete policy."""
    found, tables = [], []
    for place, words in PLACES.items():
        for name in VARIANTS:
            values = gathered(rows, name, place, "return")
            found.append(compared(f"return, {name}, {words}", SAID.get(name, "clearly worse"), values, digits=1))
        tables.append((f"Variant minus complete, {words}", differences(rows, place)))
    each = {name: [row for key, row in rows.items() if key.startswith(f"{name}, ")] for name in VARIANTS}
    mean = lambda row, place: f"{read(row[place]['return']).mean():.1f}"
    table = [
        {"variant": name, "training": k + 1} | {f"return, {words}": mean(row, place) for place, words in PLACES.items()}
        for name, some in each.items()
        for k, row in enumerate(some)
    ]
    notes = [
        "Return: sum of the reward over 30 s. Without friction calibration: trained in the description's own strips.",
        f"Trainings of each variant: {len(each['complete'])}, with 24 trials each. P values after Holm.",
    ]
    shown = [(picture(rows), "Return of each variant, mean and standard deviation over trials.")]
    return ExperimentFindings(found, shown, [*tables, ("Mean return of each training", table)], notes)


def differences(rows: dict[str, Row], place: str) -> list[dict[str, Any]]:
    """Rows of each variant's return and RMSE after arrival minus those of the complete policy, trial by trial."""
    rivals, p_of = [name for name in VARIANTS if name != "complete"], {}
    table = [{"variant": name} for name in rivals]
    for key, digits in (("return", 1), ("rmse_after_arrival", 3)):
        pairs = [[gathered(rows, one, place, key) for one in ("complete", name)] for name in rivals]
        each = [metrics.difference(key, *pair) for pair in pairs]
        p_of = {
            "Welch p": metrics.holm([d.welch_p for d in each]),
            "paired p": metrics.holm([metrics.paired_p(*x) for x in pairs]),
        }
        for k, line in enumerate(table):
            line[key.replace("rmse", "RMSE").replace("_", " ")] = each[k].text(digits)
            line |= {f"{what}, {'return' if digits == 1 else 'RMSE'}": f"{p[k]:.2g}" for what, p in p_of.items()}
    for name, line in zip(rivals, table, strict=True):
        line["arrival"] = counted("", "", gathered(rows, name, place, "arrival")).measured
    return table


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
    "16, ablations",
    "retrained without friction calibration, self-velocity or joint information",
    "the returns on the robot, where the paper's uncalibrated policy fails",
    parts,
    findings,
)
