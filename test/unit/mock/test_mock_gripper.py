"""The simulated gripper: how long it takes, what its faults do, and that a mock without a tool has none."""

from __future__ import annotations

from tool_cell import GRIPPER, LAYOUT

from construction_twin.mock.gripper import SimulatedTool


def tool():
    return SimulatedTool(LAYOUT, GRIPPER, 0.004)


def steps(gripper, count):
    for _ in range(count):
        gripper.step()
    return gripper.inputs["vacuum_reached"]


def test_the_input_follows_after_the_time_that_was_set():
    gripper = tool()
    gripper.take((True, True))
    assert not steps(gripper, 49) and steps(gripper, 1) and gripper.holds
    gripper.take((True, False))
    assert steps(gripper, 49) and not steps(gripper, 1)


def test_a_grip_that_is_opened_before_it_has_closed_never_confirms():
    gripper = tool()
    gripper.take((True, True))
    steps(gripper, 30)
    gripper.take((True, False))
    assert not any(steps(gripper, 1) for _ in range(200))


def test_inputs_begin_as_an_open_gripper_and_go_on_while_rsi_is_off():
    gripper = tool()
    assert gripper.inputs == {"vacuum_reached": False}
    gripper.take((True, True))
    gripper.begin_session()
    assert steps(gripper, 60) and gripper.outputs == {"vacuum": True}
