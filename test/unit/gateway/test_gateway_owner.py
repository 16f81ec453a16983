"""The gateway as a pure object: a stream has one owner, and nobody takes it over."""

from __future__ import annotations

import math

import pytest
from gateway_cell import START, Cell, following, slow

from construction_twin.core.units import CYCLE_NS
from construction_twin.gateway.control import MEMORY, Ownership
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.mqtt.messages import CommandProperties, Control


def intruder(cell):
    status = cell.gateway.status()["intruder"]
    return status["session"], status["count"]


def go_on(cell, cycles=50, begin=100):
    """Let the owner send on; its motion must be undisturbed."""
    for k in range(begin, begin + cycles):
        cell.send(slow(k))
        cell.cycle()
    assert cell.state is State.FOLLOWING
    # a few cycles more or less of delay are worth 1 mrad here
    assert cell.measured[0] == pytest.approx(slow(begin + cycles - 5)[0], abs=1e-3)


def test_a_second_commander_is_refused_reported_and_disturbs_nothing():
    cell = following()
    assert intruder(cell) == ("", 0)
    ok, reason = cell.arm("other")
    assert not ok and "s1" in reason
    ok, reason = cell.control("reset", "other")
    assert not ok and "s1" in reason
    assert intruder(cell) == ("other", 1)
    for k in range(100, 150):
        cell.send(slow(k))
        cell.gateway.on_command(cell.codec.encode(START), CommandProperties("another", 9000 + k, cell.stamp), cell.now)
        cell.cycle()
    assert (cell.state, cell.gateway.command_session) == (State.FOLLOWING, "s1")
    assert cell.measured[0] == pytest.approx(slow(145)[0], abs=math.radians(0.0006))
    assert (cell.count("refused_session"), cell.count("refused_arm"), cell.count("refused_reset")) == (50, 1, 1)
    assert intruder(cell) == ("another", 51)
    assert "another" in cell.gateway.status()["last_refusal"]


def test_a_second_commander_does_not_reset_an_owner_that_stands_still():
    cell = Cell()
    cell.cycle(3)
    cell.arm()
    cell.stream([START] * 50)
    assert not cell.control("reset", "other")[0]
    assert cell.gateway.command_session == "s1"
    # the owner itself may, and anybody may once its stream has ended
    assert cell.control("reset", "s1")[0]
    cell.arm("s2")
    cell.stream([START] * 50, "s2")
    cell.cycle(100)
    assert cell.state is State.HOLDING
    assert cell.control("reset", "other")[0]


def test_an_armed_session_whose_stream_never_began_can_be_reset_by_another():
    cell = Cell()
    cell.cycle(3)
    cell.arm("gone")
    assert not cell.arm("s2")[0]
    assert cell.control("reset", "s2")[0]
    assert cell.arm("s2")[0]


def test_a_session_that_had_its_turn_cannot_take_over_again():
    cell = following()
    cell.control("stop")
    cell.cycle(100)
    cell.control("reset")
    ok, reason = cell.arm("s1")
    assert not ok and "had its turn" in reason
    assert cell.state is State.READY
    assert cell.arm("s2")[0]
    assert not cell.arm("s1")[0]
    # what was on its way from the old session is refused, and is no intruder
    held = cell.measured
    cell.send(held, session="s1")
    cell.cycle()
    assert (cell.count("refused_session"), cell.state, cell.measured) == (1, State.ARMED, held)
    assert intruder(cell) == ("s1", 1)


def test_a_replayed_stream_does_nothing():
    cell = Cell()
    cell.cycle(3)
    cell.arm()
    recorded = []
    for k in range(150):
        cell.send(slow(k))
        recorded.append((cell.codec.encode(slow(k)), CommandProperties("s1", cell.seq, cell.stamp)))
        cell.cycle()
    received = cell.count("commands_received")
    # in the same session: every number was taken, or is too far behind to tell
    for k, message in enumerate(recorded):
        cell.gateway.on_command(*message, cell.now)
        cell.send(slow(150 + k))
        cell.cycle()
    assert cell.state is State.FOLLOWING
    assert cell.count("commands_received") == received + 150
    assert cell.count("refused_duplicate") + cell.count("refused_sequence") == 150
    # after it has ended, with everything that was recorded, in every state
    cell.control("stop")
    cell.cycle(200)
    held = cell.measured
    for verb in ("reset", "arm"):
        cell.take(Control("1", "s1", verb, cell.arming))
        for message in recorded:
            cell.gateway.on_command(*message, cell.now)
            cell.cycle()
    assert cell.measured == held


def test_a_recording_of_a_former_run_moves_nothing_after_a_restart_of_the_gateway():
    cell = Cell()
    cell.cycle(3)
    recorded = [(cell.control, ("reset", "s1")), (cell.control, ("arm", "s1", cell.arming))]
    recorded += [(cell.control, ("speed_limit", "s1", 1.0))]
    for k in range(200):
        recorded.append((cell.send, (slow(k),)))
    # no memory of any session, and the arm where it was when the recording began
    cell.gateway = Gateway(cell.config, "run2")
    cell.cycle(3)
    before = cell.measured
    for play, arguments in recorded:
        play(*arguments)
        cell.cycle()
    assert (cell.state, cell.measured) == (State.READY, before)
    assert (cell.count("refused_arm"), cell.count("refused_speed_limit"), cell.count("refused_not_armed")) == (
        1,
        1,
        200,
    )
    # today's bridge takes the run from the status
    assert cell.arm("s2")[0]


def test_a_control_message_that_comes_twice_acts_once_but_a_stop_always_acts():
    cell = Cell()
    cell.cycle(3)
    arm = Control("a1", "s1", "arm", cell.arming)
    assert cell.take(arm) == (True, "armed")
    cell.stream([START] * 20)
    stop = Control("a2", "s1", "stop")
    assert cell.take(stop)[0]
    cell.cycle(5)
    reset = Control("a3", "s1", "reset", cell.resetting)
    assert cell.take(reset)[0]
    assert cell.take(stop)[0]
    cell.cycle(5)
    # a recording of the reset must not undo the stop
    ok, reason = cell.take(reset)
    assert not ok and "answered before" in reason
    assert cell.gateway.status()["fault"] and cell.count("refused_repeated") == 1
    assert cell.gateway.status()["last_refusal"] == f"repeated: {reason}"
    assert cell.take(Control("a4", "s1", "reset", cell.resetting))[0]


@pytest.mark.parametrize(
    "order, reasons", [((2, 1), {"reordered": 1}), ((1, 1), {"duplicate": 1}), ((3, 1, 2), {"reordered": 2})]
)
def test_reordered_and_repeated_commands_are_dropped_and_counted_apart(order, reasons):
    cell = following()
    stamp, seq = cell.stamp, cell.seq
    for number in order:
        cell.send(slow(99 + number), seq=seq + number, stamp=stamp + number * CYCLE_NS)
    cell.seq, cell.stamp = seq + max(order), stamp + max(order) * CYCLE_NS
    cell.cycle(max(order))
    found = {
        name.removeprefix("refused_"): value
        for name, value in cell.gateway.counters.items()
        if name.startswith("refused_")
    }
    assert found == reasons
    go_on(cell, begin=100 + max(order))


def test_what_is_remembered_of_sessions_is_bounded():
    owners = Ownership()
    for k in range(MEMORY + 1):
        owners.begin(f"s{k}")
    assert not owners.has_commanded("s0") and owners.has_commanded("s1") and owners.has_commanded(f"s{MEMORY}")
