"""Judging: each check passes on a sound run and fails on one that is not; exact figures on made-up recordings."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.evaluation.recording import FeedbackStream, PlayedPlan, Recording, Stream
from construction_twin.gateway.states import State
from construction_twin.gateway.trace import TraceEntry
from construction_twin.robot.description import read_robot_files
from construction_twin.scenario.definition import make_scenario
from construction_twin.scenario.judge import judge, matches
from construction_twin.scenario.motion import distance_after, limit_usage, trace_arrays
from construction_twin.scenario.timeline import Change, GatewayStop, Run, SyncMoment

ROOT = Path(__file__).resolve().parents[3]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
LIMITS = MotionLimits.of(ROBOT)
T0 = 1_790_000_000_000_000_000
COUNT = 1000
START = 100
#: The arm begins to stand still here, and the gate closes here.
FAULT, CLOSED = 500, 530
THRESHOLD = 0.01


def profile():
    """A3 from 0 to 20 deg between the cycles 100 and 900, shape (k, 6) [rad]."""
    u = np.clip((np.arange(COUNT) - START) / 800, 0.0, 1.0)
    q = np.tile(ROBOT.home, (COUNT, 1))
    q[:, 2] += math.radians(20.0) * u**3 * (10 + u * (6 * u - 15))
    return q


def make_run(arm=None, twin=None, changes=(), closings=(), failure="", missed=()):
    stamps = T0 + CYCLE_NS * np.arange(COUNT)
    twin = profile() if twin is None else twin
    arm = twin if arm is None else arm
    received = stamps + 30_000_000
    recording = Recording(
        "/kr120",
        ROBOT.joint_names,
        Stream(stamps, twin, stamps),
        Stream(received, arm, received),
        FeedbackStream(received, arm, received, np.arange(COUNT), stamps),
        plans=(PlayedPlan("1", int(stamps[START]), 3.2, "finished"),),
    )
    first = [Change(T0 - 5, "sync", "IN_SYNC"), Change(T0 - 5, "link", "ARMED"), Change(T0 - 5, "execution", "IDLE")]
    return Run(
        recording,
        (*first, *changes),
        tuple(closings),
        received,
        arm,
        len(missed),
        np.array(missed, dtype=np.int64),
        failure,
    )


def at(cycle):
    return int(T0 + CYCLE_NS * cycle + 30_000_000)


def stalled_run():
    arm = profile()
    arm[FAULT:, 2] = arm[FAULT, 2]
    twin = profile()
    twin[CLOSED:, 2] = twin[CLOSED, 2]
    changes = (
        Change(at(FAULT), "fault", "stall", "A3"),
        Change(at(CLOSED), "sync", "HOLDING"),
        Change(at(CLOSED), "outcome", "held"),
    )
    error = tuple(np.abs(twin - arm)[CLOSED])
    closing = SyncMoment(at(CLOSED), ROBOT.joint_names, error, (THRESHOLD,) * 6, math.nan)
    return make_run(arm, twin, changes, [closing])


def make_trace(positions, cycle_ms=4):
    return [TraceEntry(cycle_ms * k, 0, State.FOLLOWING, 1, tuple(q)) for k, q in enumerate(positions)]


def expectation(**changes):
    goal = np.degrees(profile()[-1]).tolist()
    expect = {"sync": ["IN_SYNC"], "final": {"sync": "IN_SYNC", "link": "ARMED"}, "ends": "goal"} | changes
    return make_scenario("test", {"title": "t", "steps": [{"move": {"goal_deg": goal}}], "expect": expect})


def stall_expectation(**changes):
    expect = {"sync": ["IN_SYNC", "HOLDING"], "final": {"outcome": "held"}, "ends": "holds"} | changes
    steps = [
        {"move": {"goal_deg": np.degrees(profile()[-1]).tolist()}},
        {"inject": {"fault": "stall", "joint": "joint_a3"}},
    ]
    return make_scenario("test", {"title": "t", "steps": steps, "expect": expect})


def verdict_of(scenario, run, trace=None, cycle_ms=4):
    return judge(scenario, run, make_trace(profile()) if trace is None else trace, LIMITS, 6, cycle_ms / 1000)


def failed(verdict):
    return [check.name for check in verdict.checks if not check.passed]


def test_a_sound_run_passes():
    verdict = verdict_of(expectation(max_error_deg=0.001), make_run())
    assert verdict.passed, verdict.checks
    assert verdict.measured["worst_error_deg"] == pytest.approx(0.0, abs=1e-9)
    # the largest velocity of the quintic: 15/8 of the mean
    fraction = math.radians(20.0) / 3.2 * 15 / 8 / LIMITS.velocity[2]
    assert verdict.measured["velocity_fraction"] == pytest.approx(fraction, rel=1e-3)
    assert verdict.measured["arm_velocity_fraction"] == pytest.approx(fraction, rel=1e-3)
    assert verdict.measured["detection_s"] is None


@pytest.mark.parametrize(
    "changes, name",
    [
        ({"sync": ["IN_SYNC", "HOLDING"]}, "states of the gate"),
        ({"final": {"link": "NEEDS_RESET"}}, "final link"),
        ({"ends": "holds"}, "holds before the goal"),
    ],
)
def test_another_outcome_fails(changes, name):
    assert failed(verdict_of(expectation(**changes), make_run())) == [name]


def test_a_run_that_was_not_carried_out_fails():
    assert failed(verdict_of(expectation(), make_run(failure="waited in vain"))) == ["carried out"]


def test_detection_is_counted_from_the_first_sample_over_the_threshold_and_from_the_fault():
    run = stalled_run()
    error = np.abs(run.recording.twin.positions - run.arm)[:, 2]
    over = int((error[FAULT : CLOSED + 1] > THRESHOLD).sum())
    assert 1 < over < 25
    verdict = verdict_of(stall_expectation(detection_samples=over, detection_s=0.121), run)
    assert verdict.passed, verdict.checks
    assert verdict.measured["detection_samples"] == over
    assert verdict.measured["detection_s"] == pytest.approx(30 * CYCLE)
    assert verdict.measured["worst_joint"] == "joint_a3"
    assert verdict.measured["worst_error_deg"] == pytest.approx(np.degrees(error.max()))
    late = verdict_of(stall_expectation(detection_samples=over - 1, detection_s=0.119), run)
    assert failed(late) == ["detection_s", "detection_samples"]


GROWTH = "error of the stalled joint"


def test_a_stalled_joint_s_error_may_grow_until_the_gate_closes_and_no_further():
    run = stalled_run()
    assert failed(verdict_of(stall_expectation(), run)) == []
    speed = np.abs(np.diff(profile()[CLOSED - 40 : CLOSED + 1, 2])).max() / CYCLE
    (check,) = [check for check in verdict_of(stall_expectation(), run).checks if check.name == GROWTH]
    assert f"{math.degrees(speed):.1f} deg/s" in check.expected
    # commands that go on beyond the closing drive the twin away from the arm
    late = profile()
    late[CLOSED + 30 :, 2] = late[CLOSED + 30, 2]
    stream = dataclasses.replace(run.recording.twin, positions=late)
    bad = dataclasses.replace(run, recording=dataclasses.replace(run.recording, twin=stream))
    assert failed(verdict_of(stall_expectation(), bad)) == [GROWTH]


@pytest.mark.parametrize("joint, further, fails", [(0, 0.0, []), (0, 0.01, ["distance after silence"]), (2, 0.01, [])])
def test_no_sound_joint_goes_further_than_the_gateway_stated(joint, further, fails):
    stated, moved = [1.0] * 6, [1.0] * 6
    moved[joint] += further
    run = dataclasses.replace(stalled_run(), stops=(GatewayStop("silence", tuple(stated), tuple(moved)),))
    # A3 is the joint that stalls
    assert failed(verdict_of(stall_expectation(), run)) == fails


@pytest.mark.parametrize("stated, fails", [(3.0, []), (0.5, ["stated stop distance"])])
def test_an_emergency_stop_ends_within_what_the_controller_stated(stated, fails):
    arm, count = profile(), np.minimum(np.arange(COUNT - FAULT), 40)
    arm[FAULT:, 2] = arm[FAULT, 2] + (arm[FAULT, 2] - arm[FAULT - 1, 2]) * (count - count**2 / 80)
    assert 0.5 < math.degrees(arm[-1, 2] - arm[FAULT, 2]) < 3.0
    run = make_run(arm, arm, [Change(at(FAULT), "fault", "estop")])
    run = dataclasses.replace(run, stated=(0.0, 0.0, -stated, 0.0, 0.0, 0.0))
    stop = {"event": "fault estop", "distance_deg": 5.0}
    assert failed(verdict_of(expectation(ends="holds", stop=stop), run)) == fails


@pytest.mark.parametrize("noted", [-3, 0, 3], ids=["before the first cycle", "in it", "after it"])
def test_an_arm_that_a_new_session_finds_elsewhere_has_not_moved(noted):
    arm = np.tile(ROBOT.home, (COUNT, 1))
    arm[950:, 0] += math.radians(20.0)
    changes = [Change(at(950) + noted * 1_000_000, "fault", "restart_at"), Change(at(950), "session", "2")]
    changes.sort(key=lambda change: change.stamp)
    stop = {"event": "fault restart_at", "distance_deg": 0.01}
    assert "stop distance" not in failed(verdict_of(expectation(stop=stop), make_run(arm, changes=changes)))
    # what it does from then on is motion
    arm[960:, 0] += math.radians(0.02)
    assert "stop distance" in failed(verdict_of(expectation(stop=stop), make_run(arm, changes=changes)))


def test_what_is_not_detected_fails():
    run = dataclasses.replace(stalled_run(), closings=())
    assert failed(verdict_of(stall_expectation(detection_samples=5), run)) == ["detection_samples"]


def test_an_error_over_the_bound_fails():
    run = stalled_run()
    worst = verdict_of(stall_expectation(), run).measured["worst_error_deg"]
    assert failed(verdict_of(stall_expectation(max_error_deg=worst * 0.99), run)) == ["largest error"]


def test_the_stop_distance_is_measured_until_the_arm_may_move_again():
    run = stalled_run()
    distance = np.degrees(np.abs(run.arm[480:] - run.arm[480])[:, 2].max())
    event = Change(at(480), "call", "stop")
    run = dataclasses.replace(run, changes=(*run.changes[:3], event, *run.changes[3:]))
    stop = {"event": "call stop", "distance_deg": distance * 1.3}
    verdict = verdict_of(stall_expectation(stop=stop), run)
    assert verdict.passed, verdict.checks
    assert verdict.measured["stop_distance_deg"] == pytest.approx(distance, rel=0.1)
    assert verdict.measured["stop_time_s"] == pytest.approx(20 * CYCLE, abs=2 * CYCLE)
    assert failed(verdict_of(stall_expectation(stop=stop | {"distance_deg": distance * 0.5}), run)) == ["stop distance"]
    assert failed(verdict_of(stall_expectation(stop=stop | {"event": "call reset"}), run)) == ["stop distance"]


def test_a_run_in_which_the_fault_never_was_on_fails():
    run = stalled_run()
    assert "faults that were on" not in failed(verdict_of(stall_expectation(), run))
    without = dataclasses.replace(run, changes=tuple(change for change in run.changes if change.topic != "fault"))
    assert "faults that were on" in failed(verdict_of(stall_expectation(), without))


def test_packets_that_were_to_be_lost_must_have_been():
    assert failed(verdict_of(expectation(min_missed=2), make_run(missed=[at(300), at(400)]))) == []
    assert failed(verdict_of(expectation(min_missed=2), make_run(missed=[at(300)]))) == ["missed replies"]


def test_corrections_and_sound_joints_outside_the_limits_fail():
    jump = profile()
    jump[600:, 0] += math.radians(5.0)
    run = make_run(arm=jump)
    assert "sound joints inside the limits" in failed(verdict_of(expectation(), run))
    # a missed reply explains it, so it is reported only; one at another time does not
    excused = verdict_of(expectation(), make_run(arm=jump, missed=[at(601)]))
    assert "sound joints inside the limits" not in failed(excused)
    assert excused.measured["arm_acceleration_fraction"] > 1.0
    assert "sound joints inside the limits" in failed(verdict_of(expectation(), make_run(arm=jump, missed=[at(300)])))
    # the next cycles of a process that was late come later, and are the missed reply's all the same
    late = make_run(arm=jump, missed=[at(598)])
    stamps = late.arm_stamps + np.where(np.arange(COUNT) > 598, 40_000_000, 0)
    paused = dataclasses.replace(late, arm_stamps=stamps)
    assert "sound joints inside the limits" not in failed(verdict_of(expectation(), paused))
    assert failed(verdict_of(expectation(), make_run(), make_trace(jump))) == ["corrections inside the limits"]
    assert failed(verdict_of(expectation(), make_run(), [])) == ["corrections inside the limits"]


def at_12_ms(run):
    """The run with the arm of a controller at 12 ms, and the gateway's trace of it."""
    slow = dataclasses.replace(run, arm=run.arm[::3], arm_stamps=run.arm_stamps[::3])
    return slow, make_trace(slow.arm, 12)


