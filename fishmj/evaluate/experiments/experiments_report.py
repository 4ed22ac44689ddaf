"""Report of the paper's experiments, with the paper's values and those measured here."""

from collections.abc import Iterable
from typing import Any, NamedTuple

from fishmj.base.pages import Section, figure, part, report, table
from fishmj.evaluate.experiments.paper_experiment import PAPER, ExperimentFindings, PaperExperiment

ELSEWHERE = {  # figures of the paper that other commands reproduce
    "2, forces on a bent fish in a stream": "fishmj lbm_oracle forcemap --device cuda --fields",
    "5, complexity of the tank's flow": "fishmj lbm_oracle drift --device cuda",
    "7, response of the joints": "fishmj calibrate servo",
}
ABOUT = "Value (95 % interval over trials), n trials. Everything measured here is simulated."


class FinishedExperiment(NamedTuple):
    """Experiment with all its rows. cpu: s of CPU for its rows."""

    experiment: PaperExperiment
    findings: ExperimentFindings
    cpu: float


def rows_of(finished: FinishedExperiment, named: bool = False) -> list[dict]:
    """Table of one experiment; named: with the experiment's name in front."""
    front = {"experiment": finished.experiment.name} if named else {}
    return [
        front | {"figure": one.what, "the paper reports": one.paper, "measured here": one.measured, "n": one.n or ""}
        for one in finished.findings.compared
    ]


def sections(every: Iterable[FinishedExperiment]) -> list[Section]:
    """Sections of the page: all figures of several experiments in one table, then each experiment with its pictures."""
    every = list(every)
    together = table([row for one in every for row in rows_of(one, True)], left=4)
    made = [Section("The paper and fishmj", "", [together])] if len(every) > 1 else []
    for one in every:
        parts: list[str] = [
            table(rows_of(one), left=3),
            *(figure(picture, caption) for picture, caption in one.findings.pictures),
        ]
        for title, rows in one.findings.tables:
            parts += [part("heading", title), table(rows)]
        parts += [*one.findings.notes, f"Needs the real robot: {one.experiment.robot}."]
        about = f"{one.experiment.about[0].upper()}{one.experiment.about[1:]}. Figure of the paper: {one.experiment.figure}."
        made.append(Section(one.experiment.name, f"{about} {one.cpu:.0f} s of CPU.", parts))
    others = [{"figure of the paper": label, "command": line} for label, line in ELSEWHERE.items()]
    return [*made, Section("Other figures of the paper", "Remade by commands of their own.", [table(others, left=2)])]


def page(every: Iterable[FinishedExperiment], policy: str, notes: Iterable[str], robot: str = "") -> str:
    """The report as one HTML text. robot: as `fishmj.mjcf.identity.robot_line`."""
    every = list(every)
    heading = f"{policy}: {len(every)} of the paper's experiments"
    head: dict[str, Any] = {"mark": "EXPERIMENTS", "robot": robot, "notes": (*notes, f"The paper: {PAPER}. {ABOUT}")}
    return report(f"Experiments of {policy}", heading, sections(every), **head)


def as_json(every: Iterable[FinishedExperiment]) -> dict:
    """Findings by experiment, in plain types."""
    return {
        one.experiment.name: {
            "figure": one.experiment.figure,
            "cpu_s": round(one.cpu, 1),
            "compared": [found._asdict() for found in one.findings.compared],
            "tables": dict(one.findings.tables),
            "notes": one.findings.notes,
        }
        for one in every
    }
