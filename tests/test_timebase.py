"""The audit of clocks finds what was planted: lags, drifts, lost and repeated rows, counted stamps."""

import json
import math

import numpy as np
import pytest
from scipy import signal

from fishmj import log
from fishmj.base.errors import LogError
from fishmj.log import timebase
from fishmj.log.timebase import lag_between


def stamps(rng, rate, seconds, jitter=0.3):
    """Irregular stamps: steps with `jitter` of their mean as standard deviation."""
    step = np.clip(rng.normal(1, jitter, int(seconds * rate)), 0.2, None) / rate
    return np.cumsum(step)


def planted(lag, seed=0, seconds=24.0, drift=0.0, noise=0.002, shape="chirp"):
    """Commands and joints that follow them `lag` s later, each on its own irregular stamps. Synthetic."""
    rng = np.random.default_rng(seed)
    phase = {"chirp": lambda t: 2 * math.pi * (0.5 * t + 0.03 * t**2), "beat": lambda t: 2 * math.pi * t}[shape]

    def motion(t):
        return np.stack([0.4 * np.sin(phase(t) - k) for k in range(3)], axis=1)

    tc, tj = stamps(rng, 50, seconds), stamps(rng, 45, seconds)
    joints = motion(tj - lag - drift * tj) + rng.normal(0, noise, (len(tj), 3))
    tables = {"cmd": {"t": tc, **log.numbered("c#", motion(tc))}, "joint": {"t": tj, **log.numbered("j#", joints)}}
    return log.Trial({"origin": "synthetic"}, tables, name="planted")


@pytest.mark.parametrize("lag", [0.007, 0.023])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("shape", ["chirp", "beat"])
def test_a_planted_lag_is_recovered_within_2_ms_on_irregular_stamps(lag, seed, shape):
    found = timebase.audit(planted(lag, seed, shape=shape)).lags[0]
    assert abs(found.lag - lag) < 0.002 and found.low <= found.lag <= found.high and found.high - found.low < 0.002
    assert (found.earlier, found.later) == ("cmd", "joint") and found.found and not found.ambiguous


def test_most_intervals_hold_the_planted_lag_under_heavy_noise():
    runs = [timebase.audit(planted(0.023, seed, noise=0.05)).lags[0] for seed in range(20)]
    inside = sum(run.low - 1e-4 <= 0.023 <= run.high + 1e-4 for run in runs)
    assert inside >= 15  # nominal 90 %: fewer than 15 of 20 would come up one time in 400
    assert max(abs(run.lag - 0.023) for run in runs) < 0.004


def test_a_negative_lag_says_that_the_stamps_lie():
    assert timebase.audit(planted(-0.010)).lags[0].lag == pytest.approx(-0.010, abs=0.002)


def test_clocks_that_run_apart_are_found_as_drift():
    audit = timebase.audit(planted(0.02, drift=1e-3))
    assert audit.lags[0].drift == pytest.approx(1e-3, rel=0.1) and any("different rates" in f for f in audit.findings)
    assert not any("different rates" in f for f in timebase.audit(planted(0.02)).findings)


def servo_of(shape, ppm=0.0, offset=0.0, seconds=60.0):
    """Commands and the joints of a servo (first order, 60 ms) that follow them; the joints' clock is off. Synthetic."""
    rng = np.random.default_rng(3)
    fine = np.arange(-1, seconds + 5, 0.002)
    if shape == "steps":
        target = rng.uniform(-0.5, 0.5, (int(seconds) + 10, 3))[(fine + 1).astype(int)]
    else:
        phase = 2 * math.pi * {"chirp": 0.3 * fine + 0.85 / seconds * fine**2, "sine": fine}[shape]
        target = 0.4 * np.sin(phase[:, None] - np.arange(3))
    joint = signal.lfilter([1 - math.exp(-0.002 / 0.06)], [1, -math.exp(-0.002 / 0.06)], target, axis=0)
    tc, tj = (t[t < seconds] for t in (stamps(rng, 50, seconds, 0.1), stamps(rng, 48, seconds, 0.1)))
    seen = np.stack([np.interp(tj - 0.03, fine, joint[:, k]) for k in range(3)], axis=1) + rng.normal(0, 0.003, (len(tj), 3))
    tables = {"cmd": {"t": tc, **log.numbered("c#", target[np.searchsorted(fine, tc)])}}
    tables["joint"] = {"t": tj * (1 + 1e-6 * ppm) + offset, **log.numbered("j#", seen)}
    return log.Trial({"origin": "synthetic"}, tables, name=shape)


