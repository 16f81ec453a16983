"""Limits on how often: exact at their borders, of each sender its own, and never more senders than are kept."""

from __future__ import annotations

from construction_twin.core.rate_limit import MOST_SENDERS, Pace, SenderLimits
from construction_twin.core.units import NANOSECONDS


def test_of_many_names_only_some_may_and_none_is_kept():
    senders = SenderLimits(Pace(1, 1e-7))
    assert [senders.admit(f"name-{k}", 0) for k in range(1000)].count(True) == MOST_SENDERS == 64
    assert senders.waiting_time("ada", 25) == 75 and senders.admit("ada", 100)


def test_a_sender_waits_between_two_motions_and_others_do_not():
    senders = SenderLimits(Pace(1))
    second = NANOSECONDS
    assert senders.waiting_time("a", 10 * second) == 0
    assert senders.admit("a", 10 * second)
    assert senders.waiting_time("a", 10 * second + second // 4) == 3 * second // 4
    assert senders.waiting_time("b", 10 * second + second // 4) == 0
    assert senders.waiting_time("a", 11 * second) == 0


def test_no_account_gets_more_than_its_rate_in_any_second_and_none_takes_anothers():
    rate = SenderLimits(Pace(15))
    hasty = [now for now in range(0, 300) if rate.admit("hasty", now * NANOSECONDS // 100)]
    assert len(hasty) == 45
    for begin in range(200):
        assert sum(begin <= now < begin + 100 for now in hasty) <= 15
    assert rate.admit("other", 3 * NANOSECONDS)
    steady = SenderLimits(Pace(15))
    assert all(steady.admit("steady", round(number * NANOSECONDS / 14.9)) for number in range(100))
