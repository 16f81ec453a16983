"""`view` on MQTT: what stands in a message, and how far a plan has come."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
import schemas

from construction_twin.core.freshness import Moment
from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SpeedReport, SyncReport
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.remote_view import (
    COMPATIBLE,
    VERSION,
    FreshReport,
    PlanProgress,
    PoseView,
    ViewInputs,
    ViewWriter,
)
from construction_twin.link.requests import Joints

SCHEMA = json.loads(schemas.view_schema())
JOINTS = Joints(("track", "joint_a1"), (True, False))
NOW = 1_795_369_597_396_012_345
MOMENT = Moment("c0ffee00", 81_234_567_890)
INPUTS = ViewInputs(
    PoseView(1_795_369_597.39, 0.004, (1.5, math.pi / 3)),
    PoseView(1_795_369_597.388, 0.0061234567, (1.5, 1.0471)),
    FreshReport(
        SyncReport("IN_SYNC", "agree", "resume", "", (0.0, 0.0001), (0.001, 0.01), 0.03125, violations=3, agreed=True),
        0.01,
    ),
    FreshReport(
        LinkReport("ARMED", "well", "following", {"late_replies": "4", "controller_mode": "T1"}, gateway_kind="rsi"),
        0.7,
    ),
    FreshReport(
        ExecutionReport(
            "PLAYING", "plays p1", "p1", duration=8.0, rate=1.0, speed_limit=1.0, segment=1, segment_name="carry"
        ),
        2.0,
    ),
    "p2",
    0.25,
)


def writer() -> ViewWriter:
    return ViewWriter("kr120", "cafe", JOINTS)


def read(payload: bytes) -> dict:
    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    return json.loads(payload, parse_constant=refuse)


def properties(node: dict) -> dict:
    """Return what may stand at a place of the schema, and check that all of it must, and nothing else may."""
    if "$ref" in node:
        node = SCHEMA["$defs"][node["$ref"].rpartition("/")[2]]
    if "properties" in node:
        assert sorted(node["required"]) == sorted(node["properties"]) and node["additionalProperties"] is False
    return node.get("properties", {})


def test_the_message_has_the_keys_of_the_schema_at_every_level():
    held = replace(INPUTS, hold=HoldReport("joint_a1 differs", NOW), speed=SpeedReport(), expected=INPUTS.arm)
    message = read(writer().write(NOW, held, MOMENT))
    assert set(message) == set(properties(SCHEMA))
    for key, node in properties(SCHEMA).items():
        inner = properties(node)
        if inner:
            assert set(message[key]) == set(inner), key
        for name, deeper in inner.items():
            if properties(deeper):
                assert set(message[key][name]) == set(properties(deeper)), (key, name)
    assert SCHEMA["properties"]["version"]["const"] == message["version"] == VERSION
    assert SCHEMA["properties"]["compatible"]["const"] == message["compatible"] == COMPATIBLE
    assert SCHEMA["properties"]["units"]["const"] == message["units"]


def test_a_hold_and_what_is_against_an_approval_are_in_it():
    held = replace(INPUTS, hold=HoldReport("joint_a1 differs", NOW - 10**9))
    report = replace(INPUTS.execution.report, approval_obstacle="not in sync", overridable=True)
    held = replace(held, execution=replace(INPUTS.execution, report=report))
    message = read(writer().write(NOW, held, MOMENT))
    assert message["hold"] == {"cause": "joint_a1 differs", "since": 1_795_369_596.396012}
    assert (message["approval_obstacle"], message["overridable"]) == ("not in sync", True)
    well = read(writer().write(NOW, INPUTS, MOMENT))
    assert (well["hold"], well["approval_obstacle"]) == (None, "")
    without = read(writer().write(NOW, replace(held, plan=""), MOMENT))
    assert without["approval_obstacle"] == "", "there is no plan that it could stand against"


def test_the_speed_limit_and_the_controller_s_own_words_are_in_it():
    said = SpeedReport(0.2, "people", "dora has it", 0.2, "dora", NOW - 10**9, 0.5, "bob", 1.0, "", 1)
    message = read(writer().write(NOW, replace(INPUTS, speed=said), MOMENT))
    assert message["speed"] == {
        "limit": 0.2, "by": "people", "reason": "dora has it", "people": 0.2, "person": "dora",
        "since": 1_795_369_596.396012, "replaced": 0.5, "replaced_person": "bob",
    }  # fmt: skip
    assert read(writer().write(NOW, INPUTS, MOMENT))["speed"] is None

    def controller(**counters: str) -> dict | None:
        told = {f"controller_{name}": value for name, value in counters.items()}
        link = FreshReport(LinkReport("ARMED", "", "following", told, gateway_kind="rsi"), 0.0)
        return read(writer().write(NOW, replace(INPUTS, link=link), MOMENT))["link"]["controller"]

    assert controller(mode="T1", program="ACTIVE", override_percent="12.5", sentence="x") == {
        "mode": "T1",
        "program": "ACTIVE",
        "override_percent": 12.5,
    }
    # the controller's XML has one of them
    assert controller(mode="AUT") == {"mode": "AUT", "program": "", "override_percent": None}
    assert controller(override_percent="0") == {"mode": "", "program": "", "override_percent": 0.0}
    for told in ({}, {"sentence": ""}, {"mode": "", "program": "", "override_percent": ""}, {"override_percent": "?"}):
        assert controller(**told) is None
    assert read(writer().write(NOW, replace(INPUTS, link=None), MOMENT))["link"] is None


def test_messages_of_a_run_are_numbered_so_that_a_lost_or_old_one_is_noticed():
    first = writer()
    assert [read(first.write(NOW, ViewInputs(), MOMENT))["seq"] for _ in range(3)] == [1, 2, 3]
    farewell = read(first.offline())
    assert (farewell["online"], farewell["seq"], farewell["stamp"], farewell["run"]) == (False, 0, 0.0, "cafe")
    assert set(farewell) == set(SCHEMA["properties"]) and farewell["twin"] is farewell["link"] is None


def test_a_message_stays_small():
    names = tuple(f"joint_a{k}" for k in range(1, 8))
    seven = ViewWriter("kr120", "0123456789abcdef", Joints(names, (False,) * 7))
    pose = PoseView(NOW / NANOSECONDS, 0.0123456789, (-math.pi,) * 7)
    seven_values = (0.123456789,) * 7
    sync = SyncReport("HOLDING", "x" * 300, "resume", "", seven_values, seven_values, 0.03125, 0.02, 10**6)
    inputs = ViewInputs(pose, pose, FreshReport(sync, 0.01), INPUTS.link, INPUTS.execution)
    assert len(seven.write(NOW, inputs, MOMENT)) < 2500


# -- progress


def report(
    stamp: float, state: str = "PLAYING", rate: float = 1.0, outcome: str = "", plan: str = "p1", start: float = 100.0
) -> ExecutionReport:
    times = {"plan_start": round(start * NANOSECONDS), "stamp": round(stamp * NANOSECONDS)}
    return ExecutionReport(state, "", plan, outcome, duration=10.0, rate=rate, **times)


def progress(*reports: ExecutionReport) -> PlanProgress:
    made = PlanProgress()
    for each in reports:
        made.on_report(each)
    return made


def test_before_a_plan_there_is_no_progress():
    assert PlanProgress().at(5.0) == 0.0
    assert progress(ExecutionReport("IDLE", "", stamp=99 * NANOSECONDS)).at(200.0) == 0.0


def test_a_plan_played_as_planned_progresses_with_time():
    made = progress(report(100.0))
    assert [made.at(now) for now in (99.0, 100.0, 102.5, 109.0)] == pytest.approx([0.0, 0.0, 0.25, 0.9])
    assert made.at(500.0) < 1.0, "it has not said that it arrived"


def test_a_plan_that_arrived_is_over_and_one_that_was_stopped_is_not():
    assert progress(report(100.0), report(110.1, "IDLE", 1.0, "finished")).at(110.2) == 1.0
    stopped = progress(report(100.0), report(104.0, "STOPPING"), report(106.0, "IDLE", 0.0, "stopped"))
    assert stopped.at(300.0) == pytest.approx(0.5)


def test_a_slower_plan_progresses_more_slowly_and_a_paused_one_not_at_all():
    slow = progress(report(100.0, rate=1.0), report(102.0, rate=1.0), report(104.0, rate=0.5))
    # 2 s at full speed, a ramp of 2 s at 0.75 in the mean, then half
    assert slow.at(106.0) == pytest.approx(0.45)
    paused = progress(
        report(100.0), report(102.0, "PAUSING"), report(103.0, "PAUSED", 0.0), report(110.0, "PLAYING", 0.0)
    )
    assert paused.at(110.0) == pytest.approx(0.25)


def test_another_plan_and_the_same_one_approved_again_begin_at_the_beginning():
    for again in (report(120.0, plan="p2", start=120.0), report(120.0, start=120.0)):
        assert progress(report(100.0), report(105.0), again).at(121.0) == pytest.approx(0.1)


def test_a_program_that_starts_while_a_plan_is_played_knows_where_it_is():
    assert progress(report(104.0)).at(105.0) == pytest.approx(0.5)
