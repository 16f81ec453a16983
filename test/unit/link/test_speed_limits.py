"""The speed limit in force: the lowest wins, raising needs a fresh look, nothing that vanishes raises it."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import ExpiredError, PayloadError
from construction_twin.core.freshness import LIFETIME, Moment
from construction_twin.core.reports import SpeedChange
from construction_twin.core.sentences import Sentence
from construction_twin.core.speed_limit import SpeedLimit
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.observations import SHOWN_AFTER
from construction_twin.link.speed_limits import NOBODY, UNKNOWN, SpeedLimits, read_people, write_people

BOOT = "c0ffee00"
START = 100 * NANOSECONDS
#: A program's deadline, and what holds beyond it.
DEADLINE, SILENT = 0.5, 0.1


def made(people: SpeedChange = NOBODY, required: bool = False) -> SpeedLimits:
    return SpeedLimits(SpeedLimit(DEADLINE, SILENT, required), people, Moment(BOOT, START))


def at(seconds: float) -> Moment:
    """Return a moment so long after the start [s]."""
    return Moment(BOOT, START + round(seconds * NANOSECONDS))


def set_(limits: SpeedLimits, limit: float, seconds: float, person: str = "dora", seen: float | None = None) -> str:
    """Set a limit so long after the start; `seen` is the moment that was shown then, None: none is told."""
    moment = "" if seen is None else str(at(seen))
    return limits.set(limit, person, moment, at(seconds), round(seconds * NANOSECONDS))


def in_force(limits: SpeedLimits, seconds: float = 0.0) -> float:
    report = limits.state_report(START + round(seconds * NANOSECONDS))
    return 1.0 if report is None else report.limit


def say(limits: SpeedLimits, fraction: float, seconds: float, name: str = "/separation") -> None:
    limits.program.accept(fraction, name, START + round(seconds * NANOSECONDS), "somebody is near")


def test_before_anybody_limits_there_is_nothing_to_repeat():
    assert made().state_report(START) is None
    assert made(required=True).state_report(START) is None, "what is required then the executor does by itself"


def test_the_lowest_wins_whoever_came_last():
    limits = made()
    say(limits, 0.5, 1.0)
    set_(limits, 0.3, 1.1)
    assert (in_force(limits, 1.2), limits.state_report(at(1.2).at).by) == (0.3, "people")
    say(limits, 0.2, 1.2)
    report = limits.state_report(at(1.2).at)
    assert (report.limit, report.by, report.people, report.program) == (0.2, "program", 0.3, 0.2)
    assert "/separation" in report.reason and "somebody is near" in report.reason
    say(limits, 1.0, 1.3)
    assert (in_force(limits, 1.3), limits.state_report(at(1.3).at).reason) == (0.3, "dora has limited the speed to 30%")


def test_a_program_that_falls_silent_counts_as_before_and_never_as_more_than_it_had_said():
    limits = made()
    for said, silent in ((0.5, SILENT), (0.05, 0.05)):
        say(limits, said, 0.0)
        assert in_force(limits, DEADLINE) == said
        report = limits.state_report(at(DEADLINE + 0.01).at)
        assert report.limit == silent and "silent" in report.reason
    set_(limits, 0.3, 1.0)
    assert in_force(limits, 1.0) == 0.05, "people do not lift what a program has said"


def test_people_limit_beside_a_program_that_is_required_and_was_never_heard():
    limits = made(required=True)
    set_(limits, 0.5, 0.0)
    assert (in_force(limits), limits.state_report(START).by) == (SILENT, "program")


def test_who_lowers_raises_nothing_and_who_raises_lowers_nothing():
    limits = made()
    set_(limits, 0.3, 1.0)
    for limit, moment, reason in ((0.5, "", "direction"), (0.2, str(at(2.9)), "direction"), (0.5, "now", "moment")):
        with pytest.raises(PayloadError) as caught:
            limits.set(limit, "dora", moment, at(3.0), 1)
        assert (caught.value.reason, limits.people.limit) == (reason, 0.3)
    assert "is raised to 50%" in set_(limits, 0.5, 3.0, seen=2.9)
    assert limits.people.limit == 0.5


@pytest.mark.parametrize("seen, moment", [(3.0, None), (12.0, None), (0.0, "deadbeef-100000")])
def test_raising_is_void_by_what_was_shown_too_long_ago_ahead_or_elsewhere(seen, moment):
    limits = made()
    set_(limits, 0.3, 1.0)
    with pytest.raises(ExpiredError):
        limits.set(0.5, "dora", moment or str(at(seen)), at(seen + 3.01 if seen == 3.0 else 10.0), 1)
    assert limits.people.limit == 0.3


def test_nobody_raises_a_limit_that_was_lowered_since_the_screen_had_looked():
    limits = made()
    set_(limits, 0.3, 1.0)
    set_(limits, 0.2, 5.0, person="bob")
    shown = SHOWN_AFTER / NANOSECONDS
    for seen in (4.9, 5.0, 5.0 + shown):
        with pytest.raises(ExpiredError, match="is void: it was lowered since"):
            set_(limits, 0.8, 5.5, seen=seen)
    set_(limits, 0.8, 5.5, seen=5.0 + shown + 0.001)
    assert (limits.people.limit, limits.people.person) == (0.8, "dora")


def test_a_screen_that_has_not_looked_since_the_start_raises_nothing():
    limits = made(SpeedChange("dora", 0.3, 1.0, "", 1))
    with pytest.raises(ExpiredError):
        set_(limits, 0.5, 1.0, seen=-0.5)
    set_(limits, 0.5, 1.0, seen=0.5)


def test_who_set_it_and_whose_was_replaced_is_known():
    limits = made()
    set_(limits, 0.3, 1.0)
    assert limits.people == SpeedChange("dora", 0.3, 1.0, "", NANOSECONDS)
    sentence = set_(limits, 0.6, 3.0, person="bob", seen=2.9)
    assert limits.people == SpeedChange("bob", 0.6, 0.3, "dora", 3 * NANOSECONDS)
    assert isinstance(sentence, Sentence) and "(dora)" in sentence
    report = limits.state_report(START)
    assert (report.person, report.since, report.replaced, report.replaced_person) == ("bob", 3 * 10**9, 0.3, "dora")


def test_the_same_limit_again_changes_nothing_and_needs_nothing():
    limits = made()
    set_(limits, 0.3, 1.0)
    before = limits.people
    assert "is 30% already" in set_(limits, 0.3, 2.0, person="bob") and limits.people == before


@pytest.mark.parametrize("limit", [0.0, 0.049, 1.01, float("nan"), float("inf"), -1.0])
def test_what_is_no_limit_is_refused(limit):
    limits = made()
    with pytest.raises(PayloadError, match="0.05 to 1, of the planned speed$") as caught:
        limits.set(limit, "dora", str(at(1.0)), at(1.0), 1)
    assert caught.value.reason == "values" and limits.people == NOBODY


@pytest.mark.parametrize("person", ["", "  "])
def test_nobody_limits_without_a_name(person):
    with pytest.raises(PayloadError) as caught:
        made().set(0.5, person, "", at(1.0), 1)
    assert caught.value.reason == "person"


def test_what_people_set_outlasts_the_process(tmp_path):
    file, limits = tmp_path / "kr120.json", made()
    assert read_people(file) == (NOBODY, "")
    set_(limits, 0.35, 1.0)
    assert write_people(file, limits.people) == ""
    again, problem = read_people(file)
    assert (again, problem) == (limits.people, "") and in_force(made(again)) == 0.35
    written = {"limit": 0.35, "person": "dora", "since": NANOSECONDS, "replaced": 1.0, "replaced_person": ""}
    assert json.loads(file.read_text()) == written


GOOD = '"limit": 0.5, "person": "dora", "since": 1, "replaced": 1.0, "replaced_person": ""'


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", "{}", '{"limit": 0.5}', *(
        "{" + GOOD.replace(old, new) + "}"
        for old, new in (("0.5", "2.0"), ("0.5", "0.0"), ("0.5", '"1"'), ("0.5", "true"), ("0.5", "NaN"), ("1.0", "0.0"),
                         ('"dora"', "1"), ('"since": 1', '"since": "x"'))
    )],
)  # fmt: skip
def test_a_file_of_something_else_is_none_and_stays_to_be_looked_at(tmp_path, text):
    file = tmp_path / "kr120.json"
    file.write_text("{" + GOOD + "}")
    assert read_people(file) == (SpeedChange("dora", 0.5, 1.0, "", 1), "")
    file.write_text(text)
    people, problem = read_people(file)
    assert people == UNKNOWN and problem.startswith(str(file)) and file.read_text() == text


_limit = st.integers(1, 20).map(lambda number: number / 20)
_step = st.one_of(
    st.tuples(st.just("people"), _limit, st.sampled_from(["dora", "bob"]), st.floats(0.0, 6.0), st.booleans()),
    st.tuples(st.just("program"), st.floats(0.0, 1.0)),
    st.tuples(st.just("wait"), st.floats(0.0, 1.0)),
    st.tuples(st.just("restart")),
)


@given(st.lists(_step, max_size=40))
def test_whatever_happens_only_a_fresh_look_raises_people_s_limit_and_the_lowest_is_in_force(steps):
    limits, now, told, spoken = made(), 1.0, None, 0.0
    for step in steps:
        before = limits.people
        if step[0] == "people":
            _, limit, person, age, has_moment = step
            try:
                set_(limits, limit, now, person, now - age if has_moment else None)
            except (PayloadError, ExpiredError):
                assert limits.people == before and (limit > before.limit or has_moment)
            else:
                assert limits.people.limit == limit and (limit == before.limit or has_moment == (limit > before.limit))
                if limit > before.limit:
                    assert age * NANOSECONDS <= LIFETIME + 10**6
        elif step[0] == "program":
            say(limits, step[1], now)
            told, spoken = step[1], now
        elif step[0] == "wait":
            now += step[1]
        else:
            limits = SpeedLimits(limits.program, before, at(now))
        if step[0] != "people":
            assert limits.people == before, "nothing but a person changes it"
        report = limits.state_report(at(now).at)
        assert report is None or report.limit == min(report.people, report.program)
        assert report is not None or (told is None and limits.people == NOBODY)
        if told is not None:
            heard = now - spoken <= DEADLINE
            assert report.program <= (told if heard else min(told, SILENT))
            assert report.limit <= limits.people.limit