def test_a_controller_at_12_ms_is_judged_by_its_own_cycle():
    run, trace = at_12_ms(make_run())
    verdict = verdict_of(expectation(), run, trace, 12)
    assert verdict.passed, verdict.checks
    fraction = math.radians(20.0) / 3.2 * 15 / 8 / LIMITS.velocity[2]
    for name in ("velocity_fraction", "arm_velocity_fraction"):
        assert verdict.measured[name] == pytest.approx(fraction, rel=1e-3)
    # the corrections' acceleration is the motion's: no cycle of it counts as a start from rest
    most = np.abs(np.diff(profile()[::3], n=2, axis=0)).max() / 0.012**2 / LIMITS.acceleration[2]
    assert verdict.measured["acceleration_fraction"] == pytest.approx(most, rel=1e-3)


def test_at_12_ms_too_the_arm_rests_after_a_missed_telegram():
    for missed, begins in ((0, [0]), (1, [0, 10]), (2, [0, 10])):
        entries = make_trace(np.cumsum(np.full((20, 6), 1e-4), axis=0), 12)
        entries = [dataclasses.replace(e, ipoc=e.ipoc + (12 * missed if k >= 10 else 0)) for k, e in enumerate(entries)]
        assert np.flatnonzero(trace_arrays(entries, 0.012)[1]).tolist() == begins


