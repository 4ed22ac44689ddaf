"""Each fault of the loopback robot does what it says: to the datagrams on the radio, seen from the host's side."""

import re

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.loopback.faults import FAULTS, RADIO, described, parse
from fishmj.deploy.loopback.network_faults import HELD, RadioChannel

COUNT, PERIOD = 400, 0.02
PACKETS = [bytes([k % 256, k // 256, *range(30)]) for k in range(COUNT)]


def sent(*texts, direction="down", seed=3, delay=0.005, spread=0.0):
    """(number of the packet, s under way, bytes) of what arrives, in order of arrival."""
    radio = RadioChannel(direction, seed, parse(texts), delay, spread)
    found = []
    for k, data in enumerate(PACKETS):
        found += [(arrival.t, k, arrival.data) for arrival in radio.send(k * PERIOD, data)]
    return [(k, t - k * PERIOD, data) for t, k, data in sorted(found)]


def test_without_faults_every_datagram_arrives_once_unchanged_and_in_order():
    found = sent()
    assert [data for _, _, data in found] == PACKETS
    assert {round(late, 6) for _, late, _ in found} == {0.005}


def test_a_quiet_radio_spreads_its_delay_without_a_mean():
    late = np.array([late for _, late, _ in sent(spread=0.0015)])
    assert late.mean() == pytest.approx(0.0055, abs=2e-4)  # whole milliseconds, rounded up
    assert 0.001 < late.std() < 0.002 and late.min() >= 0.001


def test_loss_loses_its_share():
    assert 0.15 < 1 - len(sent("loss=0.2")) / COUNT < 0.25
    assert sent("loss=1") == []


def test_delay_delays_all_and_only_in_its_direction_and_time():
    assert {round(late, 6) for _, late, _ in sent("delay=0.15")} == {0.155}
    assert {round(late, 6) for _, late, _ in sent("delay:up=0.15")} == {0.005}
    assert {round(late, 6) for _, late, _ in sent("delay:up=0.15", direction="up")} == {0.155}
    late = {k: round(late, 6) for k, late, _ in sent("delay=0.15@2-4")}
    assert [k for k, value in late.items() if value == 0.155] == list(range(100, 200))


def test_jitter_is_never_early():
    late = np.array([late for _, late, _ in sent("jitter=0.02")])
    assert late.min() >= 0.005 and 0.015 < late.std() < 0.025


def test_reorder_lets_the_next_ones_overtake():
    found = sent("reorder=0.1")
    order = [k for k, _, _ in found]
    held = [k for k, late, _ in found if late > 0.006]
    assert sorted(order) == list(range(COUNT)) and order != sorted(order)
    assert 0.06 < len(held) / COUNT < 0.14
    assert all(order.index(k) > order.index(k + 1) for k in held if k + 1 < COUNT and k + 1 not in held)


def test_duplicates_are_copies_up_to_30_ms_later():
    found = sent("duplicate=0.1")
    twice = [k for k in range(COUNT) if sum(k == other for other, _, _ in found) == 2]
    assert len(found) == COUNT + len(twice) and 0.06 < len(twice) / COUNT < 0.14
    assert all(data == PACKETS[k] for k, _, data in found)
    assert max(late for _, late, _ in found) <= 0.005 + HELD + 1e-6


def test_corrupt_flips_few_bits_or_cuts():
    found = sent("corrupt=0.3")
    bad = [(k, data) for k, _, data in found if data != PACKETS[k]]
    assert len(found) == COUNT and 0.22 < len(bad) / COUNT < 0.38
    cut = [data for k, data in bad if len(data) < len(PACKETS[k])]
    flipped = [sum((a ^ b).bit_count() for a, b in zip(data, PACKETS[k], strict=True)) for k, data in bad if len(data) == 32]
    assert cut and set(flipped) <= {1, 2, 3, 4} and len(set(flipped)) == 4


def test_a_silent_radio_is_silent_from_t0_to_t1():
    assert {k for k, _, _ in sent("silent_radio@2-4")} == set(range(COUNT)) - set(range(100, 200))


def test_same_seed_same_bytes_and_another_seed_others():
    texts = ("loss=0.1", "jitter=0.02", "reorder=0.1", "duplicate=0.1", "corrupt=0.1")
    assert sent(*texts) == sent(*texts)
    assert sent(*texts) != sent(*texts, seed=4)
    assert sent(*texts) != sent(*texts, direction="up")


def test_one_fault_never_changes_what_another_one_does():
    lost = set(range(COUNT)) - {k for k, _, _ in sent("loss=0.1")}
    assert lost == set(range(COUNT)) - {k for k, _, _ in sent("loss=0.1", "jitter=0.05", "corrupt=0.5")}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("loss=2", "0 to 1"),
        ("loss=nan", "finite"),
        ("loss=much", "finite"),
        ("silent_radio=1", "no value"),
        ("loss@5-3", "T0 < T1"),
        ("loss@-3", "expected NAME"),
        ("brown_out:up@3", "radio"),
        ("loss:sideways", "up or down"),
        ("stuck_servo=1.5", "joint"),
        ("Loss", "expected NAME"),
        ("", "expected NAME"),
        ("loss=0.1@3-4@5", "finite"),
    ],
)
def test_what_is_no_fault_is_refused_with_the_reason(text, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        parse([text])


def test_an_unknown_fault_gets_the_nearest_name():
    with pytest.raises(UnknownName, match="'brown_out'"):
        parse(["brownout"])


def test_every_loopback_fault_is_in_the_help_and_enabled_by_its_name():
    assert [line.split()[0] for line in described()] == list(FAULTS)
    assert [fault.name for fault in parse(FAULTS)] == list(FAULTS)
    assert {name for name, kind in FAULTS.items() if kind.where == RADIO} == {
        "loss", "delay", "jitter", "reorder", "duplicate", "corrupt", "silent_radio",
    }  # fmt: skip
