"""Torques through the whole chain, on the simulated clock: what is no collision holds nothing, what is one does."""

from __future__ import annotations

import pytest
from physics_samples import bodies_of, drives
from scenario_run import ScenarioRun, shipped

from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.states import ExecutorState
from construction_twin.mock.faults import Fault
from construction_twin.physics.plant import InverseDynamics, bare_model

#: A gate that takes poses patiently, so that only torques can close it.
PATIENT = {"lag_allowance": 0.2, "lag_margin": 0.2, "feedback_timeout": 0.3}


def run_with(*faults, ends="goal", meanwhile=lambda run: None):
    """Return the run of the scenario lost_load with other faults, from its begin, and what is done to it `meanwhile`."""
    content = shipped("lost_load")
    scenario = content["scenario"]
    move = scenario["steps"][0]
    scenario["steps"] = [*({"inject": fault} for fault in faults), move]
    scenario["limit"] = 8.0
    scenario["expect"] = {"sync": ["IN_SYNC"], "final": {"outcome": "finished"}, "ends": ends}
    content["pca_monitor"] |= PATIENT
    run = ScenarioRun("lost_load", content)
    meanwhile(run)
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


#: What is done when so many seconds of the motion have passed.
PAUSES, LETS_GO, BELIEVES = 1.0, 1.1, 1.2


@pytest.mark.parametrize("believes", [True, False])
def test_a_load_that_is_let_go_while_the_watch_pauses_is_no_difference_to_the_model_without_it(believes):
    empty = InverseDynamics(bare_model(bodies_of("kr120"), drives())).torques

    def releasing(run):
        chain, watch = run.chain, run.chain.gate.watch_of_torques

        def go_on():
            if believes:
                watch.believe(empty)
            watch.count(True)

        todo = [
            (PAUSES, lambda: watch.count(False)),
            (LETS_GO, lambda: chain.requests.append(lambda: chain.faults.inject(Fault("lost_load")))),
            (BELIEVES, go_on),
        ]

        def on_time():
            executor = chain.executor
            played = (chain.now - executor.plan_start) / NANOSECONDS
            while todo and executor.state is ExecutorState.PLAYING and played >= todo[0][0]:
                todo.pop(0)[1]()

        chain.repeat(NANOSECONDS // 250, on_time)

    run = run_with(meanwhile=releasing)
    assert run.chain.faults.active == (str(Fault("lost_load")),)
    assert ("torque_differs" in events(run)) is not believes
    if believes:
        assert run.chain.executor.outcome == "finished" and run.chain.gate.watch_of_torques.compared > 500
