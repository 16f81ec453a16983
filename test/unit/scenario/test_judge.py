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
from construction_twin.scenario.timeline import Change, Run, SyncMoment

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
