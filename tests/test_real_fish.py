"""The slip ratio by a real fish: four of its swims set it, the others have no part in it."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, LogError
from studies.grid_studies import real_fish
from studies.grid_studies.real_fish import fit_slip, speed_of, swims

SLIPS = (0.95, 0.97, 0.98, 0.99, 1.0)


def planted(s: float, error=lambda beat: 1.0):
    """Swims of a fish whose speeds are those of a solver at slip ratio s, and that solver's."""
    law = lambda beat, slip: 0.1 * beat * np.exp(20 * (slip - 1.0))
    real = [swim._replace(speed=law(swim.beat, s) * error(swim.beat)) for swim in swims()]
    return real, {(swim.beat, slip): law(swim.beat, slip) for swim in real for slip in SLIPS}


def test_eight_swims_were_filmed_and_every_second_one_is_kept_aside():
    real = swims()
    assert len(real) == 8 and [swim.sets for swim in real] == [True, False] * 4
    assert [swim.speed for swim in real] == sorted(swim.speed for swim in real)
    assert real[-2].gait.amplitude == pytest.approx(np.radians([24.2, 24.8])) and real[-2].gait.frequency == 1.5


def test_a_planted_slip_ratio_is_found():
    real, swum = planted(0.983)
    fit = fit_slip(real, swum)
    assert fit.slip == pytest.approx(0.983, abs=2e-4) and fit.high - fit.low < 1e-3
    assert fit.misfit < 0.01 and fit.judged < 0.01
    assert fit.speeds[1.5] == pytest.approx(real[-2].speed, rel=0.01)


def test_swims_that_are_kept_aside_only_judge():
    aside = {swim.beat for swim in swims() if not swim.sets}
    real, swum = planted(0.983, lambda beat: 2.0 if beat in aside else 1.0)
    fit = fit_slip(real, swum)
    assert fit.slip == pytest.approx(0.983, abs=2e-4) and fit.judged == pytest.approx(np.log(2), abs=0.01)


def test_the_range_is_what_leaving_one_swim_out_does():
    real, swum = planted(0.98, lambda beat: 1.3 if beat == 0.38 else 1.0)
    fit = fit_slip(real, swum)
    assert fit.low == pytest.approx(0.98, abs=3e-4) and 0.98 + 2e-3 < fit.slip < fit.high


def test_two_ratios_are_too_few():
    real, swum = planted(0.98)
    with pytest.raises(LogError, match="three or more"):
        fit_slip(real, {key: u for key, u in swum.items() if key[1] < 0.98})


def test_speed_is_that_of_the_last_two_beats():
    class Swum:
        robot = type("R", (), {"timing": type("T", (), {"bus_dt": 0.02})})
        first = np.zeros(5)
        rows = [(0, 0, 0, np.array([min(0.1 * t, 0.1 * 2 + 0.3 * (t - 2)) if t > 2 else 0.1 * t, 0.0])) for t in
                0.02 * np.arange(1, 201)]  # fmt: skip

    speed, gain = speed_of(Swum(), 1.0)
    assert speed == pytest.approx(0.1) and gain == pytest.approx(0.0)
    Swum.rows = [(0, 0, 0, np.array([0.1 * min(t, 2) + 0.3 * max(t - 2, 0), 0.0])) for t in 0.02 * np.arange(1, 201)]
    speed, gain = speed_of(Swum(), 1.0)
    assert speed == pytest.approx(0.3) and gain == pytest.approx(1.0)


def test_beats_that_leave_nothing_to_compare_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="expected more than 4"):
        real_fish.main(["--domain", "laptop", "--beats", "4", "--out", str(tmp_path / "a")])
