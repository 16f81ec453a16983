"""What a start waits for, in order, each told once; and launch arguments that cannot work."""

from __future__ import annotations

from dataclasses import replace

import pytest

from construction_twin.views import preflight
from construction_twin.views.startup import PATIENCE, Deployment, Seen, StartUp, Word, first_missing

CELL = Deployment("/kr120", "real", "10.0.0.5:8883", "10.0.0.6:49152", gateway=False)
HERE = replace(CELL, arm="mock", gateway=True)
GOOD = Seen(
    link=Word("ARMED", "commands flow"),
    sync=Word("IN_SYNC", "the poses agree"),
    execution=Word("IDLE", ""),
    feedback=True,
    twin=True,
    scene=True,
)


@pytest.mark.parametrize(
    "change, what, action",
    [
        ({"link": None}, "the bridge", "its log"),
        ({"link": Word("DISCONNECTED", "nobody listens there")}, "the MQTT broker 10.0.0.5:8883", "broker_host"),
        ({"link": Word("GATEWAY_OFFLINE", "")}, "the gateway", "on the cell PC with --broker 10.0.0.5:8883"),
        ({"link": Word("MISMATCH", "its hash differs")}, "the gateway's configuration", "export"),
        ({"link": Word("NO_CONTROLLER", "")}, "the controller (RSI)", "start the RSI program"),
        ({"feedback": False}, "the first pose of the arm", "mqtt_bridge"),
        ({"twin": False}, "the twin", "virtual_robot"),
        ({"scene": False}, "the scene", "/kr120/scene"),
        ({"link": Word("NEEDS_RESET", "it braked")}, "a reset", "twin --robot kr120 reset"),
        ({"link": Word("RESYNC", "")}, "twin and arm to take the same pose", "by itself"),
        ({"sync": Word("HOLDING", "joint_a3")}, "the gate to open", "agree"),
        ({"sync": Word("STOPPED", "held too long")}, "the gate to open", "reset"),
        ({"execution": Word("WAITING", "")}, "the executor", "gate"),
        ({"execution": None}, "the executor", "gate"),
    ],
)
def test_what_is_missing_is_named_with_what_to_do(change, what, action):
    missing = first_missing(replace(GOOD, **change), CELL)
    assert missing.what == what and action in missing.action


def test_the_first_missing_thing_is_named():
    assert first_missing(Seen(link=Word("NO_CONTROLLER", "")), CELL).what == "the controller (RSI)"
    assert first_missing(Seen(), CELL).what == "the bridge"
    assert first_missing(GOOD, CELL) is None


def test_advice_fits_what_was_started_here():
    assert "49152 taken?" in first_missing(replace(GOOD, link=Word("GATEWAY_OFFLINE", "")), HERE).action
    assert "mock_rsi" in first_missing(replace(GOOD, link=Word("NO_CONTROLLER", "")), HERE).action


@pytest.mark.parametrize(
    "gateway, real, mock",
    [
        ("no_controller", "start the RSI program, or cure what is refused", "or what it sends"),
        ("measuring", "by itself within seconds", "by itself within seconds"),
        ("other_cycle", "correct RSI_ON", "one rsi_cycle"),
        ("joined_running", "once RSI has timed out", "by itself"),
    ],
)
def test_without_a_session_the_advice_fits_what_the_gateway_says(gateway, real, mock):
    why = "the controller's cycle is 12 ms"
    seen = replace(GOOD, link=Word("NO_CONTROLLER", why, gateway))
    for deployment, advice in ((CELL, real), (HERE, mock)):
        missing = first_missing(seen, deployment)
        assert advice in missing.action and missing.reason == why


def test_what_the_controller_says_against_a_motion_is_told_once_it_stands_and_when_it_is_gone():
    startup, stopped = StartUp(CELL), replace(GOOD, controller="the controller's program is stopped (STOP)")
    assert startup.update(GOOD, 1.0)[0].startswith("ready")
    assert startup.update(stopped, 2.0) == []
    assert startup.update(stopped, 2.0 + PATIENCE) == ["the controller's program is stopped (STOP)"]
    assert startup.update(stopped, 9.0) == []
    # a word of one moment is none
    assert startup.update(GOOD, 9.1) == startup.update(stopped, 9.2) == startup.update(stopped, 30.0) == []
    assert startup.update(GOOD, 31.0) == []
    assert startup.update(GOOD, 31.0 + PATIENCE) == ["the controller reports nothing against a motion any more"]


def off(percent):
    return replace(
        GOOD, clock=f"the controller's clock is {percent:.2f} % slow against this PC's: the arm is as much slower"
    )


