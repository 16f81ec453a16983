"""The example of a bare PLC: what makes it lawful, with its limits those of the arm it is made for."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from bare_plc import (
    AXES,
    CYCLE,
    HOME,
    QUIET,
    SILENCE,
    START_TOLERANCE,
    Axis,
    BarePlc,
    State,
)
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.robot.description import read_robot_files

ROOT = Path(__file__).resolve().parents[3]
SLOW = (Axis(-10.0, 10.0, 100.0, 200.0), Axis(-90.0, 90.0, 50.0, 400.0))


def string(*values: float) -> bytes:
    return ",".join(f"{value:+08.3f}" for value in values).encode()


class Cell:
    """A PLC, its clock, and a sender that sends a string per cycle."""

    def __init__(self, axes=SLOW, start=(0.0, 0.0), delay=3):
        self.axes, self.plc = axes, BarePlc(axes, start, delay=delay)
        self.now = 100.0
        self.poses = [self.plc.position]
        self.words = [self.plc.word]

    def cycles(self, count: int, *payloads: bytes) -> Cell:
        """Let cycles pass; each brings the next of some payloads, the last of them for ever."""
        for number in range(count):
            if payloads:
                self.plc.on_string(payloads[min(number, len(payloads) - 1)], False, self.now)
            self.now += CYCLE
            self.plc.cycle(self.now)
            self.poses.append(self.plc.position)
            self.words.append(self.plc.word)
        return self

    def move(self, speed: float, cycles: int, slowing: int = 0) -> float:
        """Move the first axis from rest, within its limit, slowing down in the last cycles; return where the last string was."""
        most, step, at = self.axes[0].acceleration * CYCLE**2, 0.0, self.plc.position[0]
        for number in range(cycles):
            step = min(step + most, speed * CYCLE) if number < cycles - slowing else max(step - most, 0.0)
            at = round(at + step, 3)
            self.cycles(1, string(at, 0.0))
        return at

    def assert_brakes_in_limits(self, rounding: float = 0.0021):
        """Every change of speed, while it brakes too, is within the axes' acceleration, and a digit's rounding."""
        for first, second, third in zip(self.poses, self.poses[1:], self.poses[2:]):
            for a, b, c, axis in zip(first, second, third, self.axes):
                assert abs(c - 2 * b + a) <= axis.acceleration * CYCLE**2 + rounding
                assert axis.lower - 0.0011 <= c <= axis.upper + 0.0011


def test_a_stream_is_played_string_by_string_after_its_delay():
    cell = Cell()
    cell.cycles(10, string(0.0, 0.0))
    last = cell.move(40.0, 90, 60)
    cell.cycles(10, string(last, 0.0))
    assert cell.plc.position == (last, 0.0) and set(cell.words) == {"ready"} and cell.plc.state is State.FOLLOWING
    assert cell.plc.joint_string == string(last, 0.0)


@pytest.mark.parametrize(
    "payload, reason",
    [
        (string(START_TOLERANCE + 0.001, 0.0), "start"),
        (string(10.001, 0.0), "range"),
        (string(math.nan, 0.0), "format"),
        (string(0.0), "format"),
        (string(0.0, 0.0, 0.0), "format"),
        (b"+000.000,+000.0000", "format"),
        (b"+000.000 ,+000.000", "format"),
        (b" 000.000,+000.000", "format"),
        (b"", "format"),
        (b"\xff" * 17, "format"),
    ],
)
def test_a_first_string_that_is_wrong_starts_nothing_and_is_shown_until_strings_stop(payload, reason):
    cell = Cell().cycles(1000, payload)
    assert set(cell.poses) == {(0.0, 0.0)} and cell.plc.counters[reason] == 1 and cell.words[1:] == ["offline"] * 1000
    cell.cycles(round(QUIET / CYCLE) + 1)
    assert cell.plc.word == "ready"


@pytest.mark.parametrize("step, word", [(0.201, "ready"), (0.202, "offline"), (-0.202, "offline")])
def test_a_step_is_one_cycle_s_way_at_most(step, word):
    cell, at, speed = Cell().cycles(10, string(0.0, 0.0)), 0.0, 0.0
    while abs(speed) < 0.2:
        speed = max(min(speed + math.copysign(0.006, step), 0.2), -0.2)
        at += speed
        cell.cycles(1, string(0.0, at))
    cell.cycles(1, string(0.0, at + step))
    assert cell.plc.word == word and cell.plc.counters["step"] == (word == "offline")


#: SLOW's second axis: 400 deg/s^2 are 0.0064 deg per cycle and cycle, and rounding adds at most 0.002.
@pytest.mark.parametrize(
    "changes, word", [((0.008, 0.016), "ready"), ((0.009,), "offline"), ((0.006, -0.003), "offline")]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_speed_changes_by_one_cycle_s_acceleration_at_most(changes, word, sign):
    cell, at = Cell().cycles(10, string(0.0, 0.0)), 0.0
    for step in changes:
        at += sign * step
        cell.cycles(1, string(0.0, at))
    assert cell.plc.word == word and cell.plc.counters["acceleration"] == (word == "offline")
    cell.cycles(100)
    cell.assert_brakes_in_limits()


def test_a_string_that_leaves_no_room_to_brake_is_refused_before_it_is_played():
    cell = Cell(start=(8.0, 0.0)).cycles(10, string(8.0, 0.0))
    cell.move(60.0, 200)
    assert cell.plc.counters["braking_room"] == 1 and cell.plc.reason == "refused: braking_room"
    cell.cycles(200)
    cell.assert_brakes_in_limits()
    assert 8.0 < cell.plc.position[0] <= 10.0 and cell.plc.state is State.HOLDING


@pytest.mark.parametrize("speed", [0.0, 40.0])
def test_on_silence_it_brakes_within_the_limits_holds_and_says_offline(speed):
    cell = Cell().cycles(10, string(0.0, 0.0))
    cell.move(speed, 25)
    cell.cycles(round(SILENCE / CYCLE) + 5)
    assert cell.plc.word == "offline" and cell.plc.reason in ("silence", "a string was late")
    rest = cell.cycles(60).plc.position
    cell.assert_brakes_in_limits()
    assert cell.cycles(20).plc.position == rest and cell.plc.joint_string == string(*rest)
    cell.cycles(round(QUIET / CYCLE))
    assert cell.plc.word == "ready" and cell.words.index("offline") > 10


def test_strings_of_a_broken_stream_do_not_start_another():
    cell = Cell().cycles(10, string(0.0, 0.0))
    cell.move(40.0, 25)
    cell.cycles(60)
    cell.cycles(3000, cell.plc.joint_string)
    assert cell.plc.word == "offline" and cell.plc.counters["stopped"] == 3000
    cell.cycles(round(QUIET / CYCLE) + 1)
    cell.cycles(20, cell.plc.joint_string)
    assert cell.plc.state is State.FOLLOWING


def test_a_retained_string_is_refused_and_changes_nothing():
    cell = Cell()
    cell.plc.on_string(string(0.0, 0.0), True, cell.now)
    assert cell.plc.state is State.HOLDING and cell.plc.counters == {"retained": 1}
    cell.cycles(20, string(0.0, 0.0))
    cell.plc.on_string(string(9.0, 0.0), True, cell.now)
    cell.cycles(20, string(0.0, 0.0))
    assert cell.plc.state is State.FOLLOWING and cell.plc.position == (0.0, 0.0)


CENTRES = st.tuples(st.integers(-10_500, 10_500), st.integers(-91_000, 91_000))
STEPS = st.tuples(st.integers(-420, 420), st.integers(-220, 220))
MESSAGES = st.one_of(
    CENTRES.map(lambda pose: ("at", pose)),
    st.tuples(st.just("by"), STEPS),
    st.tuples(st.just("times"), st.integers(1, 40)),
    st.tuples(st.just("nothing"), st.integers(1, 40)),
    st.tuples(st.just("bytes"), st.binary(max_size=20)),
)


@given(st.lists(MESSAGES, max_size=40))
def test_whatever_comes_speed_acceleration_and_range_are_kept(messages):
    """Poses in thousandths of a degree: jumps, steps, the same step many times over, silence, and bytes that mean nothing."""
    cell, at, step = Cell(), (0, 0), (0, 0)
    cell.cycles(10, string(0.0, 0.0))
    for kind, value in messages:
        if kind == "bytes":
            cell.cycles(1, value)
        elif kind == "nothing":
            cell.cycles(value)
        else:
            step = value if kind == "by" else (0, 0) if kind == "at" else step
            at = value if kind == "at" else at
            for _ in range(value if kind == "times" else 1):
                at = tuple(here + by for here, by in zip(at, step))
                cell.cycles(1, string(*[here / 1000.0 for here in at]))
    cell.cycles(200)
    for before, after in zip(cell.poses, cell.poses[1:]):
        for a, b, axis in zip(before, after, cell.axes):
            assert abs(b - a) <= axis.speed * CYCLE + 0.0021 and axis.lower - 0.0011 <= b <= axis.upper + 0.0011
    # at the end of a stop the pose is rounded
    cell.assert_brakes_in_limits(0.0026)
    assert cell.poses[-1] == cell.poses[-50] and cell.plc.word == "ready"
    assert len(cell.plc.joint_string) == len(string(0.0, 0.0))


def test_its_limits_home_and_string_are_the_arm_s():
    robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
    for axis, low, high, speed, acceleration in zip(AXES, robot.lower, robot.upper, robot.velocity, robot.acceleration):
        expected = tuple(map(math.degrees, (low, high, speed, acceleration)))
        assert (axis.lower, axis.upper, axis.speed, axis.acceleration) == pytest.approx(expected)
    assert len(AXES) == len(robot.lower) and HOME == pytest.approx(tuple(map(math.degrees, robot.home)))
    assert BarePlc(AXES, HOME).joint_string == JointStringCodec.of(robot, 3).encode(robot.home)
    assert BarePlc(AXES, (-1e-5,) * 6).joint_string == b",".join([b"+000.000"] * 6)
