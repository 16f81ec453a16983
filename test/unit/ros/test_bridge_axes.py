"""Torques and motor currents through the bridge: it turns axes into joints, and refuses what it cannot read."""

from __future__ import annotations

import json
import math

import pytest
from bridge_bench import BridgeBench, Clocks
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.axis_quantities import CURRENT, QUANTITIES, TORQUE
from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS
from construction_twin.mqtt.messages import AxisReport, StateProperties, Topics, read_report
from construction_twin.ros.nodes import mqtt_bridge
from construction_twin.ros.transport.joint_stream import from_time

BESIDE = StateProperties(7, 11, 5 * NANOSECONDS)


def payload(quantity, *values):
    return AxisReport.of(BESIDE, values).to_json(quantity)


@pytest.fixture
def bench(monkeypatch):
    return BridgeBench(Clocks(monkeypatch, mqtt_bridge), joints=(("one", 1), ("two", -1)))


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_axes_become_joints_and_name_their_command(bench, quantity):
    bench.bridge.on_told(quantity, payload(quantity, 120.5, -3.0), False)
    ((message,),) = bench.told[quantity]
    told = getattr(message, {TORQUE: "torque", CURRENT: "current"}[quantity])
    assert (tuple(message.name), list(told), message.seq) == (("one", "two"), [120.5, 3.0], 7)
    assert (from_time(message.command_stamp), from_time(message.header.stamp)) == (5 * NANOSECONDS, bench.clocks.wall)
    # each on its own topic alone
    assert sum(len(heard) for heard in bench.told.values()) == 1


def test_a_torque_that_is_not_told_is_no_number(bench):
    bench.bridge.on_told(TORQUE, payload(TORQUE, 120.5, math.nan), False)
    assert math.isnan(bench.told[TORQUE][0][0].torque[1])


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize(
    "change",
    [
        {"more": 1}, {"seq": -1}, {"seq": True}, {"stamp": 1.5}, {"command_stamp": "5"}, {"values": [1.0]},
        {"values": [1.0, "2"]}, {"values": [1.0, True]}, {"values": [1.0, 1e7]}, {"values": 1.0}, {"values": None},
    ],
)  # fmt: skip
def test_what_is_no_report_is_refused_and_counted(bench, quantity, change):
    change = {quantity.key if key == "values" else key: value for key, value in change.items()}
    document = json.loads(payload(quantity, 120.5, 1.0)) | change
    bench.bridge.on_told(quantity, json.dumps(document).encode(), False)
    assert bench.refused[f"{quantity.name}_{quantity.name}"] == 1 and not bench.told[quantity]


@pytest.mark.parametrize(
    "spoilt", [b"", b"+1.000", b"[1, 2]", payload(TORQUE, 120.5, 1.0).replace(b"120.5", b"NaN"),
               payload(TORQUE, 120.5, 1.0).replace(b"120.5", b"1e999"), payload(CURRENT, 1.0, 2.0)],
)  # fmt: skip
def test_another_payload_is_no_torque(bench, spoilt):
    bench.bridge.on_told(TORQUE, spoilt, False)
    assert bench.refused["torque_torque"] == 1 and not bench.told[TORQUE]


def test_a_current_beyond_any_percentage_is_another_unit(bench):
    # 1001 mA of a motor, not percent of its amplifier
    document = json.loads(payload(CURRENT, 1.0, 2.0)) | {CURRENT.key: [1001.0, 2.0]}
    bench.bridge.on_told(CURRENT, json.dumps(document).encode(), False)
    assert bench.refused["current_current"] == 1 and not bench.told[CURRENT]


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_retained_one_is_of_another_time(bench, quantity):
    bench.bridge.on_told(quantity, payload(quantity, 1.0, 2.0), True)
    assert bench.refused[f"{quantity.name}_retained"] == 1 and not bench.told[quantity]


@pytest.mark.parametrize("quantity", QUANTITIES)
@given(st.lists(st.just(math.nan) | st.floats(-1e3, 1e3), min_size=6, max_size=6), st.integers(0, 1 << 40))
def test_what_is_written_is_read_again(quantity, values, number):
    written = AxisReport.of(StateProperties(number, number, number), values).to_json(quantity)
    read = read_report(quantity, written, 6)
    assert (read.seq, read.stamp, read.command_stamp) == (number,) * 3
    assert read.values == pytest.approx(values, abs=0.0005, nan_ok=True)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_report_or_refused(data):
    with pytest.raises(PayloadError):
        read_report(CURRENT, b'{"current_percent":' + data, 6)


def test_each_quantity_has_a_topic_of_its_own():
    topics = Topics("twin", "kr120")
    assert [topics.told(quantity) for quantity in QUANTITIES] == ["twin/kr120/torque", "twin/kr120/current"]
