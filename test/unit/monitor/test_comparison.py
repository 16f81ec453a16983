"""Algorithm 1, the twin's history, and the comparison by command stamp."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.monitor.comparison import (
    ALIGNED,
    HISTORY,
    Comparison,
    ComparisonSettings,
    PoseComparison,
    TwinHistory,
)

T0 = 1_000 * CYCLE_NS
VIRTUAL = (0.0,) * 6
THRESHOLD = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)
angles = st.floats(-3.0, 3.0)
SETTINGS = ComparisonSettings((0.01, 0.01), lag_allowance=0.05, lag_margin=0.01)
vectors = st.lists(angles, min_size=6, max_size=6).map(tuple)


def joint(index: int, value: float) -> tuple[float, ...]:
    return tuple(value if i == index else 0.0 for i in range(6))


def agrees(virtual, physical, threshold) -> bool:
    return Comparison(T0, ALIGNED, virtual, physical, threshold, math.nan, math.nan).agrees


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize("sign", [1, -1])
class TestAlgorithm1:
    def test_a_difference_equal_to_the_threshold_agrees(self, index, sign):
        physical = joint(index, sign * THRESHOLD[index])
        assert agrees(VIRTUAL, physical, THRESHOLD)

    def test_one_joint_above_its_threshold_does_not_agree(self, index, sign):
        physical = joint(index, sign * math.nextafter(THRESHOLD[index], 1.0))
        assert not agrees(VIRTUAL, physical, THRESHOLD)


def test_a_pose_that_is_no_number_does_not_agree():
    assert not agrees(VIRTUAL, joint(3, math.nan), THRESHOLD)


@given(vectors, vectors, st.lists(st.floats(0.0, 6.0), min_size=6, max_size=6))
def test_agrees_exactly_when_every_joint_is_inside_its_threshold(virtual, physical, threshold):
    inside = all(abs(p - v) <= limit for p, v, limit in zip(physical, virtual, threshold))
    assert agrees(virtual, physical, threshold) is inside


class TestTwinHistory:
    def history(self) -> TwinHistory:
        history = TwinHistory()
        for k, q in enumerate((0.0, 0.1, 0.3)):
            history.add(T0 + k * CYCLE_NS, (q, -q))
        return history

    def test_is_empty_at_first(self):
        assert TwinHistory().latest is None and TwinHistory().at(T0) is None

    def test_interpolates_pose_and_gives_the_velocity_between_two_commands(self):
        q, velocity = self.history().at(T0 + CYCLE_NS + CYCLE_NS // 4)
        # the cubic from 0.1 to 0.3 that begins with the mean slope of both segments and ends with that of its own
        assert q == pytest.approx((0.14296875, -0.14296875))
        assert velocity == pytest.approx((0.2 / 0.004, -0.2 / 0.004))

    def test_returns_kept_poses_exactly(self):
        assert [self.history().at(T0 + k * CYCLE_NS)[0] for k in range(3)] == [(0.0, -0.0), (0.1, -0.1), (0.3, -0.3)]

    @pytest.mark.parametrize("stamp", [T0 - 1, T0 + 2 * CYCLE_NS + 1])
    def test_knows_nothing_outside_what_it_keeps(self, stamp):
        assert self.history().at(stamp) is None

    @pytest.mark.parametrize("stamp", [T0, T0 + 2 * CYCLE_NS])
    def test_ignores_a_pose_that_is_not_newer(self, stamp):
        history = self.history()
        history.add(stamp, (9.0, 9.0))
        assert history.latest == (T0 + 2 * CYCLE_NS, (0.3, -0.3))

    def test_begins_anew_where_the_stamps_are_of_a_clock_that_was_set_back(self):
        """What is compared with poses of before would be another moment's; without them the gate hears of the twin, or holds."""
        history = self.history()
        history.add(T0 - NANOSECONDS, (0.5, -0.5))
        assert history.latest == (T0 - NANOSECONDS, (0.5, -0.5)) and history.at(T0) is None

    def test_forgets_the_oldest(self):
        history = TwinHistory()
        for k in range(HISTORY + 1):
            history.add(T0 + k * CYCLE_NS, (float(k),))
        assert history.at(T0) is None and history.at(T0 + CYCLE_NS) == ((1.0,), (250.0,))


