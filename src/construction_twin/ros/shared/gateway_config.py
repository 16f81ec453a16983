"""The gateway's configuration, from robot model and link settings on the parameter server."""

from __future__ import annotations

from collections.abc import Mapping

import rospy

from construction_twin.controller.makes import DEFAULT, make_of
from construction_twin.controller.tool import GatewayTool, ToolOutput
from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.robot.description import RobotModel
from construction_twin.robot.tool import Tool, tool_of
from construction_twin.ros.shared.params import Parameters, robot_from_parameters

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
    form = make_of(settings.get("make", DEFAULT)).file
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
    make = make_of(settings.pop("make", DEFAULT))
    layout = settings["layout"] = make.layout_of(settings.pop("ethernet_xml", ""), axes)
    tool = settings.pop("tool", None)
    if tool and make.tool_channels(layout):
        settings["tool"] = gateway_tool(tool_of(tool, "tool"))
    timeout, cycle = settings.pop("timeout", TIMEOUT), settings.get("cycle", 4)
    if type(timeout) is not int or timeout < 1:
        expected = f"a whole number of cycles, 1 or more, as {make.words.timeout}"
        raise ConfigurationError("timeout", timeout, expected)
    ends = [
        sorted((axis.sign * low + axis.offset, axis.sign * high + axis.offset))
        for axis, low, high in zip(robot.axes, robot.lower, robot.upper)
    ]
    try:
        config = GatewayConfig(
            robot=robot.name,
            axes=axes,
            lower=tuple(low for low, _ in ends),
            upper=tuple(high for _, high in ends),
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
