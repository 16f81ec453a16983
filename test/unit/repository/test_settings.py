"""The shipped configuration files are accepted by the settings of the nodes that read them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from separation_node import Settings as SeparationSettings

from construction_twin.extensions.console.nodes.console_node import Settings as ConsoleSettings
from construction_twin.extensions.planners.nodes.follow_joint_trajectory import Settings as FollowSettings
from construction_twin.mock.program import MockSettings
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.commands.experiment import ExperimentSettings
from construction_twin.ros.nodes.executor import Settings as ExecutorSettings
from construction_twin.ros.nodes.mqtt_bridge import Settings as BridgeSettings
from construction_twin.ros.nodes.neighbour import NeighbourSettings
from construction_twin.ros.nodes.pca_monitor import Settings as MonitorSettings
from construction_twin.ros.nodes.planner import Settings as PlannerSettings
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.ros.nodes.tool_marker import Settings as MarkerSettings

ROOT = Path(__file__).parents[3]


def config(name: str) -> dict:
    return yaml.safe_load((ROOT / "config" / f"{name}.yaml").read_text())


@pytest.mark.parametrize(
    "model, name, deployment",
    [
        (ExperimentSettings, "experiment", {"results_dir": "/tmp"}),
        (MockSettings, "mock_rsi", {"gateway_host": "127.0.0.1", "gateway_port": 49152}),
        (BridgeSettings, "mqtt_bridge", {"host": "127.0.0.1", "port": 1883, "arm": "mock"}),
        (ConsoleSettings, "console_node", {"host": "127.0.0.1", "port": 1883}),
        (MonitorSettings, "pca_monitor", {"arm": "mock", "decimals": 3, "servo_model": ""}),
        (ExecutorSettings, "executor", {"arm": "mock"}),
        (FollowSettings, "follow_joint_trajectory", {"arm": "mock"}),
        (SeparationSettings, "separation", {}),
        (NeighbourSettings, "neighbour", {"name": "b"}),
        (MarkerSettings, "tool_marker", {"self_collision": "/tmp/pairs.yaml", "tf_prefix": ""}),
        (PlannerSettings, "planner", {"self_collision": "/tmp/pairs.yaml", "tf_prefix": ""}),
    ],
)
def test_the_shipped_configuration_is_accepted(model, name, deployment):
    settings = model(**config(name), **deployment)
    for key, value in config(name).items():
        assert settings.model_dump()[key] == value


def test_the_shipped_gateway_settings_make_a_configuration():
    robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
    shipped = gateway_config(robot, config("gateway") | {"decimals": 3})
    assert shipped == gateway_config(robot, {})
    assert shipped.axes == ("A1", "A2", "A3", "A4", "A5", "A6")
