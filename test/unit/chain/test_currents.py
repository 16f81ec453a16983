"""Motor currents through the whole chain, on the simulated clock: a heavier load shows where it is, a pause does not."""

from __future__ import annotations

import pytest
from scenario_run import ScenarioRun, shipped

from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.currents import compare_currents, runs_of, same_plan
from construction_twin.execution.states import ExecutorState
from construction_twin.mock.motor_current import TORQUE_PER_PERCENT


def runs_with(payload=60.0, delay=(), name="run"):
    """Return the runs of the scenario lost_load without its fault, whose arm carries so much [kg].

    Args:
        delay: Acts on the chain, and after how many seconds of the motion each.
    """
    content = shipped("lost_load")
    scenario = content["scenario"]
    scenario["steps"] = scenario["steps"][:1]
    scenario |= {"limit": 15.0, "expect": {"sync": ["IN_SYNC"], "final": {"outcome": "finished"}, "ends": "goal"}}
    content["mock_rsi"]["payload"] = [payload, 0.0, 0.0, 0.2]
    content["pca_monitor"] = {"policy": "resume", "lag_allowance": 0.2, "lag_margin": 0.2}
    run = ScenarioRun("lost_load", content)
    chain, todo = run.chain, list(delay)

    def on_time():
        executor = chain.executor
        playing = executor.state in (ExecutorState.PLAYING, ExecutorState.PAUSED)
        while todo and playing and chain.now - executor.plan_start >= todo[0][0] * NANOSECONDS:
            todo.pop(0)[1](chain)

    chain.repeat(NANOSECONDS // 250, on_time)
    run.carry_out()
    assert (
        chain.executor.outcome == "finished"
        and not todo
        and "current_channels_unreadable" not in chain.gateway.counters
    )
    return runs_of(name, chain.recording(), [chain.executor.plan])


@pytest.fixture(scope="module")
def reference():
    return runs_with(name="reference")


def by_joint(reference, runs):
    found = compare_currents(*same_plan(reference, runs))
    return found, {axis.joint: axis for axis in found.axes}


def test_the_same_run_again_takes_the_same_currents(reference):
    found, axes = by_joint(reference, runs_with())
    assert found.compared > 600 and max(abs(axis.largest) for axis in axes.values()) < 0.01


def test_a_heavier_load_shows_on_the_axes_that_carry_it(reference):
    found, axes = by_joint(reference, runs_with(80.0))
    # at the plan's end the tool is level: 20 kg more, 0.2 m from the flange, which is 0.215 m from the wrist, on A5
    a5 = axes["joint_a5"]
    assert found.worst is a5 and a5.time == pytest.approx(3.0, abs=0.01)
    assert abs(a5.largest) == pytest.approx(20.0 * 9.81 * 0.415 / TORQUE_PER_PERCENT["A5"], rel=0.01)
    # a plumb axis carries nothing
    assert abs(axes["joint_a1"].largest) < 1.0 < abs(axes["joint_a2"].largest)


def test_a_pause_is_no_difference(reference):
    pauses = [(1.0, lambda chain: chain.executor.pause(chain.now)), (2.5, lambda chain: chain.executor.resume())]
    found, axes = by_joint(reference, runs_with(delay=pauses))
    assert found.other_pace > 50 and found.compared > 300
    # compared is what is 0.2 s from another pace: by then a servo has forgotten it
    assert max(abs(axis.largest) for axis in axes.values()) < 0.1
