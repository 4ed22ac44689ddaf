"""What docs/simulate/water.md says of the prior water is what the code gives: figures, coefficients, lagged added mass."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fishmj import mjcf
from fishmj.water import planar_water
from fishmj.water.dynamics import planar_chain, strip_forces

ROOT = Path(__file__).parent.parent
MANUAL = (ROOT / "docs" / "simulate" / "water.md").read_text(encoding="utf-8")
ROBOT = mjcf.load_robot("fish")
CHAIN, FISH = planar_chain.chain_of(ROBOT), planar_chain.nominal(ROBOT)
STILL = [(0.0, 0.0)] * CHAIN.n


@pytest.mark.slow
def test_the_example_prints_the_figures_of_the_manual(tmp_path):
    """Every line of `examples/gait_map.py` stands in the page, and its picture is drawn."""
    picture = tmp_path / "map.png"
    surroundings = {**os.environ, "MPLBACKEND": "agg", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(ROOT / "examples" / "gait_map.py"), str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, env=surroundings, check=False)
    assert done.returncode == 0, done.stderr
    missing = [line for line in done.stdout.splitlines() if line not in MANUAL]
    assert not missing and picture.stat().st_size > 10_000


def test_the_manual_states_every_coefficient_with_its_value():
    stated = dict(re.findall(r"^\| `(\w+)` \| ([^|]+?) \|", MANUAL, re.MULTILINE))
    unset = strip_forces.Coefficients._field_defaults | strip_forces.SHAPE
    water = unset | {key: value for key, value in ROBOT.water.items() if key != "model"}
    assert stated.keys() == water.keys()
    for key, text in stated.items():
        assert [float(n) for n in re.findall(r"\d+\.?\d*", text)] == np.atleast_1d(water[key]).tolist(), key


def lagged(dt, share=1.0):
    """Physics steps until the straight fish, told to bend by 17 deg, exceeds 100 rad/s with -M_a a of the step before.

    share: under-relaxation of the lagged acceleration, 1 is none. Returns None where 500 steps pass.
    """
    ch, q, v, late = CHAIN._replace(dt=dt), np.zeros(6), np.zeros(6), np.zeros(6)
    joints = np.arange(3, 6)
    for n in range(500):
        k = planar_chain.kinematics(np, ch, q, v, STILL)
        drive = planar_chain.servo_drive(np, ch, FISH, q, v, [0.3] * 3)
        water = planar_chain.water_forces(np, ch, FISH, k, q[2], (0.0, 0.0), 0.5)
        both = zip(water, planar_chain.bias_forces(ch, FISH, k, water=False), strict=True)
        force = np.array(planar_chain.generalised(np, ch, q[2], planar_chain.gather(ch, k, [np.add(*pair) for pair in both])))
        force[joints] += drive - np.array(FISH.kb) * v[joints]
        own, added = (
            planar_water.world_matrix(ch, q[2], planar_chain.mass_matrix(ch, FISH, k, rigid=r, water=not r))
            for r in (True, False)
        )
        own[joints, joints] += dt * np.array(FISH.kb)
        late = (1 - share) * late + share * np.linalg.solve(own, force - added @ late)
        v = v + dt * late
        q = q + dt * v
        if np.abs(v).max() > 100:
            return n + 1
    return None


@pytest.mark.parametrize("dt", [4e-3, 1e-3, 1e-4])
def test_lagged_added_mass_diverges_at_any_step(dt):
    """A fixed-point iteration whose factor is the ratio of the masses, up to 22: no step is small enough."""
    assert lagged(dt) <= 5


def test_under_relaxation_only_helps_below_the_stability_bound():
    """alpha < 2 / (1 + 22) = 0.087 holds the iteration, and then filters the added mass."""
    assert lagged(1e-4, share=0.2) is not None and lagged(1e-4, share=0.05) is None


def test_added_mass_is_twenty_times_the_fishs_own_in_some_direction():
    rng, largest = np.random.default_rng(0), []
    for _ in range(300):
        k = planar_chain.kinematics(np, CHAIN, [0.0, 0.0, 0.0, *rng.uniform(-1.05, 1.05, 3)], [0.0] * 6, STILL)
        own, added = (
            planar_water.world_matrix(CHAIN, 0.0, planar_chain.mass_matrix(CHAIN, FISH, k, rigid=r, water=not r))
            for r in (True, False)
        )
        largest.append(np.linalg.eigvals(np.linalg.solve(own, added)).real.max())
    assert 18 < min(largest) and max(largest) < 22.1
