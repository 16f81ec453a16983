"""The bridge without ROS master and broker: what it makes of the gateway's status, of clocks that are set, and of requests."""

from __future__ import annotations

import json
import sys
import threading
from types import SimpleNamespace

import pytest
import rospy
from bridge_bench import BridgeBench, Clocks
from gateway_cell import RUN, following
from processes import wait_until

from construction_twin.core.units import NANOSECONDS
from construction_twin.link.observations import STATUS_TIMEOUT, LinkState
from construction_twin.link.supervisor import NOT_CHECKED
from construction_twin.ros.nodes import mqtt_bridge
from construction_twin.ros.shared import diagnostics
from construction_twin.rsi.status_channels import RsiStatus


@pytest.fixture
def clocks(monkeypatch):
    rospy.rostime.set_rostime_initialized(True)
    yield Clocks(monkeypatch, mqtt_bridge)
    rospy.rostime.set_rostime_initialized(False)


@pytest.fixture
def bench(clocks):
    return BridgeBench(clocks)


def limit(value, source="/separation"):
    """A message on `speed_limit_in_force`."""
    return SimpleNamespace(limit=value, _connection_header={"callerid": source})


# -- the gateway's status ----------------------------------------------------------------------------------------------


def test_playout_mode_and_intruder_reach_link_and_diagnostics(bench):
    cell = following()
    cell.arm("other")
    shown = bench.shown(cell.gateway.status())
    assert (shown["playout_delay_ms"], shown["playout_jitter_ms"], shown["mode"]) == ("20", "0", "normal")
    assert (shown["intruder_session"], shown["intruder_count"]) == ("other", "1")
    assert shown["last_refusal"].startswith("arm: ")
    # and beside them what was there before
    assert (shown["refused_arm"], shown["decimals"]) == ("1", "3")
    values = bench.bridge.diagnose().values
    assert {f"gateway {name}" for name in shown} - set(values) == {
        "gateway decimals",
        "gateway reply_us_max",
        "gateway states_lost",
    }
    assert values["gateway playout_delay_ms"] == "20"


def test_what_the_controller_says_against_a_motion_stands_in_link_and_diagnostics(bench):
    bench.connect()
    stopped = RsiStatus(3, 4, 100.0)
    status = following().gateway.status() | {"controller": stopped.status_fields()}
    shown = bench.shown(status)
    assert (shown["controller_mode"], shown["controller_program"]) == ("AUT", "STOP")
    assert (shown["controller_override_percent"], shown["controller_sentence"]) == ("100", stopped.sentence)
    assert bench.links[-1][0].reason.endswith(f"; {stopped.sentence}")
    assert bench.bridge.diagnose().sentence.endswith(f"; {stopped.sentence}")
    bench.shown(status | {"controller": RsiStatus(3, 3, 100.0).status_fields()})
    assert "STOP" not in bench.links[-1][0].reason


def test_a_count_of_refused_datagrams_that_grows_is_no_news(bench):
    def told():
        return [json.loads(payload) for topic, payload in bench.client.published if topic.endswith("bridge/status")]

    bench.connect()
    bench.gateway |= {"state": "no_controller", "reason": "no telegram yet"}
    bench.step()
    before, links = len(told()), len(bench.links)
    for k in range(500):
        why = f"xml: telegram is not well-formed: line 1, column {k % 7}"
        bench.gateway["reason"] = f"no telegram yet; datagrams refused: {k // 50}, the last one for {why}"
        bench.step()
    assert len(told()) == before + 1 and "datagrams refused: 0, " in told()[-1]["reason"]
    # `link`, once a second anyway, has the number
    assert len(bench.links) - links in (10, 11) and "datagrams refused: 9, " in bench.links[-1][0].reason
    bench.gateway["reason"] = "no telegram yet; datagrams refused: 9, the last one for address: another sender"
    bench.step()
    assert len(told()) == before + 2 and told()[-1]["reason"].endswith("address: another sender")


def test_what_a_controller_said_before_its_gateway_went_is_not_told(bench):
    bench.connect()
    status = following().gateway.status() | {"controller": RsiStatus(1).status_fields()}
    bench.shown(status)
    bench.shown(status | {"state": "offline", "reason": "gateway stopped"})
    assert bench.links[-1][0].text == "GATEWAY_OFFLINE" and "T1" not in bench.links[-1][0].reason


