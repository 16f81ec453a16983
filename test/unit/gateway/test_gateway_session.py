"""The gateway as a pure object: controller sessions, arming, and what it tells."""

from __future__ import annotations

import math

import pytest
from gateway_cell import (
    CONFIG,
    DELAY_CYCLES,
    RUN,
    SENDER_EPOCH,
    START,
    Cell,
    following,
    gap,
    jump_ahead,
    jump_back,
    other_source,
    slow,
)

from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, format_allowance
from construction_twin.gateway.gateway import State
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import FIRST_PROTOCOL, PROTOCOL, protocol_mismatch

# -- session ---------------------------------------------------------------------------------------------------------


def test_the_first_telegram_is_answered_with_zero_and_captures_the_origin():
    cell = Cell()
    assert cell.state is State.NO_CONTROLLER
    assert cell.cycle() == (0.0, 0.0)
    assert cell.state is State.READY
    assert cell.count("rsi_sessions") == 1


def test_a_small_droop_is_no_running_session_and_never_a_correction():
    cell = Cell()
    cell.measured = (START[0] + 0.9 * CONFIG.start_tolerance, START[1])
    assert cell.cycle() == (0.0, 0.0)


def test_the_origin_is_the_programmed_pose_or_by_option_the_measured_one():
    for reference, expected in (("ASPos", START), ("AIPos", (START[0] + 1e-4, START[1]))):
        cell = Cell(reference=reference)
        cell.measured = (START[0] + 1e-4, START[1])
        cell.cycle(1)
        cell.arm()
        target = JointStringCodec(2).quantise(START)
        for _ in range(20):
            cell.send(target)
            reply = cell.cycle()
        assert reply == pytest.approx([goal - origin for goal, origin in zip(target, expected)], abs=1e-15)
        # it is the one of the first telegram: none was taken for a drift, and put right
        assert cell.count("reference_drifts") == 0


@pytest.mark.parametrize("off", [1.1, -1.1])
def test_a_running_session_is_not_answered_until_it_has_timed_out(off):
    cell = Cell()
    cell.measured = (START[0], START[1] + off * CONFIG.start_tolerance)
    assert cell.cycle(50) is None
    assert cell.replies == [None] * 50
    assert cell.state is State.JOINED
    assert "A2" in cell.gateway.reason
    assert cell.count("telegrams_unanswered") == 50
    assert not cell.arm()[0]
    # the controller gives up; where the program starts again, AIPos and ASPos agree
    cell.now += int(0.5 * NANOSECONDS)
    cell.gateway.poll(cell.now)
    assert cell.state is State.NO_CONTROLLER
    cell.setpoint = cell.measured
    assert cell.cycle() == (0.0, 0.0)
    assert cell.arm()[0]


def test_a_telegram_with_only_an_ipoc_is_answered_with_zero_and_counted():
    cell = Cell()
    assert cell.cycle(measured=None, setpoint=None, missed=None) == (0.0, 0.0)
    assert cell.count("telegrams_without_pose") == 1
    assert not cell.arm()[0]
    assert cell.cycle() == (0.0, 0.0)
    assert cell.arm()[0]


@pytest.mark.parametrize("lost", ["setpoint", "measured"])
def test_a_session_whose_telegrams_lack_a_pose_is_not_answered_and_says_what_to_declare(lost):
    # the arm may stand displaced: zero would take it to its start pose in one cycle (docs/architecture.md, law 2)
    cell = Cell()
    assert cell.cycle(**{lost: None}) is None
    assert cell.cycle(**{lost: None}) is None
    assert cell.state is State.JOINED
    assert "DEF_ASPos" in cell.gateway.reason and "DEF_AIPos" in cell.gateway.reason
    assert not cell.arm()[0]


def test_only_the_first_telegram_of_a_session_may_hold_nothing_but_its_ipoc():
    cell = Cell()
    assert cell.cycle(measured=None, setpoint=None) == (0.0, 0.0)
    assert cell.cycle(measured=None, setpoint=None) is None
    assert cell.state is State.JOINED


@pytest.mark.parametrize(
    "event, counter",
    [
        (gap, None),
        (other_source, "sessions_by_source"),
        (jump_ahead, "sessions_by_ipoc_jump"),
        (jump_back, "sessions_by_ipoc_jump"),
    ],
)
def test_a_new_session_captures_its_own_origin_and_disarms(event, counter):
    cell = following()
    # the controller stopped the old session and starts its program anew where the arm stands
    cell.setpoint = cell.measured
    event(cell)
    assert cell.cycle() == (0.0, 0.0)
    assert cell.state is State.READY
    assert cell.gateway.command_session == ""
    assert cell.count("rsi_sessions") == 2
    assert counter is None or cell.count(counter) == 1
    cell.send(slow(100))
    assert cell.count("refused_not_armed") == 1
    here = cell.held()
    assert cell.arm("s2")[0]
    cell.stream([here] * 30, "s2")
    assert cell.measured == pytest.approx(here, abs=math.radians(0.0005))


