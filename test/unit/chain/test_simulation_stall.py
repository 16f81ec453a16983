"""A stalled joint in the whole chain on a simulated clock: how soon it is noticed, how far the twin gets away, what follows."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import numpy as np
import pytest
from chain_samples import ROBOT, assert_corrections_inside_limits, make_chain, make_plan
from simulation import SimulatedChain, SimulatedLink

from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, radians
from construction_twin.execution.executor import ExecutorState
from construction_twin.gateway.states import State
from construction_twin.mock.faults import Fault
from construction_twin.monitor.settings import GateSettings
from construction_twin.monitor.states import SyncEvent, SyncState, Transition

A3 = 2
SPEED = math.radians(30.0)
STALL = Fault("stall", "A3")
#: A3 turns by 60 deg, and another joint beside it.
GOAL = radians((20.0, -90.0, 30.0, 0.0, 90.0, 0.0))
#: Largest rounding of one pose on the wire, 3 decimals of a degree [rad].
ROUNDING = math.radians(0.5e-3)


def plan_at_full_speed(chain: SimulatedChain):
    """Return a plan on which A3 turns at 30 deg/s at its fastest, and the time of that [s]."""
    plan = make_plan(chain, GOAL, duration=3.0)
    fastest = np.abs(velocities(plan)).max()
    plan = make_plan(chain, GOAL, duration=3.0 * fastest / SPEED)
    speeds = np.abs(velocities(plan))
    assert speeds.max() == pytest.approx(SPEED, rel=1e-3)
    return plan, float(speeds.argmax()) * CYCLE


def velocities(plan) -> np.ndarray:
    trajectory = plan.trajectory
    return trajectory.sample_many(np.arange(0.0, trajectory.duration, CYCLE))[1][:, A3]


@dataclass
class Stalled:
    """A chain whose gate has just closed, and what was known just before the stall."""

    chain: SimulatedChain
    plan: object
    at: int
    round_trip: float
    servo_lag: float
    closed: Transition


def stalled(link: SimulatedLink = SimulatedLink(), gate: GateSettings = GateSettings(), decimals: int = 3) -> Stalled:
    chain = make_chain(decimals, link=link, gate=gate)
    chain.run_for(0.5)
    plan, fastest = plan_at_full_speed(chain)
    chain.play(plan)
    chain.run_for(fastest)
    before = chain.gate.comparison.last
    chain.faults.inject(STALL)
    at = chain.now
    assert chain.run_until(lambda: chain.gate.state is not SyncState.IN_SYNC, 1.0)
    closed = next(change for change in chain.transitions if change.source is SyncState.IN_SYNC)
    return Stalled(chain, plan, at, before.round_trip, before.servo_lag, closed)


def aligned_errors(run: Stalled) -> tuple[np.ndarray, np.ndarray]:
    """Return reception [ns] and A3's error [rad] of every state sample since the stall, computed without the gate."""
    stamps, poses = map(np.array, zip(*run.chain.twin_poses))
    samples = [sample for sample in run.chain.feedback if sample[0] >= run.at]
    lag = round(run.servo_lag * NANOSECONDS)
    virtual = np.interp([sample[3] - lag - run.at for sample in samples], stamps - run.at, poses[:, A3])
    measured = np.array([sample[1][A3] for sample in samples])
    return np.array([sample[0] for sample in samples]), np.abs(measured - virtual)


def links():
    quick, slow = random.Random(5), random.Random(6)
    return {
        "quiet": SimulatedLink(),
        "on_the_grid": SimulatedLink(phase=0),
        "jitter": SimulatedLink(
            command_delay=lambda: 300_000 + quick.randrange(4_000_000),
            state_delay=lambda: 300_000 + slow.randrange(3_000_000),
        ),
        "far": SimulatedLink(command_delay=lambda: 12_000_000, state_delay=lambda: 9_000_000, phase=3_100_000),
    }


