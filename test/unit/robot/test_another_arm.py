"""An arm that is no KUKA, from its URDF and one YAML, through the whole chain on a simulated clock."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plan_samples
import pytest
import yaml
from simulation import SimulatedChain

from construction_twin.core.units import radians
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.planning.timing import time_path
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.launch_parameters import home_positions
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.scene.self_collision import read_self_collision

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT / "test" / "data"
ROBOT = read_robot_files(DATA / "ur_like.urdf", DATA / "ur_like.yaml")
GOAL = radians((35.0, -75.0, 80.0, -20.0, 70.0, 40.0))


def test_a_plan_is_played_to_its_goal_with_nothing_but_the_urdf_and_the_yaml():
    settings = yaml.safe_load((ROOT / "config" / "gateway.yaml").read_text())
    ethernet = (ROOT / "krl" / "ethernet" / "ctwin_ethernet.xml").read_text()
    config = gateway_config(ROBOT, settings | {"decimals": 3, "ethernet_xml": ethernet})
    mock = MockSettings(gateway_host="simulated", ethernet_xml=ethernet)
    chain = SimulatedChain(ROBOT, config, build_controller(mock, ROBOT))
    assert chain.run_until(lambda: chain.ready, 5.0), chain.supervisor.reason
    assert chain.twin.pose == pytest.approx(ROBOT.home, abs=1e-5)
    trajectory = time_path(np.array([chain.twin.pose, GOAL]), ROBOT)
    chain.play(plan_samples.make_plan(trajectory, "plan-1", asked_ns=chain.now))
    assert chain.run_until(lambda: chain.executor.outcome == "finished", trajectory.duration + 5.0), (
        chain.executor.reason
    )
    chain.run_for(1.0)
    assert chain.controller.measured == pytest.approx(chain.codec.quantise(GOAL), abs=1e-7)
    assert not [name for name in chain.gateway.counters if name.startswith(("refused", "stops"))]


def test_its_self_collision_file_belongs_to_it():
    assert read_self_collision(DATA / "ur_like_self_collision.yaml", ROBOT) is not None


def test_its_home_needs_no_further_file():
    assert home_positions(DATA / "ur_like.yaml") == dict(zip(ROBOT.joint_names, ROBOT.home))