def test_a_clock_that_is_off_is_told_once_though_its_figure_wavers_and_when_it_is_right_again():
    startup = StartUp(CELL)
    said = lines_over(startup, lambda now: off(1.2 + 0.01 * (int(4 * now) % 3)), 1.0)
    assert len(said) == 2 and said[0].startswith("ready") and said[1].startswith("the controller's clock is 1.2")
    assert lines_over(startup, lambda now: GOOD, 20.0) == ["the controller's clock is right again"]


def refused(count, why="xml: telegram is not well-formed: line 1, column 19"):
    reason = f"gateway has no RSI session: no telegram yet; datagrams refused: {count}, the last one for {why}"
    return replace(GOOD, link=Word("NO_CONTROLLER", reason, "no_controller"))


def lines_over(startup, seen, begin=0.0):
    """What is said in ten seconds, asked four times a second as the node does."""
    return [line for k in range(40) for line in startup.update(seen(k / 4.0), begin + k / 4.0)]


def test_a_count_that_grows_neither_keeps_a_line_back_nor_makes_another():
    said = lines_over(StartUp(CELL), lambda now: refused(1 + 250 * int(now)), 1.0)
    assert len(said) == 1 and "waiting for the controller (RSI)" in said[0] and "datagrams refused: 251, " in said[0]


def test_reasons_that_alternate_do_not_keep_a_line_back_either():
    garbage = "xml: no element found", "root: the telegram's root is 'Sen'"
    said = lines_over(StartUp(CELL), lambda now: refused(int(4 * now), garbage[int(2 * now) % 2]), 1.0)
    assert len(said) == 1


def test_another_reason_that_stays_is_told():
    startup = StartUp(CELL)
    assert len(lines_over(startup, lambda now: refused(int(now)), 1.0)) == 1
    (line,) = lines_over(startup, lambda now: refused(int(now), "element: the telegram lacks 'AIPos'"), 20.0)
    assert "lacks 'AIPos'" in line


def test_the_port_is_named_where_it_is_known():
    of_the_xml = replace(HERE, rsi="127.0.0.1:0")
    taken = first_missing(replace(GOOD, link=Word("GATEWAY_OFFLINE", "")), of_the_xml).action
    assert "127.0.0.1, PORT of the Ethernet XML taken?" in taken
    elsewhere = first_missing(replace(GOOD, link=Word("NO_CONTROLLER", "")), CELL).action
    assert "sends to the address given to rsi_gateway --listen" in elsewhere


@pytest.mark.parametrize(
    "state, what, action",
    [
        ("GATEWAY_OFFLINE", "the PLC", "`ready`"),
        ("MISMATCH", "the PLC", "gateway_kind"),
        ("NO_CONTROLLER", "the PLC's pose", "`state`"),
        ("NEEDS_RESET", "a person who arms the bare PLC by name", "twin --robot kr120 arm --responsible NAME"),
    ],
)
def test_with_a_bare_plc_it_is_the_plc_and_a_person_that_are_waited_for(state, what, action):
    missing = first_missing(replace(GOOD, link=Word(state, "")), replace(CELL, gateway_kind="plc"))
    assert missing.what == what and action in missing.action


def test_without_an_arm_nobody_waits_for_a_link():
    alone = replace(CELL, arm="none")
    assert first_missing(replace(GOOD, link=None, feedback=False), alone) is None
    assert first_missing(Seen(), alone).what == "the twin"


def test_a_mirrored_arm_needs_no_open_gate():
    assert first_missing(replace(GOOD, link=Word("MIRROR", ""), sync=Word("WAITING", "")), CELL) is None


def test_each_line_is_said_once_and_ready_at_the_end():
    startup = StartUp(CELL)
    waiting = Seen(link=Word("DISCONNECTED", "nobody listens there"))
    assert startup.update(waiting, 10.0) == []
    (line,) = startup.update(waiting, 10.0 + PATIENCE)
    assert line.startswith("waiting for the MQTT broker 10.0.0.5:8883: nobody listens there; start it")
    assert startup.update(waiting, 60.0) == []
    (line,) = startup.update(GOOD, 61.0)
    assert line.startswith("ready; plan with") and "--robot kr120" in line and startup.missing is None
    assert startup.update(GOOD, 99.0) == []
    lost = replace(GOOD, link=Word("NO_CONTROLLER", "RSI stopped"))
    assert startup.update(lost, 100.0) == []
    (line,) = startup.update(lost, 100.0 + PATIENCE)
    assert line.startswith("not ready any more, waiting for the controller (RSI): RSI stopped; ")
    assert len(startup.update(GOOD, 102.0)) == 1


