"""A record and its ROS message: both directions, field by field."""

from __future__ import annotations

import math
from dataclasses import replace

import genpy
from construction_twin.msg import Execution, Link, Segment, Sync
from diagnostic_msgs.msg import KeyValue
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.reports import ExecutionReport, LinkReport, SyncReport
from construction_twin.robot.segments import Segment as SegmentRecord
from construction_twin.robot.segments import Signal, Switch
from construction_twin.ros.messages.records import from_msg, to_msg

STAMP = 1_795_369_597_396_012_345
RELEASE = Switch("vacuum", False, (Signal("held", False),), 1.5)
SEGMENT = SegmentRecord("carry", 2.5, True, (Signal("held", True),), (RELEASE,), "before", "after")


def test_the_stamp_is_that_of_the_header():
    message = to_msg(ExecutionReport("IDLE", "", stamp=STAMP, plan_start=5), Execution)
    assert (message.header.stamp, message.plan_start) == (genpy.Time(*divmod(STAMP, 10**9)), genpy.Time(0, 5))
    assert from_msg(ExecutionReport, message).stamp == STAMP


def test_records_in_records_come_back_equal_and_of_their_types():
    message = to_msg(SEGMENT, Segment)
    assert [switch.confirm[0].name for switch in message.switches] == ["held"] and message.put == []
    assert from_msg(SegmentRecord, message) == SEGMENT


def test_pairs_of_key_and_value_are_a_mapping():
    report = LinkReport("ARMED", "", gateway_counters={"telegrams": "9"}, not_checked=("age",))
    message = to_msg(report, Link)
    assert message.gateway_counters == [KeyValue("telegrams", "9")] and message.not_checked == ["age"]
    assert from_msg(LinkReport, message) == report


def test_what_has_no_place_on_the_other_side_is_left_alone():
    assert to_msg(ExecutionReport("IDLE", "why"), Sync).reason == "why"
    assert not hasattr(from_msg(SyncReport, Link(text="ARMED", session="s")), "session")


NUMBERS = st.floats(allow_nan=False)


@given(st.text(), st.lists(NUMBERS, max_size=7), NUMBERS, st.integers(0, 2**31), st.booleans())
def test_a_report_comes_back_as_it_was(text, errors, number, count, flag):
    report = SyncReport(
        text, text, error=tuple(errors), round_trip=number, servo_lag=number, violations=count, agreed=flag,
        stamp=count * 10**9 + 1,
    )  # fmt: skip
    assert from_msg(SyncReport, to_msg(report, Sync)) == report
    unknown = from_msg(SyncReport, to_msg(replace(report, round_trip=math.nan), Sync))
    assert math.isnan(unknown.round_trip)
