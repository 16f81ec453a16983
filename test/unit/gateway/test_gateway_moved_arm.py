"""The gateway when the controller moves the arm, or switches RSI off and on, behind its back."""

from __future__ import annotations

import math

import pytest
from gateway_cell import START, Cell, following, gap, other_source, slow

from construction_twin.core.units import CYCLE, NANOSECONDS
from construction_twin.gateway.gateway import State

TEN_DEG = math.radians(10.0)


def displaced(ending: str = "reset", **changes) -> Cell:
    """Return a cell whose arm stands under a correction of A1, in READY after a `reset` or in HOLDING."""
    cell = following(**changes)
    cell.stream(slow(k) for k in range(100, 300))
    cell.control("stop")
    cell.cycle(300)
    assert cell.state is State.HOLDING
    if ending == "reset":
        assert cell.control("reset")[0]
        cell.cycle()
    assert abs(cell.replies[-1][0]) > math.radians(5.0)
    return cell


def switch_on_anew(cell: Cell, gap_ms: int = 200, **changes):
    """KRL ends RSI and begins it again: its correction is zero, and its programmed pose is where the arm stands."""
    cell.setpoint = cell.measured
    return cell.cycle(step_ms=gap_ms, **changes)


def moved(q, way=TEN_DEG):
    return (q[0] + way, q[1])


class TestSwitchedOffAndOn:
    @pytest.mark.parametrize("ending", ["reset", "stop"])
    @pytest.mark.parametrize("gap_ms", [8, 12, 200, 400])
    def test_faster_than_silence_shows_it_is_a_new_session_all_the_same(self, ending, gap_ms):
        cell = displaced(ending)
        assert switch_on_anew(cell, gap_ms) == (0.0, 0.0)
        assert (cell.state, cell.count("rsi_sessions"), cell.count("sessions_by_restart")) == (State.READY, 2, 1)
        assert "switched on anew" in cell.gateway.reason and str(gap_ms) in cell.gateway.reason
        here = cell.held()
        cell.control("reset")
        assert cell.arm("s2")[0]
        cell.stream([here] * 30, "s2")
        assert cell.measured == pytest.approx(here, abs=math.radians(0.0005))

    def test_in_mid_stream_too(self):
        cell = following()
        assert math.degrees(cell.replies[-1][0]) > 0.1
        assert switch_on_anew(cell) == (0.0, 0.0)
        assert cell.state is State.READY and cell.gateway.command_session == ""

    def test_a_program_that_moves_the_arm_under_a_correction_is_none(self):
        cell = displaced()
        before = cell.replies[-1]
        for _ in range(20):
            cell.setpoint, cell.measured = moved(cell.setpoint, 0.002), moved(cell.measured, 0.002)
            assert cell.cycle(step_ms=8) == pytest.approx(before, abs=1e-12)
        assert cell.count("rsi_sessions") == 1

    def test_a_servo_that_has_not_moved_yet_is_none(self):
        cell = Cell()
        cell.cycle(3)
        cell.arm()
        for k in range(120):
            cell.send(slow(k))
            if k % 30 == 28:
                continue
            # the arm stays where it is, and a telegram is lost now and then
            assert cell.cycle(step_ms=8 if k % 30 == 29 else 4, measured=START) is not None
        assert cell.replies[-1][0] > math.radians(0.05)
        assert cell.count("rsi_sessions") == 1

    def test_a_first_telegram_with_nothing_but_an_ipoc_is_not_answered_with_what_was(self):
        # RSI up to 2.3; whether it is that or a broken telegram nobody can tell: a controller without answers stops by itself
        cell = displaced()
        cell.setpoint = cell.measured
        assert cell.cycle(step_ms=200, measured=None, setpoint=None) is None
        assert cell.cycle() is None and cell.state is State.JOINED
        gap(cell)
        assert cell.cycle(measured=None, setpoint=None) == (0.0, 0.0)
        assert cell.cycle() == (0.0, 0.0) and cell.state is State.READY

    def test_missed_telegrams_under_a_correction_are_none(self):
        cell = displaced()
        before = cell.replies[-1]
        assert cell.cycle(step_ms=400) == before
        assert cell.count("rsi_sessions") == 1