def test_what_leaves_the_limits_at_12_ms_fails():
    jump = profile()[::3].copy()
    # more than at 12 ms, less than a third of it would be at 4 ms
    jump[200:, 0] += 1.1 * LIMITS.velocity[0] * 0.012
    run, _ = at_12_ms(make_run())
    found = failed(verdict_of(expectation(), dataclasses.replace(run, arm=jump), make_trace(jump, 12), 12))
    assert {"corrections inside the limits", "sound joints inside the limits"} <= set(found)


def test_a_stalled_joint_is_not_sound_and_a_new_session_is_no_motion():
    run = stalled_run()
    assert "sound joints inside the limits" not in failed(verdict_of(stall_expectation(), run))
    jump = profile()
    jump[950:, 0] += math.radians(5.0)
    session = Change(at(950), "session", "2")
    run = make_run(arm=jump, changes=(session,))
    assert "sound joints inside the limits" not in failed(verdict_of(expectation(), run))


@pytest.mark.parametrize(
    "expected, found, answer",
    [
        (["A"], ["A"], True),
        (["A", "B?", "C"], ["A", "C"], True),
        (["A", "B?", "C"], ["A", "B", "C"], True),
        (["A", "B?", "B"], ["A", "B"], True),
        (["A", "B"], ["A", "B", "A"], False),
        (["A"], [], False),
        ([], [], True),
    ],
)
def test_orders_of_states(expected, found, answer):
    assert matches(expected, found) is answer


