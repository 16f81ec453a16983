"""rsi_gateway: its configuration from the parameter server, handed to a gateway on this machine."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import rosgraph
import rospy

from construction_twin.broker.start import ACCOUNTS
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import write_atomically
from construction_twin.gateway.command_line import check, read_arguments
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.stop_file import StopFile
from construction_twin.ros.shared.gateway_config import config_from_parameters
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import Parameters, ros_home
from construction_twin.ros.shared.start_refusal import expect_own_parameters

#: In the robot's namespace, by the launch file: which arm it is. A mock is another one in each launch: nobody has stopped it yet.
ARM, NEW_MOCK, MOCK = "gateway_arm", "new mock", "mock"


def stop_file(arm: str, config: Path, robot: str) -> Path:
    """Return the file that keeps the stop of an `ARM`: of a real one the same with every master, which a mock never touches."""
    path = config.with_suffix(".stopped") if arm in (NEW_MOCK, MOCK) else config.with_name(f"{robot}.stopped")
    stops = StopFile(path)
    if arm == NEW_MOCK:
        stops.save("")
    stops.close()
    return path


def checked_config(words: list[str], parameters: Parameters = rospy) -> GatewayConfig:
    """Return the configuration of a gateway with these options; raise the ConstructionTwinError that it is refused for."""
    config = config_from_parameters(parameters=parameters)
    options = read_arguments([*words, "--config", ""])
    check(options, config)
    is_meant = parameters.get_param("mqtt_bridge/anonymous_broker_is_meant", False)
    if parameters.get_param(ARM, "") not in (NEW_MOCK, MOCK, "") and not options.account and is_meant is not True:
        raise ConfigurationError("accounts", "", ACCOUNTS)
    return config


def main() -> None:
    """Start the gateway on this machine as roslaunch would start a node; ROS ends where the gateway begins."""
    run_node("rsi_gateway", _hand_over)


def _hand_over() -> None:
    arguments = rospy.myargv(sys.argv)[1:]
    config = checked_config(arguments)
    expect_own_parameters()
    # one file per node and ROS master: two masters of one user must not hand each other's configuration over
    name = re.sub(r"\W+", "_", f"{rosgraph.get_master_uri()} {rospy.get_name()}")
    path = ros_home() / f"{name}.json"
    arm = rospy.get_param(ARM, "")
    stops = stop_file(arm, path, config.robot)
    if arm == NEW_MOCK:
        rospy.set_param(ARM, MOCK)
    write_atomically(path, config.to_json())
    rospy.signal_shutdown("handing over to the gateway")
    files = ["--config", str(path), "--stop-file", str(stops)]
    os.execv(sys.executable, [sys.executable, "-m", "construction_twin.gateway", *files, *arguments])
