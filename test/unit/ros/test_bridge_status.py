"""What the bridge makes of the gateway's status, on `link` and `/diagnostics`; without a ROS master or a broker."""

from __future__ import annotations

import json
import threading
from collections import Counter
from types import SimpleNamespace

import pytest
import rospy
from gateway_cell import following

from construction_twin.core.travel_time import StateCheck
from construction_twin.core.units import NANOSECONDS, last_digit
from construction_twin.link.speed_forwarder import SpeedForwarder
from construction_twin.link.states import LinkState
from construction_twin.link.supervisor import LinkSupervisor
from construction_twin.mqtt.messages import parse_control
from construction_twin.ros.nodes import mqtt_bridge as mqtt_bridge_node
from construction_twin.ros.nodes.mqtt_bridge import MIRROR_MODE, MqttBridgeNode


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


# -- clocks ----------------------------------------------------------------------------------------------------------


class Clocks:
    """The wall clock, which somebody sets, and the monotonic one."""

    def __init__(self, monkeypatch):
        self.wall, self.steady = 1_764_000_000 * NANOSECONDS, 1000 * NANOSECONDS
        monkeypatch.setattr(mqtt_bridge_node, "now_ns", lambda: self.wall)
        steady = SimpleNamespace(monotonic_ns=lambda: self.steady, monotonic=lambda: self.steady / NANOSECONDS)
        monkeypatch.setattr(mqtt_bridge_node, "time", steady)

    def run(self, seconds: float) -> None:
        self.wall += round(seconds * NANOSECONDS)
        self.steady += round(seconds * NANOSECONDS)


@pytest.fixture
def clocks(monkeypatch):
    return Clocks(monkeypatch)


def poll(node):
    """One turn of `run`."""
    with node._lock:
        return node._supervisor.poll(mqtt_bridge_node.time.monotonic_ns())


def test_a_wall_clock_that_is_set_back_keeps_no_silent_gateway_alive(bridge, clocks):
    bridge._supervisor.on_connection(True)
    status = following().gateway.status() | {"hash": "hash"}
    take(bridge, status)
    poll(bridge)
    assert bridge._supervisor.state is not LinkState.GATEWAY_OFFLINE
    clocks.run(1.0)
    clocks.wall -= 60 * NANOSECONDS
    clocks.run(2.5)
    poll(bridge)
    assert bridge._supervisor.state is LinkState.GATEWAY_OFFLINE


def test_a_wall_clock_that_is_set_makes_no_pose_old_and_none_at_rest(bridge, clocks):
    bridge._supervisor.on_connection(True)
    bridge._codec = cell_codec = following().codec
    stamps = []
    bridge._physical = SimpleNamespace(publish=lambda stamp, q: stamps.append(stamp))
    bridge._feedback = SimpleNamespace(publish=lambda *content: None)
    bridge._properties = False
    payload = cell_codec.encode((0.1, -1.0))
    for k in range(100):
        clocks.run(0.004)
        if k == 20:
            clocks.wall += 60 * NANOSECONDS
        if k == 30:
            assert not bridge._supervisor.inputs.at_rest(clocks.steady)
        bridge._on_state(payload, [], False)
    assert bridge._supervisor.inputs.at_rest(clocks.steady)
    # what goes out on ROS carries ROS time
    assert stamps[-1] == clocks.wall


# -- speed limit and mirror mode -------------------------------------------------------------------------------------


def test_a_second_source_of_speed_limit_is_refused_as_by_the_executor(bridge, clocks):
    bridge._speed = SpeedForwarder(0.5)
    for source, limit in (("/separation", 0.2), ("/other", 1.0), ("/separation", 2.0)):
        bridge._on_speed_limit(SimpleNamespace(limit=limit, _connection_header={"callerid": source}))
    assert bridge._diagnostics.refused == {"speed_limit_source": 1, "speed_limit": 1}
    assert bridge._speed.poll("s1", clocks.steady) == 0.2


def test_speed_limits_go_to_the_gateway_numbered_upwards(bridge, clocks, monkeypatch):
    bridge._speed = SpeedForwarder(0.5)
    bridge._topics.control = "control"
    bridge._supervisor = SimpleNamespace(
        poll=lambda now: None, state=LinkState.ARMED, reason="", session="s1", status={}
    )
    sent, turns = [], iter(range(50))

    def publish(topic, payload, *_, **__):
        if topic == "control":
            sent.append(parse_control(payload))

    def sleep(seconds):
        clocks.run(seconds)
        bridge._speed.on_limit(0.5, "/separation", clocks.steady)

    bridge._client = SimpleNamespace(publish=publish, disconnect=lambda: None, loop_stop=lambda: None)
    monkeypatch.setattr(mqtt_bridge_node.time, "sleep", sleep, raising=False)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: next(turns, None) is None)
    bridge.run()
    assert [(control.verb, control.session, control.value) for control in sent] == [("speed_limit", "s1", 0.5)] * len(
        sent
    )
    assert [control.id for control in sent] == [str(k) for k in range(1, len(sent) + 1)] and len(sent) >= 4


def test_mirror_mode_is_kept_where_the_next_process_finds_it(bridge, clocks, monkeypatch):
    kept = {}
    monkeypatch.setattr(rospy, "set_param", kept.__setitem__)
    node = bridge
    node._publish_control = lambda control: None
    node._client.is_connected = lambda: True
    node._supervisor.begin_mirror = lambda now: "the arm leads"
    assert node._on_mirror(SimpleNamespace(data=True)).success and kept == {MIRROR_MODE: True}
    node._supervisor._mirror.active = True
    assert node._on_stop(None).success and kept == {MIRROR_MODE: False}
    assert not node._on_mirror(SimpleNamespace(data=False)).success and kept == {MIRROR_MODE: False}