@pytest.mark.parametrize(
    "state, reason, line",
    [
        (
            "DISCONNECTED",
            "not connected to the broker: broker 10.0.0.5:8883: nobody listens there; start the broker, or check host and port",
            "waiting for the MQTT broker 10.0.0.5:8883: nobody listens there; start the broker, or check host and port",
        ),
        (
            "DISCONNECTED",
            "not connected to the broker yet",
            "waiting for the MQTT broker 10.0.0.5:8883: start it, or give broker_host and broker_port",
        ),
        (
            "GATEWAY_OFFLINE",
            "no gateway answers on the broker; start rsi_gateway on the cell PC",
            "waiting for the gateway: start rsi_gateway on the cell PC with --broker 10.0.0.5:8883",
        ),
        (
            "NEEDS_RESET",
            "gateway was stopped and is holding: stop: ada stopped it; call reset",
            "waiting for a reset: holding: stop: ada stopped it; remove the cause, then on the robot's PC: "
            "rosrun construction_twin twin --robot kr120 reset",
        ),
    ],
)
def test_nothing_is_said_twice_in_a_line(state, reason, line):
    startup = StartUp(CELL)
    assert startup.update(Seen(link=Word(state, reason), feedback=True, twin=True, scene=True), 10.0) == []
    assert startup.update(Seen(link=Word(state, reason), feedback=True, twin=True, scene=True), 10.0 + PATIENCE) == [
        line
    ]


def test_a_clock_that_is_no_controller_s_is_not_mended_in_the_program():
    reason = "the controller's clock runs 0.25 times as fast as real time: what sends is no controller in real time"
    missing = first_missing(replace(GOOD, link=Word("NO_CONTROLLER", reason, "other_cycle")), CELL)
    assert missing.kind == "no_clock" and "RSI_ON" not in missing.action and "milliseconds" in missing.action
    reason = "the controller's cycle is 12 ms (IPOC steps of 12); expected 4"
    missing = first_missing(replace(GOOD, link=Word("NO_CONTROLLER", reason, "other_cycle")), CELL)
    assert missing.kind == "cycle"


def test_what_comes_up_by_itself_is_no_news():
    startup = StartUp(CELL)
    assert startup.update(Seen(), 1.0) == []
    assert startup.update(Seen(link=Word("DISCONNECTED", "")), 1.0 + 0.6 * PATIENCE) == []
    assert startup.update(Seen(link=Word("RESYNC", "")), 1.0 + 1.2 * PATIENCE) == []
    assert len(startup.update(GOOD, 1.0 + 1.5 * PATIENCE)) == 1


FINE = {
    "robot": "kr120_1",
    "arm": "mock",
    "decimals": "3",
    "rsi_port": "0",
    "broker": "true",
    "scene": "",
    "robot_config": "/a",
}


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"arm": "foo"}, "arm:=foo: expected mock, real or none"),
        ({"robot": "KR 120"}, "robot:=KR 120: expected a name"),
        ({"robot": ""}, "robot:='': expected a name"),
        ({"decimals": "7"}, "decimals:=7: expected a whole number from 1 to 6"),
        ({"rsi_port": "-1"}, "rsi_port:=-1: expected a whole number"),
        ({"rsi_port": "²"}, "rsi_port:=²: expected a whole number"),
        ({"frame_rate": "0"}, "frame_rate:=0: expected a whole number from 1 to 250"),
        ({"frame_rate": "251"}, "frame_rate:=251: expected a whole number from 1 to 250"),
        ({"frame_rate": "12.5"}, "frame_rate:=12.5: expected a whole number from 1 to 250"),
        ({"broker": "yes"}, "broker:=yes: expected true or false"),
        ({"track": "off"}, "track:=off: expected true or false"),
        ({"robot_config": "/nope"}, "robot_config:=/nope: expected the absolute path"),
        ({"robot_config": ""}, "robot_config:='': expected the absolute path"),
        ({"scene": "/nope"}, "scene:=/nope: expected the absolute path of a file that can be read, or none"),
        ({"broker_config": "/nope"}, "broker_config:=/nope: expected"),
        ({"rsi_listen": "192.168.1.10", "rsi_controller": ""}, "rsi_controller:='': expected the controller's address"),
        ({"servo": "perfect"}, "servo:=perfect: expected ideal or realistic"),
        ({"gateway_kind": "bare"}, "gateway_kind:=bare: expected rsi or plc"),
        ({"gateway_kind": "plc", "track": "true"}, "track:=true with gateway_kind:=plc: "),
        ({"console": "maybe"}, "console:=maybe: expected true or false"),
        ({"console_port": "0"}, "console_port:=0: expected a whole number from 1 to 65535"),
        ({"console_key": "/nope"}, "console_key:=/nope: expected the absolute path"),
        ({"console": "true", "arm": "none"}, "console:=true with arm:=none: nothing is told by MQTT"),
        ({"console": "true", "console_certificate": "/a"}, "console_key:='': expected a file, because"),
        ({"console": "true", "console_key": "/a"}, "console_certificate:='': expected a file, because"),
        (
            {"console": "true", "console_listen": "0.0.0.0"},
            "console_listen:=0.0.0.0: expected loopback, or console_cert",
        ),
        ({"console": "true", "bridge_account": "/a"}, "console_broker_ca:='' with bridge_account: expected the ca.crt"),
        ({"console": "true", "broker_host": "b.cell"}, "console_broker_ca:='' with broker_host:=b.cell: expected"),
    ],
)
def test_an_argument_that_cannot_work_is_one_sentence(change, sentence):
    assert preflight.problem(FINE | change, "/a".__eq__).startswith(sentence)


