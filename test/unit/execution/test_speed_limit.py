"""The executor's speed limit: what counts before a source was heard, while one speaks, and after it fell silent."""

from __future__ import annotations

import pytest

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.speed_limit import LimitState, SpeedLimit

#: Longest silence of a source [s], and the fraction that counts after it.
DEADLINE, SILENT = 0.5, 0.1


def test_without_a_source_there_is_no_limit_where_none_is_required():
    limit = SpeedLimit(DEADLINE, SILENT, required=False)
    assert limit.update(NANOSECONDS) == 1.0 and limit.state is LimitState.UNLIMITED


def test_where_a_source_is_required_its_absence_is_silence():
    limit = SpeedLimit(DEADLINE, SILENT, required=True)
    assert limit.update(0) == SILENT and limit.state is LimitState.MISSING
    assert "one is required; start a source of `speed_limit`" in limit.reason


@pytest.mark.parametrize("given, after", [(0.4, SILENT), (0.05, 0.05), (0.0, 0.0)])
def test_silence_of_a_source_counts_as_the_lower_of_both_and_is_said(given, after):
    limit = SpeedLimit(DEADLINE, SILENT, required=False)
    limit.on_limit(given, "a person is near", "/scanner", 0)
    assert limit.update(NANOSECONDS // 2) == given and limit.state is LimitState.HEARD
    assert "/scanner: a person is near" in limit.reason
    assert limit.update(NANOSECONDS // 2 + 1) == after and limit.state is LimitState.SILENT
    assert "/scanner is silent for more than 0.5 s" in limit.reason
    limit.on_limit(1.0, "", "/scanner", NANOSECONDS)
    assert limit.limit == 1.0 and "no reason given" in limit.reason


def test_what_is_refused_changes_nothing():
    limit = SpeedLimit(DEADLINE, SILENT, required=False)
    limit.on_limit(0.4, "", "/scanner", 0)
    for fraction, source in ((1.1, "/scanner"), (0.9, "/another")):
        with pytest.raises(PayloadError):
            limit.on_limit(fraction, "", source, 1)
    assert limit.update(2) == 0.4
