"""Controllers of every clock against a running gateway: real UDP on loopback, a real broker."""

from __future__ import annotations

import dataclasses
import re

import pytest
from processes import wait_until
from service_cell import CONFIG, FreeController, client_of, serving


@pytest.mark.parametrize("cycle", [4, 12])
def test_a_controller_of_the_configured_cycle_is_ready_once_it_was_measured(broker, topics, cycle):
    config = dataclasses.replace(CONFIG, cycle=cycle)
    with serving(broker, topics, config, measures=True) as (_, address), client_of(broker, topics) as client:
        client.wait_for_status(state="no_controller")
        controller = FreeController(address, cycle, cycle / 1000)
        try:
            controller.start()
            client.wait_for_status(state="measuring")
            client.wait_for_status(timeout=30.0, state="ready")
            assert client.status()["cycle"]["ipoc_step_ms"] == cycle
            assert client.arm(config)["ok"]
        finally:
            controller.close()


@pytest.mark.parametrize(
    "expected, step, every, said",
    [
        (
            4,
            12,
            0.012,
            r"the controller's cycle is 12 ms \(IPOC steps of 12\); expected 4 ms: RSI_ON\(\.\.\., #IPO_FAST\)",
        ),
        (
            4,
            1,
            0.004,
            r"the controller's clock runs 0\.\d\d times as fast as real time \(IPOC steps of 1, a telegram every ",
        ),
        (
            4,
            4,
            0.002,
            r"the controller's clock runs [12]\.\d\d times as fast as real time \(IPOC steps of 4, a telegram every ",
        ),
        (12, 4, 0.004, r"the controller's cycle is 4 ms \(IPOC steps of 4\); expected 12 ms: RSI_ON\(\.\.\., #IPO\)"),
    ],
)
def test_a_controller_with_another_clock_is_named_and_not_armed(broker, topics, expected, step, every, said):
    config = dataclasses.replace(CONFIG, cycle=expected)
    with serving(broker, topics, config, measures=True) as (_, address), client_of(broker, topics) as client:
        controller = FreeController(address, step, every)
        try:
            controller.start()
            client.wait_for_status(timeout=30.0, state="other_cycle")
            status = client.status()
            assert re.match(said, status["reason"])
            assert status["cycle"]["ipoc_step_ms"] == step
            answer = client.arm(config)
            assert not answer["ok"] and answer["reason"] == f"gateway is other_cycle: {status['reason']}"
            wait_until(lambda: client.on(topics.state), what="the arm's pose: it is reported all the same")
            assert controller.corrections() == {(0.0,) * len(CONFIG.axes)}
        finally:
            controller.close()
