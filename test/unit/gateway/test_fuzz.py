"""Hostile messages and telegrams at a running gateway; `make fuzz` sends a million of each."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable

import pytest
from fuzz_gateway import Arm, Cycling, GatewayProcess, Mqtt, flood_mqtt, flood_rsi
from processes import wait_until

pytestmark = pytest.mark.realtime

COUNT, SEED = int(os.environ.get("FUZZ_COUNT", "2000")), int(os.environ.get("FUZZ_SEED", "3"))
#: The process may have grown by this much after the first tenth: allocator noise. And the status stays this small [bytes].
GROWTH, STATUS = 8 << 20, 8192


@pytest.mark.timeout(0 if COUNT > 10_000 else 300)
def test_a_running_gateway_counts_all_moves_nothing_and_does_not_grow(broker, tmp_path):
    gateway = GatewayProcess(tmp_path, broker)
    arm = Arm(gateway.address)

    def flooded(flood: Callable[[int, int], Counter]) -> Counter:
        flood(COUNT // 10, SEED + 1)
        before = gateway.resident()
        counts = flood(COUNT, SEED)
        assert gateway.resident() - before <= GROWTH
        assert arm.controller.measured == arm.home
        return counts

    def beside_the_arm(count: int, seed: int) -> Counter:
        with Cycling(arm):
            return flood_mqtt(mqtt, count, seed)

    try:
        mqtt = Mqtt(broker)
        wait_until(lambda: arm.cycle(), 10.0, "a reply of the gateway")
        messages = flooded(beside_the_arm)
        telegrams = flooded(lambda count, seed: flood_rsi(arm, mqtt, count, seed))
        assert mqtt.largest_status <= STATUS
        mqtt.close()
        gateway.end()
    finally:
        arm.close()
        gateway.kill()
    print(messages, telegrams)
    # the refusals that the mutations are made for
    for name in ("session", "control", "properties", "verb", "retained", "not_armed"):
        assert messages[f"refused_{name}"], name
    for name in ("telegram_refused_xml", "telegram_refused_ipoc", "telegram_refused_source", "telegrams"):
        assert telegrams[name], name
