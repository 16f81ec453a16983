"""Forwarding a speed limit: changes at once, repeats rarely, silence as silence, and to a new session what still holds."""

from __future__ import annotations

from construction_twin.core.units import NANOSECONDS
from construction_twin.link.speed_limits import PERIOD, SpeedForwarder

MS = 1_000_000


def sent(
    forwarder: SpeedForwarder, until: int, session: str = "s1", source_period: int | None = None, limit: float = 0.5
) -> list:
    """Poll every 20 ms up to `until` [ns]; the source speaks every `source_period` [ns]."""
    found = []
    for now in range(0, until, 20 * MS):
        if source_period and now % source_period == 0:
            forwarder.accept(limit, "/source", now)
        value = forwarder.poll(session, now)
        if value is not None:
            found.append((now, value))
    return found


def test_nothing_is_sent_before_a_source_spoke_or_without_a_session():
    assert sent(SpeedForwarder(0.5), NANOSECONDS) == []
    assert sent(SpeedForwarder(0.5), NANOSECONDS, "", 100 * MS) == []


def test_repeats_are_sent_five_times_a_second_however_fast_they_come():
    times = [now for now, _ in sent(SpeedForwarder(0.5), NANOSECONDS, "s1", 20 * MS)]
    assert times == list(range(0, NANOSECONDS, PERIOD))


def test_a_source_that_falls_silent_is_not_repeated():
    forwarder = SpeedForwarder(0.5)
    forwarder.accept(0.5, "/source", 0)
    assert sent(forwarder, 5 * NANOSECONDS) == [(0, 0.5)]


def test_what_is_sent_is_numbered_upwards_in_every_session():
    forwarder, numbers = SpeedForwarder(0.5), []
    for k in range(40):
        now = k * 100 * MS
        forwarder.accept((0.5, 0.2)[k % 2], "/source", now)
        if forwarder.poll("s1" if k < 20 else "s2", now) is not None:
            numbers.append(forwarder.number)
    assert numbers == list(range(1, 41))


def test_a_change_is_sent_at_once():
    forwarder = SpeedForwarder(0.5)
    forwarder.accept(0.5, "/source", 0)
    assert forwarder.poll("s1", 0) == 0.5
    forwarder.accept(0.2, "/source", 20 * MS)
    assert forwarder.poll("s1", 20 * MS) == 0.2


def test_a_new_session_is_told_what_still_holds_and_nothing_old():
    forwarder = SpeedForwarder(0.5)
    forwarder.accept(0.5, "/source", 0)
    assert forwarder.poll("s1", 0) == 0.5
    assert forwarder.poll("s2", 400 * MS) == 0.5 and forwarder.poll("s2", 420 * MS) is None
    assert forwarder.poll("s3", 600 * MS) is None


def test_a_limit_that_nobody_was_armed_for_is_forgotten_with_its_source():
    forwarder = SpeedForwarder(0.5)
    forwarder.accept(0.5, "/source", 0)
    assert forwarder.poll("", 100 * MS) is None
    assert forwarder.poll("s1", 500 * MS + 1) is None
    assert forwarder.poll("s1", 600 * MS) is None
    forwarder.accept(0.5, "/source", 700 * MS)
    assert forwarder.poll("s1", 700 * MS) == 0.5
