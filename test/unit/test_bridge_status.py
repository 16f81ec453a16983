"""What the bridge makes of the gateway's status, on `link` and `/diagnostics`; without a ROS master or a broker."""

from __future__ import annotations

import json
import threading
from collections import Counter
from types import SimpleNamespace

import pytest
import rospy
from gateway_cell import following

from construction_twin.mqtt.freshness import StateCheck
from construction_twin.mqtt.supervisor import LinkSupervisor
from construction_twin.ros.mqtt_bridge_node import MqttBridgeNode
from construction_twin.units import last_digit


class Refusals:
    """In place of `NodeDiagnostics`, which wants a master."""

    def __init__(self):
        self.refused = Counter()

    def refuse(self, reason, sentence):
        self.refused[reason] += 1


@pytest.fixture
def ros_time():
    rospy.rostime.set_rostime_initialized(True)
    yield
    rospy.rostime.set_rostime_initialized(False)


@pytest.fixture
def bridge(ros_time):
    """The node without its connections: everything between a message on `status` and the reports."""
    node = MqttBridgeNode.__new__(MqttBridgeNode)
    node._lock = threading.Lock()
    node._supervisor = LinkSupervisor("hash", 3, (1e-3,) * 6, (last_digit(3),) * 6, lambda: "s1")
    node._connection = SimpleNamespace(sentence="")
    node._diagnostics = Refusals()
    node._state_check = StateCheck(0.1)
    node._sequence = node._states = 0
    node._properties = True
    node._gateway_values = {}
    node._reported, node._reported_at = (), 0.0
    node.links = []
    node._link = SimpleNamespace(publish=node.links.append)
    node._client = SimpleNamespace(publish=lambda *_, **__: None)
    node._topics = SimpleNamespace(bridge_status="")
    return node


def take(node, status) -> dict[str, str]:
    """Give the node a status; return what `link` says of the gateway then."""
    node._on_status(None, None, SimpleNamespace(payload=json.dumps(status).encode()))
    node._reported_at = float("-inf")
    node._publish_link()
    return {pair.key: pair.value for pair in node.links[-1].gateway_counters}


def test_playout_mode_and_intruder_reach_link_and_diagnostics(bridge):
    cell = following()
    cell.arm("other")
    shown = take(bridge, cell.gateway.status())
    assert (shown["playout_delay_ms"], shown["playout_jitter_ms"], shown["mode"]) == ("20", "0", "normal")
    assert (shown["intruder_session"], shown["intruder_count"]) == ("other", "1")
    assert shown["last_refusal"].startswith("arm: ")
    # and beside them what was there before
    assert (shown["refused_arm"], shown["decimals"]) == ("1", "3")
    _, _, values = bridge._report()
    assert {f"gateway {name}" for name in shown} - set(values) == {
        "gateway decimals", "gateway reply_us_max", "gateway states_lost",
    }  # fmt: skip
    assert values["gateway playout_delay_ms"] == "20"


def test_a_change_of_the_playout_is_shown(bridge):
    status = following().gateway.status()
    take(bridge, status)
    status["playout"]["delay_ms"] = 36.0
    assert take(bridge, status)["playout_delay_ms"] == "36"


def test_a_status_whose_playout_cannot_be_read_changes_nothing_and_is_counted(bridge):
    status = following().gateway.status()
    before = take(bridge, status)
    spoilt = status | {"state": "offline", "playout": {"delay_ms": [1]}}
    assert take(bridge, spoilt) == before
    assert bridge._supervisor.status["state"] == "following"
    assert bridge._diagnostics.refused == {"status": 1}
