"""Torques through the whole chain, on the simulated clock: what is no collision holds nothing, what is one does."""

from __future__ import annotations

from scenario_run import ScenarioRun, shipped

#: A gate that takes poses patiently, so that only torques can close it.
PATIENT = {"lag_allowance": 0.2, "lag_margin": 0.2, "feedback_timeout": 0.3}


def run_with(*faults, ends="goal"):
    """Return the run of the scenario lost_load with other faults, from its begin."""
    content = shipped("lost_load")
    scenario = content["scenario"]
    move = scenario["steps"][0]
    scenario["steps"] = [*({"inject": fault} for fault in faults), move]
    scenario["limit"] = 8.0
    scenario["expect"] = {"sync": ["IN_SYNC"], "final": {"outcome": "finished"}, "ends": ends}
    content["pca_monitor"] |= PATIENT
    run = ScenarioRun("lost_load", content)
    run.carry_out()
    return run


def events(run):
    return [change.event.value for change in run.chain.transitions]


def test_lost_replies_are_no_collision():
    run = run_with({"fault": "drop", "value": [0.02]})
    assert run.chain.controller.counters["missed"] > 20 and run.chain.executor.outcome == "finished"
    assert run.chain.gate.watch_of_torques.compared > 100
    assert events(run) == []


def test_a_motion_without_fault_is_compared_all_the_time():
    run = run_with()
    assert events(run) == [] and run.chain.executor.outcome == "finished"
    assert run.chain.gate.watch_of_torques.compared > 700


def test_a_collision_on_an_axis_closes_the_gate_and_names_it():
    run = run_with({"fault": "collision", "joint": "joint_a2", "value": [1500.0]})
    assert "torque_differs" in events(run)
    (first,) = [change for change in run.chain.transitions if change.event.value == "torque_differs"][:1]
    assert "axis A2" in first.reason
