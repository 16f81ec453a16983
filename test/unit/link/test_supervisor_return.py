"""How an interrupted link comes back: by itself where nothing could jump, otherwise by a person's reset."""

from __future__ import annotations

import math
import re

import pytest
from supervisor_bench import DECIMALS, FAULT, POLL, POSE, SILENCE, STOP, TOLERANCE, armed, bench, moved

from construction_twin.core.errors import ReviewError
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.observations import FRESH, REST, LinkState

#: Fixtures of the bench.
__all__ = ["armed", "bench"]


class TestReturn:
    """Law 5: by itself only where nothing could jump; everything else waits for a person."""

    def test_after_silence_within_tolerance_it_goes_on_in_a_new_session(self, armed):
        session = armed.supervisor.session
        armed.set_gateway("holding", SILENCE)
        armed.run(1.0)
        assert armed.state is LinkState.ARMED and armed.supervisor.session != session
        assert armed.verbs == ["reset", "arm"]

    def test_after_silence_outside_tolerance_it_needs_a_reset(self, armed):
        armed.set_gateway("holding", SILENCE)
        armed.pose = moved(1.1 * TOLERANCE)
        armed.run(5.0)
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == []

    def test_while_the_arm_still_moves_it_does_not_go_on(self, armed):
        armed.set_gateway("holding", SILENCE)
        for k in range(100):
            armed.pose = armed.command = moved((k % 2) * 0.9 * TOLERANCE)
            armed.poll()
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == []

    @pytest.mark.parametrize("reason", [FAULT, STOP, "", "silenced by somebody"])
    def test_after_anything_but_silence_it_needs_a_reset_even_within_tolerance(self, armed, reason):
        armed.set_gateway("holding", reason)
        armed.run(5.0)
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == []

    def test_a_gateway_whose_program_has_failed_is_restarted_before_a_reset(self, armed):
        armed.set_gateway("failed", FAULT)
        armed.run(1.0)
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == []
        assert armed.supervisor.reason.endswith("restart rsi_gateway, then call reset")
        for request in (armed.supervisor.request_reset, armed.supervisor.request_arm):
            with pytest.raises(ReviewError, match="restart rsi_gateway"):
                request(armed.now)
        armed.run(1.0)
        assert armed.sent == []

    @pytest.mark.parametrize(
        "stop, state",
        [
            ({"cause": "silence"}, LinkState.ARMED),
            ({"cause": "stop"}, LinkState.NEEDS_RESET),
            ({}, LinkState.NEEDS_RESET),
        ],
    )
    def test_the_cause_in_the_status_counts_and_not_the_sentence(self, armed, stop, state):
        sentence = "kein Sollwert seit 0,104 s" if state is LinkState.ARMED else SILENCE
        armed.set_gateway("holding", sentence, stop=stop)
        armed.run(2.0)
        assert armed.state is state

    def test_a_cause_of_a_stop_before_does_not_count_while_the_gateway_does_something_else(self, armed):
        armed.set_gateway("joined_running", SILENCE, stop={"cause": "silence"}, session="")
        armed.run(0.5)
        armed.set_gateway("braking", SILENCE, stop={"cause": "silence"})
        armed.run(0.5)
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == []

    def test_a_bridge_started_while_the_gateway_holds_after_silence_goes_on_within_tolerance(self, bench):
        bench.set_gateway("holding", SILENCE, session="an older bridge's")
        bench.run(1.0)
        assert bench.state is LinkState.ARMED

    def test_a_bridge_started_while_the_gateway_holds_after_silence_elsewhere_needs_a_reset(self, bench):
        bench.set_gateway("holding", SILENCE)
        bench.pose = moved(-1.1 * TOLERANCE)
        bench.run(5.0)
        assert bench.state is LinkState.NEEDS_RESET and "call reset" in bench.supervisor.reason and bench.sent == []

    def test_a_bridge_started_while_the_gateway_still_follows_waits_until_it_holds(self, bench):
        bench.set_gateway("following", session="an older bridge's")
        bench.run(0.1)
        assert bench.state is LinkState.NEEDS_RESET and bench.sent == []
        bench.set_gateway("braking", SILENCE, session="")
        bench.run(0.1)
        assert bench.sent == []
        bench.set_gateway("holding", SILENCE)
        bench.run(1.0)
        assert bench.state is LinkState.ARMED

    def test_a_bridge_started_while_the_gateway_is_armed_for_a_stream_that_never_began_goes_on(self, bench):
        bench.set_gateway("armed", "armed", session="an older bridge's")
        bench.run(1.0)
        assert bench.state is LinkState.ARMED and bench.verbs == ["reset", "arm"]

    def test_a_controller_restarted_at_the_same_pose_goes_on(self, armed):
        armed.set_gateway("no_controller", "no telegram", session="")
        armed.run(0.5)
        assert armed.state is LinkState.NO_CONTROLLER
        armed.set_gateway("ready", "RSI session began")
        armed.run(1.0)
        assert armed.state is LinkState.ARMED

    def test_a_controller_restarted_at_another_pose_needs_a_reset(self, armed):
        armed.set_gateway("no_controller", "no telegram", session="")
        armed.pose = None
        armed.run(0.5)
        armed.pose = moved(0.5)
        armed.set_gateway("ready", "RSI session began")
        armed.run(5.0)
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == [] and not armed.forwarded
        armed.command = None
        armed.supervisor.request_reset(armed.now)
        armed.run(0.5)
        armed.command = armed.pose
        armed.run(0.5)
        assert armed.state is LinkState.ARMED

    @pytest.mark.parametrize("distance, state", [(0.0, LinkState.ARMED), (0.5, LinkState.NEEDS_RESET)])
    def test_a_restarted_gateway_is_armed_again_only_within_tolerance(self, armed, distance, state):
        armed.set_gateway("offline", session="")
        armed.run(0.5)
        armed.set_gateway("joined_running", "joined a running session")
        armed.run(0.5)
        assert armed.state is LinkState.NO_CONTROLLER
        armed.pose = moved(distance)
        armed.set_gateway("ready", "RSI session began")
        armed.run(1.0)
        assert armed.state is state

    def test_a_lost_broker_connection_ends_like_silence(self, armed):
        armed.supervisor.inputs.on_connection(False)
        armed.speaking = False
        armed.run(0.5)
        assert armed.state is LinkState.DISCONNECTED and not armed.forwarded
        armed.supervisor.inputs.on_connection(True)
        armed.run(0.1)
        assert armed.state is LinkState.GATEWAY_OFFLINE
        armed.speaking = True
        armed.set_gateway("holding", SILENCE, session="")
        armed.run(1.0)
        assert armed.state is LinkState.ARMED


