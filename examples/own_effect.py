"""An effect of your own: a cable that trails behind the fish.

    python examples/own_effect.py

An effect is a formula at one place of the physics with named, bounded parameters. At its null it must change no bit of a step:
`join` checks that, that it stays finite at its bounds, and that JAX and the compiled engine can follow it. From then on it can be
listed in a description, drawn in training and named by the search: `--effects examples/own_effect.py:CABLE`.
"""

from dataclasses import replace

import numpy as np

from fishmj.effects import Effect, Parameter
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.engines import own_effects
from fishmj.mjcf import load_robot
from fishmj.sim import Sim


def towed(xp, p, body, memory, h):
    """Forces on a link in its own axes, N."""
    return body._replace(fx=body.fx - p.drag * body.u * xp.abs(body.u)), memory


CABLE = Effect(
    name="trailing_cable",
    stage="hydrodynamics",
    about="a cable behind the fish: drag along its way",
    formula="F = -c u |u|",
    source="made up for this example",
    parameters=(Parameter(name="drag", unit="N s2/m2", low=0.0, high=20.0, typical=(0.5, 3.0)),),
    shows=("position", "power"),
    body=towed,
)


def speed(robot) -> float:
    """m/s after 6 s of a gait of 1 Hz in still water."""
    gait = lambda t: 0.5 * min(t, 1.0) * np.sin(2 * np.pi * t - np.radians(60) * np.arange(robot.n_joints))
    truth = Sim(robot).run(gait, 6.0).table("truth")
    late = truth["t"] > 4.0
    return float(np.hypot(np.mean(truth["vx"][late]), np.mean(truth["vy"][late])))


if __name__ == "__main__":
    own_effects.join([f"{__file__}:CABLE"])
    robot = load_robot("fish")
    tied = replace(robot, effects=(FittedEffect("trailing_cable", {"drag": Interval(1.0, 1.0, 1.0)}),))
    free, slow = speed(robot), speed(tied)
    print(f"free {free:.3f} m/s, with the cable {slow:.3f} m/s")
    assert 0.1 < slow < free