def test_a_status_whose_playout_cannot_be_read_changes_nothing_and_is_counted(bench):
    status = following().gateway.status()
    before = bench.shown(status)
    spoilt = status | {"state": "offline", "playout": {"delay_ms": [1]}}
    assert bench.shown(spoilt) == before
    assert bench.links[-1][0].gateway_state == "following"
    assert bench.refused == {"status": 1}


# -- counters and threads ----------------------------------------------------------------------------------------------


def test_counters_may_grow_in_other_threads_while_they_are_reported(clocks, monkeypatch):
    """What is refused for a new reason in the MQTT thread must not end the report, and with it the node, in motion."""
    monkeypatch.setattr(
        diagnostics.diagnostic_updater,
        "Updater",
        lambda: SimpleNamespace(setHardwareID=lambda name: None, add=lambda name, task: None, update=lambda: None),
    )
    monkeypatch.setattr(diagnostics, "Publisher", lambda *_, **__: None)
    monkeypatch.setattr(diagnostics.rospy, "Timer", lambda *_: None)
    monkeypatch.setattr(diagnostics.rospy, "logwarn_throttle", lambda *_: None)
    bench = BridgeBench(clocks, diagnostics=lambda report: diagnostics.NodeDiagnostics("arm", report))
    bench.connect()
    status = json.dumps(following().gateway.status()).encode()
    interval, ended = sys.getswitchinterval(), threading.Event()

    def refuse():
        number = 0
        while not ended.is_set():
            number += 1
            bench.diagnostics.refuse(f"state_{number % 4000}", "no")
            bench.bridge.on_status(status)

    threads = [threading.Thread(target=refuse) for _ in range(2)]
    sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        for _ in range(300):
            clocks.run(1.1)
            bench.bridge.poll()
            bench.bridge.diagnose()
    finally:
        ended.set()
        sys.setswitchinterval(interval)
        for thread in threads:
            thread.join()
    assert len(bench.links) == 300 and bench.links[-1][0].states_refused > 0


# -- speed limit, mirror mode, halt ------------------------------------------------------------------------------------


def test_a_speed_limit_goes_to_an_armed_session_changes_at_once_and_repeats_five_times_a_second(bench, clocks):
    bench.bridge.on_speed_limit(limit(0.5))
    assert bench.client.controls == []
    bench.arm()
    for k in range(50):
        bench.bridge.on_speed_limit(limit(0.5 if k < 25 else 0.2))
        clocks.run(0.02)
    sent = [control for control in bench.client.controls if control.verb == "speed_limit"]
    assert [control.value for control in sent] == [0.5] * 3 + [0.2] * 3
    assert [control.id for control in sent] == list("123456")


def test_of_a_speed_limit_that_changes_with_every_message_the_newest_is_sent_fifty_times_a_second(bench):
    bench.arm()
    said = [1.0 - 0.001 * k for k in range(250)]
    for k in range(0, 250, 5):
        for value in said[k : k + 5]:
            bench.bridge.on_speed_limit(limit(value))
        bench.step()
    for _ in range(5):
        bench.step()
    sent = [control for control in bench.client.controls if control.verb == "speed_limit"]
    # the first one at once, then the last one of each 20 ms, each once
    assert [control.value for control in sent] == [said[0], *said[4::5]]
    assert [control.id for control in sent] == [str(number) for number in range(1, 52)]


def test_a_speed_limit_that_waited_when_the_link_was_lost_is_not_sent_later(bench):
    bench.arm()
    for value in (0.2, 0.9):
        bench.bridge.on_speed_limit(limit(value))
    bench.gateway["state"] = "offline"
    bench.step()
    assert bench.bridge.link is LinkState.GATEWAY_OFFLINE
    assert [control.value for control in bench.client.controls if control.verb == "speed_limit"] == [0.2]
    bench.client.published.clear()
    bench.gateway |= {"state": "ready", "session": ""}
    bench.arm()
    assert [control.verb for control in bench.client.controls] == ["arm"]


