"""How long a login waits after wrong passwords: whose wait grows, how far, until when, and whose does not."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.console.login_pace import LoginPace, PaceLimits, network
from construction_twin.core.units import NANOSECONDS

LIMITS = PaceLimits()
HOME, STRANGER = "192.0.2.7", "198.51.100.9"


def guess(pace: LoginPace, address: str, account: str, times: int, now: int = 0) -> list[str | None]:
    """Note wrong passwords; return what is to be appended to the line of each."""
    return [pace.wrong(address, account, now) for _ in range(times)]


def test_each_wrong_password_doubles_the_wait_up_to_the_longest():
    pace, waits = LoginPace(LIMITS), []
    for _ in range(7):
        waits.append((pace.wait_s(HOME, "ada", 0), pace.wait_s(HOME, "bob", 0)))
        pace.wrong(HOME, "ada", 0)
    assert waits == [(0, 0), (0.5, 0.1), (1, 0.2), (2, 0.4), (4, 0.8), (5, 1.6), (5, 2)]


def test_a_stranger_s_wrong_passwords_slow_nobody_at_another_address():
    pace = LoginPace(LIMITS)
    guess(pace, STRANGER, "ada", 1000)
    assert pace.wait_s(STRANGER, "ada", 0) == LIMITS.account_most_s
    assert pace.wait_s(HOME, "ada", 0) == 0


def test_a_wait_ends_with_time_and_a_clock_that_goes_back_ends_none():
    pace, forget = LoginPace(LIMITS), round(LIMITS.forget_s * NANOSECONDS)
    guess(pace, HOME, "ada", 3, now=forget)
    waits = [pace.wait_s(HOME, "ada", forget * k) for k in range(1, 5)]
    assert waits == [2, 1, 0.5, 0]
    assert pace.wait_s(HOME, "ada", 0) == 2
    # however many there were
    guess(pace, HOME, "ada", 1000, now=forget * 10)
    assert pace.wait_s(HOME, "ada", forget * (10 + LIMITS.most)) == 0


def test_a_good_login_ends_the_wait_of_its_account_there_and_of_nothing_else():
    pace = LoginPace(LIMITS)
    for address in (HOME, STRANGER):
        for account in ("ada", "bob"):
            guess(pace, address, account, 4)
    assert pace.right(HOME, "ada") == 4
    assert pace.right(HOME, "ada") == 0
    assert pace.wait_s(HOME, "ada", 0) == LIMITS.address_most_s
    assert pace.wait_s(HOME, "bob", 0) == pace.wait_s(STRANGER, "ada", 0) == 4
    assert pace.right("203.0.113.1", "ada") == 0
    assert pace.count == 16


def test_of_two_addresses_of_one_network_of_ipv6_each_waits_for_the_other():
    pace = LoginPace(LIMITS)
    guess(pace, "2001:db8:0:1::1", "ada", 4)
    assert pace.wait_s("2001:db8:0:1:ffff::2", "ada", 0) == 4
    assert pace.wait_s("2001:db8:0:2::1", "ada", 0) == 0


@pytest.mark.parametrize(
    ("address", "found"),
    (
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("::1", "::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("", ""),
    ),
)
def test_what_an_address_stands_for(address, found):
    assert network(address) == found


def test_of_a_long_account_the_beginning_counts():
    pace = LoginPace(LIMITS)
    guess(pace, HOME, "x" * 65_000, 4)
    assert pace.wait_s(HOME, "x" * 64, 0) == 4


def test_who_tries_many_names_ends_no_wait_and_is_paced_as_an_address():
    pace = LoginPace(LIMITS)
    guess(pace, HOME, "ada", 5)
    for number in range(10_000):
        guess(pace, HOME, f"name {number}", 4)
    assert pace.wait_s(HOME, "ada", 0) == LIMITS.account_most_s
    assert pace.wait_s(HOME, "never tried", 0) == LIMITS.address_most_s


def test_many_addresses_end_no_longer_wait_than_their_own():
    pace = LoginPace(LIMITS)
    guess(pace, HOME, "ada", 5)
    for number in range(3 * LIMITS.addresses):
        guess(pace, f"10.{number // 256}.{number % 256}.1", "ada", 4)
    assert pace.wait_s(HOME, "ada", 0) == LIMITS.account_most_s
    # the newest is always remembered
    assert pace.wait_s(f"10.{number // 256}.{number % 256}.1", "ada", 0) == 4


SMALL = dataclasses.replace(LIMITS, addresses=3, accounts=2)
EVENTS = st.lists(
    st.tuples(
        st.sampled_from(("a", "b", "c", "d", "e")),
        st.sampled_from(("ada", "bob", "eve", "")),
        st.booleans(),
        st.integers(0, 200 * NANOSECONDS),
    ),
    max_size=60,
)


@given(EVENTS, st.sampled_from((LIMITS, SMALL)))
def test_no_wait_is_longer_than_the_longest_and_who_guessed_nothing_has_none(events, limits):
    pace, now, wrong = LoginPace(limits), 0, []
    for address, account, is_right, after in events:
        now += after
        if is_right:
            pace.right(address, account)
        else:
            pace.wrong(address, account, now)
            wrong.append(address)
            # what was just wrong is never forgotten at once
            assert pace.wait_s(address, account, now) >= limits.account_first_s
        for each in ("a", "b", "c", "d", "e"):
            waits = [pace.wait_s(each, name, now) for name in ("ada", "bob", "eve", "", "other")]
            assert all(0 <= wait <= limits.account_most_s for wait in waits)
            assert waits[-1] <= limits.address_most_s
            assert each in wrong or not any(waits)
    later = now + round(limits.most * limits.forget_s * NANOSECONDS)
    assert not any(pace.wait_s(each, "ada", later) for each in ("a", "b", "c", "d", "e"))
    assert pace.count == len(wrong)


@given(EVENTS)
def test_what_others_do_leaves_an_address_as_it_is_where_there_is_room(events):
    alone, among, now = LoginPace(LIMITS), LoginPace(LIMITS), 0
    for address, account, is_right, after in events:
        now += after
        for pace in (alone, among) if address == "a" else (among,):
            pace.right(address, account) if is_right else pace.wrong(address, account, now)
        assert [alone.wait_s("a", name, now) for name in ("ada", "bob", "eve")] == [
            among.wait_s("a", name, now) for name in ("ada", "bob", "eve")
        ]


@given(st.lists(st.tuples(st.sampled_from("bcdef"), st.sampled_from(("ada", "bob", "eve", "x", "y"))), max_size=200))
def test_what_has_fewer_wrong_passwords_never_takes_the_room_of_more(guesses):
    pace = LoginPace(SMALL)
    guess(pace, "a", "ada", SMALL.most)
    seen = {name: 0 for name in "bcdef"}
    for address, account in guesses:
        if seen[address] < SMALL.most - 1:
            seen[address] += 1
            pace.wrong(address, account, 0)
            assert pace.wait_s("a", "ada", 0) == SMALL.account_most_s


def test_a_flood_has_a_line_at_a_time_which_counts_the_others_and_hides_nobody_else_s():
    pace, second = LoginPace(LIMITS), NANOSECONDS
    lines = [line for k in range(181) if (line := pace.wrong(HOME, "ada", k * second)) is not None]
    assert lines == ["", *[" (59 more like this since the last such line)"] * 3]
    assert pace.wrong(HOME, "bob", 100 * second) == ""
    assert pace.wrong(STRANGER, "ada", 100 * second) == ""


def test_names_without_number_share_the_lines_of_their_address():
    pace = LoginPace(LIMITS)
    lines = [pace.wrong(HOME, f"name {number}", 0) for number in range(10_000)]
    assert sum(line is not None for line in lines) == LIMITS.accounts + 1
    assert pace.wrong(STRANGER, "ada", 0) == ""
    minute = round(LIMITS.line_s * NANOSECONDS)
    later = [pace.wrong(HOME, f"another {number}", minute) for number in range(10_000)]
    assert later[: LIMITS.accounts + 1] == [
        *[""] * LIMITS.accounts,
        f" ({10_000 - LIMITS.accounts - 1} more like this since the last such line)",
    ]
    assert not any(line is not None for line in later[LIMITS.accounts + 1 :])
