"""Training: the return over control steps, and the policy at three stages, S1 to S3, downstream and upstream at 0.2 m/s."""

from functools import partial

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.figures import canvas, png, style
from fishmj.evaluate.experiments.approach_target import SIDES
from fishmj.evaluate.experiments.experiment_figures import compared, counted, figures_row, read, series_row
from fishmj.evaluate.experiments.experiment_training import learning_curve, settings_of, sim_seconds, train_stages
from fishmj.evaluate.experiments.paper_experiment import (
    Done,
    ExperimentFindings,
    ExperimentPart,
    ExperimentSetup,
    PaperExperiment,
    Row,
)
from fishmj.evaluate.plots import COLOURS, INK, STYLE
from fishmj.train.settings import Settings

STAGES = {"S1": 50_000, "S2": 450_000}  # control steps; S3 is the end
EARLY = 5.0  # s, in which the stream carries a passive fish by a metre


def parts(setup: ExperimentSetup) -> list[ExperimentPart]:
    """One training for each seed, with an evaluation of its stages."""
    made = []
    for seed in range(setup.of(constant("training", "runs"), 1)):
        settings = settings_of(setup, seed=setup.seed + seed)
        made.append(ExperimentPart(f"run {seed + 1}", sim_seconds(settings), partial(trained, setup, settings)))
    return made


def trained(setup: ExperimentSetup, settings: Settings, done: Done) -> Row:
    """Row of one training: its curve, and trials of every stage."""
    stages = {name: steps for name, steps in STAGES.items() if steps < settings.steps} | {"S3": settings.steps}
    folder, files = train_stages(setup, f"run-{settings.seed}", settings, tuple(stages.values()))
    trials = setup.trials(
        speeds=[constant("experiments", "transfer_speed")],
        los_deg=list(SIDES.values()),
        repeats=constant("experiments", "stage_trials"),
    )
    row: Row = {"curve": learning_curve(folder), "stages": {}}
    for (stage, steps), file in zip(stages.items(), files, strict=True):
        result = setup.judge(str(file), trials, lambda seconds: None)
        row["stages"][stage] = figures_row(result) | series_row(result, until=30.0) | {"steps": steps}
    done(sim_seconds(settings))
    return row


def findings(setup: ExperimentSetup, rows: dict[str, Row]) -> ExperimentFindings:
    """Arrival and distance at each stage, over all runs."""
    verdicts = {"S1": "overshoots, or does not approach", "S2": "reaches and keeps the target", "S3": "agile, highly stable"}
    found, first = [], next(iter(rows.values()))
    for stage in first["stages"]:
        each = [row["stages"][stage]["figures"] for row in rows.values()]
        found.append(counted(f"arrival, {stage}", verdicts[stage], np.concatenate([read(one["arrival"]) for one in each])))
        last = np.concatenate([read(one["rmse_last20"]) for one in each])
        found.append(compared(f"RMSE of the last 20 s, {stage}", verdicts[stage], last, "m"))
    table = [
        {"stage": stage, "target": side} | actions([row["stages"][stage] for row in rows.values()], los)
        for stage in first["stages"]
        for side, los in SIDES.items()
    ]
    total = int(max(row["curve"]["step"][-1] for row in rows.values()))
    notes = [
        f"{len(rows)} runs of {total:,} control steps; the paper's converges at {constant('training', 'steps_converged'):,}.",
        ", ".join(f"{stage} after {one['steps']:,}" for stage, one in first["stages"].items()) + " control steps.",
    ]
    shown = [
        (curves(rows), "Mean reward of a control step over training: mean and standard deviation of the runs."),
        (tracks(first), "Tracks seen from the target, first run; the water flows down the page."),
    ]
    return ExperimentFindings(found, shown, [("Actions of each stage", table)], notes)


def actions(every: list[Row], los: int) -> dict[str, str]:
    """Figures of the trials of one stage and direction, over all runs."""
    some = [np.array(one["los"]) == los for one in every]
    figure = lambda key: np.concatenate([read(one["figures"][key])[mask] for one, mask in zip(every, some, strict=True)])
    series = lambda key: np.concatenate([read(one[key])[mask] for one, mask in zip(every, some, strict=True)])
    distance, early = series("distance"), read(every[0]["t"]) <= EARLY
    toward = (distance[:, 0] - distance[:, early][:, -1]) / EARLY
    return {
        "arrival": counted("", "", figure("arrival")).measured,
        f"speed to the target, first {EARLY:g} s [m/s]": compared("", "", toward, digits=2).measured,
        "least distance [m]": compared("", "", np.nanmin(distance, 1), digits=2).measured,
        "RMSE of the last 20 s [m]": compared("", "", figure("rmse_last20")).measured,
        "power [W]": compared("", "", figure("power"), digits=1).measured,
    }


@style(STYLE)
def curves(rows: dict[str, Row]) -> bytes:
    """Learning curve."""
    figure, axes = canvas(1, 1, (7, 3.6))
    step = read(next(iter(rows.values()))["curve"]["step"])
    reward = np.stack([np.interp(step, row["curve"]["step"], row["curve"]["reward"]) for row in rows.values()])
    middle, spread = reward.mean(0), reward.std(0)
    axes[0, 0].fill_between(step / 1e6, middle - spread, middle + spread, color=COLOURS[0], alpha=0.2, linewidth=0)
    axes[0, 0].plot(step / 1e6, middle, color=COLOURS[0], linewidth=2)
    for stage, one in next(iter(rows.values()))["stages"].items():
        axes[0, 0].axvline(one["steps"] / 1e6, color=INK, linewidth=0.8, linestyle=":")
        axes[0, 0].annotate(stage, (one["steps"] / 1e6, middle.max()))
    axes[0, 0].set(xlabel="control steps [million]", ylabel="mean reward of a step")
    return png(figure)


@style(STYLE)
def tracks(row: Row) -> bytes:
    """Tracks of each stage and side."""
    stages = row["stages"]
    figure, axes = canvas(len(SIDES), len(stages), (3.4 * len(stages), 3.4 * len(SIDES)), sharex=True, sharey=True)
    for column, (stage, one) in enumerate(stages.items()):
        for line, (side, los) in zip(axes, SIDES.items(), strict=True):
            some = np.array(one["los"]) == los
            axis = line[column]
            axis.plot(-read(one["side"])[some].T, read(one["upstream"])[some].T, color=COLOURS[column], linewidth=0.8)
            axis.plot(0, 0, "+", color=INK, markersize=10)
            axis.set(xlim=(-2, 2), ylim=(-2.4, 2), aspect="equal", title=f"{stage}, {side}")
    figure.supxlabel("right of the target, facing upstream [m]")
    figure.supylabel("upstream of it [m]")
    return png(figure)


EXPERIMENT = PaperExperiment(
    "stages",
    "8, training process and its stages",
    "a training, its return over control steps, and the policy at three stages",
    "none of it: the paper's figure is simulated too",
    parts,
    findings,
)
