"""A planner on another PC: its plans are judged by their content, never by its clock, and the arm does not depend on it."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest
from construction_twin.msg import Execution, Link, Sync
from namespaces import Namespaces, why_no_namespaces
from other_pc import OtherPc, TwinPc
from processes import wait_until

from construction_twin.core.units import radians

pytestmark = pytest.mark.ends_rospy
#: How far the other PC's clock is ahead [s].
AHEAD = 10
NEAR, ASIDE = (12.0, -85.0, 85.0, 0.0, 80.0, 10.0), (-12.0, -85.0, 85.0, 0.0, 80.0, 10.0)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    reason = why_no_namespaces()
    if reason:
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("lab")
    with Namespaces() as spaces, TwinPc(spaces, folder) as twin:
        yield spaces, twin, OtherPc(spaces, folder, AHEAD)


@pytest.fixture
def spaces(lab):
    return lab[0]


@pytest.fixture
def twin(lab):
    wait_until(lab[1].ready, 20.0, "a robot that is ready")
    return lab[1]


@pytest.fixture
def other(lab):
    return lab[2]


def next_plan(twin, before: int, program):
    """Return the plan that follows on `before` plans."""
    wait_until(lambda: len(twin.plans) > before or program.ended, 40.0, "a plan")
    assert len(twin.plans) > before, program.output
    return twin.plans[-1]


def undisturbed(twin, syncs: int, links: int) -> bool:
    """Return whether gate and link have stayed as they were since so many reports."""
    return all(report.state == Sync.IN_SYNC for report in twin.syncs[syncs:]) and all(
        report.state == Link.ARMED for report in twin.links[links:]
    )


def test_a_plan_of_a_pc_whose_clock_is_ten_seconds_ahead_is_planned_reviewed_and_executed(twin, other, tmp_path):
    assert other.clock() - time.time() == pytest.approx(AHEAD, abs=2.0)
    before, began = len(twin.plans), time.time()
    # somebody whose clock is an hour ahead cancelled all goals up to his time; actionlib would drop what comes until then
    twin.cancel_all_before(time.time() + 3600.0)
    with other.reaching("action", NEAR, 4.0, tmp_path) as program:
        plan = next_plan(twin, before, program)
        sent = float(re.search(r"at (\S+) by this PC's clock", program.output)[1])
        # the plan's stamp is this PC's; the times in it are from its start, as they were sent
        assert abs(plan.header.stamp.to_sec() - (sent - AHEAD)) < 3.0
        assert plan.duration == 4.0 and plan.source.endswith(" from /matlab")
        motion = np.loadtxt(tmp_path / "motion.csv", delimiter=",")
        found = np.array([point.positions for point in plan.trajectory.points])
        assert np.array_equal(found[1:], motion[1:, 1:7]) and np.abs(found[0] - motion[0, 1:7]).max() < 1e-12
        assert np.allclose(
            [point.time_from_start.to_sec() for point in plan.trajectory.points], motion[:, 0], atol=1e-9
        )
        assert twin.executions[-1].state == Execution.IDLE  # nothing moves before a person approves
        twin.approve()
        assert program.wait(60.0) == 0, program.output
    wait_until(lambda: twin.ended(plan.id), 10.0, "the end")
    assert twin.ended(plan.id) == "finished"
    assert "the goal" in program.output
    files = {"figure8.png", "figure9.png", "motion.csv", "physical.csv", "virtual.csv"}
    assert {file.name for file in tmp_path.iterdir()} == files
    for name in ("virtual", "physical"):
        table = np.loadtxt(tmp_path / f"{name}.csv", delimiter=",")
        # stamps are the twin's PC's, and the arm really was where the plan says
        assert began < table[-1, 0] < time.time() and len(table) > 500
        assert np.abs(table[-1, 1:] - radians(NEAR)).max() < 1e-4


def test_a_line_that_is_cut_in_the_middle_of_a_motion_changes_nothing_on_the_arm_s_side(twin, other, tmp_path):
    before, syncs, links = len(twin.plans), len(twin.syncs), len(twin.links)
    try:
        with other.reaching("action", ASIDE, 6.0, tmp_path) as program:
            plan = next_plan(twin, before, program)
            twin.approve()
            wait_until(lambda: twin.executions[-1].state == Execution.PLAYING, 10.0, "the motion")
            assert other.reaches_the_twin()
            other.cut()
            assert not other.reaches_the_twin() and not twin.ended(plan.id)
            wait_until(lambda: twin.ended(plan.id), 30.0, "the end of the motion")
            assert twin.ended(plan.id) == "finished"
            # and its planner's power fails while nobody can tell
            program.kill()
        wait_until(twin.ready, 10.0, "a robot that is ready")
        assert undisturbed(twin, syncs, links), twin.log()[-4000:]
    finally:
        other.mend()