@pytest.fixture(scope="module", params=list(links()))
def stall(request) -> Stalled:
    """The stall over one of several links, watched for a second after the gate has closed."""
    run = stalled(links()[request.param])
    run.chain.run_for(1.0)
    return run


class TestDetection:
    def test_the_first_sample_above_the_threshold_closes_the_gate(self, stall):
        received, errors = aligned_errors(stall)
        threshold = stall.closed.comparison.threshold[A3]
        first = received[errors > threshold][0]
        # five cycles are allowed; it is one at most: what a joint falls behind may pass for servo lag for one sample
        assert 0 <= stall.closed.at - first <= 5 * CYCLE_NS
        assert stall.closed.at - first <= 1.5 * CYCLE_NS
        assert stall.closed.event is SyncEvent.POSE_DIFFERS and stall.closed.reason.startswith("A3 differs by")

    def test_commands_freeze_on_that_cycle(self, stall):
        closed = stall.closed.at
        after = [(stamp, pose) for stamp, pose in stall.chain.twin_poses if stamp >= closed]
        frozen = [pose for stamp, pose in stall.chain.twin_poses if stamp < closed][-1]
        assert len(after) > 200 and {pose for _, pose in after} == {frozen}
        assert frozen == stall.chain.gate.held
        assert closed - stall.chain.gate.held_stamp <= CYCLE_NS

    def test_the_threshold_in_force_is_that_at_rest_and_the_margin_of_a_known_lag(self, stall):
        settings = stall.chain.gate.settings
        expected = settings.threshold + settings.lag_margin * SPEED
        assert stall.closed.comparison.threshold[A3] == pytest.approx(expected, rel=2e-3)

    def test_the_error_stays_below_threshold_and_what_moves_while_nobody_can_know(self, stall):
        chain, threshold = stall.chain, stall.closed.comparison.threshold[A3]
        times, arm = map(np.array, zip(*((time, pose[A3]) for time, pose in chain.measured if time >= stall.at)))
        stamps, twin = map(np.array, zip(*((stamp, pose[A3]) for stamp, pose in chain.twin_poses)))
        worst = np.abs(np.interp(times - stall.at, stamps - stall.at, twin) - arm).max()
        received, errors = aligned_errors(stall)
        last_inside = received[errors <= threshold][-1]
        detection = (stall.closed.at - last_inside) / NANOSECONDS
        one_way = stall.round_trip + stall.servo_lag
        assert detection <= 5 * CYCLE
        assert worst <= threshold + SPEED * (detection + one_way) + 2 * ROUNDING
        # and the bound says something: without the way there it would not hold
        assert worst > threshold + SPEED * one_way / 2

    def test_nothing_but_the_stalled_joint_leaves_its_limits(self, stall):
        assert_corrections_inside_limits(stall.chain)


def assert_measured_inside_limits(chain: SimulatedChain, joints, since: int) -> None:
    """Velocity and acceleration of the arm itself from a time on [ns], with the rounding of what it was commanded."""
    arm = np.array([pose for time, pose in chain.measured if time >= since])[:, joints]
    velocity = np.diff(arm, axis=0) / CYCLE
    acceleration = np.diff(velocity, axis=0) / CYCLE
    allowance = 4 * ROUNDING / CYCLE
    assert (np.abs(velocity) <= np.array(ROBOT.velocity)[joints] + allowance).all()
    assert (np.abs(acceleration) <= np.array(ROBOT.acceleration)[joints] + allowance / CYCLE).all()


