"""A work plan through the whole chain on a simulated clock: executor, bridge, gateway, telegrams, the mock's gripper, and back."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from chain_samples import ROOT, assert_corrections_inside_limits, make_chain
from executor_bench import SCENE, make_work_plan
from simulation import SimulatedLink

from construction_twin.core.units import CYCLE_NS
from construction_twin.execution.executor import ExecutorState
from construction_twin.mock.faults import Fault

TOOL = yaml.safe_load((ROOT / "config/tools/vacuum_frame.yaml").read_text().replace("vacuum_reached", "gripped"))
XML = (ROOT / "krl/ethernet/ctwin_tool_ethernet.xml").read_text().replace("vacuum_reached", "gripped")
ONE_SCENE = {f"segment_{number}": {"scene": SCENE, "scene_after": SCENE} for number in range(4)}


def begun(**settings):
    """Return a chain that plays a work plan of grip, lift, carry and release."""
    chain = make_chain(6, ethernet_xml=XML, tool=TOOL, **settings)
    assert chain.run_until(lambda: chain.executor.tool.known, 1.0), chain.executor.tool
    plan = make_work_plan(asked_ns=chain.now, **ONE_SCENE)
    chain.play(plan)
    assert chain.run_until(lambda: chain.executor.state is ExecutorState.PLAYING, 2.0), chain.executor.reason
    return chain, plan


def vacuum(chain):
    return chain.controller.tool.outputs["vacuum"]


def edges(chain):
    """Return for every change of what replies tell the vacuum: stamp of the target, and value."""
    values = [(stamp, told[1]) for stamp, told in chain.switched]
    return [new for old, new in zip(values, values[1:]) if old[1] != new[1]]


@pytest.mark.parametrize("delay", [300_000, 30_000_000])
def test_a_work_plan_grips_carries_and_lets_go_each_in_the_cycle_of_its_stamp(delay):
    link = SimulatedLink(command_delay=lambda: delay, state_delay=lambda: delay)
    chain, plan = begun(link=link)
    assert chain.run_until(lambda: chain.executor.outcome != "", plan.trajectory.duration + 20.0), chain.executor.reason
    assert chain.executor.outcome == "finished", chain.executor.reason
    told = chain.gateway.status()["tool"]["switches"]
    assert [(switch["value"], switch["state"]) for switch in told] == [(True, "fired"), (False, "fired")]
    for switch, (stamp, value) in zip(told, edges(chain)):
        assert value is switch["value"] and 0 <= stamp - switch["stamp"] < CYCLE_NS
    assert not vacuum(chain) and len(edges(chain)) == 2
    assert np.allclose(chain.controller.measured, plan.trajectory.positions[-1], atol=1e-6)
    assert_corrections_inside_limits(chain)


def test_a_grip_that_is_lost_in_motion_stops_the_arm_and_what_is_armed_never_fires():
    chain, _ = begun()
    assert chain.run_until(lambda: chain.executor.segment_run.number == 3, 15.0), chain.executor.reason
    chain.faults.inject(Fault("grip_lost"))
    assert chain.run_until(lambda: chain.executor.state is not ExecutorState.PLAYING, 2.0)
    chain.run_for(5.0)
    assert vacuum(chain) and [value for _, value in edges(chain)] == [True]
    assert "gripped reads off" in " ".join(
        str(event) for event in (chain.executor.reason, *chain.executor.pop_events())
    )


def test_after_a_grip_that_did_not_close_a_person_opens_it_by_hand_and_a_new_session_takes_it_as_it_reads():
    chain, _ = begun()
    chain.faults.inject(Fault("grip_fails"))
    assert chain.run_until(lambda: chain.executor.outcome != "", 20.0)
    assert vacuum(chain)
    chain.faults.inject(Fault("opened_by_hand"))
    chain.run_for(1.0)
    told = chain.gateway.status()["tool"]
    assert not vacuum(chain) and not told["known"] and "vacuum reads back off, commanded on" in told["reason"]
    chain.controller.restart()
    chain.run_for(1.0)
    told = chain.gateway.status()["tool"]
    assert told["known"] and told["outputs"] == {"vacuum": False} and told["inputs"] == {"gripped": False}
