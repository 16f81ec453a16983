"""The bridge's side of arming: the first start, a gateway that does not fit, lost answers, and what ends an armed link."""

from __future__ import annotations

import re

import pytest
from supervisor_bench import FAULT, HASH, RUN, SILENCE, TOLERANCE, armed, bench, moved

from construction_twin.core.errors import ReviewError
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.gateway_status import GatewayAnswer, GatewayStatus, read
from construction_twin.link.observations import FRESH, STATUS_TIMEOUT, LinkState
from construction_twin.link.supervisor import RETRY
from construction_twin.mqtt.messages import arm_value

#: Fixtures of the bench.
__all__ = ["armed", "bench"]


class TestFirstStart:
    def test_begins_disconnected(self, bench):
        bench.supervisor.inputs.on_connection(False)
        bench.run(0.1)
        assert bench.state is LinkState.DISCONNECTED and not bench.forwarded

    def test_waits_for_a_gateway(self, bench):
        bench.speaking = False
        bench.run(0.1)
        assert bench.state is LinkState.GATEWAY_OFFLINE and "rsi_gateway" in bench.supervisor.reason

    @pytest.mark.parametrize("state", ["no_controller", "joined_running", "read_only", "measuring", "other_cycle"])
    def test_waits_for_a_controller_and_says_what_the_gateway_says(self, bench, state):
        bench.set_gateway(state, "no telegram yet")
        bench.run(0.1)
        assert bench.state is LinkState.NO_CONTROLLER and "no telegram yet" in bench.supervisor.reason

    def test_arms_by_itself_with_the_configuration_s_hash(self, bench):
        bench.run(0.5)
        assert bench.state is LinkState.ARMED and bench.forwarded
        assert bench.verbs == ["arm"]
        assert (bench.sent[0].value, bench.sent[0].session) == (arm_value(HASH, RUN), bench.supervisor.session)

    def test_the_new_session_is_known_before_it_is_armed(self, bench):
        bench.command = None
        bench.run(0.1)
        assert bench.state is LinkState.RESYNC and bench.supervisor.session and bench.sent == []

    @pytest.mark.parametrize("distance, state", [(0.99, LinkState.ARMED), (-1.01, LinkState.RESYNC)])
    def test_arms_only_while_the_stream_is_within_tolerance_of_the_arm(self, bench, distance, state):
        bench.command = moved(distance * TOLERANCE)
        bench.run(1.0)
        assert bench.state is state

    def test_an_arm_that_moves_is_not_armed_until_it_rests(self, bench):
        # a program of the controller moves it, and the twin follows closely: nobody has seen it at rest
        for k in range(50):
            bench.pose = bench.command = moved(k * 0.1 * TOLERANCE)
            bench.poll()
        assert bench.state is LinkState.RESYNC and bench.sent == []
        bench.run(0.5)
        assert bench.state is LinkState.ARMED

    def test_forwards_nothing_before_it_is_armed(self, bench):
        bench.answering = False
        bench.run(0.3)
        assert bench.state is LinkState.RESYNC and bench.verbs == ["arm"] and not bench.forwarded

    def test_a_command_from_before_the_session_does_not_count(self, bench):
        bench.set_gateway("no_controller")
        bench.run(0.1)
        bench.command = None
        bench.set_gateway("ready")
        bench.run(1.0)
        assert bench.state is LinkState.RESYNC and bench.sent == []

    @pytest.mark.parametrize("what", ["command", "pose"])
    def test_an_old_command_or_pose_does_not_count(self, bench, what):
        bench.answering = False
        bench.run(0.3)
        assert bench.verbs == ["arm"]
        setattr(bench, what, None)
        bench.run((FRESH + 2 * RETRY) / NANOSECONDS)
        last = bench.sent[-1:]
        bench.run(2 * RETRY / NANOSECONDS)
        assert bench.sent[-1:] == last


