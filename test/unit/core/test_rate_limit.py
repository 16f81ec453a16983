"""Limits on how often: exact at their borders, of each sender its own, and never more senders than are kept."""

from __future__ import annotations

from construction_twin.core.rate_limit import MOST_SENDERS, Pace, RollingWindow, SenderLimits, TokenBucket
from construction_twin.core.units import NANOSECONDS


def test_an_allowance_is_used_up_and_grows_again():
    bucket = TokenBucket(rate=2, burst=4)
    assert [bucket.take(0) for _ in range(5)] == [True] * 4 + [False]
    assert bucket.take(NANOSECONDS // 2)
    assert not bucket.take(NANOSECONDS // 2)
    # it never holds more than the burst, and a clock that goes back gives nothing
    assert not bucket.take(1000 * NANOSECONDS, 4.5)
    assert not bucket.take(0, 4.5)


def test_a_bucket_of_bytes_is_exact_at_its_border_whatever_the_clock_shows():
    bucket, now = TokenBucket(rate=65536, burst=262_144), 987_654_321_987_654_321
    assert all(bucket.take(now, 1024) for _ in range(256)) and not bucket.take(now, 1)
    assert bucket.take(now + NANOSECONDS, 65536) and not bucket.take(now + NANOSECONDS, 1)


def test_of_many_names_only_some_may_and_none_is_kept():
    senders = SenderLimits(Pace(1, 1e-7))
    assert [senders.take(f"name-{k}", 0) for k in range(1000)].count(True) == MOST_SENDERS == 64
    assert senders.wait("ada", 25) == 75 and senders.take("ada", 100)


def test_a_sender_waits_between_two_motions_and_others_do_not():
    senders = SenderLimits(Pace(1))
    second = NANOSECONDS
    assert senders.wait("a", 10 * second) == 0
    assert senders.take("a", 10 * second)
    assert senders.wait("a", 10 * second + second // 4) == 3 * second // 4
    assert senders.wait("b", 10 * second + second // 4) == 0
    assert senders.wait("a", 11 * second) == 0


def test_no_account_gets_more_than_its_rate_in_any_second_and_none_takes_anothers():
    rate = SenderLimits(Pace(15))
    hasty = [now for now in range(0, 300) if rate.take("hasty", now * NANOSECONDS // 100)]
    assert len(hasty) == 45
    for begin in range(200):
        assert sum(begin <= now < begin + 100 for now in hasty) <= 15
    assert rate.take("other", 3 * NANOSECONDS)
    steady = SenderLimits(Pace(15))
    assert all(steady.take("steady", round(number * NANOSECONDS / 14.9)) for number in range(100))


def test_a_full_window_tells_when_its_oldest_leaves_it():
    window = RollingWindow(2)
    assert window.take(0) and window.take(NANOSECONDS // 2) and not window.take(NANOSECONDS - 1)
    assert window.wait(NANOSECONDS - 1) == 1 and window.rest(NANOSECONDS) == NANOSECONDS // 2
    assert window.take(NANOSECONDS)
