"""rsi_gateway: its configuration from robot model and link settings, handed to a gateway on this machine."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import rosgraph
import rospy

from construction_twin.broker.start import ACCOUNTS
from construction_twin.controller.port import DEFAULT_MAKE, GatewayTool, ToolOutput, make_of
from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.files import write_atomically
from construction_twin.gateway.command_line import check, read_arguments
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.stop_file import StopFile
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.robot.description import RobotModel
from construction_twin.robot.tool import Tool, tool_of
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import Parameters, robot_from_parameters, ros_home
from construction_twin.ros.shared.start_refusal import expect_own_parameters

#: Time-out of a controller in every set-up that is known to be used with ROS [cycles] (docs/rsi.md, section 5).
TIMEOUT = 100


def config_from_parameters(namespace: str = "", parameters: Parameters = rospy) -> GatewayConfig:
    """Return the configuration that the parameters of a namespace describe: ``/kr120/``; the node's own by default."""
    robot = robot_from_parameters(namespace, parameters)
    return config_of_link(robot, parameters.get_param(namespace + "gateway", None))


def config_of_link(robot: RobotModel, settings: Mapping | None, needs_file: bool = True) -> GatewayConfig:
    """Return the configuration of a robot's `gateway` parameters; a bare PLC needs no file of the controller's telegrams."""
    if settings is None:
        raise ConfigurationError(f"{robot.name}/gateway", None, "link settings, as launch/bringup.launch loads them")
    form = make_of(settings.get("make", DEFAULT_MAKE)).file
    if "ethernet_xml" not in settings and needs_file and form is not None:
        where = f"{robot.name}/gateway/ethernet_xml"
        raise ConfigurationError(where, None, f"the controller's {form.name}, as launch/bringup.launch loads it")
    return gateway_config(robot, settings)


def gateway_config(robot: RobotModel, settings: Mapping) -> GatewayConfig:
    """Return the configuration of the gateway of `robot`, whose joint ranges become those of the controller's axes.

    `settings`: keys of `GatewayConfig` in SI, see config/gateway.yaml; in place of `layout` `make` and `ethernet_xml`, path or
    text; `timeout` in cycles; `tool` a tool file's content, left out where the layout has no channel of one.
    """
    axes = tuple(axis.name for axis in robot.axes)
    settings = dict(settings)
    make = make_of(settings.pop("make", DEFAULT_MAKE))
    layout = settings["layout"] = make.layout_of(settings.pop("ethernet_xml", ""), axes)
    tool = settings.pop("tool", None)
    if tool and make.tool_channels(layout):
        settings["tool"] = gateway_tool(tool_of(tool, "tool"))
    timeout, cycle = settings.pop("timeout", TIMEOUT), settings.get("cycle", 4)
    if type(timeout) is not int or timeout < 1:
        expected = f"a whole number of cycles, 1 or more, as {make.terms.timeout}"
        raise ConfigurationError("timeout", timeout, expected)
    lower, upper = zip(*robot.axis_ranges)
    try:
        config = GatewayConfig(
            robot=robot.name,
            axes=axes,
            lower=lower,
            upper=upper,
            velocity=robot.velocity,
            acceleration=robot.acceleration,
            linear=tuple(axis.name for axis, linear in zip(robot.axes, robot.linear) if linear),
            # what is no cycle is refused there, with its name
            timeout=timeout * cycle / 1000 if type(cycle) is int and cycle > 0 else 0.4,
            **settings,
        )
    except TypeError as error:
        raise ConfigurationError("gateway", settings, f"the keys of config/gateway.yaml ({error})") from error
    codec = JointStringCodec.of(robot, config.decimals)
    for end, q in (("lower", robot.lower), ("upper", robot.upper)):
        try:
            codec.encode(q)
        except PayloadError as error:
            expected = f"a range the wire can carry ({error})"
            raise ConfigurationError(f"{end} limits of {robot.name}", q, expected) from error
    return config


def gateway_tool(tool: Tool) -> GatewayTool:
    """Return what the gateway must know about a tool."""
    outputs = tuple(ToolOutput(name, output.on_stop, output.opens) for name, output in tool.outputs.items())
    return GatewayTool(tool.name, outputs, tool.inputs)


#: In the robot's namespace, by the launch file: which arm it is. A mock is another one in each launch, not stopped yet.
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
    """Return the configuration of a gateway with these options; ConstructionTwinError refuses its start."""
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
