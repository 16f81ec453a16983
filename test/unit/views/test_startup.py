"""What a start waits for, in order, each told once; and launch arguments that cannot work."""

from __future__ import annotations

from dataclasses import replace

import pytest

from construction_twin.core.sentences import Sentence
from construction_twin.views import preflight
from construction_twin.views.startup import PATIENCE, Deployment, Seen, StartUp, Word, first_missing

CELL = Deployment("/kr120", "real", "10.0.0.5:8883", "10.0.0.6:49152", gateway=False)
GOOD = Seen(
    link=Word("ARMED", "commands flow"),
    sync=Word("IN_SYNC", "the poses agree"),
    execution=Word("IDLE", ""),
    feedback=True,
    twin=True,
    scene=True,
)


READY = Sentence("startup.ready", robot="kr120")


@pytest.mark.parametrize(
    "change, kind",
    [
        ({"link": None}, "bridge"),
        ({"link": Word("DISCONNECTED", "nobody listens there")}, "broker"),
        ({"link": Word("GATEWAY_OFFLINE", "")}, "gateway_there"),
        ({"link": Word("MISMATCH", "its hash differs")}, "configuration"),
        ({"link": Word("NO_CONTROLLER", "")}, "controller"),
        ({"feedback": False}, "pose"),
        ({"twin": False}, "twin"),
        ({"scene": False}, "scene"),
        ({"link": Word("NEEDS_RESET", "it braked")}, "reset"),
        ({"link": Word("RESYNC", "")}, "same_pose"),
        ({"sync": Word("HOLDING", "joint_a3")}, "gate"),
        ({"sync": Word("STOPPED", "held too long")}, "gate_reset"),
        ({"execution": Word("WAITING", "")}, "executor"),
        ({"execution": None}, "executor"),
    ],
)
def test_what_is_missing_is_named_with_what_to_do(change, kind):
    missing = first_missing(replace(GOOD, **change), CELL)
    assert missing.kind == kind and missing.what.key == f"line.startup.{kind}.waits"
    assert missing.action.key == f"line.startup.{kind}.todo"
    # whatever a sentence names is known here
    assert missing.action.values == {
        "broker": "10.0.0.5:8883", "rsi": Sentence("startup.rsi_elsewhere"), "robot": "kr120",
    }  # fmt: skip


def test_the_first_missing_thing_is_named():
    assert first_missing(Seen(link=Word("NO_CONTROLLER", "")), CELL).kind == "controller"
    assert first_missing(Seen(), CELL).kind == "bridge"
    assert first_missing(GOOD, CELL) is None


def off(percent):
    return replace(
        GOOD, clock=f"the controller's clock is {percent:.2f} % slow against this PC's: the arm is as much slower"
    )


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
    missing = first_missing(replace(GOOD, link=Word(state, "")), replace(CELL, gateway_kind="plc"))
    assert missing.kind == kind


def test_without_an_arm_nobody_waits_for_a_link():
    alone = replace(CELL, arm="none")
    assert first_missing(replace(GOOD, link=None, feedback=False), alone) is None
    assert first_missing(Seen(), alone).kind == "twin"


def test_a_mirrored_arm_needs_no_open_gate():
    assert first_missing(replace(GOOD, link=Word("MIRROR", ""), sync=Word("WAITING", "")), CELL) is None


def test_each_line_is_said_once_and_ready_at_the_end():
    startup = StartUp(CELL)
    waiting = Seen(link=Word("DISCONNECTED", "nobody listens there"))
    assert startup.update(waiting, 10.0) == []
    (line,) = startup.update(waiting, 10.0 + PATIENCE)
    assert line == str(startup.missing) and startup.missing.reason == "nobody listens there"
    assert startup.update(waiting, 60.0) == []
    (line,) = startup.update(GOOD, 61.0)
    assert line == READY and startup.missing is None
    assert startup.update(GOOD, 99.0) == []
    lost = replace(GOOD, link=Word("NO_CONTROLLER", "RSI stopped"))
    assert startup.update(lost, 100.0) == []
    (line,) = startup.update(lost, 100.0 + PATIENCE)
    assert (
        line == Sentence("startup.not_ready", waiting=str(startup.missing)) and startup.missing.reason == "RSI stopped"
    )
    assert len(startup.update(GOOD, 102.0)) == 1


FINE = {
    "robot": "kr120_1",
    "arm": "mock",
    "decimals": "3",
    "rsi_port": "0",
    "broker": "true",
    "scene": "",
    "robot_config": "/a",
}


def wrong(name: str, value: str, expected: str) -> Sentence:
    return Sentence("preflight.wrong", name=name, value=value, expected=expected)


def number(lowest: int, highest: int) -> Sentence:
    return Sentence("preflight.expected.number", lowest=lowest, highest=highest)