def test_states_begin_with_the_one_before_the_motion():
    changes = (Change(T0 - 3, "sync", "WAITING"), Change(T0, "sync", "IN_SYNC"), Change(at(300), "sync", "STALE"))
    assert make_run(changes=changes).states("sync") == ["IN_SYNC", "STALE"]


def test_a_trace_with_missed_telegrams_goes_on_from_rest():
    positions = np.cumsum(np.full((20, 6), 1e-4), axis=0)
    entries = make_trace(positions)
    entries = [dataclasses.replace(e, ipoc=e.ipoc + (40 if k >= 10 else 0)) for k, e in enumerate(entries)]
    rows, breaks = trace_arrays(entries, CYCLE)
    assert len(rows) == 21 and np.flatnonzero(breaks).tolist() == [0, 10]
    velocity, acceleration = limit_usage(rows, breaks, LIMITS, 6, CYCLE)
    np.testing.assert_allclose(velocity, 1e-4 / CYCLE / np.array(LIMITS.velocity), rtol=1e-3)
    assert (acceleration > 0).all()


def test_distance_after_an_event():
    stamps = T0 + CYCLE_NS * np.arange(100)
    q = np.minimum(np.arange(100), 40)[:, None] * 0.01
    distance, rest = distance_after(stamps, q, int(stamps[20]), int(stamps[99]))
    assert distance[0] == pytest.approx(0.21, abs=0.011)
    assert rest == pytest.approx(20 * CYCLE)
