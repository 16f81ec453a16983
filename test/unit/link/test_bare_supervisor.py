"""Bare mode: a PLC that knows only the joint string is armed by a person's name, and by nothing else."""

from __future__ import annotations

import pytest
from supervisor_bench import POSE, TOLERANCE, BareBench, moved

from construction_twin.core.errors import ReviewError
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.gateway_status import GatewayStatus
from construction_twin.link.observations import FRESH, REST, LinkState
from construction_twin.link.supervisor import ARM_COMMAND, NOT_CHECKED


@pytest.fixture
def bench() -> BareBench:
    return BareBench()


@pytest.fixture
def waiting(bench) -> BareBench:
    bench.run(0.5)
    assert bench.state is LinkState.NEEDS_RESET
    return bench


@pytest.fixture
def armed(waiting) -> BareBench:
    waiting.supervisor.request_arm(waiting.now, "Ada")
    waiting.run(0.5)
    assert waiting.state is LinkState.ARMED
    return waiting


class TestArming:
    def test_a_plc_that_is_ready_waits_for_a_person_and_says_how(self, waiting):
        waiting.run(60.0)
        assert waiting.state is LinkState.NEEDS_RESET and not waiting.forwarded
        assert waiting.supervisor.reason == f"a bare PLC is armed by a person, by name: {ARM_COMMAND}"

    def test_a_name_arms_it_and_stands_in_the_reason_with_what_is_not_checked(self, armed):
        assert armed.forwarded and armed.supervisor.responsible == "Ada"
        assert "Ada is responsible for what is not checked: configuration, session, " in armed.supervisor.reason
        assert armed.supervisor.not_checked == NOT_CHECKED and armed.sent == []

    @pytest.mark.parametrize("name", ["", "   ", "\t", "x" * 65, "A\nB", "A\x1b[2J"])
    def test_without_a_name_nothing_is_armed(self, waiting, name):
        with pytest.raises(ReviewError, match="is none: rosrun construction_twin twin arm --responsible NAME"):
            waiting.supervisor.request_arm(waiting.now, name)
        waiting.run(1.0)
        assert waiting.state is LinkState.NEEDS_RESET and waiting.supervisor.responsible == ""

    def test_every_arming_is_another_session_so_that_twin_and_gate_start_over(self, bench):
        before = bench.supervisor.session
        bench.run(0.5)
        bench.supervisor.request_arm(bench.now, "Ada")
        bench.run(0.5)
        first = bench.supervisor.session
        bench.supervisor.halt("halted")
        bench.run(0.5)
        bench.supervisor.request_arm(bench.now, "Grace")
        bench.run(0.5)
        assert bench.state is LinkState.ARMED and len({"", before, first, bench.supervisor.session}) == 4

    @pytest.mark.parametrize("distance, state", [(0.99, LinkState.ARMED), (-1.01, LinkState.RESYNC)])
    def test_strings_begin_only_within_the_start_tolerance_of_the_arm(self, waiting, distance, state):
        waiting.supervisor.request_arm(waiting.now, "Ada")
        waiting.command = moved(distance * TOLERANCE)
        waiting.run(1.0)
        assert waiting.state is state and waiting.forwarded is (state is LinkState.ARMED)

    def test_a_stream_that_passes_the_arm_in_motion_is_not_armed(self, waiting):
        waiting.supervisor.request_arm(waiting.now, "Ada")
        for tenth in range(-30, 31):
            waiting.command = moved(tenth / 10 * TOLERANCE)
            waiting.poll()
            assert waiting.state is LinkState.RESYNC, tenth
        waiting.command = POSE
        waiting.poll()
        assert waiting.state is LinkState.RESYNC
        assert waiting.run(0.5).state is LinkState.ARMED

    def test_a_stream_whose_first_command_meets_the_arm_is_not_armed_before_it_has_rested(self, waiting):
        waiting.supervisor.request_arm(waiting.now, "Ada")
        waiting.run(REST / NANOSECONDS)
        assert waiting.state is LinkState.RESYNC
        waiting.poll()
        assert waiting.state is LinkState.ARMED

    def test_what_a_command_was_before_a_pause_of_the_stream_does_not_count_as_rest(self, waiting):
        waiting.supervisor.request_arm(waiting.now, "Ada")
        waiting.run(REST / NANOSECONDS / 2)
        waiting.command = None
        waiting.run(1.0)
        waiting.command = POSE
        waiting.poll()
        assert waiting.state is LinkState.RESYNC
        assert waiting.run(0.5).state is LinkState.ARMED

    def test_an_arm_that_moves_is_not_armed(self, waiting):
        waiting.pose = moved(5 * TOLERANCE)
        waiting.poll()
        with pytest.raises(ReviewError, match="cannot arm: the arm's pose is unknown or still changing"):
            waiting.supervisor.request_arm(waiting.now, "Ada")

    def test_who_is_responsible_already_is_named(self, armed):
        with pytest.raises(ReviewError, match="cannot arm: ARMED, .*Ada is responsible"):
            armed.supervisor.request_arm(armed.now, "Grace")


