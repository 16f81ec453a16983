"""A hold under the policy `resume`: the plan waits where the gate holds it, and goes on along its path under the same approval."""

from __future__ import annotations

import numpy as np
import pytest
from executor_bench import ACCELERATION, GOAL, ROBOT, Bench, make_plan, within_acceleration
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.errors import ExecutionError, MotionRefused, ReviewError
from construction_twin.core.limits import MotionCheck, MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.execution.executor import ExecutorState
from construction_twin.execution.playback import START_TOLERANCE
from construction_twin.monitor.states import SyncState
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.planning.timing import time_path
from construction_twin.robot.trajectory import Trajectory

HELD, PAUSED, PLAYING, IDLE = (ExecutorState[name] for name in ("HELD", "PAUSED", "PLAYING", "IDLE"))

LIMITS = MotionLimits.of(ROBOT)
#: The gate stays closed this long, as with the shipped `agree_time`: the executor has heard of the hold long before [ns].
AGREE_TIME = 25 * CYCLE_NS


class HoldBench(Bench):
    """A bench whose gate rounds, checks every setpoint with the gate's own check, and can be closed; MotionRefused ends a test.

    Args:
        decimals: Of a degree on the wire.
        hears_after: Cycles until the executor hears what the gate does.
    """

    def __init__(self, decimals: int = 3, hears_after: int = 0):
        super().__init__()
        self.codec = JointStringCodec.of(ROBOT, decimals)
        self._hears_after = hears_after
        self._news: list[tuple[int, SyncState, int]] = []
        self._check = MotionCheck(LIMITS, decimals)
        self.open = False
        self.held_stamp = 0
        self._closed_at = 0
        #: Numbers of the outputs with which the executor went back to a held setpoint.
        self.holds: list[int] = []

    def step(self):
        """One cycle; return the setpoint."""
        self.stamp += CYCLE_NS
        self._tell()
        setpoint = self.executor.step(self.stamp, self.stamp)
        self.outputs.append(setpoint)
        if setpoint is not None:
            self._pass(setpoint)
        self.executor.on_twin(self.stamp, self.twin, self.stamp)
        return setpoint

    def close(self, state: SyncState = SyncState.HOLDING) -> None:
        """Hold from the next setpoint on."""
        self.open, self._closed_at = False, self.stamp
        self._news.append((self.stamp + self._hears_after * CYCLE_NS, state, self.held_stamp))

    def try_to_open(self) -> bool:
        """Open as the gate does: some time later, when the executor's setpoint continues from the held pose."""
        if self.stamp - self._closed_at < AGREE_TIME:
            return False
        trial = MotionCheck(LIMITS, self.codec.decimals)
        trial.start(self.stamp - CYCLE_NS, self.twin)
        try:
            trial.accept(self.stamp, self.codec.quantise(self.outputs[-1]))
        except MotionRefused:
            return False
        self._check.start(self.stamp, self.twin)
        self.open = True
        return True

    def ready(self) -> HoldBench:
        """Let twin and arm agree."""
        self.twin = self.codec.quantise(self.twin)
        self._check.start(self.stamp, self.twin)
        self.open = True
        super().ready()
        self.executor.on_sync(SyncState.IN_SYNC, True, "resume", self.held_stamp)
        return self

    def _tell(self) -> None:
        while self._news and self._news[0][0] <= self.stamp:
            _, state, held = self._news.pop(0)
            was = self.state
            self.executor.on_sync(state, state is SyncState.IN_SYNC, "resume", held)
            if self.state is ExecutorState.HELD is not was:
                self.holds.append(len(self.outputs))

    def _pass(self, setpoint: tuple[float, ...]) -> None:
        if self.open:
            command = self.codec.quantise(setpoint)
            self._check.accept(self.stamp, command)
            self.twin, self.held_stamp = command, self.stamp
            self._news.append((self.stamp + self._hears_after * CYCLE_NS, SyncState.IN_SYNC, self.stamp))


@pytest.fixture
def bench() -> HoldBench:
    return HoldBench(hears_after=3).ready()