class TestResume:
    @pytest.mark.parametrize("decimals", [3, 6])
    def test_the_released_joint_catches_up_and_the_approved_path_ends_at_the_goal(self, decimals):
        run = stalled(gate=GateSettings(policy="resume"), decimals=decimals)
        chain = run.chain
        chain.run_for(1.0)
        assert (chain.gate.state, chain.executor.state) == (SyncState.HOLDING, ExecutorState.HELD)
        chain.faults.end(STALL)
        released = chain.now
        assert chain.run_until(lambda: chain.executor.outcome == "finished", 10.0), chain.executor.reason
        chain.run_for(0.5)
        assert np.abs(np.array(chain.controller.measured) - GOAL).max() <= 1e-5
        assert_measured_inside_limits(chain, [A3], released + CYCLE_NS)
        assert_measured_inside_limits(chain, [0, 1, 3, 4, 5], run.at)
        assert_corrections_inside_limits(chain)
        # one approval, by a person, covers it all
        assert [verdict.verdict for verdict in chain.verdicts] == ["approved"]
        states = [change.target for change in chain.transitions][1:]
        assert states == [SyncState.IN_SYNC, SyncState.HOLDING, SyncState.IN_SYNC]


class TestReplan:
    def test_asks_for_a_new_plan_which_waits_for_a_person(self):
        chain = make_chain(3)
        chain.planner = lambda held, goal: make_plan(chain, goal, speed_scale=0.3)
        plan, fastest = plan_at_full_speed(chain)
        chain.play(plan)
        chain.run_for(fastest)
        chain.faults.inject(STALL)
        assert chain.run_until(lambda: chain.gate.state is SyncState.REPLANNING, 1.0)
        offered = chain.executor.under_review.plan
        assert offered.id != plan.id
        assert np.abs(offered.trajectory.positions[0] - chain.gate.held).max() == 0.0
        chain.run_for(1.0)
        assert chain.executor.outcome == "held"
        chain.faults.end(STALL)
        assert chain.run_until(lambda: chain.gate.state is SyncState.IN_SYNC, 5.0)
        resting = chain.twin.pose
        chain.run_for(1.0)
        assert chain.twin.pose == resting and chain.executor.state is ExecutorState.IDLE
        chain.play(offered)
        assert chain.run_until(lambda: chain.executor.outcome == "finished", 20.0), chain.executor.reason
        chain.run_for(0.5)
        assert np.abs(np.array(chain.controller.measured) - GOAL).max() <= 1e-5
        assert_corrections_inside_limits(chain)


@pytest.mark.parametrize("servo", ["ideal", "realistic"])
@pytest.mark.parametrize("missed", [1, 5, 10])
@pytest.mark.parametrize("speed_scale", [0.15, 0.9])
def test_the_shipped_gate_stays_open_beside_missed_replies(servo, missed, speed_scale):
    """The arm stands still under HOLDON, then begins anew on its path: it trails the twin in time, and each pose meets its own."""
    chain = make_chain(3, servo=servo)
    chain.run_for(0.5)
    turn = make_plan(chain, radians((100.0, -90.0, 90.0, 0.0, 90.0, 0.0)), speed_scale=speed_scale)
    chain.play(turn)
    speeds = np.abs(turn.trajectory.sample_many(np.arange(0.0, turn.trajectory.duration, CYCLE))[1][:, 0])
    chain.run_for(float(speeds.argmax()) * CYCLE)
    receive, left = chain.controller.receive, iter(range(missed))
    chain.controller.receive = lambda *reply: None if next(left, None) is not None else receive(*reply)
    assert chain.run_until(lambda: chain.executor.outcome == "finished", 20.0), chain.gate.reason
    assert (chain.controller.counters["missed"], chain.gateway.counters["standstills"]) == (missed, missed)
    assert chain.controller.running and chain.gateway.state is State.FOLLOWING
    assert [change.target for change in chain.transitions if change.source is SyncState.IN_SYNC] == []
    # rest is skipped: a moment after the end the arm is where the twin is
    assert chain.run_until(lambda: chain.gateway.status()["playout"]["put_off_ms"] == 0.0, 5.0)
    chain.run_for(0.2)
    assert chain.controller.measured == pytest.approx(chain.twin.pose, abs=math.radians(1e-3))
