"""The bus ticks: a grid that does not drift, late ticks counted and never caught up in a burst."""

import os

import numpy as np
import pytest

from fishmj.deploy.loop.clock import HEARING, PRIORITY, SEEING, first_in_line
from fishmj.deploy.loop.ticker import Ticker
from tests.deploying import FakeClock


def beats(overslept, n):
    clock = FakeClock()
    clock.overslept.extend(overslept)
    ticker = Ticker(clock, 0.02)
    return ticker, [ticker.wait() for _ in range(n)]


def test_ticks_in_time_lie_on_the_grid():
    ticker, ticks = beats([], 100)
    assert [tick.slot for tick in ticks] == list(range(100))
    assert np.allclose([tick.began for tick in ticks], 100 + 0.02 * np.arange(100))
    assert (ticker.count, ticker.late, ticker.dropped) == (100, 0, 0)


def test_small_lateness_is_told_and_does_not_move_the_grid():
    ticker, ticks = beats([0.001, 0.003, 0.0, 0.005], 6)
    assert ticks[-1].began == pytest.approx(100.1)
    assert ticker.late == 2 and ticker.dropped == 0
    assert ticker.worst == pytest.approx(0.005)


@pytest.mark.parametrize("stall", [0.021, 0.031, 0.05, 0.0999, 1.0])
def test_a_stall_drops_grid_points_and_makes_no_burst(stall):
    ticker, ticks = beats([0.0, 0.0, stall], 12)
    began = np.array([tick.began for tick in ticks])
    assert np.diff(began).min() >= 0.01 - 1e-9
    assert np.diff([tick.slot for tick in ticks]).min() >= 1
    assert ticker.dropped == ticks[-1].slot + 1 - len(ticks)
    assert abs(ticker.dropped - stall / 0.02) <= 1
    assert ticker.late == 1
    assert np.allclose((began[4:] - 100) / 0.02, np.round((began[4:] - 100) / 0.02))


def test_no_dropped_point_goes_unreported():
    stalls = list(np.random.default_rng(0).exponential(0.01, 300))
    ticker, ticks = beats(stalls, 300)
    assert sum(tick.dropped for tick in ticks) == ticker.dropped == ticks[-1].slot + 1 - len(ticks) > 10
    assert np.diff([tick.began for tick in ticks]).min() >= 0.01 - 1e-9


def test_the_histogram_gives_the_percentiles_of_lateness():
    late = np.random.default_rng(1).uniform(0, 0.008, 2000)
    ticker, _ = beats(late, 2000)
    for share in (0.5, 0.99):
        assert ticker.lateness(share) == pytest.approx(np.quantile(late, share), abs=1e-4)
    told = ticker.figures()
    assert told["ticks"] == 2000 and told["worst_ms"] == pytest.approx(1e3 * late.max(), abs=1e-3)
    assert told["late"] == np.sum(late > 2e-3)


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="no such priorities on this system")
def test_control_loop_gets_real_time_priority_and_restores_it_afterwards():
    before = os.sched_getscheduler(0)
    with first_in_line() as first:
        now = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        assert now == (os.SCHED_FIFO if first else before)
    assert os.sched_getscheduler(0) == before


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="no such priorities on this system")
def test_the_loop_goes_before_who_hears_and_who_sees(monkeypatch):
    asked = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, policy, param: asked.append(param.sched_priority))
    for priority in (PRIORITY, HEARING, SEEING):
        with first_in_line(priority) as first:
            assert first
    assert asked[::2] == sorted(set(asked[::2]), reverse=True) and asked[1::2] == [0, 0, 0]


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="no such priorities on this system")
def test_a_system_that_does_not_let_it_goes_on_as_before(monkeypatch):
    def refused(*_):
        raise PermissionError("not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    with first_in_line() as first:
        assert first is False
