"""Requests by MQTT: each kind is stated once, and its answers keep their bytes."""

from __future__ import annotations

import pytest

from construction_twin.mqtt import requests
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import PLAN_REQUEST, REQUESTS, REVIEW, STOP, TRAJECTORY, UNKNOWN

PLAN = {"plan_id": "p", "plan_hash": "h"}


@pytest.mark.parametrize(
    "kind, known, payload",
    [
        (
            REVIEW,
            PLAN | {"verdict": "approved", "reviewer": "ada", "account": "ada", "ok": True, "reason": "taken"},
            b'{"plan_id": "p", "plan_hash": "h", "verdict": "approved", "reviewer": "ada", "account": "ada", "ok": true, '
            b'"reason": "taken", "expired": false}',
        ),
        (
            STOP,
            {"id": "7", "account": "ada", "reason": "why", "by": requests.GATEWAY},
            b'{"id": "7", "account": "ada", "ok": false, "reason": "why", "by": "gateway", "expired": false}',
        ),
        (
            PLAN_REQUEST,
            PLAN | {"id": "7", "account": "ada", "kind": "pose", "ok": True, "reason": "planned", "duration": 2.5},
            b'{"id": "7", "account": "ada", "kind": "pose", "ok": true, "reason": "planned", "plan_id": "p", '
            b'"plan_hash": "h", "duration": 2.5, "expired": false}',
        ),
        (
            TRAJECTORY,
            {"id": "7", "sender": "", "reason": "why", "account": "of no field"},
            b'{"id": "7", "sender": "", "ok": false, "reason": "why", "plan_id": "", "plan_hash": "", "duration": 0.0, '
            b'"notes": []}',
        ),
    ],
)
def test_an_answer_has_its_fields_in_their_order_whatever_is_known(kind, known, payload):
    assert kind.payload(**known) == payload


def test_no_answer_has_a_number_that_json_has_not():
    with pytest.raises(ValueError, match="JSON"):
        PLAN_REQUEST.payload(duration=float("nan"))


def test_every_field_of_an_answer_is_known_and_no_topic_is_given_twice():
    assert {field for kind in REQUESTS for field in kind.answer} == set(UNKNOWN)
    topics = [Topics("twin", "kr120").of(kind) for kind in REQUESTS]
    assert len(set(topics)) == len(REQUESTS)