class TestPoseComparison:
    def moving(self, speed: float = 1.0) -> PoseComparison:
        comparison = PoseComparison(SETTINGS)
        for k in range(100):
            comparison.twin.add(T0 + k * CYCLE_NS, (speed * k * 0.004, 0.0))
        return comparison

    def test_a_delayed_pose_meets_the_twin_s_pose_for_the_same_command(self):
        now = T0 + 99 * CYCLE_NS
        result = self.moving().compare((0.2, 0.0), T0 + 50 * CYCLE_NS, now, 0.196)
        assert result.mode == "aligned"
        assert result.theta_virtual == pytest.approx((0.2, 0.0))
        assert result.error == pytest.approx((0.0, 0.0), abs=1e-12) and result.agrees
        assert result.round_trip == 0.196 and result.at == now

    @pytest.mark.parametrize("speed", [1.0, -1.0])
    def test_threshold_grows_with_the_commanded_velocity_of_that_joint_alone(self, speed):
        result = self.moving(speed).compare((0.0, 0.0), T0 + 50 * CYCLE_NS, T0)
        assert result.threshold == pytest.approx((0.01 + 0.05, 0.01))

    def test_velocity_is_that_at_the_command_stamp_not_the_present_one(self):
        comparison = self.moving()
        for k in range(100, 120):
            comparison.twin.add(T0 + k * CYCLE_NS, (99 * 0.004, 0.0))
        assert comparison.compare((0.2, 0.0), T0 + 50 * CYCLE_NS, T0).threshold[0] == pytest.approx(0.06)
        assert comparison.compare((0.396, 0.0), T0 + 110 * CYCLE_NS, T0).threshold[0] == pytest.approx(0.01)

    @pytest.mark.parametrize("lag, agrees", [(0.049, True), (0.0601, False)])
    def test_servo_lag_within_the_allowance_agrees(self, lag, agrees):
        physical = (0.2 - lag, 0.0)
        assert self.moving().compare(physical, T0 + 50 * CYCLE_NS, T0).agrees is agrees

    def test_without_a_command_stamp_the_present_pose_is_compared(self):
        result = self.moving().compare((0.396, 0.0), 0, T0 + 99 * CYCLE_NS)
        assert result.mode == "instant" and math.isnan(result.round_trip)
        assert result.theta_virtual == pytest.approx((0.396, 0.0))
        assert result.threshold == pytest.approx((0.06, 0.01))

    def test_a_single_twin_pose_is_compared_at_rest(self):
        comparison = PoseComparison(ComparisonSettings((0.02,), 0.05, 0.02))
        comparison.twin.add(T0, (1.0,))
        assert comparison.compare((1.0,), 0, T0).threshold == (0.02,)

    @pytest.mark.parametrize("stamp", [T0 - 1, T0 + 100 * CYCLE_NS])
    def test_an_unknown_stamp_is_not_compared_and_changes_nothing(self, stamp):
        comparison = self.moving()
        before = comparison.compare((0.2, 0.0), T0 + 50 * CYCLE_NS, T0)
        assert comparison.compare((0.2, 0.0), stamp, T0 + NANOSECONDS) is None
        assert comparison.last is before

    def test_without_a_twin_nothing_is_compared(self):
        assert PoseComparison(SETTINGS).compare((0.0, 0.0), 0, T0) is None

    def test_the_worst_joint_is_the_one_that_uses_most_of_its_threshold(self):
        result = self.moving().compare((0.2 + 0.03, 0.009), T0 + 50 * CYCLE_NS, T0)
        assert result.worst() == 1

    def test_a_pose_that_is_no_number_is_the_worst(self):
        result = self.moving().compare((0.9, math.nan), T0 + 50 * CYCLE_NS, T0)
        assert result.worst() == 1 and not result.agrees

    def test_each_joint_has_its_own_threshold(self):
        comparison = PoseComparison(ComparisonSettings((0.01, 0.002), 0.05, 0.02))
        comparison.twin.add(T0, (0.0, 0.0))
        assert comparison.compare((0.009, 0.0), 0, T0).agrees
        assert not comparison.compare((0.0, 0.009), 0, T0).agrees

    @pytest.mark.parametrize("fraction, agrees", [(1.0, True), (0.81, True), (0.79, False)])
    def test_agreement_can_be_asked_for_within_a_share_of_the_threshold(self, fraction, agrees):
        comparison = PoseComparison(ComparisonSettings((0.01, 0.01), 0.05, 0.02))
        comparison.twin.add(T0, (0.0, 0.0))
        assert comparison.compare((0.008, 0.0), 0, T0).agrees_within(fraction) is agrees

    def test_instant_compares_with_the_present_pose_whatever_the_stamp_says(self):
        comparison = self.moving()
        comparison.configure(ComparisonSettings((0.01, 0.01), 0.05, 0.02, aligned=False))
        result = comparison.compare((0.396, 0.0), T0 + 50 * CYCLE_NS, T0 + 99 * CYCLE_NS, 0.196)
        assert result.mode == "instant" and result.theta_virtual == pytest.approx((0.396, 0.0))
        assert result.round_trip == 0.196


