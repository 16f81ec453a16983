"""rsi_gateway: its configuration from the parameter server, handed to a gateway on this machine."""

from __future__ import annotations

import os
import re
import sys

import rosgraph
import rospy

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.files import write_whole
from construction_twin.ros.shared.gateway_config import config_from_parameters
from construction_twin.ros.shared.master import wait_for_master
from construction_twin.ros.shared.params import ros_home

#: In the robot's namespace, by the launch file: the arm is a mock, another one in each launch, and nobody has stopped it yet.
NEW_ARM = "gateway_new_arm"


def main() -> None:
    """Start the gateway on this machine as roslaunch would start a node; ROS ends where the gateway begins."""
    try:
        wait_for_master("rsi_gateway")
        rospy.init_node("rsi_gateway", disable_signals=True, disable_rosout=True)
        config = config_from_parameters()
    except ConstructionTwinError as error:
        sys.exit(f"rsi_gateway cannot run: {error}")
    # one file per node and ROS master: two masters of one user must not hand each other's configuration over
    name = re.sub(r"\W+", "_", f"{rosgraph.get_master_uri()} {rospy.get_name()}")
    path = ros_home() / f"{name}.json"
    stops = path.with_suffix(".stopped")
    if rospy.get_param(NEW_ARM, False):
        stops.unlink(missing_ok=True)
        rospy.set_param(NEW_ARM, False)
    write_whole(path, config.to_json())
    rospy.signal_shutdown("handing over to the gateway")
    arguments = rospy.myargv(sys.argv)[1:]
    files = ["--config", str(path), "--stop-file", str(stops)]
    os.execv(sys.executable, [sys.executable, "-m", "construction_twin.gateway", *files, *arguments])