def test_that_the_arm_led_is_kept_where_the_next_process_finds_it(clocks):
    kept = []
    bench = BridgeBench(clocks, keep=lambda name, value: kept.append(value))
    bench.arm_and_rest()
    assert bench.ask("mirror", data=True).success
    bench.step()
    assert bench.bridge.link is LinkState.MIRROR
    wait_until(lambda: kept and "the arm led" in kept[-1], what="what the next process finds")


def test_halt_is_published_before_it_is_logged_or_anything_else_is_done(bench, monkeypatch):
    bench.arm()
    happened = []
    monkeypatch.setattr(rospy, "loginfo", lambda *_: happened.append("log"))
    publish = bench.client.publish
    monkeypatch.setattr(
        bench.client, "publish", lambda topic, *rest, **more: happened.append(topic) or publish(topic, *rest, **more)
    )
    assert bench.bridge.on_halt(None).success
    assert happened == ["twin/arm/control"] and bench.client.controls[-1].verb == "stop"
    assert bench.bridge.link is LinkState.NEEDS_RESET
    bench.bridge.poll()
    bench.bridge.write_log()
    assert happened.count("log") == 2 and happened[1] == "twin/arm/bridge/status"


def test_halt_without_a_broker_says_that_the_gateway_brakes_by_itself(bench):
    bench.arm()
    bench.client.connected = False
    answer = bench.bridge.on_halt(None)
    assert not answer.success and "brakes by itself" in answer.message and bench.bridge.link is LinkState.NEEDS_RESET


# -- strings that are refused, and the bare PLC --------------------------------------------------------------------


def halted_meanwhile(bench, step):
    """Step the world while a call waits, and halt after a tenth of its time; return when it was halted [ns]."""
    at = []

    def wait():
        step()
        if bench.clocks.steady > began + 100_000_000 and not at:
            bench.bridge.on_halt(None)
            at.append(bench.clocks.steady)

    began, bench.clocks.while_waiting = bench.clocks.steady, wait
    return at


def test_a_reset_that_is_halted_meanwhile_is_answered_at_once(bench):
    bench.arm()
    bench.gateway |= {"state": "holding", "session": "", "fault": True}
    bench.step()
    at = halted_meanwhile(bench, bench.step)
    answer = bench.ask("reset")
    assert not answer.success
    assert answer.message.startswith("not armed: halt was called meanwhile: NEEDS_RESET, ")
    assert bench.clocks.steady - at[0] <= 40_000_000


def answering(bench):
    """Return a step after which the gateway has carried out every control message, and said so; a stop gets a number."""
    done = {control.id for control in bench.client.controls}

    def go_on():
        bench.step()
        for control in bench.client.controls:
            if control.id in done or control.verb == "speed_limit":
                continue
            done.add(control.id)
            ok = control.verb != "reset" or control.value["fault_number"] == bench.gateway["fault_number"]
            if control.verb == "stop":
                number = bench.gateway["fault_number"] + 1
                bench.gateway |= {"state": "holding", "session": "", "fault": True, "fault_number": number}
            elif ok:
                state = {"reset": "ready", "arm": "armed"}[control.verb]
                bench.gateway |= {"state": state, "session": control.session * (state == "armed"), "fault": False}
            bench.bridge.on_status(json.dumps(bench.gateway).encode())
            answer = {"id": control.id, "verb": control.verb, "ok": ok, "reason": "by the test"}
            bench.bridge.on_answer(json.dumps(answer).encode())

    return go_on


def test_a_reset_that_failed_is_withdrawn_at_the_gateway_before_it_is_answered(bench):
    bench.arm()
    bench.gateway |= {"state": "holding", "session": "", "fault": True, "fault_number": 1}
    go_on = bench.clocks.while_waiting = answering(bench)
    go_on()
    bench.commands = False
    answer = bench.ask("reset")
    assert not answer.success and answer.message.startswith("not armed within 1 s: RESYNC, ")
    assert [control.verb for control in bench.client.controls[-2:]] == ["reset", "stop"]
    assert (bench.gateway["fault"], bench.gateway["fault_number"]) == (True, 2)
    # twin and arm are together again, and nothing comes of it for a minute
    bench.commands = True
    sent = len(bench.client.controls)
    for _ in range(3000):
        go_on()
        assert bench.bridge.link is LinkState.NEEDS_RESET
    assert len(bench.client.controls) == sent and bench.links[-1][0].reason.endswith("; call reset")
    assert {pair.key: pair.value for pair in bench.links[-1][0].gateway_counters}["fault_number"] == "2"
    # and a person who asks again, at once too, knows the stop with which it was withdrawn
    answer = bench.ask("reset")
    assert answer.success, answer.message


