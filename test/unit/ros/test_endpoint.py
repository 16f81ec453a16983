"""What cannot be read is answered at a pace, and what is not answered is counted, as is what became of the others."""

from __future__ import annotations

from construction_twin.core.units import NANOSECONDS
from construction_twin.mqtt.requests import ANSWERS
from construction_twin.ros.console.endpoint import RequestCounts


def test_ten_in_a_second_for_each_account_and_the_rest_is_counted():
    now = [0]
    answers = RequestCounts("verdicts", clock=lambda: now[0])
    assert [answers.is_due("ada") for _ in range(ANSWERS + 2)] == [True] * ANSWERS + [False] * 2
    assert answers.is_due("bob") and ANSWERS == 10
    now[0] += NANOSECONDS
    assert [answers.is_due("ada") for _ in range(ANSWERS + 1)] == [True] * ANSWERS + [False]
    assert answers.report() == {"verdicts malformed, not answered": 3}


def test_what_became_of_a_request_is_counted_in_a_word():
    counts = RequestCounts("ik", "solved", "not solved")
    for ok, word in ((True, ""), (False, ""), (True, "free"), (True, "free")):
        counts.add(ok, word)
    assert counts.report() == {"ik free": 2, "ik not solved": 1, "ik solved": 1}
