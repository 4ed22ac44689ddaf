"""The gate takes each new datagram once, and a sender that began anew."""

from hypothesis import given
from hypothesis import strategies as st

from fishmj.deploy.protocols.sequence import SequenceGate, newer

PERIOD = 0.02  # s


def sent(count: int, start: int = 0, since: float = 0.0) -> list[tuple[int, float]]:
    """Numbers and times of a sender."""
    return [((start + k) % 2**32, since + k * PERIOD) for k in range(count)]


@given(st.integers(0, 2**32 - 1), st.integers(1, 2**31 - 1))
def test_newer_is_a_direction_on_the_circle(seq, ahead):
    later = (seq + ahead) % 2**32
    assert newer(later, seq) and not newer(seq, later) and not newer(seq, seq)


@given(st.integers(0, 2**32 - 1))
def test_all_in_order_are_taken_across_the_wrap(start):
    gate = SequenceGate()
    assert all(gate.accept(*packet) for packet in sent(40, start))
    assert (gate.taken, gate.missing, gate.restarts) == (40, 0, 0)


@given(st.lists(st.integers(0, 30), min_size=1, max_size=60), st.sampled_from([0, 2**32 - 10]))
def test_what_is_taken_always_rises(order, start):
    """Whatever is lost, repeated or reordered, as long as nothing is `patience` datagrams in a row late."""
    packets, gate, newest = sent(31, start), SequenceGate(patience=100), -1
    for number in order:
        taken = gate.accept(*packets[number])
        assert taken == (number > newest)
        newest = max(newest, number)
    assert gate.taken + gate.duplicates + gate.older == len(order) and gate.restarts == 0


def test_gaps_are_counted():
    gate = SequenceGate()
    packets = sent(10)
    assert [gate.accept(*packets[k]) for k in (0, 1, 4, 4, 3, 5)] == [True, True, True, False, False, True]
    assert (gate.taken, gate.missing, gate.duplicates, gate.older) == (4, 2, 1, 1)


def test_a_robot_that_restarted_after_a_minute_is_taken_at_once():
    gate = SequenceGate()
    assert all(gate.accept(*packet) for packet in sent(3_000))
    assert all(gate.accept(*packet) for packet in sent(50)) and gate.restarts == 1


def test_a_robot_that_restarted_after_a_second_is_taken_after_ten_packets():
    gate = SequenceGate()
    assert all(gate.accept(*packet) for packet in sent(50))
    assert [gate.accept(*packet) for packet in sent(50)].index(True) == 9
    assert gate.restarts == 1 and gate.older == 9


def test_a_host_program_that_restarted_on_a_running_clock_is_taken_at_once():
    gate = SequenceGate()
    assert all(gate.accept(*packet) for packet in sent(50))
    assert gate.accept(0, 50 * PERIOD + 0.5) and gate.restarts == 1


def test_a_late_datagram_of_the_former_life_does_not_bring_it_back():
    gate = SequenceGate()
    former = sent(3_000)
    assert all(gate.accept(*packet) for packet in former)
    assert all(gate.accept(*packet) for packet in sent(20))  # restarted
    assert gate.accept(*former[-1])  # newer by number and time: it looks like a gap, and no number can tell
    assert [gate.accept(*packet) for packet in sent(40)[20:]].index(True) == 0  # and the robot is heard again at once


def test_the_same_late_datagrams_over_and_over_are_no_restart():
    gate = SequenceGate()
    packets = sent(100)
    assert all(gate.accept(*packet) for packet in packets)
    assert not any(gate.accept(*packets[k]) for _ in range(30) for k in (50, 51, 52))
    assert gate.restarts == 0


def test_what_is_forgotten_is_new_again():
    gate = SequenceGate()
    assert gate.accept(5, 1.0) and not gate.accept(5, 1.0)
    gate.forget()
    assert gate.accept(5, 1.0)
