"""The five answers of the gap search, each on a robot whose fault is hidden from it.

    python examples/gap_answers.py agrees           nothing is wrong
    python examples/gap_answers.py named            commands arrive 30 ms late: found, sized, ready to be added to the model
    python examples/gap_answers.py class            a weak motor or a slow one? records that tell are proposed and made
    python examples/gap_answers.py twins            mass further out, or more water? no swim tells; it is weighed, which does
    python examples/gap_answers.py unexplained      a fault that no catalogue holds: described as a force, not named
    python examples/gap_answers.py not_repeatable   the water is restless: repeated runs differ, so there is nothing to name

The data are synthetic: a second, independently written robot with its own water, motors, network and camera makes them.
"""

import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from fishmj.base import console
from fishmj.base.store import read_json
from fishmj.gap.__main__ import main as gap


class Story(NamedTuple):
    """What is wrong with the robot, what it was asked to do, and what to do with the answer."""

    plant: str
    runs: str
    seed: int
    next: str


MIXED = "gait_fast,drift_north,turn_left,tow_oblique"
STORIES = {
    "agrees": Story("none", MIXED, 21, "Use the model: the logs hold nothing that an independent simulation of it does not."),
    "named": Story("command_latency=0.03", MIXED, 11, "Add it to the model: python -m fishmj.gap apply REPORT"),
    "class": Story("torque_saturation=1.25", "gait,turn_left", 5, "Do the experiment, then search again."),
    "twins": Story(
        "yaw_inertia=0.006", "gait,turn_left,burst_and_coast", 12, "Add it to the model: python -m fishmj.gap apply REPORT"
    ),
    "unexplained": Story("tail_yaw_cross_force=-0.02", MIXED, 31, "Look at the robot for what could make such a force."),
    "not_repeatable": Story(
        "turbulence=0.06", "drift_north,drift_north,drift_north,gait_fast,gait_fast,gait_fast", 41, "Calm the water, log again."
    ),
}


def tell(name: str, folder: Path, extra: tuple[str, ...] = ()) -> list[str]:
    """One story in `folder`; the answers it got. extra: further arguments of the search."""
    story = STORIES[name]
    answers = [search(story, story.runs, folder / "first", extra)]
    proposed = read_json(folder / "first" / "report" / "verdict.json")["next_experiment"]
    if proposed.startswith("Weigh "):
        console.say("", "It is weighed.")
        answers.append(search(story, story.runs, folder / "second", extra, ("--weigh",)))
    if proposed.startswith("Run "):
        run = proposed.split("`")[1]
        console.say("", f"The proposed experiment is done: {run}.")
        answers.append(search(story, f"{story.runs},{run}", folder / "second", extra))
    console.say("", f"What to do: {story.next}")
    return answers


def search(story: Story, runs: str, folder: Path, extra: tuple[str, ...], more: tuple[str, ...] = ()) -> str:
    """Make logs of the faulty robot, ask what is wrong with it, and read the answer."""
    data, report, once = folder / "data", folder / "report", ("--excitations", runs, "--logs", str(len(runs.split(","))))
    call("plant", story.plant, *once, "--seed", str(story.seed), "--out", str(data), *more)
    call("find", str(data), "--out", str(report), *extra)
    return read_json(report / "verdict.json")["answer"]


def call(*arguments: str) -> None:
    """Run a command of the search as a user would, showing it."""
    console.say("", f"$ fishmj gap {' '.join(arguments)}")
    gap(list(arguments))


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in STORIES:
        raise SystemExit(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        tell(sys.argv[1], Path(folder))
