"""The gateway's configuration from the parameter server: exported to a file, or handed to a gateway on this machine."""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path

import rosgraph
import rospy

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.files import write_whole
from construction_twin.gateway.config import GatewayConfig
from construction_twin.ros.shared.gateway_export import gateway_config
from construction_twin.ros.shared.params import robot_from_parameters, ros_home


def config_from_parameters(namespace: str = "") -> GatewayConfig:
    """Return the configuration that a namespace's `robot_description`, `robot` and `gateway` parameters describe.

    Parameters
    ----------
    namespace : str, optional
        ``/kr120/``; the node's own by default.
    """
    name = namespace + "gateway"
    if not rospy.has_param(name):
        raise ConfigurationError(rospy.resolve_name(name), None, "link settings, as launch/bringup.launch loads them")
    settings = rospy.get_param(name)
    if "ethernet_xml" not in settings:
        raise ConfigurationError(
            rospy.resolve_name(f"{name}/ethernet_xml"),
            None,
            "the controller's RSI Ethernet XML, as launch/bringup.launch loads it",
        )
    return gateway_config(robot_from_parameters(namespace), settings)


def export_main() -> None:
    """Write the configuration file for a gateway on another machine."""
    parser = argparse.ArgumentParser(
        prog="export_gateway_config",
        description="Write the configuration of rsi_gateway for the cell PC, from the parameters of a running bringup.",
    )
    parser.add_argument("output", help="file to write, e.g. kr120_gateway.json; - for the terminal")
    parser.add_argument("--namespace", default="kr120", help="namespace of the robot [%(default)s]")
    arguments = parser.parse_args(rospy.myargv(sys.argv)[1:])
    rospy.init_node("export_gateway_config", anonymous=True, disable_signals=True)
    try:
        config = config_from_parameters(f"/{arguments.namespace.strip('/')}/")
    except ConstructionTwinError as error:
        sys.exit(f"export_gateway_config: {error}")
    if arguments.output == "-":
        print(config.to_json(), end="")
        return
    Path(arguments.output).write_text(config.to_json(), encoding="utf-8")
    layout = config.layout
    print(
        f"{arguments.output}: configuration {config.hash[:12]} of {config.robot}, {config.decimals} decimals; RSI on UDP port "
        f"{layout.port}, SENTYPE {layout.sentype}, "
        + ("read-only" if layout.onlysend else f"channels {', '.join(layout.receive)}")
    )


def run_gateway() -> None:
    """Start the gateway on this machine as roslaunch would start a node; ROS ends where the gateway begins."""
    rospy.init_node("rsi_gateway", disable_signals=True, disable_rosout=True)
    try:
        config = config_from_parameters()
    except ConstructionTwinError as error:
        sys.exit(f"rsi_gateway cannot run: {error}")
    # one file per node and ROS master: two masters of one user must not hand each other's configuration over
    name = re.sub(r"\W+", "_", f"{rosgraph.get_master_uri()} {rospy.get_name()}")
    path = ros_home() / f"{name}.json"
    write_whole(path, config.to_json())
    rospy.signal_shutdown("handing over to the gateway")
    arguments = rospy.myargv(sys.argv)[1:]
    os.execv(sys.executable, [sys.executable, "-m", "construction_twin.gateway", "--config", str(path), *arguments])