@pytest.mark.parametrize("behind", [0, 4, 400])
def test_a_repeated_or_reordered_telegram_is_not_answered_and_changes_nothing(behind):
    cell = following()
    cell.ipoc -= behind + 4
    assert cell.cycle() is None
    cell.ipoc += behind
    assert cell.state is State.FOLLOWING
    assert (cell.count("telegrams_repeated"), cell.count("rsi_sessions")) == (1, 1)
    assert cell.cycle() is not None
    assert cell.count("ipoc_steps_irregular") == 0


def test_ipoc_steps_up_to_the_timeout_are_one_session():
    cell = Cell()
    cell.cycle()
    cell.cycle(step_ms=400)
    assert (cell.count("rsi_sessions"), cell.count("ipoc_steps_irregular")) == (1, 1)
    cell.cycle(step_ms=404)
    assert cell.count("rsi_sessions") == 2


def test_the_controller_is_missed_after_its_timeout_and_not_before():
    cell = Cell()
    cell.cycle()
    cell.gateway.poll(cell.now + int(0.4 * NANOSECONDS))
    assert cell.state is State.READY
    cell.gateway.poll(cell.now + int(0.4 * NANOSECONDS) + 1)
    assert cell.state is State.NO_CONTROLLER
    assert cell.gateway.state_message(0) is None


@pytest.mark.parametrize("missed", [1, 2, 10, 50])
def test_after_missed_telegrams_the_arm_starts_from_standstill(missed):
    cell = Cell(decimals=6)
    cell.cycle(3)
    cell.arm()
    acceleration = cell.config.acceleration[0] * CYCLE**2
    velocity = 12 * acceleration
    ramp = math.ceil(velocity / (acceleration * 0.9))
    position, poses = START[0], []
    for k in range(400):
        position += min(velocity, k * acceleration * 0.9)
        poses.append((position, START[1]))
    cell.stream(poses[: ramp + 50])
    assert cell.state is State.FOLLOWING
    before = cell.measured[0]
    for q in poses[ramp + 50 : ramp + 51 + missed]:
        cell.send(q)
    cell.cycle(step_ms=4 * (1 + missed))
    step, budget = cell.measured[0] - before, acceleration + format_allowance(6) * CYCLE**2
    assert 0.0 < step <= budget * (1 + 1e-8)
    for q in poses[ramp + 51 + missed :]:
        before, last = cell.measured[0], step
        cell.send(q)
        cell.cycle()
        step = cell.measured[0] - before
        assert abs(step - last) <= budget * (1 + 1e-8) + 1e-12


# -- counters from the telegram --------------------------------------------------------------------------------------


def test_late_replies_are_the_increments_of_delay():
    cell = Cell()
    cell.cycle(2)
    for delay in (0, 1, 3, 3, 0, 2):
        cell.cycle(missed=delay)
    assert cell.count("late_replies") == 1 + 2 + 2


def test_a_delay_in_the_first_telegram_belongs_to_the_start_and_an_absent_one_means_nothing():
    cell = Cell()
    cell.cycle(missed=7)
    cell.cycle(missed=7)
    cell.cycle(missed=None)
    assert cell.count("late_replies") == 0
    cell.cycle(missed=8)
    assert cell.count("late_replies") == 1


def test_a_reference_that_drifts_is_counted_and_the_origin_stays():
    cell = following()
    origin = cell.setpoint
    position = cell.measured
    cell.send(slow(100))
    reply = cell.cycle(setpoint=(origin[0] + 0.01, origin[1]))
    assert cell.count("reference_drifts") == 1
    assert origin[0] + reply[0] == pytest.approx(position[0], abs=0.001)


# -- arming ----------------------------------------------------------------------------------------------------------


def test_a_reset_leaves_a_programmed_origin_where_it_is():
    cell = Cell()
    droop = (START[0] + 0.9 * CONFIG.start_tolerance, START[1])
    cell.cycle(2, measured=droop)
    assert cell.control("reset") == (True, "reset")
    assert cell.gateway.controller.origin == START
    # so that nothing is added to what the next stream asks for
    assert cell.arm()[0]
    for _ in range(20):
        cell.send(START)
        cell.cycle(measured=droop)
    assert cell.replies[-1] == (0.0, 0.0)


