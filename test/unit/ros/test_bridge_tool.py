"""The bridge and the tool, without ROS master and broker: `tool_command` to control messages, statuses and answers to `tool`."""

from __future__ import annotations

import json

import pytest
import rospy
from bridge_bench import BridgeBench, Clocks
from construction_twin.msg import Execution, Sync, ToolCommand, ToolState

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