@pytest.mark.parametrize("shape", ["chirp", "steps", "sine"])
def test_a_servo_on_one_clock_shows_no_drift(shape):
    assert not any("different rates" in f for f in timebase.audit(servo_of(shape)).findings)


@pytest.mark.parametrize("shape", ["steps", "sine"])
def test_a_drift_of_200_ppm_behind_a_servo_is_found(shape):
    audit = timebase.audit(servo_of(shape, ppm=200))
    assert any("different rates" in f for f in audit.findings) and audit.lags[0].drift == pytest.approx(2e-4, rel=0.5)


def test_a_drift_of_200_ppm_of_a_pure_delay_is_found_in_a_chirp():
    audit = timebase.audit(planted(0.02, drift=2e-4, seconds=60.0))
    assert any("different rates" in f for f in audit.findings) and audit.lags[0].drift == pytest.approx(2e-4, rel=0.1)


@pytest.mark.parametrize("offset", [1.73, -1.73, 3600.0])
@pytest.mark.parametrize("shape", ["chirp", "steps"])
def test_a_constant_offset_of_a_clock_is_reported_with_the_map_key(shape, offset):
    found = timebase.offsets(servo_of(shape, offset=offset, seconds=20.0))
    assert len(found) == 1 and "[tables.joint] offset = " in found[0]
    assert "remove the true delay" in found[0] and "state it as command_latency of the description" in found[0]
    assert float(found[0].split("offset = ")[1].split(",")[0]) == pytest.approx(-offset - 0.09, abs=0.05)
    assert found[0] in timebase.audit(servo_of(shape, offset=offset, seconds=20.0)).findings


@pytest.mark.parametrize("shape", ["chirp", "steps", "sine"])
def test_no_offset_is_claimed_on_one_clock_or_on_a_steady_beat(shape):
    assert not timebase.offsets(servo_of(shape, seconds=20.0))
    assert not timebase.offsets(servo_of("sine", offset=1.73, seconds=20.0))


def test_an_offset_of_the_camera_is_told_from_the_recoil_of_the_head():
    trial = servo_of("chirp", seconds=20.0)
    t = np.arange(0.5, 19, 1 / 60)
    recoil = -0.1 * np.interp(t - 0.045, trial.tables["joint"]["t"], trial.tables["joint"]["j1"])
    trial.tables["pose"] = {"t": t + 1.73, "x": 0.1 * t, "y": 0 * t, "yaw": recoil}
    found = timebase.offsets(trial)
    assert len(found) == 1 and "[tables.pose] offset = -1.7" in found[0] and "state it as camera_latency" in found[0]


def test_a_joint_that_moves_before_its_command_has_another_clock():
    findings = timebase.audit(planted(-0.19, shape="beat")).findings
    assert any(f.startswith("joint moves 1") and "ms before cmd" in f and "servo's true delay" in f for f in findings)


def test_a_lag_is_not_claimed_between_channels_that_have_nothing_in_common():
    trial = planted(0.02)
    rng = np.random.default_rng(1)
    trial.tables["joint"] |= {c: np.cumsum(rng.normal(0, 0.01, len(v))) for c, v in trial.tables["joint"].items() if c != "t"}
    lag = timebase.audit(trial).lags[0]
    assert not lag.found and "not told" in lag.text()


def test_a_steady_beat_of_either_sign_fits_half_a_beat_earlier_too():
    """A heading that swings against the tail: 250 ms late with one sign is 250 ms early with the other."""
    t = np.arange(0, 20, 0.02)
    cmd, yaw = np.sin(2 * np.pi * t)[:, None], -0.1 * np.cos(2 * np.pi * t)[:, None]
    found = lag_between(("cmd", t, cmd), ("pose", t, yaw), either_sign=True)
    assert abs(found.lag) == pytest.approx(0.25, abs=0.01) and found.ambiguous and "steady beat" in found.text()
    assert not lag_between(("cmd", t, cmd), ("pose", t + 0.1, cmd), either_sign=False).ambiguous


def test_a_fast_beat_makes_the_lag_ambiguous_and_says_so():
    t = np.arange(0, 20, 0.01)
    wave = np.sin(2 * math.pi * 5 * t)[:, None]
    assert lag_between(("a", t, wave), ("b", t, np.roll(wave, 3, axis=0))).ambiguous


