"""What cannot be read is answered at a pace, and what is not answered is counted."""

from __future__ import annotations

from construction_twin.core.units import NANOSECONDS
from construction_twin.ros.shared.malformed_answers import AT_ONCE, PERIOD, MalformedAnswers


def test_ten_at_once_then_ten_a_second_for_each_account_and_the_rest_is_counted():
    now = [0]
    answers = MalformedAnswers("verdicts", lambda: now[0])
    assert [answers.take("ada") for _ in range(AT_ONCE + 2)] == [True] * AT_ONCE + [False] * 2
    assert answers.take("bob") and PERIOD * 10 == NANOSECONDS
    now[0] += PERIOD
    assert [answers.take("ada") for _ in range(2)] == [True, False]
    assert answers.report() == {"verdicts malformed, not answered": 3}


def test_nothing_is_reported_where_all_were_answered():
    answers = MalformedAnswers("verdicts", lambda: 0)
    assert answers.take("ada") and answers.report() == {}
