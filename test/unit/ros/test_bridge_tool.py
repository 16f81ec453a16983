"""The bridge and the tool, without ROS master and broker: `tool_command` to control messages, statuses and answers to `tool`."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
import rospy
from bridge_bench import BridgeBench, Clocks
from construction_twin.msg import Execution, Sync, ToolCommand, ToolState
from gateway_cell import RUN

from construction_twin.link.states import LinkState
from construction_twin.ros.nodes import mqtt_bridge

TOOL = {
    "name": "vacuum_frame", "known": True, "reason": "", "outputs": {"vacuum": False}, "commanded": {"vacuum": False},
    "enabled": False, "inputs": {"vacuum_reached": False}, "switches": [],
}  # fmt: skip


@pytest.fixture
def bench(monkeypatch):
    rospy.rostime.set_rostime_initialized(True)
    bench = BridgeBench(Clocks(monkeypatch, mqtt_bridge))
    bench.gateway["tool"] = TOOL
    bench.bridge.on_execution(Execution(plan_id="plan"))
    yield bench
    rospy.rostime.set_rostime_initialized(False)


def command(id="a", verb=ToolCommand.ARM, value=True):
    message = ToolCommand(verb=verb, id=id, plan_id="plan", output="vacuum", value=value)
    message.stamp = rospy.Time(1764000000, 5)
    return message


def told(bench):
    return bench.tools[-1][0]


def switches(bench):
    message = told(bench)
    return dict(zip(message.switch_ids, message.switch_states))


def answer(bench, ok=True, reason="armed"):
    control = bench.client.controls[-1]
    content = {"id": control.id, "verb": control.verb, "ok": ok, "reason": reason, "session": control.session}
    bench.bridge.on_answer(json.dumps(content).encode())


def test_a_command_goes_to_the_gateway_with_the_session_and_what_it_says_is_told(bench):
    bench.arm()
    assert (told(bench).known, told(bench).tool) == (True, "vacuum_frame")
    assert (told(bench).outputs, told(bench).output_values) == (["vacuum"], [False])
    bench.bridge.on_tool_command(command())
    control = bench.client.controls[-1]
    assert (control.verb, control.session) == ("switch", bench.gateway["session"])
    assert control.value == {"id": "a", "output": "vacuum", "value": True, "stamp": 1764000000_000000005}
    assert switches(bench) == {}
    answer(bench)
    assert switches(bench) == {"a": ToolState.ARMED}
    fired = {"id": "a", "output": "vacuum", "value": True, "stamp": 5, "state": "fired", "reason": "fired"}
    bench.gateway["tool"] = TOOL | {"switches": [fired], "outputs": {"vacuum": True}}
    bench.step()
    assert switches(bench) == {"a": ToolState.FIRED} and told(bench).output_values == [True]


def test_it_is_told_on_change_only(bench):
    bench.arm()
    before = len(bench.tools)
    for _ in range(20):
        bench.step()
    assert len(bench.tools) == before
    bench.gateway["tool"] = TOOL | {"inputs": {"vacuum_reached": True}}
    bench.step()
    assert len(bench.tools) == before + 1 and told(bench).input_values == [True]


def test_a_refusal_is_told_with_its_sentence(bench):
    bench.arm()
    bench.bridge.on_tool_command(command())
    answer(bench, False, "tool: the outputs are not known: why")
    assert switches(bench) == {"a": ToolState.REFUSED}
    assert told(bench).switch_reasons == ["tool: the outputs are not known: why"]


def test_while_the_link_is_not_armed_a_switch_is_refused_here(bench):
    bench.connect()
    bench.step()
    assert bench.bridge.link is not LinkState.ARMED
    count = len(bench.client.controls)
    bench.bridge.on_tool_command(command())
    assert len(bench.client.controls) == count
    assert switches(bench) == {"a": ToolState.REFUSED}
    assert told(bench).switch_reasons[0].startswith(f"tool: the link is {bench.bridge.link.name}")


@pytest.mark.parametrize("played", ["", "another"])
def test_a_switch_of_another_plan_than_the_one_that_is_played_is_refused_here(bench, played):
    bench.arm()
    bench.bridge.on_execution(Execution(plan_id=played))
    count = len(bench.client.controls)
    bench.bridge.on_tool_command(command())
    assert len(bench.client.controls) == count
    assert told(bench).switch_reasons == [f"tool: switch of plan 'plan', but the executor plays {played!r}"]


@pytest.mark.parametrize(
    "state", [Sync.WAITING, Sync.HOLDING, Sync.REPLANNING, Sync.STALE, Sync.STOPPED, Sync.FAULT, 77]
)
def test_a_gate_that_is_not_open_voids_what_is_armed_without_the_executor(bench, state):
    bench.arm()
    count = len(bench.client.controls)
    bench.bridge.on_sync(Sync(state=state))
    assert len(bench.client.controls) == count
    bench.bridge.on_tool_command(command())
    bench.bridge.on_sync(Sync(state=Sync.IN_SYNC))
    assert bench.client.controls[-1].verb == "switch"
    bench.bridge.on_sync(Sync(state=state))
    control = bench.client.controls[-1]
    assert (control.verb, control.session) == ("void", bench.gateway["session"])


def test_void_is_sent_also_while_the_link_is_not_armed(bench):
    bench.connect()
    bench.step()
    bench.bridge.on_tool_command(command(verb=ToolCommand.VOID))
    assert bench.client.controls[-1].verb == "void"


def test_when_the_gateway_is_gone_nothing_is_known_and_what_was_read_stays_told(bench):
    bench.arm()
    bench.gateway = {"state": "offline", "reason": "gateway stopped", "run": RUN}
    bench.step()
    message = told(bench)
    assert message.known is False and message.reason.startswith("the link is GATEWAY_OFFLINE")
    bench.gateway |= {"state": "ready", "tool": TOOL}


def test_without_a_connection_nothing_is_known(bench):
    bench.arm()
    bench.bridge.on_disconnect(bench.client, None, None, SimpleNamespace(is_failure=False), None)
    bench.clocks.run(0.02)
    bench.bridge.poll()
    assert told(bench).known is False and "DISCONNECTED" in told(bench).reason


def test_a_status_whose_tool_cannot_be_read_is_refused_as_a_whole(bench):
    bench.arm()
    before = len(bench.tools)
    bench.gateway["tool"] = TOOL | {"inputs": 5}
    bench.bridge.on_status(json.dumps(bench.gateway).encode())
    assert bench.refused["status"] == 1 and len(bench.tools) == before


def test_a_gateway_without_a_tool_is_a_robot_without_hands(bench):
    del bench.gateway["tool"]
    bench.arm()
    message = told(bench)
    assert (message.known, message.tool) == (False, "") and "without hands" in message.reason


def test_a_bare_plc_has_no_tool(monkeypatch):
    rospy.rostime.set_rostime_initialized(True)
    bench = BridgeBench(Clocks(monkeypatch, mqtt_bridge), kind="plc")
    bench.connect()
    bench.run_bare(5)
    assert "a bare PLC has no tool" in told(bench).reason and told(bench).known is False
    for verb in (ToolCommand.ARM, ToolCommand.VOID):
        bench.bridge.on_tool_command(command(verb=verb))
    assert bench.client.controls == [] and switches(bench) == {"a": ToolState.REFUSED}
    rospy.rostime.set_rostime_initialized(False)


def test_another_verb_is_refused_and_counted(bench):
    bench.arm()
    bench.bridge.on_tool_command(command(verb=7))
    assert bench.refused["tool_command"] == 1