def hold(bench: HoldBench, cycles: int = 200, state: SyncState = SyncState.HOLDING) -> tuple[float, ...]:
    """Play a plan for some cycles and let the gate hold; return the setpoint that passed last."""
    bench.play(make_plan(), cycles)
    last = bench.outputs[-1]
    bench.close(state)
    bench.run(10)
    return last


def open_again(bench: HoldBench) -> None:
    bench.run(30)
    assert bench.try_to_open()
    bench.run(4)


class TestHeld:
    @pytest.mark.parametrize("state", [SyncState.HOLDING, SyncState.STALE])
    def test_stands_at_the_setpoint_that_passed_last(self, bench, state):
        last = hold(bench, state=state)
        assert bench.state is HELD and state.name in bench.executor.reason and bench.executor.rate == 0.0
        # what was ahead of the gate until the executor heard of it is taken back
        assert bench.outputs[-9] != last and set(bench.outputs[-7:]) == {last} == {bench.step()}
        assert bench.twin == bench.codec.quantise(last)

    @pytest.mark.parametrize("limit", [0.0, 1e-3])
    def test_what_was_held_before_it_moved_does_not_begin_when_its_approval_is_void(self, bench, limit):
        bench.executor.limit.set_fraction(limit, "somebody is near")
        last = hold(bench, 10)
        assert bench.state is HELD
        bench.executor.limit.set_fraction(1.0)
        bench.run(round(3.0 / CYCLE))
        assert bench.state is not HELD and bench.executor.outcome == "stopped"
        assert "not begun, the gate holds (HOLDING): an approval is void after 3 s" in bench.executor.reason
        open_again(bench)
        assert np.allclose(bench.run(100), last, rtol=0.0, atol=START_TOLERANCE)

    def test_goes_on_by_itself_to_the_goal_under_the_same_approval(self, bench):
        hold(bench)
        bench.run(500)
        begin = len(bench.outputs)
        open_again(bench)
        assert bench.state is PLAYING and "same approval" in bench.executor.reason
        bench.run_until_idle()
        rest = bench.outputs[begin:]
        assert rest[-1] == GOAL and bench.executor.outcome == "finished" and len(bench.records) == 1
        assert within_acceleration(bench.outputs[begin - 3 :])
        fractions = (np.array(rest) - ROBOT.home) / (np.array(GOAL) - ROBOT.home)
        assert np.ptp(fractions, axis=1).max() < 1e-12 and (np.diff(fractions[:, 0]) >= 0.0).all()
        assert bench.twin == bench.codec.quantise(GOAL)

    def test_a_hold_that_comes_back_before_it_moves_is_one_hold(self, bench):
        last = hold(bench)
        bench.run(300)
        assert bench.try_to_open()
        bench.run(1)
        bench.close()
        bench.run(10)
        assert bench.state is HELD and set(bench.outputs[-5:]) == {last}
        open_again(bench)
        assert bench.run_until_idle()[-1] == GOAL

    def test_a_hold_longer_than_the_memory_of_setpoints(self, bench):
        last = hold(bench)
        bench.run(2000)
        open_again(bench)
        bench.close()
        bench.run(4)
        assert bench.state is HELD
        bench.run(10)
        assert bench.outputs[-1] != last  # it had moved on a little, and stands there
        open_again(bench)
        assert bench.run_until_idle()[-1] == GOAL

    @pytest.mark.parametrize("stamp", [0, 1, 997 * CYCLE_NS])
    def test_a_setpoint_that_is_not_of_this_plan_ends_it_as_without_the_policy(self, bench, stamp):
        bench.play(make_plan(), 50)
        bench.executor.on_sync(SyncState.HOLDING, False, "resume", stamp)
        assert (bench.state, bench.executor.outcome) == (IDLE, "held") and "none of plan p" in bench.executor.reason

    def test_a_setpoint_too_long_ago_ends_it(self, bench):
        bench.play(make_plan(), 20)
        held = bench.stamp
        bench.run(260)
        bench.executor.on_sync(SyncState.HOLDING, False, "resume", held)
        assert (bench.state, bench.executor.outcome) == (IDLE, "held")

    def test_a_plan_that_has_not_begun_ends(self, bench):
        bench.approve(make_plan())
        bench.executor.on_sync(SyncState.HOLDING, False, "resume", bench.held_stamp)
        assert (bench.state, bench.executor.outcome) == (IDLE, "held")
        assert set(bench.run(100)) == {ROBOT.home}

    def test_the_goal_may_be_taken_back_until_the_twin_has_it(self, bench):
        """The gate closes one cycle before the goal passes; the executor hears of it only after it has sent the goal."""
        bench.play(make_plan(), 500)
        bench.close()
        assert bench.step() == GOAL
        bench.run(5)
        assert bench.state is HELD and bench.outputs[-1] != GOAL
        open_again(bench)
        bench.run_until_idle()
        assert bench.executor.outcome == "finished" and bench.twin == bench.codec.quantise(GOAL)

    def test_has_finished_when_the_goal_has_passed(self, bench):
        bench.play(make_plan(), 500)
        assert bench.step() == GOAL
        assert bench.run(4)[0] == GOAL and bench.executor.outcome == "finished" and bench.state is IDLE


