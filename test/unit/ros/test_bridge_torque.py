"""Torques through the bridge: it turns axes into joints, and refuses what it cannot read."""

from __future__ import annotations

import json
import math

import pytest
from bridge_bench import BridgeBench, Clocks

from construction_twin.core.units import NANOSECONDS
from construction_twin.mqtt.messages import StateProperties, TorqueReport
from construction_twin.ros.nodes import mqtt_bridge
from construction_twin.ros.transport.joint_stream import from_time

GOOD = TorqueReport.of(StateProperties(7, 11, 5 * NANOSECONDS), (120.5, math.nan)).to_json()


@pytest.fixture
def bench(monkeypatch):
    return BridgeBench(Clocks(monkeypatch, mqtt_bridge), joints=(("one", 1), ("two", -1)))


def test_axes_become_joints_and_name_their_command(bench):
    bench.bridge.on_torques(TorqueReport.of(StateProperties(7, 11, 5 * NANOSECONDS), (120.5, -3.0)).to_json(), False)
    ((message,),) = bench.torques
    assert (tuple(message.name), list(message.torque), message.seq) == (("one", "two"), [120.5, 3.0], 7)
    assert (from_time(message.command_stamp), from_time(message.header.stamp)) == (5 * NANOSECONDS, bench.clocks.wall)


def test_a_torque_that_is_not_told_is_no_number(bench):
    bench.bridge.on_torques(GOOD, False)
    assert math.isnan(bench.torques[0][0].torque[1])


def changed(**changes):
    return json.dumps(json.loads(GOOD) | changes).encode()


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"+1.000", b"[1, 2]", changed(more=1), changed(seq=-1), changed(seq=True), changed(stamp=1.5),
        changed(command_stamp="5"), changed(torque_nm=[1.0]), changed(torque_nm=[1.0, "2"]), changed(torque_nm=[1.0, True]),
        changed(torque_nm=[1.0, 1e7]), GOOD.replace(b"120.5", b"NaN"), GOOD.replace(b"120.5", b"1e999"),
    ],
)  # fmt: skip
def test_what_is_no_report_is_refused_and_counted(bench, payload):
    bench.bridge.on_torques(payload, False)
    assert bench.refused["torque_torque"] == 1 and not bench.torques


def test_a_retained_one_is_of_another_time(bench):
    bench.bridge.on_torques(GOOD, True)
    assert bench.refused["torque_retained"] == 1 and not bench.torques
