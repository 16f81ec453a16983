"""`lower_speed` and `raise_speed` by MQTT: read strictly, but for a moment, by which no lower limit is lost."""

from __future__ import annotations

import pytest

from construction_twin.core.errors import PayloadError
from construction_twin.link.speed_limits import LEAST, SpeedRequest, parse_speed
from construction_twin.mqtt.requests import LOWER_SPEED, RAISE_SPEED

GOOD = {"id": "1", "limit": 0.3, "moment": "c0ffee00-5000"}


def test_a_request_is_read():
    assert parse_speed(GOOD, RAISE_SPEED) == SpeedRequest("1", 0.3, "c0ffee00-5000")
    assert parse_speed({"id": "1", "limit": 1}, LOWER_SPEED) == SpeedRequest("1", 1.0, "")
    assert parse_speed({"id": "1", "limit": LEAST}, LOWER_SPEED).limit == LEAST


@pytest.mark.parametrize("moment", [None, 5, [], "x" * 65])
def test_a_moment_that_is_none_counts_to_raise_alone(moment):
    assert parse_speed(GOOD | {"moment": moment}, LOWER_SPEED).moment == ""
    with pytest.raises(PayloadError) as caught:
        parse_speed(GOOD | {"moment": moment}, RAISE_SPEED)
    assert caught.value.reason == "moment"


@pytest.mark.parametrize(
    "changes, reason",
    [
        ({"limit": 0}, "values"),
        ({"limit": LEAST - 0.001}, "values"),
        ({"limit": 1.001}, "values"),
        ({"limit": float("nan")}, "values"),
        ({"limit": "0.3"}, "values"),
        ({"limit": True}, "values"),
        ({"id": ""}, "format"),
        ({"id": 3}, "format"),
        ({"more": 1}, "format"),
    ],
)
def test_what_is_not_as_described_is_refused(changes, reason):
    with pytest.raises(PayloadError) as caught:
        parse_speed(GOOD | changes, LOWER_SPEED)
    assert caught.value.reason == reason


@pytest.mark.parametrize("missing", ["id", "limit"])
def test_what_is_needed_is_needed(missing):
    with pytest.raises(PayloadError):
        parse_speed({key: value for key, value in GOOD.items() if key != missing}, LOWER_SPEED)
