"""A policy for the second robot's water, by its user's commands: experiments in still water, `calibrate water`, `train`.

    OUT/seed_00/healthy              deploy experiment: twelve records of one second robot, in lockstep
    OUT/seed_00/fish.toml            calibrate water: the description, its water fitted to those
    OUT/seed_00/trained_unpatched    train --begin POLICY --robot fish.toml
    OUT/seed_00/log.txt              the commands and their output

The steps are those of `whole_loop`, each done once and kept. Second robots differ from one another in their unmeasured constants
(`nuisance`). This one has seed 0; each trial has one of its own.
"""

from studies.whole_loop import steps
from studies.whole_loop.steps import UNPATCHED, Loop

SEED = 0  # of the robot that was measured


def trained(loop: Loop) -> str:
    """Folder of a training in the calibrated description, which starts from `loop.policy`. Existing results are not made again.

    Raises:
        FishmjError: a command failed; the robot's `log.txt` has the reason.
    """
    steps.measure(loop, SEED, faulty=False)
    steps.calibrate(loop, SEED)
    steps.train(loop, SEED, UNPATCHED)
    return str(loop.folder(SEED) / f"trained_{UNPATCHED}")
