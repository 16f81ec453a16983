"""The gateway's status as texts for ROS."""

from __future__ import annotations

import json

import pytest
from gateway_cell import following

from construction_twin.core.errors import PayloadError
from construction_twin.link.status_values import status_values
from construction_twin.mqtt.messages import parse_status


def test_it_shows_what_a_real_gateway_says():
    cell = following()
    cell.arm("other")
    values = status_values(parse_status(json.dumps(cell.gateway.status()).encode()))
    assert values["playout_delay_ms"] == "20" and values["playout_lead_ms"] == "16"
    assert values["playout_drift_ppm"] == "" and values["playout_rate_percent"] == "0"
    assert (values["intruder_session"], values["intruder_count"]) == ("other", "1")
    assert values["last_refusal"].startswith("arm: armed for session s1") and values["mode"] == "normal"
    assert values["last_ipoc_jump_ms"] == "0"


def test_an_older_gateway_s_status_says_nothing():
    assert status_values({"state": "ready"}) == {}


@pytest.mark.parametrize(
    "status",
    [
        {"playout": 3},
        {"playout": [1]},
        {"playout": {"delay_ms": [1]}},
        {"playout": {"delay_ms": True}},
        {"playout": {"delay_ms": float("nan")}},
        {"playout": {"delay_ms": 10**400}},
        {"intruder": {"count": -(1 << 63)}},
        {"playout": {str(k): 1 for k in range(33)}},
        {"playout": {"x" * 65: 1}},
        {"intruder": {"session": {}}},
        {"last_refusal": ["x"]},
    ],
)
def test_what_is_not_in_the_interface_is_refused(status):
    with pytest.raises(PayloadError):
        status_values(status)


def test_long_texts_are_cut():
    assert len(status_values({"last_refusal": "x" * 10_000})["last_refusal"]) == 300
