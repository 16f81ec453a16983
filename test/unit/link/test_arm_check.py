"""An arm that is none of the model's is not armed: what is compared, when, and what the link says."""

from __future__ import annotations

import pytest
from supervisor_bench import POSE, bench, moved

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.link.observations import ArmCheck, LinkState

#: Fixtures of the bench.
__all__ = ["bench"]
CAUSE, FAR = "axis A2 counts the other way", "300 mm off"


def compare(axes, pose, explains):
    """Of an arm whose tool stands at X = A1 in m."""
    off = abs(pose[0] - axes[0])
    return off, 0.0, Sentence(CAUSE if explains else FAR) if off > 0.005 else ""


def report(bench, off=0.0, axes=POSE):
    bench.gateway["tool_pose"] = {"axes": list(axes), "position": [axes[0] + off, 0.0, 0.0], "abc": [0.0, 0.0, 0.0]}


@pytest.fixture
def checked(bench):
    bench.supervisor.inputs.arm = ArmCheck(compare)
    return bench


def test_an_arm_that_agrees_is_armed_and_the_difference_is_told(checked):
    report(checked, 0.001)
    assert checked.run(0.5).state is LinkState.ARMED
    arm = checked.supervisor.inputs.arm
    assert arm.text == "1.000 mm and 0.000 deg off the model's" and arm.difference == pytest.approx((0.001, 0.0))


def test_another_arm_is_never_armed_and_no_reset_helps(checked):
    report(checked, 0.3)
    assert checked.run(1.0).state is LinkState.OTHER_ARM and checked.sent == []
    assert checked.supervisor.reason == CAUSE
    with pytest.raises(ReviewError, match=CAUSE):
        checked.supervisor.request_reset(checked.now)
    # what was wrong is corrected at the controller
    report(checked)
    assert checked.run(0.5).state is LinkState.ARMED


def test_it_is_armed_all_the_same_where_that_is_meant(bench):
    bench.supervisor.inputs.arm = arm = ArmCheck(compare, refuses=False)
    report(bench, 0.3)
    assert bench.run(0.5).state is LinkState.ARMED and arm.problem == CAUSE


def test_an_arm_in_motion_is_not_compared(checked):
    report(checked)
    checked.run(0.5)
    for k in range(1, 51):
        checked.pose = checked.command = moved(1e-3 * k)
        report(checked, 0.3, checked.pose)
        checked.poll()
    assert checked.supervisor.inputs.arm.problem == ""


def test_what_is_found_while_commands_flow_ends_no_motion_and_costs_no_search(checked):
    report(checked)
    assert checked.run(0.5).state is LinkState.ARMED
    report(checked, 0.3)
    assert checked.run(1.0).state is LinkState.ARMED and checked.forwarded
    assert checked.supervisor.inputs.arm.problem == FAR
    # but nothing is armed anew
    checked.set_gateway("holding", "stop: asked for", fault=True)
    assert checked.run(0.5).state is LinkState.OTHER_ARM


def test_a_controller_that_does_not_send_it_is_armed_and_that_is_said(checked):
    assert checked.run(0.5).state is LinkState.ARMED
    assert checked.supervisor.inputs.arm.text == "not compared: the controller does not send where its tool is"


def test_a_tool_pose_that_a_simulator_fills_in_is_not_compared_and_that_is_said(checked):
    constant = "not compared: the controller sends one tool pose whatever its axes are"
    checked.gateway["tool_pose"] = {"axes": list(POSE), "position": [0.0] * 3, "abc": [0.0] * 3}
    assert checked.run(0.5).state is LinkState.ARMED and checked.supervisor.inputs.arm.text == constant
    # one that was right where the arm stood first, and stays the same elsewhere
    report(checked)
    checked.run(0.5)
    told = dict(checked.gateway["tool_pose"])
    checked.pose = checked.command = moved(0.3)
    checked.gateway["tool_pose"] = told | {"axes": list(checked.pose)}
    arm = checked.run(1.0).supervisor.inputs.arm
    assert (arm.text, arm.problem) == (constant, "")


def test_a_status_of_an_arm_with_other_axes_is_not_compared(checked):
    report(checked, 0.3, (*POSE, 0.0))
    assert checked.run(0.5).supervisor.inputs.arm.difference == ()


def test_mirror_mode_needs_no_such_arm(checked):
    report(checked, 0.3)
    checked.run(1.0)
    checked.supervisor.begin_mirror(checked.now)
    assert checked.run(0.1).state is LinkState.MIRROR
