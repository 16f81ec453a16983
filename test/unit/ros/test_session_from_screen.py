"""`reset` and `arm` from a screen elsewhere: the bridge lifts only what the screen had shown, and tells who asked."""

from __future__ import annotations

import json

import pytest
import rospy
from bridge_bench import BridgeBench, Clocks

from construction_twin.core.freshness import LIFETIME, Moment
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.observations import SHOWN_AFTER, LinkState
from construction_twin.ros.nodes import mqtt_bridge

BOOT = "c0ffee00"


@pytest.fixture
def clocks(monkeypatch):
    rospy.rostime.set_rostime_initialized(True)
    made = Clocks(monkeypatch, mqtt_bridge)
    monkeypatch.setattr(mqtt_bridge, "present_moment", lambda: Moment(BOOT, made.steady))
    yield made
    rospy.rostime.set_rostime_initialized(False)


@pytest.fixture
def stopped(clocks) -> BridgeBench:
    """A link that was halted, a second ago."""
    bench = BridgeBench(clocks)
    bench.arm_and_rest()
    bench.bridge.on_halt(None)
    for _ in range(50):
        bench.step()
    assert bench.bridge.link is LinkState.NEEDS_RESET
    return bench


def now(bench: BridgeBench) -> str:
    return str(Moment(BOOT, bench.clocks.steady))


def go_on(bench: BridgeBench) -> None:
    """Let 20 ms pass, with a gateway that does what it is told."""
    bench.step()
    for control in bench.client.controls[-1:]:
        state = {"reset": "ready", "arm": "armed", "stop": "stopped"}[control.verb]
        bench.gateway |= {"state": state, "session": control.session}
        bench.bridge.on_answer(json.dumps({"id": control.id, "ok": True, "verb": control.verb}).encode())


def reset(bench: BridgeBench, moment: str, verb: str = "reset"):
    bench.clocks.while_waiting = lambda: go_on(bench)
    return bench.ask("~act_as_seen", act=verb, person="ada", moment=moment)


def test_what_the_screen_shows_is_lifted(stopped):
    answer = reset(stopped, now(stopped))
    assert (answer.success, answer.expired) == (True, False) and stopped.bridge.link is LinkState.ARMED


def test_who_asked_and_what_is_lifted_is_told(stopped):
    why = stopped.links[-1][0].reason
    reset(stopped, now(stopped))
    (told,) = (content for (content,) in stopped.asked)
    assert (told.verb, told.person, told.lifts) == ("reset", "ada", why)


def test_a_service_at_the_robot_knows_no_name(stopped):
    stopped.clocks.while_waiting = lambda: go_on(stopped)
    assert stopped.ask("reset").success
    assert [content.person for (content,) in stopped.asked] == [""]


def test_a_stop_that_the_screen_had_not_shown_is_not_lifted(stopped):
    seen = now(stopped)
    stopped.step()
    stopped.bridge.on_halt(None)
    answer = reset(stopped, seen)
    assert not answer.success and answer.expired and "stopped after" in answer.message
    assert stopped.bridge.link is LinkState.NEEDS_RESET and stopped.refused["too_old"] == 1 and not stopped.asked
    for _ in range(50):
        stopped.step()
    assert reset(stopped, now(stopped)).success


def test_a_stop_of_the_gateway_counts_as_much(stopped):
    seen = now(stopped)
    stopped.gateway |= {"fault_number": 7, "reason": "asked by account bob", "state": "fault"}
    stopped.step()
    answer = reset(stopped, seen)
    assert not answer.success and answer.expired


def test_what_the_screen_had_shown_long_ago_lifts_nothing(stopped):
    seen = now(stopped)
    stopped.clocks.run(LIFETIME / NANOSECONDS + 0.1)
    answer = reset(stopped, seen)
    assert not answer.success and answer.expired and stopped.bridge.link is LinkState.NEEDS_RESET


@pytest.mark.parametrize("moment", ["", "now", f"deadbeef-{10**9}"])
def test_without_a_moment_of_this_computer_nothing_is_lifted(stopped, moment):
    assert not reset(stopped, moment).success and stopped.bridge.link is LinkState.NEEDS_RESET


def test_to_arm_lifts_no_stop(stopped):
    answer = reset(stopped, now(stopped), "arm")
    assert not answer.success and "call reset" in answer.message and stopped.bridge.link is LinkState.NEEDS_RESET


def test_a_view_shows_a_stop_a_while_after_it_is_known(stopped):
    stopped.bridge.on_halt(None)
    known = stopped.clocks.steady
    assert not reset(stopped, now(stopped)).success
    for _ in range(50):
        stopped.step()
    millisecond = NANOSECONDS // 1000
    assert reset(stopped, str(Moment(BOOT, known + SHOWN_AFTER))).expired
    assert reset(stopped, str(Moment(BOOT, known + SHOWN_AFTER + millisecond))).success