class TestStop:
    @pytest.mark.parametrize("state, reason", [("holding", SILENCE), ("ready", "RSI session began"), ("armed", "")])
    def test_stays_stopped_whatever_the_gateway_says_afterwards(self, armed, state, reason):
        armed.supervisor.halt("stopped on request")
        armed.set_gateway("offline")
        armed.run(0.5)
        armed.set_gateway(state, reason)
        armed.run(5.0)
        assert (
            armed.state is LinkState.NEEDS_RESET
            and "stopped on request" in armed.supervisor.reason
            and armed.sent == []
        )

    def test_a_stop_before_the_first_arming_counts_too(self, bench):
        bench.command = None
        bench.run(0.1)
        bench.supervisor.halt("stopped on request")
        bench.command = POSE
        bench.run(2.0)
        assert bench.state is LinkState.NEEDS_RESET and bench.sent == []


class TestArm:
    """`arm` lifts nothing: what stands against a session that begins by itself is lifted by a `reset`."""

    @pytest.mark.parametrize(
        "stop",
        [
            lambda bench: bench.set_gateway("holding", STOP, session="", fault=True),
            lambda bench: bench.set_gateway("holding", FAULT, session="", fault=True),
            lambda bench: bench.set_gateway("holding", "somebody's"),
            lambda bench: bench.supervisor.halt("stopped on request"),
            lambda bench: bench.supervisor.withdraw(bench.supervisor.requests, "not armed in time"),
        ],
        ids=["stop", "fault", "unknown", "halt", "failed reset"],
    )
    def test_it_is_refused_and_a_reset_is_not(self, armed, stop):
        stop(armed)
        armed.run(0.5)
        armed.sent.clear()
        with pytest.raises(ReviewError, match=re.escape(f"cannot arm: {armed.supervisor.reason}")):
            armed.supervisor.request_arm(armed.now)
        armed.run(2.0)
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == []
        armed.supervisor.request_reset(armed.now)
        armed.run(1.0)
        assert armed.state is LinkState.ARMED

    def test_an_armed_link_has_nothing_to_arm(self, armed):
        with pytest.raises(ReviewError, match=re.escape(f"nothing to arm: {armed.supervisor.sentence}")):
            armed.supervisor.request_arm(armed.now)


