"""What a start waits for, in order, each told once; and launch arguments that cannot work."""

from __future__ import annotations

from dataclasses import replace

import pytest

from construction_twin.views.startup import PATIENCE, Deployment, ReportedState, StartUp, StartupInputs, first_missing

CELL = Deployment("/kr120", "real", "10.0.0.5:8883", "10.0.0.6:49152", gateway=False)
GOOD = StartupInputs(
    link=ReportedState("ARMED", "commands flow"),
    sync=ReportedState("IN_SYNC", "the poses agree"),
    execution=ReportedState("IDLE", ""),
    feedback=True,
    twin=True,
    scene=True,
)


READY = "ready; plan with `rosrun construction_twin twin --robot kr120 plan ...`, look with `... watch`"


@pytest.mark.parametrize(
    "change, kind",
    [
        ({"link": None}, "bridge"),
        ({"link": ReportedState("DISCONNECTED", "nobody listens there")}, "broker"),
        ({"link": ReportedState("GATEWAY_OFFLINE", "")}, "gateway_there"),
        ({"link": ReportedState("MISMATCH", "its hash differs")}, "configuration"),
        ({"link": ReportedState("NO_CONTROLLER", "")}, "controller"),
        ({"feedback": False}, "pose"),
        ({"twin": False}, "twin"),
        ({"scene": False}, "scene"),
        ({"link": ReportedState("NEEDS_RESET", "it braked")}, "reset"),
        ({"link": ReportedState("RESYNC", "")}, "same_pose"),
        ({"sync": ReportedState("HOLDING", "joint_a3")}, "gate"),
        ({"sync": ReportedState("STOPPED", "held too long")}, "gate_reset"),
        ({"execution": ReportedState("WAITING", "")}, "executor"),
        ({"execution": None}, "executor"),
    ],
)
def test_what_is_missing_is_named_with_what_to_do(change, kind):
    missing = first_missing(replace(GOOD, **change), CELL)
    assert missing.kind == kind and missing.wait_reason.what and missing.wait_reason.todo
    assert "{" not in missing.wait_reason.what + missing.wait_reason.todo, "whatever a sentence names is known here"


def test_the_first_missing_thing_is_named():
    assert first_missing(StartupInputs(link=ReportedState("NO_CONTROLLER", "")), CELL).kind == "controller"
    assert first_missing(StartupInputs(), CELL).kind == "bridge"
    assert first_missing(GOOD, CELL) is None


@pytest.mark.parametrize(
    "state, kind",
    [
        ("GATEWAY_OFFLINE", "plc"),
        ("MISMATCH", "plc_other"),
        ("NO_CONTROLLER", "plc_pose"),
        ("NEEDS_RESET", "responsible"),
    ],
)
def test_with_a_bare_plc_it_is_the_plc_and_a_person_that_are_waited_for(state, kind):
    missing = first_missing(replace(GOOD, link=ReportedState(state, "")), replace(CELL, gateway_kind="plc"))
    assert missing.kind == kind


def test_without_an_arm_nobody_waits_for_a_link():
    alone = replace(CELL, arm="none")
    assert first_missing(replace(GOOD, link=None, feedback=False), alone) is None
    assert first_missing(StartupInputs(), alone).kind == "twin"


def test_a_mirrored_arm_needs_no_open_gate():
    assert (
        first_missing(replace(GOOD, link=ReportedState("MIRROR", ""), sync=ReportedState("WAITING", "")), CELL) is None
    )


def test_each_line_is_said_once_and_ready_at_the_end():
    startup = StartUp(CELL)
    waiting = StartupInputs(link=ReportedState("DISCONNECTED", "nobody listens there"))
    assert startup.update(waiting, 10.0) == []
    (line,) = startup.update(waiting, 10.0 + PATIENCE)
    assert line == str(startup.missing) and startup.missing.reason == "nobody listens there"
    assert startup.update(waiting, 60.0) == []
    (line,) = startup.update(GOOD, 61.0)
    assert line == READY and startup.missing is None
    assert startup.update(GOOD, 99.0) == []
    lost = replace(GOOD, link=ReportedState("NO_CONTROLLER", "RSI stopped"))
    assert startup.update(lost, 100.0) == []
    (line,) = startup.update(lost, 100.0 + PATIENCE)
    assert line == f"not ready any more, {startup.missing}" and startup.missing.reason == "RSI stopped"
    assert len(startup.update(GOOD, 102.0)) == 1
