"""The motion check that gate and gateway fraction."""

from __future__ import annotations

import math

import pytest

from construction_twin.core.errors import MotionRefused
from construction_twin.core.limits import RANGE_SLACK, MotionCheck, MotionLimits, outside_tolerance
from construction_twin.core.units import CYCLE, CYCLE_NS, format_allowance
from construction_twin.mqtt.joint_string import JointStringCodec

LIMITS = MotionLimits(("A1", "A2"), (-3.0, -1.0), (3.0, 1.0), (2.0, 1.0), (2.5, 5.0))
DECIMALS = 3
#: What rounding adds to one step [rad].
ROUNDING = math.radians(10.0**-DECIMALS)
#: What one cycle may change the velocity by [rad/s].
BUDGET = (2.5 + format_allowance(DECIMALS)) * CYCLE


def refusal(call, *arguments) -> MotionRefused:
    with pytest.raises(MotionRefused) as caught:
        call(*arguments)
    return caught.value


class Stream:
    """Feeds a check by velocities [rad/s] of A1; A2 stands still."""

    def __init__(self, q=0.0):
        self.check = MotionCheck(LIMITS, DECIMALS)
        self.check.start(0, (q, 0.0))
        self.stamp, self.q = 0, q

    def step(self, velocity, cycles=1):
        stamp, q = self.stamp + cycles * CYCLE_NS, self.q + velocity * cycles * CYCLE
        self.check.accept(stamp, (q, 0.0))
        self.stamp, self.q = stamp, q

    def accelerate(self, velocity):
        """Reach `velocity` with the acceleration limit."""
        now = 0.0
        while now != velocity:
            now = min(velocity, now + 2.5 * CYCLE) if velocity > 0 else max(velocity, now - 2.5 * CYCLE)
            self.step(now)
        return self


# -- range -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("q", [(3.0, 1.0), (-3.0, -1.0), (0.0, 1.0 + 0.9 * RANGE_SLACK)])
def test_the_ends_of_the_range_belong_to_it(q):
    LIMITS.check_range(q)


@pytest.mark.parametrize(
    "q, name, limit", [((0.0, 1.0 + 1e-8), "A2", 1.0), ((-3.1, 5.0), "A1", -3.0), ((3.1, 0.0), "A1", 3.0)]
)
def test_a_value_outside_names_the_first_joint_and_the_end_it_passed(q, name, limit):
    error = refusal(LIMITS.check_range, q)
    assert (error.reason, error.joint, error.limit) == ("range", name, limit)


@pytest.mark.parametrize("q", [(0.0,), (0.0, 0.0, 0.0), (), (math.nan, 0.0), (0.0, math.inf)])
def test_what_is_not_one_number_per_joint_has_no_range(q):
    assert refusal(LIMITS.check_range, q).reason == "values"


def test_from_a_start_a_hair_outside_a_joint_may_stay_or_come_in_and_nothing_else():
    outside = 3.0 + math.radians(0.04)
    check = MotionCheck(LIMITS, DECIMALS)
    check.start(0, (outside, 0.0))
    check.accept(CYCLE_NS, (outside, 0.0))
    inwards = outside - 2e-5
    check.accept(2 * CYCLE_NS, (inwards, 0.0))
    for q in ((inwards + 1e-6, 0.0), (inwards, 1.0 + 1e-6)):
        assert refusal(check.accept, 3 * CYCLE_NS, q).reason == "range"
    for over, linear in ((math.radians(0.06), False), (math.radians(0.05), True)):
        limits = MotionLimits(("A1",), (-3.0,), (3.0,), (2.0,), (2.5,), (linear,))
        for far in (3.0 + over, -3.0 - over):
            assert refusal(limits.check_range, (far,), (far,)).reason == "range"


def test_tolerance_names_the_first_joint_beyond_it_and_includes_its_bound():
    assert outside_tolerance((1.0, 2.0), (1.5, 2.0), 0.5) is None
    assert outside_tolerance((1.0, 2.0, 9.0), (1.5, 3.0, 0.0), 0.5) == 1


# -- velocity --------------------------------------------------------------------------------------------------------


def test_the_velocity_limit_is_allowed_with_one_rounding_step_more_and_not_beyond():
    stream = Stream(-2.0).accelerate(2.0)
    stream.step(2.0 + 0.99 * ROUNDING / CYCLE)
    error = refusal(stream.step, 2.0 + 1.01 * ROUNDING / CYCLE)
    assert (error.reason, error.joint) == ("velocity", "A1")