class TestFault:
    """The gateway remembers what stopped it, also for a bridge that was not there then."""

    @pytest.mark.parametrize("state", ["ready", "holding"])
    def test_reset_clears_it_at_the_gateway_before_arming(self, bench, state):
        bench.set_gateway(state, FAULT, fault=True)
        bench.run(1.0)
        bench.supervisor.request_reset(bench.now)
        bench.run(1.0)
        assert bench.verbs == ["reset", "arm"] and bench.state is LinkState.ARMED

    def test_one_that_comes_while_a_session_begins_by_itself_ends_it(self, bench):
        bench.command = None
        bench.run(0.5)
        assert bench.state is LinkState.RESYNC
        bench.set_gateway("ready", "stop", fault=True)
        bench.run(1.0)
        assert bench.state is LinkState.NEEDS_RESET and bench.sent == []

    @pytest.mark.parametrize("status", [{}, {"fault": False}])
    def test_without_it_everything_begins_as_usual(self, bench, status):
        bench.gateway |= status
        assert bench.run(1.0).state is LinkState.ARMED


class TestReset:
    def test_begins_a_new_session_while_armed(self, armed):
        session = armed.supervisor.session
        armed.supervisor.request_reset(armed.now)
        armed.run(1.0)
        assert armed.state is LinkState.ARMED and armed.supervisor.session != session
        assert armed.verbs == ["reset", "arm"]

    def test_is_refused_while_the_arm_moves(self, armed):
        for k in range(20):
            armed.pose = moved(k * 0.001)
            armed.poll()
        with pytest.raises(ReviewError, match="cannot reset: the arm's pose is unknown or still changing"):
            armed.supervisor.request_reset(armed.now)

    def test_is_possible_once_the_arm_has_rested_long_enough(self, armed):
        armed.pose = moved(0.1)
        armed.poll()
        armed.run(REST / NANOSECONDS - 2 * POLL / NANOSECONDS)
        with pytest.raises(ReviewError, match="cannot reset: the arm's pose is unknown or still changing"):
            armed.supervisor.request_reset(armed.now)
        armed.run(3 * POLL / NANOSECONDS)
        armed.supervisor.request_reset(armed.now)

    def test_is_refused_when_the_pose_is_old(self, armed):
        armed.pose = None
        armed.run(FRESH / NANOSECONDS + 0.04)
        with pytest.raises(ReviewError, match="cannot reset: the arm's pose is unknown or still changing"):
            armed.supervisor.request_reset(armed.now)

    @pytest.mark.parametrize("angle_deg", [5.0, 45.0, 120.0])
    def test_an_arm_that_flickers_by_one_digit_is_at_rest(self, armed, angle_deg):
        for k in range(50):
            armed.pose = (math.radians(angle_deg + (k % 2) * 10.0**-DECIMALS), 0.2)
            armed.poll()
        armed.supervisor.request_reset(armed.now)

    def test_an_arm_that_creeps_is_not_at_rest(self, armed):
        for k in range(100):
            armed.pose = moved(k * math.radians(0.002))
            armed.poll()
        with pytest.raises(ReviewError, match="cannot reset: the arm's pose is unknown or still changing"):
            armed.supervisor.request_reset(armed.now)

    @pytest.mark.parametrize("state", ["offline", "no_controller"])
    def test_is_refused_without_an_arm(self, armed, state):
        armed.set_gateway(state)
        armed.poll()
        with pytest.raises(ReviewError, match="cannot reset:"):
            armed.supervisor.request_reset(armed.now)

    def test_that_could_not_be_carried_out_is_forgotten(self, armed):
        armed.supervisor.request_reset(armed.now)
        armed.set_gateway("no_controller", session="")
        armed.run(0.5)
        armed.pose = moved(0.5)
        armed.set_gateway("ready")
        armed.run(2.0)
        assert armed.state is LinkState.NEEDS_RESET and armed.sent == []

    def test_waits_for_a_braking_gateway(self, armed):
        armed.set_gateway("braking", FAULT, session="")
        armed.run(0.5)
        armed.supervisor.request_reset(armed.now)
        armed.run(0.5)
        assert armed.sent == []
        armed.set_gateway("holding", FAULT)
        armed.run(1.0)
        assert armed.state is LinkState.ARMED

    def test_never_arms_away_from_the_arm(self, armed):
        armed.set_gateway("holding", FAULT, session="")
        armed.pose = moved(0.3)
        armed.run(0.5)
        armed.supervisor.request_reset(armed.now)
        armed.run(3.0)
        assert armed.state is LinkState.RESYNC and "arm" not in armed.verbs
        armed.command = armed.pose
        armed.run(0.5)
        assert armed.state is LinkState.ARMED
