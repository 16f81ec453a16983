"""How old a request is: by the moment that it repeats, and by no other clock."""

from __future__ import annotations

import pytest

from construction_twin.core import freshness as robot_clock
from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import LIFETIME, Moment, is_newer, parse_moment, staleness
from construction_twin.core.units import NANOSECONDS

SEEN = Moment("c0ffee00", 1000 * NANOSECONDS)


def later(seconds: float) -> Moment:
    return Moment(SEEN.origin, SEEN.at + round(seconds * NANOSECONDS))


def test_a_lifetime_is_at_most_five_seconds_and_longer_than_a_view_counts_as_the_present():
    assert NANOSECONDS < LIFETIME <= 5 * NANOSECONDS


@pytest.mark.parametrize("age", [0.0, 0.04, 2.9, 3.0])
def test_what_was_just_shown_may_be_carried_out(age):
    assert staleness(SEEN, later(age)) == ""


@pytest.mark.parametrize("age, told", [(3.001, "3.0 s ago"), (6.0, "6.0 s ago"), (120.0, "120.0 s ago")])
def test_what_was_shown_long_ago_is_void_and_says_how_old_it_is_and_what_to_do(age, told):
    problem = staleness(SEEN, later(age))
    assert told in problem and "after 3 s it is void" in problem and "look again" in problem


def test_a_moment_that_is_yet_to_come_was_never_shown():
    assert "0.001 s ahead" in staleness(later(0.001), SEEN)


def test_a_moment_of_another_computer_or_of_before_a_restart_is_never_compared():
    assert "another computer" in staleness(Moment("deadbeef", SEEN.at), SEEN)


def test_a_moment_comes_back_as_it_went_never_younger_and_at_most_a_millisecond_older():
    for at in (0, 1, 999_999, 1_000_000, 123_456_789_012_345_678):
        moment = Moment("c0ffee00", at)
        back = parse_moment(str(moment))
        assert str(back) == str(moment) and 0 <= at - back.at < 1_000_000


@pytest.mark.parametrize(
    "text",
    [
        None, "", 5, 5.0, True, [], {}, "c0ffee00", "-5", "c0ffee00-", "c0ffee00--5", "c0ffee00-5.0", "C0FFEE00-5", "c0ffee0-5",
        "c0ffee000-5", " c0ffee00-5", "c0ffee00-5\n", "c0ffee00-" + "9" * 16, "c0ffee00-٣",
    ],
)  # fmt: skip
def test_anything_else_is_no_moment(text):
    with pytest.raises(
        PayloadError, match="as moment; expected the text moment of the newest view, as it came"
    ) as refused:
        parse_moment(text)
    assert refused.value.reason == "moment" and len(str(refused.value)) < 200


def test_the_robot_s_clock_is_one_clock_that_nobody_sets(monkeypatch):
    monkeypatch.setattr(robot_clock.time, "time_ns", lambda: 0)
    monkeypatch.setattr(robot_clock.time, "time", lambda: 0.0)
    first, second = robot_clock.present_moment(), robot_clock.present_moment()
    assert first.origin == second.origin and first.at <= second.at
    assert parse_moment(str(first)).origin == first.origin and staleness(first, second) == ""


@pytest.mark.parametrize(
    "seen, act, newer",
    [
        (Moment("c0ffee00", 5), None, True),
        (Moment("c0ffee00", 5), Moment("c0ffee00", 4), True),
        (Moment("c0ffee00", 5), Moment("c0ffee00", 5), False),
        (Moment("c0ffee00", 5), Moment("c0ffee00", 6), False),
        (Moment("c0ffee00", 5), Moment("deadbeef", 4), False),
    ],
)
def test_what_was_shown_is_of_after_an_act(seen, act, newer):
    assert is_newer(seen, act) is newer