def test_the_yaw_that_recoils_against_the_joints_gives_the_camera_lag():
    lag = next(lag for lag in recoiling(lambda t: 0.045).lags if lag.later == "pose")
    assert lag.lag == pytest.approx(0.045, abs=0.003) and lag.correlation < -0.9


def recoiling(late):
    """A trial whose heading recoils against the first joint, `late(t)` s behind it."""
    trial = planted(0.02)
    t = np.arange(0.5, 23, 1 / 60)
    recoil = -0.1 * np.interp(t - late(t), trial.tables["joint"]["t"], trial.tables["joint"]["j1"])
    trial.tables["pose"] = {"t": t, "x": 0.1 * t, "y": 0 * t, "yaw": recoil}
    return timebase.audit(trial)


def test_a_heading_ahead_of_its_joint_has_another_clock():
    assert any("pose moves" in text and "before joint" in text for text in recoiling(lambda t: -0.15).findings)
    assert not any("pose moves" in text for text in recoiling(lambda t: 0.045).findings)


def test_a_lag_that_changes_as_the_fish_gathers_way_is_no_drift():
    lags = [recoiling(late) for late in (lambda t: 0.04 + 0.03 * np.exp(-t / 4), lambda t: 0.04 + 5e-3 * t)]
    assert [any("pose drifts" in text for text in audit.findings) for audit in lags] == [False, True]


def test_lost_and_repeated_rows_are_counted_from_numbers_or_from_steps():
    t = np.arange(0, 10, 0.02)
    seq = np.arange(len(t), dtype=float)
    keep = np.ones(len(t), bool)
    keep[[50, 51, 200]] = False
    table = {"t": t[keep], "c1": np.sin(t[keep]), "seq": seq[keep]}
    assert timebase.clock_of("cmd", table).dropped == 3
    del table["seq"]
    assert timebase.clock_of("cmd", table).dropped == 3
    twice = np.sort(np.concatenate([t, t[[30, 60]] + 0.001]))
    values = np.sin(np.floor(twice / 0.02 + 1e-6))
    assert timebase.clock_of("cmd", {"t": twice, "c1": values}).duplicated == 2
    unset = {"t": np.arange(5) * 0.02, "c1": np.arange(5.0), "seq": np.full(5, -1.0)}  # a driver that does not count
    assert timebase.clock_of("cmd", unset).duplicated == timebase.clock_of("cmd", unset).dropped == 0


def test_a_bus_that_changes_its_rate_loses_nothing():
    t = np.concatenate([np.arange(0, 3, 0.0035), np.arange(3, 6, 0.0053)])
    assert timebase.clock_of("joint", {"t": t, "j1": np.sin(t)}).dropped == 0


def test_audit_tells_frame_counters_from_clocks_and_finds_a_stretched_one():
    frames = np.arange(250) / 30
    steps = np.cumsum(0.078 + 0.006 * np.random.default_rng(0).normal(size=254))
    pose = {"t": frames, "x": 0.1 * frames, "y": 0 * frames, "yaw": 0.1 * np.sin(frames)}
    gait = {"t": steps, "amplitude": np.full(254, 0.2), "bias": np.zeros(254)}
    audit = timebase.audit(log.Trial({}, {"pose": pose, "gait": gait}, name="tail"))
    assert any(f.startswith("pose: stamps are perfectly even: counted at 30 Hz") for f in audit.findings)
    assert any("one of the clocks may run 2.3" in f for f in audit.findings)
    json.dumps(audit.as_dict())
    assert "254 rows" in audit.text()


def test_too_short_a_stretch_is_a_finding_and_not_a_number():
    audit = timebase.audit(planted(0.02, seconds=2.0))
    assert not audit.lags and any("at least 3.2 s are needed" in f for f in audit.findings)
    with pytest.raises(LogError, match="never moves"):
        t = np.arange(0, 20, 0.02)
        lag_between(("a", t, np.zeros((len(t), 1))), ("b", t, np.sin(t)[:, None]))


def test_radio_delay_is_told_from_both_stamps_of_a_command():
    trial = planted(0.02)
    trial.tables["cmd"]["t_rx"] = trial.tables["cmd"]["t"] + 0.012
    assert any("received 12.0 ms after sending" in f for f in timebase.audit(trial).findings)