def test_none_is_no_file_of_a_scene_but_of_nothing_else():
    assert preflight.problem(FINE | {"scene": "none"}, "/a".__eq__) == ""
    assert preflight.problem(FINE | {"robot_config": "none"}, "/a".__eq__).startswith("robot_config:=none: expected")


def test_arguments_that_can_work_pass():
    assert preflight.problem(FINE, "/a".__eq__) == ""
    network = {"rsi_listen": "192.168.1.10", "rsi_controller": ""}
    for fine in ({"rsi_controller": "krc4"}, {"rsi_listen": "127.0.0.2"}, {"gateway": "false"}, {"arm": "none"}):
        assert preflight.problem(FINE | network | fine, "/a".__eq__) == ""
    assert preflight.problem(FINE | {"broker": "false", "broker_config": "/nope"}, "/a".__eq__) == ""


def test_a_console_on_a_site_and_one_on_this_machine_can_work():
    site = {"bridge_account": "/a", "broker_host": "b.cell", "console_broker_ca": "/a", "console_listen": "0.0.0.0"}
    assert preflight.problem(FINE | {"console": "true"}, "/a".__eq__) == ""
    tls = {"console_certificate": "/a", "console_key": "/a"}
    assert preflight.problem(FINE | {"console": "true"} | site | tls, "/a".__eq__) == ""
    assert preflight.problem(FINE | {"console": "false", "console_listen": "0.0.0.0"}, "/a".__eq__) == "", "not started"


def test_a_bare_plc_needs_neither_gateway_nor_its_account_here():
    bare = REAL | {"gateway_kind": "plc", "gateway": "true", "gateway_account": "", "rsi_listen": "10.0.0.1"}
    assert preflight.problem(bare, "/a".__eq__) == ""
    assert preflight.problem(REAL | {"gateway": "true", "gateway_account": ""}, "/a".__eq__) != ""
    assert preflight.problem(bare | {"bridge_account": ""}, "/a".__eq__).startswith("bridge_account:='' with arm:=real")


def test_a_bare_plc_and_a_real_arm_are_possible_and_said_plainly():
    (note,) = preflight.notes(REAL | {"gateway_kind": "plc"})
    for words in ("not checked", "twin arm --responsible NAME", "docs/broker.md", "session, sequence and age"):
        assert words in note
    assert preflight.notes(REAL) == preflight.notes(FINE | {"gateway_kind": "plc"}) == []


#: A real arm on a site's broker, with the gateway on the cell PC.
REAL = FINE | {
    "arm": "real", "gateway": "false", "bridge_account": "/a", "broker": "false", "auto_approve": "false",
}  # fmt: skip


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"auto_approve": "true"}, "auto_approve:=true with arm:=real: "),
        ({"auto_approve": "1", "anonymous_broker_is_meant": "true"}, "auto_approve:=true with arm:=real: "),
        ({"bridge_account": ""}, "bridge_account:='' with arm:=real: "),
        ({"bridge_account": "", "auto_approve_is_meant": "true"}, "bridge_account:='' with arm:=real: "),
        ({"gateway": "true", "gateway_account": ""}, "gateway_account:='' with arm:=real: "),
        ({"broker": "true", "broker_config": "/a"}, "broker_config:=/a with arm:=real: "),
        ({"anonymous_broker_is_meant": "yes"}, "anonymous_broker_is_meant:=yes: expected true or false"),
    ],
)
def test_a_real_arm_without_accounts_or_without_a_person_must_be_meant(change, sentence):
    said = preflight.problem(REAL | change, "/a".__eq__, "/a".__eq__)
    assert said.startswith(sentence)
    # one sentence that says what to do
    assert "expected" in said or "_is_meant:=true" in said


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
    assert said.startswith(
        "auto_approve_sources:=/move_group with arm:=real: expected none, because the name of a client proves"
    )
    assert (
        preflight.problem(REAL | {"auto_approve_sources": "/move_group", "auto_approve_is_meant": "true"}, "/a".__eq__)
        == said
    )
    assert preflight.problem(REAL | {"auto_approve_sources": ""}, "/a".__eq__) == ""
    assert preflight.problem(REAL | {"arm": "mock", "auto_approve_sources": "/move_group"}, "/a".__eq__) == ""
