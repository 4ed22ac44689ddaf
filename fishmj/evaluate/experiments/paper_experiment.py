"""Common interface of the paper's experiments, and the setting in which they run."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from fishmj import control, engines
from fishmj.control import Controller
from fishmj.evaluate import protocol
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.run_trials import judge_in_solver, run
from fishmj.lbm_oracle.run.solver_water import SolverWater
from fishmj.mjcf.description import Robot

PAPER = "Egocentric Station Holding of Robotic Fish in Unknown Turbulent Background Flow"
Row = dict[str, Any]  # result of one part, in JSON types
Done = Callable[[float], None]  # progress callback, called with simulated seconds


class ExperimentPart(NamedTuple):
    """Part of an experiment, saved as soon as it ends. seconds: its cost as simulated time of trials."""

    key: str
    seconds: float
    run: Callable[[Done], Row]


class PaperFinding(NamedTuple):
    """Value of the paper and the one measured here. value, low, high: NaN if there is none; n: number of trials."""

    what: str
    paper: str
    measured: str
    value: float = float("nan")
    low: float = float("nan")
    high: float = float("nan")
    n: int = 0


class ExperimentFindings(NamedTuple):
    """Result of an experiment. tables: (title, rows); pictures: (PNG, caption)."""

    compared: list[PaperFinding]
    pictures: list[tuple[bytes, str]]
    tables: list[tuple[str, list[dict]]] = []  # noqa: RUF012
    notes: list[str] = []  # noqa: RUF012


class PaperExperiment(NamedTuple):
    """One experiment.

    Attributes:
        figure: number and subject of the paper's figure. about: one line. robot: results that need the real robot.
        parts: parts with unique keys. findings: function that computes values and plots from the rows by key.
    """

    name: str
    figure: str
    about: str
    robot: str
    parts: "Callable[[ExperimentSetup], list[ExperimentPart]]"
    findings: "Callable[[ExperimentSetup, dict[str, Row]], ExperimentFindings]"


@dataclass(kw_only=True)
class ExperimentSetup:
    """Setting of all experiments. robot: in its water. quick: fewer trials. solver: water of the flow solver, or None.

    trained: folder of policies for the ablations; None: they are trained. described: shipped name or file of the robot.
    """

    robot: Robot
    policy: str
    seed: int
    quick: bool
    out: Path
    solver: SolverWater | None = None
    device: str = "auto"
    tanks: int = 1
    trained: Path | None = None
    described: str = "fish"

    def of(self, full: Any, quick: Any) -> Any:
        """First value, or with `quick` the second."""
        return quick if self.quick else full

    def trials(self, **options: Any) -> Trials:
        """Trials as `protocol.trials` with this seed."""
        return protocol.trials(**{"seed": self.seed, **options})

    @cached_property
    def brain(self) -> Controller:
        """Controller made from the policy. Raises ConfigError, UnknownName: a policy for another fish, or no policy."""
        return control.chosen(self.policy, self.robot)

    @property
    def leader(self) -> str:
        """Name of the policy in results."""
        return self.brain.name

    @cached_property
    def engine(self) -> Any:
        """Engine of the fitted water, compiled at the first use."""
        return engines.make(engines.fastest(), self.robot)

    def judge(self, brain: "Controller | str", trials: Trials, done: Done) -> Result:
        """Evaluates a controller, given as an object or as the user named it, in this water."""
        brain = control.chosen(brain, self.robot) if isinstance(brain, str) else brain
        step = self.robot.timing.control_dt
        if self.solver is None:
            return run(brain, self.robot, trials, self.engine, progress=lambda k: done(k * step * len(trials)))
        options: dict[str, Any] = {"water": self.solver, "device": self.device, "tanks": self.tanks}
        return judge_in_solver(brain, self.robot, trials, self.out, progress=lambda k: done(k * step), **options)

    def part(self, key: str, brain: "Controller | str", trials: Trials, row: Callable[[Result], Row]) -> ExperimentPart:
        """Part that evaluates one controller over trials and saves `row(result)`."""
        return ExperimentPart(key, trials.duration * len(trials), lambda done: row(self.judge(brain, trials, done)))
