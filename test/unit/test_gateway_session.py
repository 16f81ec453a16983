"""The gateway as a pure object, on a simulated clock with a simulated controller."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.errors import PayloadError
from construction_twin.mqtt.codec import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control
from construction_twin.rsi.codec import RobotTelegram
from construction_twin.rsi.config import GatewayConfig
from construction_twin.rsi.session import Gateway, State
from construction_twin.units import CYCLE, CYCLE_NS, NANOSECONDS, format_allowance

CONFIG = GatewayConfig("arm", ("A1", "A2"), (-0.5, -3.2), (0.5, 3.2), (2.0, 4.5), (2.34, 17.4))
DELAY_CYCLES = 5
START = JointStringCodec(2).quantise((0.1, -1.0))
#: The sender's clock when the cell's reads 0.
SENDER_EPOCH = 1_764_000_000_000_000_000


def slow(cycle, rate=2.0):
    """A smooth motion of A1 from START, well inside the limits; `cycle` from 0."""
    return (START[0] + 0.1 * (1 - math.cos(rate * cycle * CYCLE)), START[1])


class Cell:
    """A controller that carries out each reply at once, and a sender, on one simulated clock."""

    def __init__(self, start=START, **changes):
        self.config = dataclasses.replace(CONFIG, **changes)
        self.gateway = Gateway(self.config)
        self.codec = JointStringCodec(2, self.config.decimals)
        self.now = 50 * NANOSECONDS
        self.ipoc = 1_000_000
        self.source = ("192.168.1.20", 49152)
        self.setpoint = self.measured = start
        self.delay = 0
        self.seq = 0
        self.stamp = SENDER_EPOCH
        self.replies = []

    # the controller

    def telegram(self, **changes):
        telegram = RobotTelegram(self.ipoc, self.measured, self.setpoint, self.delay)
        reply = self.gateway.on_telegram(dataclasses.replace(telegram, **changes), self.source, self.now)
        if reply is not None:
            self.measured = tuple(start + value for start, value in zip(self.setpoint, reply))
        self.replies.append(reply)
        return reply

    def cycle(self, count=1, step_ms=4, **changes):
        self.step_ms = step_ms
        for _ in range(count):
            self.now += step_ms * 1_000_000
            self.ipoc += step_ms
            reply = self.telegram(**changes)
            self.gateway.poll(self.now)
        return reply

    # the sender

    def send(self, q, session="s1", stamp=None, seq=None, payload=None):
        self.stamp += CYCLE_NS
        self.seq += 1
        properties = CommandProperties(
            session, self.seq if seq is None else seq, self.stamp if stamp is None else stamp
        )
        self.gateway.on_command(
            self.codec.encode(q) if payload is None else payload,
            properties if self.config.properties else None,
            self.now,
        )

    def stream(self, poses):
        """One command, one cycle, and so on."""
        for q in poses:
            self.send(q)
            self.cycle()

    def control(self, verb, session="s1", value=None):
        return self.gateway.on_control(Control("1", session, verb, value))

    def arm(self, session="s1"):
        return self.control("arm", session, self.config.hash)

    # shorthand

    @property
    def state(self):
        return self.gateway.state

    def count(self, name):
        return self.gateway.counters[name]

    def held(self):
        """Where a still arm has been put, checked over a second of telegrams."""
        before = self.measured
        self.cycle(250)
        assert self.measured == before
        return before


def following(cycles=100, **changes) -> Cell:
    """Return a cell in the middle of a motion of A1."""
    cell = Cell(**changes)
    cell.cycle(3)
    assert cell.arm() == (True, "armed")
    cell.stream(slow(k) for k in range(cycles))
    assert cell.state is State.FOLLOWING
    return cell


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


@pytest.mark.parametrize("off", [1.1, -1.1])
def test_a_running_session_is_not_answered_until_it_has_timed_out(off):
    cell = Cell()
    cell.measured = (START[0], START[1] + off * CONFIG.start_tolerance)
    assert cell.cycle(50) is None
    assert cell.replies == [None] * 50
    assert cell.state is State.JOINED
    assert "A2" in cell.gateway.reason
    assert cell.count("telegrams_unanswered") == 49
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
    assert cell.cycle(measured=None, setpoint=None, delay=None) == (0.0, 0.0)
    assert cell.count("telegrams_without_pose") == 1
    assert not cell.arm()[0]
    assert cell.cycle() == (0.0, 0.0)
    assert cell.arm()[0]


@pytest.mark.parametrize("lost", ["setpoint", "measured"])
def test_a_session_whose_telegrams_lack_a_pose_is_not_answered_and_says_what_to_declare(lost):
    # the arm may stand displaced: zero would take it to its start pose in one cycle (design, law 2)
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


def test_telegrams_that_lose_their_pose_later_do_not_stop_the_motion():
    cell = following()
    before = cell.measured
    cell.send(slow(100))
    assert cell.cycle(measured=None, setpoint=None) is not None
    assert cell.measured != before
    assert cell.state is State.FOLLOWING


def gap(cell):
    cell.now += round(cell.config.timeout * NANOSECONDS)
    cell.gateway.poll(cell.now + CYCLE_NS)
    assert cell.state is State.NO_CONTROLLER


def other_source(cell):
    cell.source = (cell.source[0], cell.source[1] + 1)


def jump_ahead(cell):
    cell.ipoc += 500


def jump_back(cell):
    cell.ipoc -= 4000


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
    assert cell.gateway.session == ""
    assert cell.count("rsi_sessions") == 2
    assert counter is None or cell.count(counter) == 1
    cell.send(slow(100))
    assert cell.count("refused_not_armed") == 1
    here = cell.held()
    assert cell.arm()[0]
    cell.stream([here] * 30)
    assert cell.measured == pytest.approx(here, abs=math.radians(0.0005))


@pytest.mark.parametrize("event", [other_source, jump_ahead])
def test_a_new_session_in_the_middle_of_a_correction_counts_as_joined(event):
    cell = following()
    event(cell)
    assert cell.cycle() is None
    assert cell.state is State.JOINED


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


@pytest.mark.parametrize("missed", [2, 10, 50])
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


def test_a_missed_telegram_moves_playout_by_8_ms_and_the_motion_stays_inside_the_limits():
    cell = following()
    cell.send(slow(100))
    cell.send(slow(101))
    before = cell.measured[0]
    cell.cycle(step_ms=8)
    assert cell.count("ipoc_steps_irregular") == 1
    assert abs(cell.measured[0] - before) <= 2.0 * CYCLE
    for k in range(102, 160):
        cell.send(slow(k))
        cell.cycle()
    assert cell.measured[0] == pytest.approx(slow(160 - DELAY_CYCLES)[0], abs=math.radians(0.001))
    assert cell.state is State.FOLLOWING


# -- counters from the telegram --------------------------------------------------------------------------------------


def test_late_replies_are_the_increments_of_delay():
    cell = Cell()
    cell.cycle(2)
    for delay in (0, 1, 3, 3, 0, 2):
        cell.cycle(delay=delay)
    assert cell.count("late_replies") == 1 + 2 + 2


def test_a_delay_in_the_first_telegram_belongs_to_the_start_and_an_absent_one_means_nothing():
    cell = Cell()
    cell.cycle(delay=7)
    cell.cycle(delay=7)
    cell.cycle(delay=None)
    assert cell.count("late_replies") == 0
    cell.cycle(delay=8)
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


def test_only_the_right_configuration_hash_arms():
    cell = Cell()
    cell.cycle()
    for value in (None, "", "0" * 64, cell.config.hash[:-1], [cell.config.hash]):
        ok, reason = cell.control("arm", value=value)
        assert not ok
        assert "hash" in reason
    assert cell.state is State.READY
    assert cell.count("refused_arm") == 5


def test_without_a_controller_nothing_arms_and_nothing_resets():
    cell = Cell()
    assert not cell.arm()[0]
    assert not cell.control("reset")[0]
    assert cell.state is State.NO_CONTROLLER


def test_arming_twice_for_the_same_session_is_no_fault_and_for_another_is_refused():
    cell = following()
    assert cell.arm() == (True, "already armed for this session")
    assert not cell.arm("s2")[0]
    assert (cell.state, cell.gateway.session) == (State.FOLLOWING, "s1")


@pytest.mark.parametrize("verb", ["", "ARM", "move", "__init__"])
def test_unknown_verbs_do_nothing(verb):
    cell = following()
    ok, reason = cell.control(verb)
    assert not ok
    assert "unknown verb" in reason
    assert cell.state is State.FOLLOWING


# -- following -------------------------------------------------------------------------------------------------------


def test_nothing_moves_before_it_is_armed():
    cell = Cell()
    cell.cycle()
    cell.stream(slow(k) for k in range(100))
    assert cell.count("refused_not_armed") == 100
    assert set(cell.replies) == {(0.0, 0.0)}


def test_armed_without_a_stream_holds():
    cell = Cell()
    cell.cycle()
    cell.arm()
    assert cell.held() == START
    assert cell.state is State.ARMED


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


def test_a_stream_that_begins_outside_the_range_is_refused():
    cell = Cell(start=(0.5, 0.0))
    cell.cycle()
    cell.arm()
    cell.send((0.5 + math.radians(0.002), 0.0))
    assert (cell.state, cell.count("refused_range")) == (State.ARMED, 1)


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
    cell.cycle(200)
    assert cell.state is State.HOLDING
    held = cell.held()
    # neither the stream going on nor an arm without a reset moves it
    for k in range(101, 140):
        cell.send(slow(k))
        cell.cycle()
    assert not cell.arm()[0]
    assert cell.measured == held
    assert cell.control("reset") == (True, "reset")
    assert cell.arm()[0]


def test_the_refused_setpoint_itself_is_never_played():
    cell = following(cycles=300)
    before = cell.measured[0]
    cell.send((START[0] - 0.05, START[1]))
    cell.cycle(100)
    # it moved upwards when it was stopped, and comes to rest upwards
    assert before <= cell.measured[0] < before + 0.02


PAYLOADS = [
    b"",
    b"\x00" * 17,
    b"nan,nan",
    b"+000.000",
    b"+000.000,+000.000,+000.000",
    b"+005.730,-057.2960",
    b"+005.7300,-057.2960",
    b"+00a.000,+000.000",
    "+005.730,−057.296".encode(),
    b"+005.730;-057.296",
    b"+1e9.000,+000.000",
]


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


def test_another_decimals_setting_is_one_clear_counter():
    cell = following()
    cell.send(START, payload=JointStringCodec(2, 4).encode(START))
    assert cell.count("refused_decimals") == 1


@pytest.mark.parametrize(
    "reason, changes",
    [("session", {"session": "s2"}), ("sequence", {"seq": 100}), ("sequence", {"seq": 1}), ("sequence", {"seq": 0})],
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


def test_the_age_is_relative_to_the_quickest_command_not_to_our_clock():
    cell = Cell()
    cell.stamp += 3600 * NANOSECONDS
    cell.cycle()
    cell.arm()
    cell.stream([START] * 10)
    assert cell.count("commands_received") == 10
    cell.now += int(0.6 * NANOSECONDS)
    cell.send(START)
    assert cell.count("refused_stale") == 1


@pytest.mark.parametrize("seconds", [3600.0, 0.6])
def test_a_senders_clock_that_is_set_forward_stops_the_arm_instead_of_playing_in_slow_motion(seconds):
    cell = following()
    cell.stamp += round(seconds * NANOSECONDS)
    cell.send(slow(100))
    assert (cell.state, cell.count("refused_lead")) == (State.BRAKING, 1)


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


def test_commands_before_the_stream_began_are_not_lost_ones():
    cell = Cell()
    cell.cycle()
    cell.arm()
    cell.seq = 5000
    cell.stream([START] * 5)
    assert cell.count("commands_lost") == 0


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


def test_a_stream_resumed_within_the_silence_goes_on():
    cell = following()
    here = cell.codec.quantise(slow(99))
    cell.cycle(DELAY_CYCLES + 20)
    cell.stamp += (DELAY_CYCLES + 20) * CYCLE_NS
    cell.stream([here] * 50)
    assert (cell.state, cell.count("stops_silence")) == (State.FOLLOWING, 0)
    assert cell.measured == pytest.approx(here, abs=1e-12)


def test_stop_brakes_and_latches_and_names_who_asked():
    cell = following()
    assert cell.control("stop", session="anybody")[0]
    assert cell.state is State.BRAKING
    assert "anybody" in cell.gateway.reason
    cell.cycle(100)
    assert cell.state is State.HOLDING
    cell.held()


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
    assert not cell.arm()[0]
    assert cell.control("reset")[0]
    assert cell.arm()[0]


def test_a_stop_without_a_controller_holds_when_one_comes():
    cell = Cell()
    assert cell.control("stop")[0]
    cell.cycle(3)
    assert not cell.arm()[0]


def test_stop_needs_no_session_and_is_granted_in_every_state():
    for cell in (Cell(), following()):
        assert cell.control("stop", session="")[0]
        assert cell.control("stop", session="")[0]


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
    assert cell.control("arm", "s2", cell.config.hash)[0]
    for _ in range(50):
        cell.send(stopped, session="s2")
        cell.cycle()
    assert cell.state is State.FOLLOWING
    assert cell.measured == pytest.approx(stopped, abs=math.radians(0.0005))
    assert all(abs(a - b) <= math.radians(0.001) for a, b in zip(cell.measured, stopped))


def test_commands_of_the_session_before_the_reset_are_refused_after_it():
    cell = following()
    cell.control("stop")
    cell.cycle(100)
    cell.control("reset")
    cell.arm("s2")
    cell.send(cell.measured, session="s1")
    assert (cell.count("refused_session"), cell.state) == (1, State.ARMED)


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


def test_command_stamp_lies_between_commands_when_playout_does():
    cell = Cell(playout_delay=0.019)
    cell.cycle()
    cell.arm()
    cell.stream([START] * 20)
    stamp = cell.gateway.state_message(cell.now)[1].command_stamp
    assert (stamp - SENDER_EPOCH) % CYCLE_NS == 1_000_000


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


def test_states_carry_the_measured_pose_their_own_sequence_and_our_stamp():
    cell = Cell()
    assert cell.gateway.state_message(1) is None
    cell.cycle()
    first = cell.gateway.state_message(11)
    second = cell.gateway.state_message(12)
    assert first[0] == cell.codec.encode(START)
    assert (first[1].seq, first[1].stamp) == (1, 11)
    assert (second[1].seq, second[1].stamp) == (2, 12)


def test_a_measured_pose_that_does_not_fit_the_format_is_counted_not_sent():
    cell = Cell()
    cell.cycle()
    cell.cycle(measured=(math.radians(1000), 0.0))
    assert cell.gateway.state_message(1) is None
    assert cell.count("state_refused_range") == 1


def test_status_names_state_reason_session_configuration_and_counters():
    cell = following()
    status = cell.gateway.status()
    assert (status["state"], status["session"]) == ("following", "s1")
    assert (status["hash"], status["decimals"], status["properties"]) == (cell.config.hash, 3, True)
    assert status["counters"]["commands_received"] == 100
    cell.control("stop")
    assert cell.gateway.status()["session"] == ""
    assert status["counters"].get("stops_stop") is None


def test_a_change_of_state_is_told_once():
    cell = Cell()
    cell.gateway.take_change()
    assert not cell.gateway.take_change()
    cell.cycle()
    assert cell.gateway.take_change()
    assert not cell.gateway.take_change()


# -- MQTT 3.1.1: the string alone ------------------------------------------------------------------------------------


def test_without_properties_the_stream_is_played_on_its_arrival_grid():
    cell = Cell(properties=False)
    cell.cycle(3)
    cell.arm()
    poses = [cell.codec.quantise(slow(k)) for k in range(1000)]
    for k, q in enumerate(poses):
        # jitter of arrival: -1, 0 or 1 ms
        cell.now += (k % 3 - 1) * 1_000_000
        cell.send(q)
        cell.now -= (k % 3 - 1) * 1_000_000
        cell.cycle()
    moved = cell.replies[-1][0] + START[0]
    assert moved == pytest.approx(poses[1000 - DELAY_CYCLES][0], abs=1e-3)
    assert (cell.state, cell.count("settling")) == (State.FOLLOWING, 0)
    assert cell.gateway.state_message(cell.now)[1].command_stamp == 0


def test_without_properties_nothing_moves_unarmed_and_silence_still_brakes():
    cell = Cell(properties=False)
    cell.cycle(3)
    cell.send(START)
    assert cell.count("refused_not_armed") == 1
    cell.arm()
    cell.stream(slow(k) for k in range(100))
    cell.cycle(60)
    assert (cell.count("stops_silence"), cell.state) == (1, State.HOLDING)


@pytest.mark.parametrize("drift", [200e-6, -200e-6])
def test_without_properties_a_drifting_sender_is_followed_for_as_long_as_it_sends(drift):
    cell = Cell(properties=False, silence=0.02)
    cell.cycle(3)
    cell.arm()
    offset = 0.0
    for _ in range(40_000):
        offset += drift * CYCLE_NS
        cell.now += round(offset)
        cell.send(START)
        cell.now -= round(offset)
        cell.cycle()
        # the controller drifts with the sender here; only our own clock differs
    assert abs(offset) > 0.02 * NANOSECONDS
    assert (cell.state, cell.count("commands_received")) == (State.FOLLOWING, 40_000)


# -- anything at all -------------------------------------------------------------------------------------------------


class Guard:
    """Holds every reply against the limits: origin + correction."""

    def __init__(self, cell):
        self.cell = cell
        self.sessions = -1

    def check(self):
        cell, config = self.cell, self.cell.config
        reply = cell.replies[-1]
        if cell.count("rsi_sessions") != self.sessions or reply is None:
            self.sessions = cell.count("rsi_sessions")
            self.q, self.step = cell.setpoint, (0.0, 0.0)
            if reply is None:
                return
        if cell.step_ms > 8:
            # under HOLDON the arm has come to a stand: the next step is one from standstill
            self.step = (0.0, 0.0)
        q = tuple(start + value for start, value in zip(cell.setpoint, reply))
        step = tuple(new - old for new, old in zip(q, self.q))
        rounding = math.radians(10.0**-config.decimals)
        for k in range(2):
            assert config.lower[k] - 1.1e-9 <= q[k] <= config.upper[k] + 1.1e-9
            assert abs(step[k]) <= config.velocity[k] * CYCLE + rounding + 1e-12
            budget = (config.acceleration[k] + format_allowance(config.decimals)) * CYCLE**2
            assert abs(step[k] - self.step[k]) <= budget * (1 + 1e-8) + 1e-14
        if cell.state in (State.READY, State.ARMED, State.HOLDING):
            assert step == (0.0, 0.0)
        self.q, self.step = q, step


class Pilot:
    """A sender that knows the last command it sent, and what may go wrong with it."""

    def __init__(self, cell):
        self.cell, self.q, self.speed, self.session = cell, START[0], 0.0, "s1"
        self.guard = Guard(cell)

    def cycle(self, **changes):
        self.cell.cycle(**changes)
        self.guard.check()

    def send(self, cycles=1, acceleration=0.0, **changes):
        config = self.cell.config
        self.speed = min(max(self.speed + acceleration * config.acceleration[0] * CYCLE, -2.0), 2.0)
        self.q = min(max(self.q + self.speed * CYCLE * cycles, -9.0), 9.0)
        self.cell.send((self.q, START[1]), session=self.session, **changes)

    def do(self, kind, value, cycles):
        getattr(self, f"_{kind}")(value, cycles)

    def _drive(self, value, cycles):
        for _ in range(cycles):
            self.send(acceleration=value)
            self.cycle()

    def _to_the_end(self, value, cycles):
        for _ in range(2 * cycles):
            room = 0.5 - abs(self.q)
            self.speed = math.copysign(min(abs(self.speed) + 2.34 * CYCLE, math.sqrt(max(0.0, 2 * 2.34 * room))), value)
            self.send()
            self.cycle()

    def _rest(self, value, cycles):
        self.speed = 0.0
        self._drive(0.0, cycles)

    def _jump(self, value, cycles):
        self.q += value
        self.send()
        self.cycle()

    def _lose(self, value, cycles):
        cycles = min(cycles, 12)
        for _ in range(cycles):
            self.cycle()
        self.cell.seq += cycles
        self.cell.stamp += cycles * CYCLE_NS
        self.send(cycles)

    def _silence(self, value, cycles):
        for _ in range(2 * cycles):
            self.cycle()

    def _burst(self, value, cycles):
        for _ in range(min(cycles, 20)):
            self.send()
        for _ in range(cycles):
            self.cycle()

    def _garbage(self, value, cycles):
        self.send(payload=PAYLOADS[cycles % len(PAYLOADS)])
        self.cycle()

    def _wrong(self, value, cycles):
        changes = (
            {"seq": max(0, self.cell.seq - cycles)},
            {"stamp": self.cell.stamp - cycles * CYCLE_NS * 4},
            {"stamp": 2**63},
        )
        self.send(**changes[cycles % 3])
        self.cycle()

    def _other_session(self, value, cycles):
        self.cell.send((value, value), session="s9")
        self.cycle()

    def _skip(self, value, cycles):
        self.send()
        self.cycle(step_ms=4 * (1 + cycles % 5))

    def _control(self, value, cycles):
        self.cell.control(("stop", "reset", "arm", "nonsense")[cycles % 4], value=str(value))
        self.cycle()

    def _recover(self, value, cycles):
        self.cell.control("stop")
        for _ in range(400):
            self.cycle()
        self.cell.control("reset")
        self.session = f"s{self.cell.seq + 2}"
        self.cell.arm(self.session)
        self.q, self.speed = self.cell.measured[0], 0.0

    def _new_session(self, value, cycles):
        if cycles % 3:
            self.cell.setpoint = self.cell.measured
        (gap, other_source, jump_ahead, jump_back)[cycles % 4](self.cell)
        self.cycle()


_KINDS = [
    "drive", "drive", "to_the_end", "to_the_end", "rest", "jump", "lose", "silence", "burst", "garbage", "wrong", "other_session",
    "skip", "control", "recover", "recover", "new_session",
]  # fmt: skip
_EVENT = st.tuples(
    st.sampled_from(_KINDS),
    st.one_of(st.sampled_from((-1.0, 1.0)), st.floats(-1.2, 1.2)),
    st.integers(1, 60),
)


@settings(max_examples=120, deadline=None)
@given(st.lists(_EVENT, min_size=1, max_size=14), st.sampled_from((2, 3, 6)), st.booleans())
def test_corrections_stay_inside_the_limits_whatever_arrives(events, decimals, properties):
    cell = Cell(decimals=decimals, properties=properties)
    pilot = Pilot(cell)
    pilot.cycle()
    cell.arm()
    for event in events:
        pilot.do(*event)
    # and whatever it was, silence ends it
    for _ in range(600):
        pilot.cycle()
    assert cell.state not in (State.FOLLOWING, State.BRAKING)
    if cell.replies[-1] is not None:
        assert cell.held() == cell.measured
