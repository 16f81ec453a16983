"""`halt` is carried out and answered whatever fails beside it: the log, the master, the connection to the broker, a clock."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
import rospy
from bridge_bench import BridgeBench, Clocks, open_node_io
from gateway_cell import CONFIG
from processes import wait_until

from construction_twin.core.units import NANOSECONDS
from construction_twin.link.observations import LinkState
from construction_twin.ros.nodes import mqtt_bridge
from construction_twin.ros.shared.diagnostics import WARN, DeferredLog


def fail(*_given, **_named):
    raise RuntimeError("nobody foresaw this")


@pytest.fixture
def clocks(monkeypatch):
    rospy.rostime.set_rostime_initialized(True)
    yield Clocks(monkeypatch, mqtt_bridge)
    rospy.rostime.set_rostime_initialized(False)


@pytest.fixture
def armed(clocks) -> BridgeBench:
    bench = BridgeBench(clocks)
    bench.arm_and_rest()
    return bench


def assert_halted(bench: BridgeBench) -> None:
    """Check that the link is not armed, that no command goes out, and that the bridge lives on and says so."""
    assert bench.bridge.link is LinkState.NEEDS_RESET
    before = len(bench.client.streamed)
    for _ in range(50):
        bench.step()
    assert len(bench.client.streamed) == before
    assert bench.links[-1][0].text == "NEEDS_RESET"


@pytest.mark.parametrize("step", [-10.0, -1.0, -0.05, 0.0, 0.05, 1.0, 10.0])
def test_with_a_wall_clock_that_was_set(armed, clocks, step):
    clocks.wall += round(step * NANOSECONDS)
    assert armed.bridge.on_halt(None).success and armed.client.controls[-1].verb == "stop"
    assert_halted(armed)


@pytest.mark.parametrize(
    "place, name", [(rospy, "loginfo"), (rospy, "logerr"), (DeferredLog, "add"), (DeferredLog, "flush")]
)
def test_with_a_log_that_fails(armed, monkeypatch, place, name):
    with monkeypatch.context() as broken:
        broken.setattr(place, name, fail)
        if name == "logerr":
            broken.setattr(rospy, "loginfo", fail)
        assert armed.bridge.on_halt(None).success and armed.client.controls[-1].verb == "stop"
        if name == "add":
            # of a halt alone; what the link's own changes say may end the node as ever
            broken.undo()
        assert_halted(armed)
    report = armed.bridge.diagnose()
    assert report.level == WARN and "nobody foresaw this" in report.sentence
    assert report.values["failed beside an act: the log"] > 0


def test_with_a_stop_that_cannot_be_sent_the_commands_end_and_the_person_is_told(armed, monkeypatch):
    with monkeypatch.context() as broken:
        broken.setattr(armed.client, "publish", fail)
        answer = armed.bridge.on_halt(None)
    assert not answer.success and "could not be sent to the gateway, which brakes by itself" in answer.message
    assert_halted(armed)
    assert armed.bridge.diagnose().values["failed beside an act: the stop for the gateway"] == 1


def test_with_a_log_that_hangs_the_link_is_polled_and_the_gateway_is_told(armed, clocks, monkeypatch):
    hangs = threading.Event()
    monkeypatch.setattr(rospy, "loginfo", lambda *words: hangs.wait(10.0))
    writer = threading.Thread(target=armed.bridge.write_log)
    for number in range(1, 4):
        assert armed.bridge.on_halt(None).success
        assert [control.verb for control in armed.client.controls[-number:]] == ["stop"] * number
        if number == 1:
            writer.start()
        clocks.run(0.02)
        armed.bridge.poll()
    assert armed.links[-1][0].text == "NEEDS_RESET" and writer.is_alive()
    hangs.set()
    writer.join(10.0)


def test_that_a_person_is_waited_for_outlasts_the_bridge_until_a_person_has_reset(clocks):
    kept = []
    bench = BridgeBench(clocks, keep=lambda _, value: kept.append(value))
    bench.arm_and_rest()
    assert kept == []
    bench.bridge.on_halt(None)
    bench.step()
    wait_until(lambda: kept == ["stopped at the gateway on request; call reset"], what="the sentence")
    # the stop never came to the gateway, and this process ends
    after = BridgeBench(clocks, waits=kept[-1], keep=lambda _, value: kept.append(value))
    after.connect()
    for _ in range(500):
        after.step()
        assert after.bridge.link is not LinkState.ARMED and not after.client.controls
    assert after.links[-1][0].reason == kept[0] and after.bridge.link is LinkState.NEEDS_RESET
    done = []

    def answer() -> None:
        after.step()
        for control in after.client.controls[len(done) :]:
            done.append(control)
            state = "armed" if control.verb == "arm" else "ready"
            after.gateway |= {"state": state, "session": control.session * (state == "armed")}
            after.bridge.on_status(json.dumps(after.gateway).encode())
            after.bridge.on_answer(json.dumps({"id": control.id, "ok": True, "verb": control.verb}).encode())

    clocks.while_waiting = answer
    assert after.ask("reset").success
    after.step()
    wait_until(lambda: kept[-1] == "", what="the end of it")


def test_a_bridge_that_is_started_again_reads_what_the_one_before_it_waited_for(clocks, monkeypatch):
    bench = BridgeBench(clocks)
    bench.client.on_stream = lambda *_: None
    monkeypatch.setattr(mqtt_bridge, "config_of_link", lambda *_: CONFIG)
    monkeypatch.setattr(mqtt_bridge, "make_client", lambda *_, **__: bench.client)
    monkeypatch.setattr(mqtt_bridge, "connect", lambda *_, **__: None)
    monkeypatch.setattr(mqtt_bridge, "arm_check", lambda *_: None)
    node_io = open_node_io(bench.diagnostics, waits="not armed within 5 s; call reset")
    axes = [SimpleNamespace(name=name, sign=1, offset=0.0) for name in CONFIG.axes]
    robot = SimpleNamespace(name="arm", joint_names=CONFIG.axes, axes=axes, linear=(False,) * 2)
    settings = mqtt_bridge.Settings(host="127.0.0.1", port=1, arm="mock", reset_timeout=1.0, max_state_age=0.1)
    bench.bridge = mqtt_bridge.start(settings, robot, node_io)
    bench.connect()
    for _ in range(100):
        bench.step()
    assert bench.bridge.link is LinkState.NEEDS_RESET and not bench.client.controls
    assert node_io.publishers["link"][-1][0].reason == node_io.parameters[mqtt_bridge.WAITS]


def test_a_master_that_does_not_keep_that_is_shown(clocks):
    def away(_name, _value):
        raise ConnectionRefusedError("nobody there")

    bench = BridgeBench(clocks, keep=away)
    bench.arm_and_rest()
    bench.bridge.on_halt(None)
    bench.step()
    said = "waits_for_person was not written, and what it says would not outlast this node (nobody there)"
    wait_until(lambda: said in bench.bridge.diagnose().sentence)
    assert bench.bridge.diagnose().level == WARN


def test_a_new_launch_begins_without_waiting():
    launch = ElementTree.parse(Path(__file__).parents[3] / "launch/bringup.launch").getroot()
    assert [param.get("value") for param in launch.iter("param") if param.get("name") == mqtt_bridge.WAITS] == [""]
