"""The library of experiments: bounded, at rest first, as long as it says, found by name."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.log import excitation
from fishmj.log.excitation import LEAD, PERIOD, Excitation

RESTING = round(LEAD / PERIOD)
WANTED = """sine square impulse chirp gait gait_mirrored steps staircase slow_triangle burst_and_coast turn_left turn_right
drift_east drift_north drift_west drift_south spin out_and_back hold_angles station_left station_right ramps""".split()


@pytest.mark.parametrize("name", excitation.names())
def test_every_experiment_is_sound(name):
    run = excitation.get(name)
    assert run.id == name and run.about and len(run.t) == len(run.commands)
    assert run.seconds == pytest.approx(run.t[-1] + PERIOD) and 3.0 < run.seconds < 20.0
    assert np.max(np.abs(run.commands)) <= np.pi / 3 + 1e-12
    assert np.all(run.commands[:RESTING] == run.commands[0])
    assert all(abs(c) < 1.8 for c in run.start[:2])  # inside the tank


def test_what_identification_needs_is_there():
    assert set(WANTED) <= set(excitation.names()) and set(excitation.DESIGNED) <= set(excitation.names())
    assert len(set(excitation.DESIGNED)) == 12
    assert set(excitation.CASUAL) | set(excitation.DRY) <= set(excitation.names())


def test_a_drift_runs_at_four_headings():
    headings = [excitation.get(f"drift_{side}").start[2] for side in ("east", "north", "west", "south")]
    assert headings == pytest.approx([0.0, np.pi / 2, np.pi, -np.pi / 2])


def test_a_gait_beats_as_ordered():
    wave = excitation.gait(1.0, 0.5, np.pi / 3, 0.1, seconds=6.0)[RESTING + 100 :]
    assert wave.max(0) == pytest.approx(0.6, abs=2e-3) and wave.min(0) == pytest.approx(-0.4, abs=2e-3)
    assert wave[50:] == pytest.approx(wave[:-50], abs=1e-9)  # a period is a second
    late = round(1 / 6 / PERIOD)
    assert wave[late:, 1] == pytest.approx(wave[:-late, 0], abs=0.03)  # a lag of 60 deg is a sixth of a beat, to a sample


def test_mirrored_gait_mirrors_the_commands_of_the_gait():
    assert np.array_equal(excitation.get("gait_mirrored").commands, -excitation.get("gait").commands)


def test_a_chirp_sweeps_a_decade():
    wave = excitation.get("chirp").commands[RESTING:, 0]
    crossings = np.flatnonzero(np.diff(np.sign(wave)) > 0) * PERIOD
    beats = 1 / np.diff(crossings)
    assert beats[0] < 0.35 and beats[-1] > 2.5 and np.all(np.diff(beats) > -0.2)


def test_random_ramps_repeat_by_seed():
    one, again, other = (excitation.random_ramps(s) for s in (1, 1, 2))
    assert np.array_equal(one, again) and not np.array_equal(one, other)
    assert np.max(np.abs(np.diff(one, axis=0))) < 1.6 / 0.2 * PERIOD + 1e-9  # never a jump


def test_wrong_names_and_shapes_are_refused():
    with pytest.raises(UnknownName, match="Did you mean 'chirp'"):
        excitation.get("chrip")
    with pytest.raises(ConfigError, match="must be"):
        Excitation(id="x", commands=np.zeros(5), about="")
    with pytest.raises(ConfigError, match="degrees"):
        Excitation(id="x", commands=np.full((5, 3), 30.0), about="")