def test_a_stop_that_comes_while_a_reset_waits_is_answered_at_once(bench):
    bench.arm()
    bench.gateway |= {"state": "holding", "session": "", "fault": True, "fault_number": 1}
    bench.step()
    bench.commands = False
    began, go_on = bench.clocks.steady, answering(bench)

    def stopped():
        if bench.clocks.steady > began + 100_000_000 and bench.gateway["fault_number"] == 1:
            bench.gateway |= {"state": "holding", "fault": True, "fault_number": 2, "reason": "stop: by anna"}
        go_on()

    bench.clocks.while_waiting = stopped
    answer = bench.ask("reset")
    assert answer.message.startswith(
        "not armed: NEEDS_RESET, gateway was stopped since the call (stop 2): stop: by anna"
    )
    assert not answer.success and bench.clocks.steady - began < 300_000_000


def test_an_end_of_mirror_mode_that_arms_nothing_in_time_says_so_and_arms_nothing_later(bench):
    bench.arm_and_rest()
    go_on = bench.clocks.while_waiting = answering(bench)
    assert bench.ask("mirror", data=True).success
    for _ in range(20):
        go_on()
    bench.commands = False
    answer = bench.ask("mirror", data=False)
    assert answer.success and "; not armed within 1 s: RESYNC, " in answer.message
    bench.commands = True
    for _ in range(500):
        go_on()
        assert bench.bridge.link is LinkState.NEEDS_RESET


def test_a_bare_plc_is_armed_by_name_and_sent_strings_alone(clocks):
    bench = BridgeBench(clocks, kind="plc")
    bench.connect()
    bench.run_bare(20)
    assert bench.bridge.link is LinkState.NEEDS_RESET
    refused = bench.arm_by_name(" ")
    assert not refused.success and "--responsible NAME" in refused.message
    assert not bench.ask("reset").success and bench.client.streamed == []
    bench.clocks.while_waiting = bench.run_bare
    answer = bench.arm_by_name("Ada")
    assert answer.success and "Ada is responsible for what is not checked: configuration, " in answer.message
    bench.run_bare(1)
    link = bench.links[-1][0]
    assert (link.text, link.gateway_kind, link.responsible) == ("ARMED", "plc", "Ada")
    assert tuple(link.not_checked) == NOT_CHECKED
    assert {(topic, pairs) for topic, _, pairs in bench.client.streamed} == {("twin/arm/command", None)}
    assert bench.client.controls == []
    said = json.loads(
        next(payload for topic, payload in bench.client.published[::-1] if topic.endswith("bridge/status"))
    )
    assert (said["responsible"], tuple(said["not_checked"])) == ("Ada", NOT_CHECKED)
    # neither a speed limit nor a stop is understood: silence is
    bench.bridge.on_speed_limit(limit(0.5))
    bench.run_bare(5)
    answer = bench.bridge.on_halt(None)
    assert answer.success and "brakes on silence" in answer.message and bench.client.controls == []
    sent = len(bench.client.streamed)
    bench.run_bare(20)
    assert bench.bridge.link is LinkState.NEEDS_RESET and len(bench.client.streamed) == sent


def test_a_bare_plc_whose_poses_do_not_meet_the_twin_is_not_armed_later(clocks):
    bench = BridgeBench(clocks, kind="plc")
    bench.connect()
    bench.run_bare(20)
    bench.clocks.while_waiting = lambda: bench.run_bare(commands=False)
    answer = bench.arm_by_name("Ada")
    assert not answer.success and answer.message.startswith("not armed within 1 s: RESYNC")
    bench.run_bare(50)
    assert bench.bridge.link is LinkState.NEEDS_RESET and bench.client.streamed == []