@pytest.mark.parametrize("situation", ["waiting", "armed"])
def test_a_reset_without_a_name_is_refused_with_what_to_do_and_changes_nothing(situation, request):
    link = request.getfixturevalue(situation)
    before = link.state
    with pytest.raises(ReviewError, match="cannot reset a bare PLC without a name: .* --responsible NAME$"):
        link.supervisor.request_reset(link.now)
    assert link.run(1.0).state is before


class TestEnds:
    def end(self, bench, state: LinkState) -> None:
        bench.run(0.04)
        assert bench.state is state and not bench.forwarded and bench.supervisor.responsible == ""

    def test_the_plc_says_offline(self, armed):
        armed.word = "offline"
        self.end(armed, LinkState.GATEWAY_OFFLINE)

    def test_an_offline_between_two_polls_ends_it_too(self, armed):
        armed.publish_word("offline")
        armed.publish_word("ready")
        self.end(armed, LinkState.NEEDS_RESET)

    def test_an_offline_that_a_request_came_across_is_not_forgotten(self, armed):
        armed.publish_word("offline")
        armed.publish_word("ready")
        with pytest.raises(ReviewError):
            armed.supervisor.begin_mirror(armed.now)
        self.end(armed, LinkState.NEEDS_RESET)

    def test_no_pose_comes_any_more(self, armed):
        armed.pose = None
        armed.run(FRESH / NANOSECONDS)
        self.end(armed, LinkState.NO_CONTROLLER)
        assert "no valid joint string comes" in armed.supervisor.reason

    def test_the_broker_is_lost(self, armed):
        armed.supervisor.inputs.on_connection(False)
        self.end(armed, LinkState.DISCONNECTED)

    def test_a_person_halts(self, armed):
        armed.supervisor.halt("halted")
        self.end(armed, LinkState.NEEDS_RESET)

    def test_a_gateway_answers_in_its_place(self, armed):
        armed.supervisor.inputs.on_status(GatewayStatus(state="ready"), armed.now)
        armed.word = None
        self.end(armed, LinkState.MISMATCH)
        assert "gateway_kind:=rsi" in armed.supervisor.reason

    def test_whatever_ended_it_only_a_name_arms_it_again(self, armed):
        for word in ("offline", "ready"):
            armed.word = word
            armed.run(5.0)
        assert armed.state is LinkState.NEEDS_RESET and not armed.forwarded


class TestMirror:
    def test_the_arm_leads_and_then_a_person_arms_again(self, armed):
        armed.supervisor.begin_mirror(armed.now)
        armed.run(0.5)
        assert armed.state is LinkState.MIRROR and not armed.forwarded and armed.supervisor.responsible == ""
        armed.supervisor.end_mirror(armed.now)
        armed.run(0.5)
        assert armed.state is LinkState.NEEDS_RESET


def test_a_word_that_was_never_said_is_waited_for(bench):
    bench.word = None
    bench.run(1.0)
    assert bench.state is LinkState.GATEWAY_OFFLINE and "no PLC has said `ready`" in bench.supervisor.reason