class TestMismatch:
    @pytest.mark.parametrize(
        "change, word",
        [
            ({"hash": "beef"}, "hash"),
            ({"hash": ""}, "hash"),
            ({"run": ""}, "run"),
            ({"protocol": 1}, "gateway speaks protocol 1, the bridge 2: install the same version on both sides"),
            ({"protocol": 3}, "gateway speaks protocol 3, the bridge 2"),
        ],
    )
    def test_never_arms_another_configuration_and_says_what_differs(self, bench, change, word):
        bench.gateway |= change
        bench.run(1.0)
        assert bench.state is LinkState.MISMATCH and re.search(word, bench.supervisor.reason) and bench.sent == []
        with pytest.raises(ReviewError, match=word):
            bench.supervisor.request_reset(bench.now)

    def test_stops_forwarding_when_the_gateway_comes_back_with_another_configuration(self, armed):
        armed.gateway["hash"] = "beef"
        armed.run(0.1)
        assert armed.state is LinkState.MISMATCH and not armed.forwarded

    def test_arms_when_both_sides_agree_again(self, bench):
        bench.gateway["hash"] = "beef"
        bench.run(0.5)
        bench.gateway["hash"] = HASH
        bench.run(0.5)
        assert bench.state is LinkState.ARMED


class TestAnswers:
    def test_a_lost_answer_is_asked_for_again(self, bench):
        bench.answering = False
        bench.run(0.3)
        assert bench.verbs == ["arm"] and bench.state is LinkState.RESYNC
        bench.answering = True
        bench.run(2.0)
        assert bench.state is LinkState.ARMED
        assert bench.gateway["session"] == bench.supervisor.session

    def test_messages_are_repeated_no_faster_than_the_retry_pause(self, bench):
        bench.answering = False
        bench.carry_out = lambda control: None
        bench.run(5.0)
        assert 8 <= len(bench.sent) <= 5.0 * NANOSECONDS / RETRY + 1
        assert len({control.id for control in bench.sent}) == len(bench.sent)

    def test_a_refusal_is_told_and_asked_again_after_the_pause(self, bench):
        bench.carry_out = lambda control: bench.refuse(control, "the arm is elsewhere")
        bench.run(3.0)
        assert bench.state is LinkState.RESYNC and "the arm is elsewhere" in bench.supervisor.reason
        assert len(bench.sent) <= 3.0 * NANOSECONDS / RETRY + 1

    @pytest.mark.parametrize("answer", [GatewayAnswer(), GatewayAnswer(id="nobody's", ok=True)])
    def test_an_answer_to_something_else_is_ignored(self, bench, answer):
        bench.answering = False
        bench.run(0.3)
        bench.supervisor.on_answer(answer, bench.now)
        assert bench.state is LinkState.RESYNC

    def test_an_answer_to_an_older_attempt_is_ignored(self, bench):
        bench.answering = False
        bench.carry_out = lambda control: None
        bench.run(1.2)
        assert len(bench.sent) >= 2
        bench.answer(bench.sent[0])
        assert bench.state is LinkState.RESYNC
        bench.answer(bench.sent[-1])
        assert bench.state is LinkState.ARMED

    def test_an_answer_after_the_connection_was_lost_does_not_arm(self, bench):
        bench.answering = False
        bench.run(0.3)
        bench.supervisor.inputs.on_connection(False)
        bench.poll()
        bench.answer(bench.sent[0])
        assert bench.state is LinkState.DISCONNECTED


class TestWhileArmed:
    def test_a_status_sent_before_the_arming_does_not_disturb(self, bench):
        bench.run(0.3)
        bench.gateway |= {"state": "ready", "session": ""}
        bench.run(0.3)
        assert bench.state is LinkState.ARMED

    def test_stays_armed_while_the_gateway_follows(self, armed):
        armed.run(10.0)
        assert armed.state is LinkState.ARMED and armed.forwarded and armed.sent == []

    @pytest.mark.parametrize("state, reason", [("braking", SILENCE), ("braking", FAULT), ("holding", FAULT)])
    def test_a_gateway_that_brakes_or_holds_gets_no_more_commands(self, armed, state, reason):
        armed.set_gateway(state, reason)
        armed.poll()
        armed.poll()
        assert armed.state is LinkState.NEEDS_RESET and not armed.forwarded
        assert reason in armed.supervisor.reason

    def test_another_session_at_the_gateway_is_not_ours(self, armed):
        armed.gateway["session"] = "somebody else's"
        armed.run(0.2)
        assert armed.state is LinkState.NEEDS_RESET

    def test_loses_the_gateway_when_its_status_stops(self, armed):
        armed.speaking = False
        armed.run(STATUS_TIMEOUT / NANOSECONDS - 0.1)
        assert armed.state is LinkState.ARMED
        armed.run(0.2)
        assert armed.state is LinkState.GATEWAY_OFFLINE and not armed.forwarded

    def test_loses_the_gateway_at_once_by_its_last_will(self, armed):
        armed.set_gateway("offline", "connection lost")
        armed.run(0.04)
        assert armed.state is LinkState.GATEWAY_OFFLINE