def waiting_for_a_name(clocks) -> BridgeBench:
    bench = BridgeBench(clocks, kind="plc")
    bench.connect()
    bench.run_bare(20)
    assert bench.bridge.link is LinkState.NEEDS_RESET
    return bench


def test_a_bare_plc_that_is_armed_in_the_last_moment_is_not_said_to_be_unarmed(clocks):
    bench = waiting_for_a_name(clocks)
    end = clocks.steady + round(0.95 * NANOSECONDS)
    clocks.while_waiting = lambda: bench.run_bare(30, True) if clocks.steady >= end else bench.run_bare(commands=False)
    answer = bench.arm_by_name("Ada")
    assert answer.success is (bench.bridge.link is LinkState.ARMED), answer.message
    bench.run_bare(50)
    assert answer.success is (bench.bridge.link is LinkState.ARMED) is bool(bench.client.streamed)


def test_a_second_person_s_refused_call_does_not_withdraw_the_first_one_s(clocks):
    bench = waiting_for_a_name(clocks)
    refusals = []

    def wait() -> None:
        bench.run_bare()
        if not refusals:
            refusals.append(bench.arm_by_name("Grace"))

    clocks.while_waiting = wait
    answer = bench.arm_by_name("Ada")
    assert not refusals[0].success and "Ada has taken the responsibility" in refusals[0].message
    assert answer.success and "Ada is responsible for" in answer.message and bench.bridge.link is LinkState.ARMED


def test_a_person_whose_arming_was_halted_is_not_told_of_the_next_one_s_and_does_not_end_it(clocks):
    bench = waiting_for_a_name(clocks)
    answers = []

    def wait() -> None:
        bench.run_bare()
        if not answers:
            bench.bridge.on_halt(None)
            answers.append(None)
            answers[0] = bench.arm_by_name("Grace")

    clocks.while_waiting = wait
    answer = bench.arm_by_name("Ada")
    assert answers[0].success and "Grace is responsible for" in answers[0].message
    assert not answer.success and "Grace is responsible for" in answer.message
    assert bench.bridge.link is LinkState.ARMED


def test_properties_beside_a_bare_plc_s_state_are_refused(clocks):
    bench = BridgeBench(clocks, kind="plc")
    bench.connect()
    bench.bridge.on_state(b"+005.730,-057.296", [("seq", "1"), ("stamp", "1"), ("command_stamp", "0")], False)
    bench.bridge.on_state(b"+005.730,-057.296", [], True)
    assert bench.refused == {"state_properties": 1, "state_retained": 1} and bench.physical == []


def test_what_answers_in_the_other_mode_is_named_with_the_argument(clocks):
    bench = BridgeBench(clocks)
    bench.connect()
    bench.bridge.on_status(b"ready")
    bench.bridge.poll()
    assert bench.bridge.link is LinkState.MISMATCH and "gateway_kind:=plc" in bench.links[-1][0].reason
    bench.bridge.on_status(b"offline")
    bench.bridge.poll()
    assert bench.bridge.link is LinkState.GATEWAY_OFFLINE


@pytest.mark.parametrize("word", [b"ready", b"offline"])
def test_a_word_on_status_stops_nothing_while_the_gateway_answers(bench, word):
    bench.arm()
    bench.bridge.on_status(word)
    bench.bridge.poll()
    assert bench.bridge.link is LinkState.ARMED and bench.refused == {"status": 1}
    # the gateway's own word counts at once
    bench.bridge.on_status(json.dumps({"state": "offline", "run": RUN}).encode())
    bench.bridge.poll()
    assert bench.bridge.link is LinkState.GATEWAY_OFFLINE
    bench.bridge.on_status(b"ready")
    bench.bridge.poll()
    assert bench.bridge.link is LinkState.MISMATCH and bench.refused == {"status": 1}


def test_a_word_on_status_is_believed_once_the_gateway_is_silent(bench):
    bench.arm()
    bench.clocks.run(STATUS_TIMEOUT / NANOSECONDS + 0.02)
    bench.bridge.on_status(b"ready")
    bench.bridge.poll()
    assert bench.bridge.link is LinkState.MISMATCH and bench.refused == {}
