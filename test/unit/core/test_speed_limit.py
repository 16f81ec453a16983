"""A source that must repeat itself: its limit counts until the deadline, its silence never lifts it."""

from __future__ import annotations

import math

import pytest

from construction_twin.core.errors import PayloadError
from construction_twin.core.speed_limit import LimitState, SpeedLimit

SECOND = 1_000_000_000
#: Longest silence of a source [s], and the fraction that counts after it.
DEADLINE, SILENT = 0.5, 0.1


def test_a_source_counts_until_its_deadline_and_is_silent_after_it():
    source = SpeedLimit(0.5, 0.1)
    source.accept(0.4, "camera", SECOND)
    assert source.is_fresh(SECOND + SECOND // 2) and not source.is_silent(SECOND + SECOND // 2)
    assert source.is_silent(SECOND + SECOND // 2 + 1) and not source.is_fresh(SECOND + SECOND // 2 + 1)
    assert source.deadline == 0.5


@pytest.mark.parametrize("fraction", [-0.01, 1.01, math.nan, math.inf, -math.inf])
def test_what_is_no_fraction_is_refused_and_the_deadline_runs_on(fraction):
    source = SpeedLimit(0.5)
    source.accept(0.4, "camera", 0)
    with pytest.raises(PayloadError) as refusal:
        source.accept(fraction, "camera", SECOND // 2)
    assert refusal.value.reason == "speed_limit"
    assert source.fraction == 0.4 and source.is_silent(SECOND // 2 + 1)


def test_a_sender_without_a_name_is_refused_because_its_silence_could_not_be_noticed():
    source = SpeedLimit(0.5, 0.1)
    source.accept(0.4, "camera", 0)
    for now in (SECOND // 4, SECOND):
        with pytest.raises(PayloadError) as refusal:
            source.accept(0.9, "", now)
        assert refusal.value.reason == "speed_limit_source"
    assert (source.name, source.fraction) == ("camera", 0.4) and source.is_silent(SECOND)


def test_another_source_is_refused_while_one_is_heard_and_taken_after_its_silence():
    source = SpeedLimit(0.5)
    source.accept(0.4, "camera", 0)
    with pytest.raises(PayloadError) as refusal:
        source.accept(0.9, "fence", SECOND // 2)
    assert refusal.value.reason == "speed_limit_source"
    assert (source.name, source.fraction) == ("camera", 0.4)
    source.accept(0.9, "fence", SECOND // 2 + 1)
    assert (source.name, source.fraction) == ("fence", 0.9)


def test_without_a_source_there_is_no_limit_where_none_is_required():
    limit = SpeedLimit(DEADLINE, SILENT, required=False)
    assert limit.update(SECOND) == 1.0 and limit.state is LimitState.UNLIMITED


def test_where_a_source_is_required_its_absence_is_silence():
    limit = SpeedLimit(DEADLINE, SILENT, required=True)
    assert limit.update(0) == SILENT and limit.state is LimitState.MISSING
    assert "one is required; start a source of `speed_limit`" in limit.reason


@pytest.mark.parametrize("given, after", [(0.4, SILENT), (0.05, 0.05), (0.0, 0.0)])
def test_silence_of_a_source_counts_as_the_lower_of_both_and_is_said(given, after):
    limit = SpeedLimit(DEADLINE, SILENT, required=False)
    limit.accept(given, "/scanner", 0, "a person is near")
    assert limit.update(SECOND // 2) == given and limit.state is LimitState.FRESH
    assert "/scanner: a person is near" in limit.reason
    assert limit.update(SECOND // 2 + 1) == after and limit.state is LimitState.SILENT
    assert "/scanner is silent for more than 0.5 s" in limit.reason
    limit.accept(1.0, "/scanner", SECOND, "")
    assert limit.limit == 1.0 and "no reason given" in limit.reason