class TestRun:
    """The gateway is started again; its retained status, or the last one under way, is still the former run's."""

    def started_again(self, bench, control, run):
        """What a gateway of this run does with an `arm` that may name another one: it tells its status before it answers."""
        if control is None or control.verb != "arm":
            return
        if control.value == arm_value(HASH, run):
            bench.set_gateway("armed", "armed", session=control.session)
            bench.answer(control)
        else:
            bench.set_gateway("ready", run=run)
            bench.supervisor.inputs.on_status(read(GatewayStatus, bench.gateway), bench.now)
            bench.refuse(control, "run 'run1' is not the gateway's present one")

    def test_a_former_run_s_status_costs_one_refusal_and_no_person(self, bench):
        bench.carry_out = lambda control: self.started_again(bench, control, "run2")
        bench.run(1.0)
        # no farewell of the former run was heard: it may answer still
        assert bench.state is LinkState.MISMATCH and "run run1 and run run2" in bench.supervisor.reason
        bench.run(STATUS_TIMEOUT / NANOSECONDS)
        assert bench.state is LinkState.ARMED and bench.gateway["session"] == bench.supervisor.session
        assert [control.value["run"] for control in bench.sent] == ["run1", "run2"]

    def test_while_the_former_run_s_status_stays_it_says_why_and_asks_at_the_usual_pace(self, bench):
        bench.carry_out = lambda control: bench.refuse(control, "run 'run1' is not the gateway's present one")
        bench.run(5.0)
        assert bench.state is LinkState.RESYNC and "present one" in bench.supervisor.reason
        assert 2 <= len(bench.sent) <= 5.0 * NANOSECONDS / RETRY + 1
        bench.carry_out = lambda control: self.started_again(bench, control, "run2")
        bench.set_gateway("ready", run="run2")
        bench.run((STATUS_TIMEOUT + 2 * RETRY) / NANOSECONDS + 0.5)
        assert bench.state is LinkState.ARMED

    def test_an_arm_that_nobody_answered_is_asked_again_of_the_run_that_is_there_then(self, bench):
        bench.carry_out = lambda control: None
        bench.run(0.3)
        bench.gateway["run"] = "run2"
        bench.carry_out = lambda control: self.started_again(bench, control, "run2")
        bench.run(STATUS_TIMEOUT / NANOSECONDS + 2.0)
        assert bench.state is LinkState.ARMED
        assert [control.value["run"] for control in bench.sent] == ["run1", "run2"]


class TestRefusedArm:
    def test_the_next_attempt_is_another_session_s(self, bench):
        """As when the gateway was armed, its answer came too late, and the session has had its turn."""
        bench.answering = False
        while not bench.sent:
            bench.poll()
        bench.set_gateway("ready")
        bench.refuse(bench.sent[0], "session has had its turn; begin another")
        assert "had its turn" in bench.supervisor.reason
        bench.answering = True
        bench.run(2 * RETRY / NANOSECONDS + 1.0)
        assert bench.state is LinkState.ARMED
        first, second = [control.session for control in bench.sent if control.verb == "arm"]
        assert first != second == bench.supervisor.session

    def test_a_refusal_that_lasts_is_asked_no_more_often_than_before(self, bench):
        bench.answering = False
        for _ in range(200):
            control = bench.poll()
            bench.set_gateway("ready")
            if control is not None:
                bench.refuse(control, "no")
        assert bench.state is LinkState.RESYNC
        assert 2 <= len(bench.sent) <= 200 * 0.02 / (RETRY / NANOSECONDS) + 1


@pytest.mark.parametrize("state", LinkState)
def test_halt_leads_from_everywhere_to_where_only_a_person_leads_on(armed, state):
    armed.supervisor.state = state
    armed.supervisor.halt("halted")
    armed.run(1.0)
    assert (armed.state, armed.supervisor.reason, armed.verbs) == (LinkState.NEEDS_RESET, "halted", [])


def test_values_are_those_of_the_message():
    assert [(state.name, state.value) for state in LinkState] == [
        ("DISCONNECTED", 0), ("GATEWAY_OFFLINE", 1), ("NO_CONTROLLER", 2), ("MISMATCH", 3), ("RESYNC", 4),
        ("ARMED", 5), ("NEEDS_RESET", 6), ("MIRROR", 7), ("OTHER_ARM", 8),
    ]  # fmt: skip