class TestDrift:
    def test_aspos_that_moves_while_a_stream_is_followed_is_braked_for(self):
        cell = following()
        speed = cell.measured[0] - slow(0)[0]
        assert speed > 0.0
        cell.setpoint = moved(cell.setpoint)
        cell.cycle()
        assert cell.state is State.BRAKING and cell.gateway.fault
        assert "A1 is 0.174533 rad off" in cell.gateway.reason and "AIPos" in cell.gateway.reason
        assert cell.count("stops_drift") == 1
        moves = [cell.replies[-1][0]]
        while cell.state is State.BRAKING:
            moves.append(cell.cycle()[0])
        budget = cell.config.acceleration[0] * CYCLE**2
        steps = [b - a for a, b in zip(moves, moves[1:])]
        assert all(0 <= a - b <= budget * (1 + 1e-9) + 1e-12 for a, b in zip(steps, steps[1:]))
        assert cell.gateway.status()["stop"]["cause"] == "drift"
        assert not cell.arm("s2")[0]
        # a person goes on from where the arm really is
        assert cell.control("reset", "s2")[0]
        cell.cycle()
        assert cell.arm("s2")[0]
        before = cell.replies[-1]
        cell.send(cell.measured, "s2")
        assert cell.cycle() == pytest.approx(before, abs=math.radians(0.001))
        assert cell.state is State.FOLLOWING

    def test_less_than_the_start_tolerance_is_counted_only(self):
        cell = following()
        cell.send(slow(100))
        cell.cycle(setpoint=moved(cell.setpoint, 0.9 * cell.config.start_tolerance))
        assert (cell.count("reference_drifts"), cell.state) == (1, State.FOLLOWING)


class TestArmedWhereTheArmIs:
    def test_with_aipos_as_reference_a_moved_arm_is_not_armed_before_a_reset(self):
        cell = Cell(reference="AIPos")
        cell.cycle(3)
        cell.setpoint = cell.measured = there = moved(START)
        # the cell's controller would carry the answer out: this one has a program of its own
        cell.cycle(3)
        assert cell.measured == there
        ok, said = cell.arm()
        assert not ok and "A1 is 0.174533 rad off" in said and "reset" in said
        assert cell.control("reset")[0]
        assert cell.arm()[0]
        cell.send(START)
        assert cell.count("refused_start") == 1
        cell.send(there)
        assert cell.cycle() == pytest.approx((0.0, 0.0), abs=math.radians(0.001))
        assert cell.state is State.FOLLOWING

    def test_under_a_correction_the_program_must_begin_again(self):
        cell = displaced(reference="AIPos")
        held = cell.replies[-1]
        cell.setpoint = moved(cell.setpoint)
        cell.cycle(3)
        for _ in range(2):
            ok, said = cell.arm("s2")
            assert not ok and "start the controller's program again" in said
            assert cell.control("reset")[0]
            assert cell.cycle() == held

    def test_an_arm_that_does_not_get_where_it_is_held_is_not_armed(self):
        cell = Cell()
        cell.cycle(3)
        cell.cycle(measured=moved(START, 2.1 * cell.config.start_tolerance))
        assert not cell.arm()[0]
        cell.cycle(measured=moved(START, 1.9 * cell.config.start_tolerance))
        assert cell.arm()[0]

    @pytest.mark.parametrize("session", ["", "s 1", "ä", "a" * 65, "s1\n", "../s1"])
    def test_a_session_that_no_command_could_name_is_not_armed(self, session):
        cell = Cell()
        cell.cycle(3)
        ok, said = cell.arm(session)
        assert not ok and "letters, digits, - and _" in said
        assert (cell.state, cell.count("refused_arm")) == (State.READY, 1)


def test_a_joined_session_tells_no_pose_of_the_one_before():
    cell = following()
    other_source(cell)
    cell.now += NANOSECONDS // 5
    cell.cycle()
    assert cell.state is State.JOINED
    assert cell.gateway.state_message(cell.now) is None
    gap(cell)
    cell.setpoint = cell.measured
    cell.cycle()
    assert cell.codec.decode(cell.gateway.state_message(cell.now)[0]) == pytest.approx(cell.measured, abs=1e-5)