# -- acceleration ----------------------------------------------------------------------------------------------------


def test_the_first_step_is_from_rest():
    Stream().step(0.99 * BUDGET)
    assert refusal(Stream().step, 1.01 * BUDGET).reason == "acceleration"
    assert refusal(Stream().step, -1.01 * BUDGET).reason == "acceleration"


@pytest.mark.parametrize("sign", [1, -1])
def test_speeding_up_is_bounded_by_the_budget(sign):
    stream = Stream().accelerate(sign * 0.5)
    error = refusal(stream.step, sign * (0.5 + 1.01 * BUDGET))
    assert (error.reason, error.joint) == ("acceleration", "A1")
    stream.step(sign * (0.5 + 0.99 * BUDGET))


def test_after_a_lost_command_the_budget_is_that_of_the_mean_of_both_periods():
    stream = Stream().accelerate(0.5)
    budget = 2.5 * 1.5 * CYCLE + format_allowance(DECIMALS) * CYCLE / 2
    assert refusal(stream.step, 0.5 + 1.001 * budget, 2).reason == "acceleration"
    stream.step(0.5 + 0.999 * budget, 2)


@pytest.mark.parametrize("sign", [1, -1])
def test_stopping_at_once_is_the_followers_to_absorb(sign):
    stream = Stream().accelerate(sign * 1.0)
    stream.step(0.0)
    stream.step(0.0)


def test_turning_round_harder_than_the_budget_is_refused():
    stream = Stream().accelerate(1.0)
    assert refusal(stream.step, -1.01 * BUDGET).reason == "acceleration"
    stream.step(-0.99 * BUDGET)


@pytest.mark.parametrize("decimals", range(1, 7))
def test_a_motion_at_the_limits_passes_with_every_number_of_decimals(decimals):
    codec = JointStringCodec(2, decimals)
    check = MotionCheck(LIMITS, decimals)
    check.start(0, codec.quantise((-2.9, 0.0)))
    q, velocity = -2.9, 0.0
    for k in range(1, 900):
        # up to the limit, along it, and down again to rest
        velocity = min(2.0, velocity + 2.5 * CYCLE) if k < 500 else max(0.0, velocity - 2.5 * CYCLE)
        q += velocity * CYCLE
        check.accept(k * CYCLE_NS, codec.quantise((q, 0.0)))
    assert velocity == 0.0


# -- room to brake ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
def test_a_step_that_leaves_no_room_to_brake_before_the_range_ends_is_refused(sign):
    stream = Stream(sign * 1.9).accelerate(sign * 1.0)
    error = None
    for _ in range(1000):
        try:
            stream.step(sign * 1.0)
        except MotionRefused as refused:
            error = refused
            break
    assert (error.reason, error.joint) == ("braking_room", "A1")
    # 1 rad/s at 2.5 rad/s^2 needs 0.2 rad: it was refused within one step of that
    assert 0.2 - 2 * ROUNDING / CYCLE < 3.0 - abs(stream.q) < 0.2 + 1.0 * CYCLE


def test_a_motion_may_end_exactly_at_the_end_of_the_range():
    budget = 2.5 * CYCLE
    # up to 10 budgets and down again: 10 + 9 + ... on each side
    stream = Stream(3.0 - (55 + 45) * budget * CYCLE)
    for k in [*range(1, 11), *range(9, 0, -1), 0]:
        stream.step(k * budget)
    assert stream.q == pytest.approx(3.0, abs=1e-12)


# -- order and memory ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0, -CYCLE_NS])
def test_a_stamp_that_is_not_later_is_refused(step):
    stream = Stream()
    stream.step(0.0)
    assert refusal(stream.check.accept, stream.stamp + step, (0.0, 0.0)).reason == "order"


def test_a_refused_setpoint_is_not_remembered():
    stream = Stream().accelerate(0.5)
    before = stream.check.position
    refusal(stream.check.accept, stream.stamp + CYCLE_NS, (2.0, 0.0))
    assert stream.check.position == before
    stream.step(0.5)


def test_a_new_start_forgets_the_motion_before():
    stream = Stream(-2.0).accelerate(1.0)
    stream.check.start(5 * CYCLE_NS, (2.0, 0.5))
    assert stream.check.position == (2.0, 0.5)
    assert refusal(stream.check.accept, 6 * CYCLE_NS, (2.0 + 1.0 * CYCLE, 0.5)).reason == "acceleration"
    stream.check.accept(6 * CYCLE_NS, (2.0, 0.5))