A_NAME, A_SWITCH = Sentence("preflight.expected.robot"), preflight.one_of(("true", "false"))
A_FILE = Sentence("preflight.expected.file")


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"arm": "foo"}, wrong("arm", "foo", preflight.one_of(("mock", "real", "none")))),
        ({"robot": "KR 120"}, wrong("robot", "KR 120", A_NAME)),
        ({"robot": ""}, wrong("robot", "''", A_NAME)),
        ({"decimals": "7"}, wrong("decimals", "7", number(1, 6))),
        ({"rsi_port": "-1"}, wrong("rsi_port", "-1", number(0, 65535))),
        ({"rsi_port": "²"}, wrong("rsi_port", "²", number(0, 65535))),
        ({"broker": "yes"}, wrong("broker", "yes", A_SWITCH)),
        ({"track": "off"}, wrong("track", "off", A_SWITCH)),
        ({"robot_config": "/nope"}, wrong("robot_config", "/nope", A_FILE)),
        ({"robot_config": ""}, wrong("robot_config", "''", A_FILE)),
        ({"scene": "/nope"}, wrong("scene", "/nope", Sentence("preflight.expected.file_or_none", none="none"))),
        ({"broker_config": "/nope"}, Sentence("preflight.broker_config", path="/nope")),
        (
            {"rsi_listen": "192.168.1.10", "rsi_controller": ""},
            Sentence("preflight.rsi_controller", listen="192.168.1.10"),
        ),
        ({"servo": "perfect"}, wrong("servo", "perfect", preflight.one_of(("ideal", "realistic", "physics")))),
        ({"gateway_kind": "bare"}, wrong("gateway_kind", "bare", preflight.one_of(("rsi", "plc")))),
        ({"gateway_kind": "plc", "track": "true"}, Sentence("preflight.track")),
        ({"console": "maybe"}, wrong("console", "maybe", A_SWITCH)),
        ({"console_port": "0"}, wrong("console_port", "0", number(1, 65535))),
        ({"console": "true", "arm": "none"}, Sentence("preflight.console_arm")),
        (
            {"console": "true", "console_listen": "0.0.0.0"},
            Sentence("preflight.console_site", why="console_listen:=0.0.0.0"),
        ),
        ({"console": "true", "bridge_account": "/a"}, Sentence("preflight.console_site", why="bridge_account")),
        ({"console": "true", "broker_host": "b.cell"}, Sentence("preflight.console_site", why="broker_host:=b.cell")),
    ],
)
def test_an_argument_that_cannot_work_is_one_sentence(change, sentence):
    assert preflight.problem(FINE | change, "/a".__eq__) == sentence


def anonymous(what: str) -> Sentence:
    return Sentence("preflight.anonymous", anonymous=what)


def test_a_bare_plc_needs_neither_gateway_nor_its_account_here():
    bare = REAL | {"gateway_kind": "plc", "gateway": "true", "gateway_account": "", "rsi_listen": "10.0.0.1"}
    assert preflight.problem(bare, "/a".__eq__) == ""
    assert preflight.problem(REAL | {"gateway": "true", "gateway_account": ""}, "/a".__eq__) != ""
    assert preflight.problem(bare | {"bridge_account": ""}, "/a".__eq__) == anonymous("bridge_account:=''")


def test_a_bare_plc_and_a_real_arm_are_possible_and_said_plainly():
    assert preflight.notes(REAL | {"gateway_kind": "plc"}) == [Sentence("preflight.bare")]
    assert preflight.notes(REAL) == preflight.notes(FINE | {"gateway_kind": "plc"}) == []


#: A real arm on a site's broker, with the gateway on the cell PC.
REAL = FINE | {
    "arm": "real", "gateway": "false", "bridge_account": "/a", "broker": "false", "auto_approve": "false",
}  # fmt: skip


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"auto_approve": "true"}, Sentence("preflight.auto_approve")),
        ({"auto_approve": "1", "anonymous_broker_is_meant": "true"}, Sentence("preflight.auto_approve")),
        ({"bridge_account": ""}, anonymous("bridge_account:=''")),
        ({"bridge_account": "", "auto_approve_is_meant": "true"}, anonymous("bridge_account:=''")),
        ({"gateway": "true", "gateway_account": ""}, anonymous("gateway_account:=''")),
        ({"broker": "true", "broker_config": "/a"}, anonymous("broker_config:=/a")),
        ({"anonymous_broker_is_meant": "yes"}, wrong("anonymous_broker_is_meant", "yes", A_SWITCH)),
    ],
)
def test_a_real_arm_without_accounts_or_without_a_person_must_be_meant(change, sentence):
    assert preflight.problem(REAL | change, "/a".__eq__, "/a".__eq__) == sentence


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"auto_approve": "true", "auto_approve_is_meant": "true"},
        {"bridge_account": "", "anonymous_broker_is_meant": "true"},
        {"broker": "true", "broker_config": "/a", "anonymous_broker_is_meant": "True"},
        {"gateway": "true", "gateway_account": "/a"},
        {"arm": "mock", "bridge_account": "", "auto_approve": "true"},
    ],
)
def test_a_real_arm_with_accounts_and_a_person_starts_and_so_does_what_is_meant(change):
    assert preflight.problem(REAL | change, "/a".__eq__, "/a".__eq__) == ""


def test_a_real_arm_needs_a_person_whatever_a_client_calls_itself():
    said = preflight.problem(REAL | {"auto_approve_sources": "/move_group"}, "/a".__eq__)
    assert said == Sentence("preflight.auto_approve_sources", sources="/move_group")
    assert (
        preflight.problem(REAL | {"auto_approve_sources": "/move_group", "auto_approve_is_meant": "true"}, "/a".__eq__)
        == said
    )
    assert preflight.problem(REAL | {"auto_approve_sources": ""}, "/a".__eq__) == ""
    assert preflight.problem(REAL | {"arm": "mock", "auto_approve_sources": "/move_group"}, "/a".__eq__) == ""