class TestLag:
    """The lag that the arm has is found, taken out, and not allowed for any more."""

    def compared(self, lag: float, aligned: bool = True, cycles: int = 150, speed: float = 0.5, twin_leads: int = 10):
        """Let a twin move and the arm follow; return the comparisons."""
        comparison = PoseComparison(ComparisonSettings((0.01, 0.01), 0.08, 0.01, aligned))
        results = []
        for k in range(cycles):
            comparison.twin.add(T0 + k * CYCLE_NS, (speed * k * 0.004, 0.0))
            stamp = T0 + (k - twin_leads) * CYCLE_NS
            if k > 2 * twin_leads:
                q = (speed * ((k - twin_leads) * 0.004 - lag), 0.0)
                results.append(comparison.compare(q, stamp, T0 + k * CYCLE_NS))
        return results

    @pytest.mark.parametrize("lag", [0.0, 0.008, 0.0213])
    def test_is_found_and_taken_out(self, lag):
        results = self.compared(lag)
        assert math.isnan(results[0].servo_lag)
        assert results[-1].servo_lag == pytest.approx(lag, abs=1e-6)
        assert results[-1].error[0] == pytest.approx(0.0, abs=1e-6)
        assert results[0].threshold[0] == pytest.approx(0.01 + 0.08 * 0.5)
        assert results[-1].threshold == pytest.approx((0.01 + 0.01 * 0.5, 0.01))

    def test_seen_at_the_present_moment_holds_the_whole_way(self):
        assert self.compared(0.008, aligned=False)[-1].servo_lag == pytest.approx(0.008 + 10 * 0.004, abs=1e-6)

    def test_is_not_learned_at_rest(self):
        assert math.isnan(self.compared(0.0, speed=0.0)[-1].servo_lag)

    def test_a_joint_that_stands_still_is_not_taken_for_one_that_is_late(self):
        comparison = PoseComparison(ComparisonSettings((0.01, 0.01), 0.08, 0.01))
        for k in range(400):
            comparison.twin.add(T0 + k * CYCLE_NS, (0.1 * k * 0.004, 0.0))
            moved = 0.1 * (min(k, 200) - 1) * 0.004
            result = comparison.compare((moved, 0.0), T0 + (k - 1) * CYCLE_NS, T0 + k * CYCLE_NS) if k > 2 else None
        assert not result.agrees
        assert comparison.last.servo_lag < 0.08


class Whole(TwinHistory):
    """Keeps every pose of a rest."""

    def add(self, stamp, q):
        self._poses.append((stamp, q))


@given(
    st.lists(st.tuples(st.lists(st.integers(1, 5), max_size=12), st.floats(-0.01, 0.01)), min_size=1, max_size=12),
    st.data(),
)
def test_a_rest_of_which_the_middle_is_forgotten_is_interpolated_as_if_nothing_were(motion, data):
    """Each part of the motion: cycles between poses at rest, some of which are missing, and a step [rad] behind them."""
    kept, whole, stamp, q = TwinHistory(), Whole(), CYCLE_NS, 0.0
    for rest, step in motion:
        q += step
        for cycles in (*rest, 1):
            for history in (kept, whole):
                history.add(stamp, (q,))
            newest, stamp = stamp, stamp + cycles * CYCLE_NS
    at = data.draw(st.integers(CYCLE_NS, newest))
    found, wanted = kept.at(at), whole.at(at)
    assert found is not None and wanted is not None
    assert found[0] == pytest.approx(wanted[0], abs=1e-15) and found[1] == pytest.approx(wanted[1], abs=1e-12)


def test_a_motion_is_remembered_however_long_the_twin_has_rested_since():
    history = TwinHistory()
    for k in range(1, 11):
        history.add(k * CYCLE_NS, (0.1 * k,))
    for k in range(11, 10 * HISTORY):
        history.add(k * CYCLE_NS, (1.0,))
    for stamp in (5, 10, 11, HISTORY, 9 * HISTORY):
        assert history.at(stamp * CYCLE_NS)[0] == pytest.approx((min(0.1 * stamp, 1.0),))
    # as many poses in motion as it keeps push it out
    for k in range(HISTORY):
        history.add((10 * HISTORY + k) * CYCLE_NS, (1.0 + 0.1 * (k + 1),))
    assert history.at(5 * CYCLE_NS) is None and history.at(9 * HISTORY * CYCLE_NS) is None
