"""A controller whose arm is none of the model's, the whole chain in one process: nothing is armed, and the cause is named."""

from __future__ import annotations

import pytest
from chain_samples import ROBOT, SETTINGS
from simulation import SimulatedChain

from construction_twin.link.observations import LinkState
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.ros.nodes.mqtt_bridge import Settings, arm_check
from construction_twin.ros.nodes.rsi_gateway import gateway_config

TOOL = (12.5, -40.0, 310.0, 30.0, 0.0, 90.0)


def chain_of(precision=6, expected=(0.0,) * 6, **another) -> SimulatedChain:
    mock = MockSettings(gateway_host="simulated", gateway_port=1, precision=precision, another_arm=another)
    chain = SimulatedChain(ROBOT, gateway_config(ROBOT, SETTINGS), build_controller(mock, ROBOT))
    settings = Settings(arm="mock", host="", port=1, reset_timeout=1.0, max_state_age=0.1, tool_frame=expected)
    chain.supervisor.inputs.arm = arm_check(settings, ROBOT)
    return chain


@pytest.mark.parametrize("precision", [4, 6])
def test_the_model_s_arm_is_armed_and_differs_by_what_rounding_leaves(precision):
    chain = chain_of(precision=precision)
    assert chain.run_until(lambda: chain.ready, 5.0), chain.supervisor.reason
    distance, angle = chain.supervisor.inputs.arm.difference
    assert distance < 1e-5 and angle < 1e-5


def test_an_arm_with_the_tool_that_is_expected_is_armed():
    chain = chain_of(expected=TOOL, tool=TOOL)
    assert chain.run_until(lambda: chain.ready, 5.0), chain.supervisor.reason


@pytest.mark.parametrize(
    "another, cause",
    [
        ({"reversed": "A2"}, "axis A2 counts the other way"),
        ({"tool": TOOL}, "$TOOL is X 12.500 Y -40.000 Z 310.000 A 30.000 B 0.000 C 90.000"),
        ({"base": (0.0, 900.0, 250.0, 45.0, 0.0, 0.0)}, "$BASE is X 0.000 Y 900.000 Z 250.000 A 45.000"),
        ({"longer": {"joint_a3": 200.0}}, "the 1150 mm to link_3 are 1350 mm"),
    ],
)
def test_another_arm_is_not_armed_and_the_cause_is_named(another, cause):
    chain = chain_of(**another)
    chain.run_for(5.0)
    assert chain.supervisor.state is LinkState.OTHER_ARM and not chain.corrections[-1][1][0]
    assert cause in chain.supervisor.reason, chain.supervisor.reason
    assert not chain.commands_sent
