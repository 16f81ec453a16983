"""The gateway as a pure object: following, refusing, falling silent, stopping."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from gateway_cell import (
    CONFIG,
    DELAY_CYCLES,
    PAYLOADS,
    START,
    Cell,
    following,
    gap,
    slow,
)

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, format_allowance
from construction_twin.gateway.gateway import State

# -- following -------------------------------------------------------------------------------------------------------


def test_nothing_moves_before_it_is_armed():
    cell = Cell()
    cell.cycle()
    cell.stream(slow(k) for k in range(100))
    assert cell.count("refused_not_armed") == 100
    assert set(cell.replies) == {(0.0, 0.0)}


def test_the_stream_is_carried_out_the_playout_delay_later_and_exactly():
    cell = Cell()
    cell.cycle(3)
    cell.arm()
    poses = [cell.codec.quantise(slow(k)) for k in range(1500)]
    cell.stream(poses)
    moved = [tuple(start + value for start, value in zip(START, reply)) for reply in cell.replies[3:]]
    for k in range(DELAY_CYCLES, 1500):
        assert moved[k] == pytest.approx(poses[k + 1 - DELAY_CYCLES], abs=1e-15)
    assert cell.count("settling") == 0
    assert cell.count("commands_received") == 1500


@pytest.mark.parametrize("decimals", [3, 6])
def test_a_stream_that_stops_dead_is_settled_on_and_goes_on_without_a_reset(decimals):
    cell = Cell(decimals=decimals)
    cell.cycle(3)
    cell.arm()
    budget = CONFIG.acceleration[0] * CYCLE**2
    poses, step = [START], 0.0
    while step < 20 * budget:
        step += 0.9 * budget
        poses.append((poses[-1][0] + step, START[1]))
    end = cell.codec.quantise(poses[-1])
    positions = [START[0]]
    for q in [*poses, *[end] * 300]:
        cell.stream([q])
        positions.append(cell.measured[0])
    allowed = (CONFIG.acceleration[0] + format_allowance(decimals)) * CYCLE**2 + 1e-12
    moves = [b - a for a, b in itertools.pairwise(positions)]
    assert all(abs(b - a) <= allowed for a, b in itertools.pairwise(moves))
    assert max(positions) > end[0] + 1e-4, "it had no room to brake before its target"
    assert cell.measured == pytest.approx(end, abs=1e-12)
    assert cell.count("settling") > 10
    assert (cell.state, cell.gateway.fault, cell.count("refused_acceleration")) == (State.FOLLOWING, False, 0)
    # no reset and no arm
    cell.stream([(end[0] - min(k, 50) * 0.5 * budget, end[1]) for k in range(100)])
    assert cell.state is State.FOLLOWING and cell.measured[0] < end[0]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stream_begins_within_the_start_tolerance_only(sign):
    cell = Cell()
    cell.cycle()
    cell.arm()
    cell.send((START[0] + sign * math.radians(0.052), START[1]))
    assert (cell.state, cell.count("refused_start")) == (State.ARMED, 1)
    near = (START[0] + sign * math.radians(0.048), START[1])
    cell.stream([near] * 100)
    assert cell.state is State.FOLLOWING
    assert cell.measured == pytest.approx(near, abs=math.radians(0.0005))
    # the remainder is blended in, not stepped over
    steps = np.diff([reply[0] for reply in cell.replies], 2)
    assert np.abs(steps).max() / CYCLE**2 <= cell.config.limits.acceleration[0] + 1e-6


def test_the_tolerance_is_measured_from_the_held_pose_not_from_the_measured_one():
    cell = Cell()
    cell.cycle()
    cell.arm()
    away = (START[0] + math.radians(0.2), START[1])
    cell.cycle(measured=away)
    cell.send(away)
    assert cell.state is State.ARMED
    cell.send(START)
    assert cell.state is State.FOLLOWING


def test_a_stream_that_begins_further_outside_the_range_than_an_encoder_reads_is_refused():
    cell = Cell(start=(0.5 + math.radians(0.02), 0.0))
    cell.cycle()
    cell.arm()
    cell.send((0.5 + math.radians(0.052), 0.0))
    assert (cell.state, cell.count("refused_range")) == (State.ARMED, 1)


@pytest.mark.parametrize("held, begin", [(0.0, 0.002), (0.02, 0.02), (0.03, 0.032)])
def test_from_a_hair_outside_the_range_the_arm_stands_or_comes_in(held, begin):
    cell = Cell(start=(0.5 + math.radians(held), 0.0))
    cell.cycle()
    cell.arm()
    begins = 0.5 + math.radians(begin)
    cell.stream([(begins, 0.0)] * 100)
    assert cell.state is State.FOLLOWING and set(cell.replies) == {(0.0, 0.0)}
    cell.stream([(begins - 0.05 * (1 - math.cos(2.0 * k * CYCLE)), 0.0) for k in range(300)])
    assert cell.state is State.FOLLOWING and cell.measured[0] < 0.5
    corrections = [reply[0] for reply in cell.replies]
    assert all(later <= earlier + 1e-12 for earlier, later in zip(corrections, corrections[1:]))


def test_outside_the_range_no_target_goes_further_out():
    cell = Cell(start=(0.5 + math.radians(0.02), 0.0))
    cell.cycle()
    cell.arm()
    cell.stream([cell.measured] * 100)
    cell.send((0.5 + math.radians(0.022), 0.0))
    assert (cell.state, cell.count("refused_range")) == (State.BRAKING, 1)


# -- refusals --------------------------------------------------------------------------------------------------------


def refused_motions():
    here = slow(100)
    return [
        ("range", (0.6, START[1])),
        ("velocity", (here[0] + 0.05, here[1])),
        ("acceleration", (here[0] - 0.004, here[1])),
    ]


@pytest.mark.parametrize("reason, q", refused_motions())
def test_a_refused_motion_brakes_latches_and_waits_for_reset(reason, q):
    cell = following()
    cell.send(q)
    assert cell.state is State.BRAKING
    assert (cell.count(f"refused_{reason}"), cell.count("stops_refused")) == (1, 1)
    assert reason in cell.gateway.reason
    # a fault with a number, as the bridge reads it: nothing goes on by itself, and a `reset` must name it
    assert (cell.gateway.status()["fault"], cell.gateway.status()["fault_number"]) == (True, 1)
    cell.cycle(200)
    assert cell.state is State.HOLDING
    held = cell.held()
    # neither the stream going on nor an arm without a reset moves it
    for k in range(101, 140):
        cell.send(slow(k))
        cell.cycle()
    assert not cell.arm("s2")[0]
    assert cell.measured == held
    assert cell.control("reset") == (True, "reset")
    assert cell.arm("s2")[0]


def test_the_refused_setpoint_itself_is_never_played():
    cell = following(cycles=300)
    before = cell.measured[0]
    cell.send((START[0] - 0.05, START[1]))
    cell.cycle(100)
    # it moved upwards when it was stopped, and comes to rest upwards
    assert before <= cell.measured[0] < before + 0.02


@pytest.mark.parametrize("payload", PAYLOADS)
def test_a_payload_that_is_no_joint_string_is_counted_and_disturbs_nothing(payload):
    cell = following()
    refusals = sum(value for name, value in cell.gateway.counters.items() if name.startswith("refused_"))
    cell.send(START, payload=payload)
    cell.seq -= 1
    cell.stamp -= CYCLE_NS
    assert sum(value for name, value in cell.gateway.counters.items() if name.startswith("refused_")) == refusals + 1
    cell.stream(slow(k) for k in range(100, 200))
    assert cell.state is State.FOLLOWING
    assert cell.measured[0] == pytest.approx(slow(200 - DELAY_CYCLES)[0], abs=math.radians(0.0006))


@pytest.mark.parametrize(
    "reason, changes",
    [
        ("session", {"session": "s2"}),
        ("duplicate", {"seq": 100}),
        ("duplicate", {"seq": 37}),
        ("sequence", {"seq": 36}),
        ("sequence", {"seq": 1}),
        ("sequence", {"seq": 0}),
    ],
)
def test_a_command_of_another_session_or_an_old_one_is_counted_and_disturbs_nothing(reason, changes):
    cell = following()
    cell.send((0.0, 0.0), **changes)
    assert (cell.count(f"refused_{reason}"), cell.state) == (1, State.FOLLOWING)


def test_a_command_without_properties_and_one_with_unreadable_ones_are_refused():
    cell = following()
    payload = cell.codec.encode(slow(100))
    cell.gateway.on_command(payload, None, cell.now)
    cell.gateway.on_command(payload, PayloadError("properties", "user properties ['x']"), cell.now)
    assert (cell.count("refused_properties"), cell.state) == (2, State.FOLLOWING)


def test_a_command_that_travelled_too_long_is_stale():
    cell = following()
    # a second later on our clock with the stamp of the next cycle; the controller goes on meanwhile
    cell.send(slow(100), stamp=cell.stamp + CYCLE_NS - int(0.51 * NANOSECONDS))
    assert (cell.count("refused_stale"), cell.state) == (1, State.FOLLOWING)


def test_a_sender_faster_than_time_is_stopped():
    cell = following()
    for k in range(100, 400):
        cell.send(slow(k))
        if k % 2:
            cell.cycle()
        if cell.state is not State.FOLLOWING:
            break
    assert cell.count("refused_lead") == 1
    cell.cycle(100)
    cell.held()


def test_a_controller_that_falls_silent_does_not_make_commands_look_early():
    # 0.2 s of playout delay and 0.38 s of silence are more than max_age, and nobody's clock was set
    cell = following(playout_delay=0.2, playout_delay_max=0.2)
    for k in range(100, 195):
        cell.now += CYCLE_NS
        cell.send(slow(k))
    assert (cell.state, cell.count("refused_lead")) == (State.FOLLOWING, 0)


def test_a_senders_clock_that_is_set_back_stops_the_arm():
    cell = following()
    cell.send(slow(100), stamp=cell.stamp - int(0.3 * NANOSECONDS))
    assert (cell.state, cell.count("refused_order")) == (State.BRAKING, 1)


def test_lost_commands_are_counted_and_bridged():
    cell = following()
    for k in range(100, 200):
        if k in (110, 120, 121):
            cell.seq += 1
            cell.stamp += CYCLE_NS
        else:
            cell.send(slow(k))
        cell.cycle()
    assert cell.count("commands_lost") == 3
    assert cell.state is State.FOLLOWING
    assert cell.measured[0] == pytest.approx(slow(200 - DELAY_CYCLES)[0], abs=math.radians(0.0006))


# -- silence, stop, reset --------------------------------------------------------------------------------------------


def test_silence_brakes_after_its_time_holds_and_goes_on_answering():
    cell = following(cycles=200)
    cycles = 0
    while cell.state is State.FOLLOWING:
        assert cell.cycle() is not None
        cycles += 1
    # the delay's commands, then the permitted silence
    assert cycles == DELAY_CYCLES - 1 + 25 + 1
    assert cell.count("stops_silence") == 1
    assert cell.cycle(300) is not None
    assert cell.state is State.HOLDING
    cell.held()
    assert None not in cell.replies


def test_a_stop_of_an_arm_at_rest_is_not_forgotten():
    cell = Cell()
    cell.cycle(3)
    assert cell.control("stop")[0]
    cell.cycle()
    assert cell.state is State.HOLDING
    assert cell.gateway.status()["fault"]
    assert not cell.arm()[0]
    assert cell.control("reset")[0]
    assert not cell.gateway.status()["fault"]
    assert cell.arm()[0]


def test_a_stop_after_silence_replaces_its_reason():
    cell = following()
    cell.cycle(200)
    assert (cell.state, cell.gateway.reason.split(":")[0]) == (State.HOLDING, "silence")
    assert not cell.gateway.status()["fault"]
    cell.control("stop")
    cell.cycle()
    assert (cell.state, cell.gateway.reason.split(":")[0]) == (State.HOLDING, "stop")
    assert cell.gateway.status()["fault"]


def test_a_stop_outlives_the_rsi_session():
    cell = following()
    cell.control("stop")
    cell.cycle(100)
    cell.setpoint = cell.measured
    gap(cell)
    cell.cycle(3)
    assert cell.state is State.READY
    assert not cell.arm("s2")[0]
    assert cell.control("reset")[0]
    assert cell.arm("s2")[0]


def test_a_stop_without_a_controller_holds_when_one_comes():
    cell = Cell()
    assert cell.control("stop")[0]
    cell.cycle(3)
    assert not cell.arm()[0]


def test_reset_is_refused_while_the_arm_moves():
    cell = following(cycles=200)
    assert not cell.control("reset")[0]
    assert cell.state is State.FOLLOWING
    cell.control("stop")
    cell.cycle(2)
    assert not cell.control("reset")[0]
    assert cell.state is State.BRAKING
    cell.cycle(200)
    assert cell.control("reset")[0]
    assert cell.state is State.READY


def test_after_reset_and_arm_the_stream_begins_where_the_arm_was_stopped():
    cell = following()
    cell.control("stop")
    cell.cycle(100)
    stopped = cell.held()
    cell.control("reset")
    assert cell.arm("s2")[0]
    for _ in range(50):
        cell.send(stopped, session="s2")
        cell.cycle()
    assert cell.state is State.FOLLOWING
    assert cell.measured == pytest.approx(stopped, abs=math.radians(0.0005))
    assert all(abs(a - b) <= math.radians(0.001) for a, b in zip(cell.measured, stopped))


# -- the last refusal --------------------------------------------------------------------------------------------------


def last_refusal(cell):
    return cell.gateway.status()["last_refusal"]


def later_refusal(cell):
    return cell.gateway.status()["later_refusal"]


def test_what_a_stream_was_stopped_for_is_not_overwritten_by_the_commands_that_still_come():
    cell = following()
    cell.send((0.4, 3.0))
    cause = last_refusal(cell)
    assert cell.state is State.BRAKING and cause.startswith("velocity: A1")
    for k in range(100, 200):
        cell.send(slow(k))
        cell.cycle()
    assert (cell.state, cell.count("refused_not_armed"), last_refusal(cell)) == (State.HOLDING, 100, cause)
    assert later_refusal(cell) == ""
    # any other refusal is news, but no cause
    assert cell.control("nonsense") == (False, "unknown verb 'nonsense'")
    assert (last_refusal(cell), later_refusal(cell)) == (cause, "verb: unknown verb 'nonsense'")
    cell.send(slow(200))
    assert (last_refusal(cell), later_refusal(cell)) == (cause, "verb: unknown verb 'nonsense'")


def arm_again(cell):
    assert not cell.arm("s2")[0]


def limit_speed(cell):
    assert not cell.control("speed_limit", value=0.5)[0]


def stray_datagram(cell):
    cell.gateway.refusals.count_telegram("source", "a datagram from 10.0.0.9:1 while another sender's session is alive")


@pytest.mark.parametrize(
    "later, told",
    [
        (limit_speed, ""),
        (arm_again, "arm: stopped since the last reset; reset first"),
        (stray_datagram, "telegram source: a datagram from 10.0.0.9:1 while another sender's session is alive"),
    ],
)
def test_what_stopped_a_stream_is_kept_until_a_reset_and_what_is_refused_later_stands_beside_it(later, told):
    cell = following()
    cell.send((0.4, 3.0))
    cause = last_refusal(cell)
    assert cause.startswith("velocity: A1") and later_refusal(cell) == ""
    for _ in range(100):
        later(cell)
        cell.cycle()
    assert (cell.state, last_refusal(cell), later_refusal(cell)) == (State.HOLDING, cause, told)
    assert cell.control("reset")[0]
    assert (last_refusal(cell), later_refusal(cell)) == (told or cause, "")
    stray_datagram(cell)
    assert last_refusal(cell).startswith("telegram source: ") and later_refusal(cell) == ""