class TestEnds:
    @pytest.mark.parametrize(
        "event, state, outcome",
        [
            (lambda e, now: e.on_sync(SyncState.STOPPED, False, "resume", now), IDLE, "held"),
            (lambda e, now: e.on_sync(SyncState.FAULT, False, "resume", now), IDLE, "held"),
            (lambda e, now: e.on_sync(SyncState.WAITING, False, "resume", now), IDLE, "held"),
            (lambda e, now: e.on_sync(SyncState.HOLDING, False, "replan", now), IDLE, "held"),
            (lambda e, now: e.on_sync(SyncState.HOLDING, False, "stop", now), IDLE, "held"),
            (lambda e, now: e.on_sync(SyncState.STALE, False), IDLE, "held"),
            (lambda e, now: e.on_link(False, "gateway is holding"), IDLE, "dropped"),
            (lambda e, now: e.restart("new command session", now), ExecutorState.WAITING, "dropped"),
            (lambda e, now: e.stop(now), IDLE, "stopped"),
            (lambda e, now: e.on_scene("0ther"), IDLE, "stopped"),
        ],
        ids="stopped fault waiting replan stop_policy silent link restart stop scene".split(),
    )
    @pytest.mark.parametrize("held", [True, False], ids=["held", "playing"])
    def test_everything_else_ends_a_held_plan_for_good(self, bench, event, state, outcome, held):
        if held:
            hold(bench)
        else:
            bench.play(make_plan(), 200)
        event(bench.executor, bench.stamp)
        bench.close()
        if bench.state is ExecutorState.STOPPING:
            bench.run_until_idle()
        assert (bench.state, bench.executor.outcome) == (state, outcome)
        held_at = bench.twin
        bench.executor.on_sync(SyncState.IN_SYNC, True, "resume", bench.held_stamp)
        bench.run(50)
        assert bench.twin == held_at and bench.state is IDLE
        with pytest.raises(ReviewError, match="was decided already or withdrawn"):
            bench.approve(make_plan())


class TestPaused:
    @pytest.mark.parametrize("rested", [True, False], ids=["paused", "pausing"])
    def test_a_pause_comes_back_as_a_pause(self, bench, rested):
        bench.play(make_plan(), 200)
        bench.executor.pause(bench.stamp)
        if rested:
            bench.run_until(PAUSED)
        bench.run(3)
        bench.close()
        bench.run(5)
        assert bench.state is HELD
        open_again(bench)
        assert bench.state is PAUSED and len(set(bench.run(300))) == 1
        bench.executor.resume()
        assert bench.run_until_idle()[-1] == GOAL and len(bench.records) == 1

    def test_a_pause_asked_for_while_held_is_one_afterwards(self, bench):
        last = hold(bench)
        assert "HELD" in bench.executor.pause(bench.stamp)
        with pytest.raises(ExecutionError):
            bench.executor.resume()
        open_again(bench)
        assert bench.state is PAUSED and set(bench.run(100)) == {last}


