"""A policy for the second robot's water, by what its user would type: experiments in still water, `calibrate water`, `train`.

    OUT/seed_00/healthy              deploy experiment: twelve records of one second robot, in lockstep
    OUT/seed_00/fish.toml            calibrate water: the description, its water fitted to those
    OUT/seed_00/trained_unpatched    train --begin POLICY --robot fish.toml
    OUT/seed_00/log.txt              the commands, and what they said

The steps are those of `whole_loop`, each done once and kept. Second robots differ from one another in what nobody measured
(`nuisance`); this one is that of seed 0, each trial has one of its own.
"""

from studies.whole_loop import steps
from studies.whole_loop.steps import UNPATCHED, Loop

SEED = 0  # of the robot that was measured


def trained(loop: Loop) -> str:
    """The folder of a training in the calibrated description; it begins with `loop.policy`. What is there is not made again.

    Raises:
        FishmjError: a command failed; the robot's `log.txt` says why.
    """
    steps.measure(loop, SEED, faulty=False)
    steps.calibrate(loop, SEED)
    steps.train(loop, SEED, UNPATCHED)
    return str(loop.folder(SEED) / f"trained_{UNPATCHED}")