def test_only_the_right_configuration_hash_arms():
    cell = Cell()
    cell.cycle()
    wrong = ("", "0" * 64, cell.config.hash[:-1], [cell.config.hash])
    for value in (None, *wrong, {}, *({"hash": each, "run": RUN} for each in wrong)):
        named = value if isinstance(value, dict) else {"hash": value}
        ok, reason = cell.control("arm", value=named | {"protocol": PROTOCOL})
        assert not ok
        assert reason.startswith("configuration hash ") and cell.config.hash in reason
    assert cell.state is State.READY
    assert cell.count("refused_arm") == 10


@pytest.mark.parametrize(
    "named", [{"run": "run0"}, {"run": ""}, {"run": None}, {"run": [RUN]}, {}, {"run": RUN, "x": 1}]
)
def test_only_the_gateway_s_present_run_arms(named):
    cell = Cell()
    cell.cycle()
    ok, reason = cell.control("arm", value={"hash": cell.config.hash, "protocol": PROTOCOL} | named)
    assert not ok and "run" in reason
    assert (cell.state, cell.count("refused_arm")) == (State.READY, 1)
    status = cell.gateway.status()
    assert (status["last_refusal"], status["run"]) == (f"arm: {reason}", RUN)
    # the session has not had its turn, and the next attempt may be right
    assert cell.arm()[0]


def test_a_bridge_of_another_protocol_arms_and_resets_nothing_and_learns_why():
    cell = Cell()
    cell.cycle()
    for verb, value in (("arm", cell.config.hash), ("reset", {"run": RUN, "fault_number": 0})):
        assert cell.control(verb, value=value) == (False, protocol_mismatch(PROTOCOL, FIRST_PROTOCOL))


def test_without_a_controller_nothing_arms_and_nothing_resets():
    cell = Cell()
    assert not cell.arm()[0]
    assert not cell.control("reset")[0]
    assert cell.state is State.NO_CONTROLLER


def test_arming_twice_for_the_same_session_is_no_fault_and_for_another_is_refused():
    cell = following()
    assert cell.arm() == (True, "already armed for this session")
    assert not cell.arm("s2")[0]
    assert (cell.state, cell.gateway.command_session) == (State.FOLLOWING, "s1")


@pytest.mark.parametrize("verb", ["", "ARM", "move", "__init__"])
def test_unknown_verbs_do_nothing(verb):
    cell = following()
    ok, reason = cell.control(verb)
    assert not ok
    assert "unknown verb" in reason
    assert cell.state is State.FOLLOWING
    assert (cell.count("refused_verb"), cell.gateway.status()["last_refusal"]) == (1, f"verb: {reason}")


# -- what is told ----------------------------------------------------------------------------------------------------


def test_command_stamp_is_that_of_the_target_in_the_reply_before_the_packet():
    cell = Cell()
    cell.cycle(3)
    cell.arm()
    stamps, sent = [], {}
    for k in range(50):
        cell.send(slow(k))
        sent[cell.stamp] = cell.codec.quantise(slow(k))
        cell.cycle()
        stamps.append(cell.gateway.state_message(cell.now)[1].command_stamp)
    # the first packet of the stream came from a reply without a target
    assert stamps[0] == 0
    assert stamps[1] == SENDER_EPOCH + CYCLE_NS
    # by construction the measured pose of a packet is what the reply before it commanded
    for k in range(DELAY_CYCLES + 1, 50):
        moved = tuple(start + value for start, value in zip(START, cell.replies[3 + k - 1]))
        assert moved == pytest.approx(sent[stamps[k]], abs=1e-15)


@pytest.mark.parametrize("end", ["stop", "refused", "silence"])
def test_without_a_target_there_is_no_command_stamp(end):
    cell = following()
    assert cell.gateway.state_message(cell.now)[1].command_stamp != 0
    if end == "stop":
        cell.control("stop")
    elif end == "refused":
        cell.send((0.6, 0.0))
    cell.cycle(60)
    assert cell.gateway.state_message(cell.now)[1].command_stamp == 0


def test_a_measured_pose_that_does_not_fit_the_format_is_counted_not_sent():
    cell = Cell()
    cell.cycle()
    cell.cycle(measured=(math.radians(1000), 0.0))
    assert cell.gateway.state_message(1) is None
    assert cell.count("state_refused_range") == 1