ACTIONS = st.lists(
    st.tuples(
        st.sampled_from(["hold", "stale", "open", "pause", "resume", 0.0, 0.2, 0.6, 1.0]),
        st.integers(0, 120),
    ),
    max_size=12,
)


def act(bench: HoldBench, action) -> None:
    """Do something that is possible at the moment, or nothing."""
    if action in ("hold", "stale") and bench.open:
        bench.close(SyncState.HOLDING if action == "hold" else SyncState.STALE)
    elif action == "open" and not bench.open:
        bench.try_to_open()
    elif action == "pause" and bench.state in (PLAYING, HELD):
        bench.executor.pause(bench.stamp)
    elif action == "resume" and bench.state in (PAUSED, ExecutorState.PAUSING) and bench.open:
        try:
            bench.executor.resume()
        except ExecutionError:
            assert bench.state is not PLAYING
    elif isinstance(action, float):
        bench.executor.limit.set_fraction(action, "test")


def play_with(bench: HoldBench, actions) -> None:
    """Do one after the other, then let the plan run to its end; while the gate is closed nothing may go to the robots."""
    for action, cycles in actions:
        act(bench, action)
        before, opened = bench.twin, bench.open
        bench.run(cycles)
        assert opened or bench.twin == before
    bench.executor.limit.set_fraction(1.0)
    for _ in range(20_000):
        if bench.state is IDLE:
            return
        act(bench, "resume" if bench.open else "open")
        bench.step()
    raise AssertionError(bench.executor.reason)


def runs(bench: HoldBench) -> list[np.ndarray]:
    """Split the setpoints where the executor went back to a held one; each run begins at rest."""
    parts = np.split(np.array([q or ROBOT.home for q in bench.outputs]), bench.holds)
    return [np.concatenate([part[:1], part[:1], part]) for part in parts if len(part)]


def planned(seed: int, points: int, span: float, scale: float) -> Trajectory:
    """A random motion as the planner times it."""
    rng = np.random.default_rng(seed)
    path = np.array(ROBOT.home) + span * rng.uniform(-1.0, 1.0, (points, 6))
    path[0] = ROBOT.home
    return time_path(path, ROBOT, speed_scale=scale)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32),
    st.integers(2, 5),
    st.sampled_from([0.05, 0.3, 0.6]),
    st.sampled_from([3, 6]),
    st.integers(0, 12),
    ACTIONS,
)
def test_any_sequence_of_holds_pauses_and_limits_stays_on_the_path_and_passes_the_gate(
    seed, points, span, decimals, hears_after, actions
):
    """The bench's gate checks every setpoint that goes to the robots, rounded as on the wire."""
    motion = planned(seed, points, span, 1.0)
    bench = HoldBench(decimals, hears_after).ready()
    assert set(bench.run(20)) == {bench.twin}  # nothing without an approval
    bench.play(make_plan(motion=motion), 15)
    play_with(bench, actions)
    assert bench.executor.outcome == "finished" and len(bench.records) == 1
    assert bench.twin == bench.codec.quantise(tuple(motion.positions[-1]))
    path = motion.sample_many(np.arange(0.0, motion.duration + 2 * CYCLE, CYCLE / 4))[0]
    farthest = np.abs(np.diff(path, axis=0)).max()
    for q in bench.outputs[4::100]:
        assert np.abs(path - q).max(axis=1).min() <= farthest


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.3, 0.6]), st.integers(0, 8), ACTIONS)
def test_between_holds_a_straight_plan_keeps_its_velocity_and_acceleration_limits(seed, scale, hears_after, actions):
    """Not its jerk limits: where there is no smooth ramp they are only aimed at, see `Progress.advance` and test_progress."""
    bench = HoldBench(6, hears_after).ready()
    bench.play(make_plan(motion=planned(seed, 2, 0.6, scale)), 15)
    play_with(bench, actions)
    assert bench.executor.outcome == "finished"
    for rows in runs(bench):
        velocity, acceleration = (np.diff(rows, order, axis=0) / CYCLE**order for order in (1, 2))
        assert (np.abs(velocity) <= np.array(ROBOT.velocity)).all()
        assert (np.abs(acceleration) <= ACCELERATION * (1 + 1e-6)).all()
