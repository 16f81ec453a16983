"""From robot model and link settings to the gateway's configuration.

Used by the exporter, and by the bridge, which compares hashes.
"""

from __future__ import annotations

from collections.abc import Mapping

from construction_twin.errors import ConfigurationError
from construction_twin.robot import RobotModel
from construction_twin.rsi.config import GatewayConfig
from construction_twin.rsi.ethernet_xml import check_gateway, read_ethernet_xml


def gateway_config(robot: RobotModel, settings: Mapping) -> GatewayConfig:
    """Return the configuration of the gateway of `robot`.

    Parameters
    ----------
    robot : RobotModel
        Its joint ranges are turned into ranges of the controller's axes (sign and offset).
    settings : Mapping
        The other keys of `GatewayConfig`, SI units; see config/gateway.yaml. In place of `layout` it holds `ethernet_xml`: the text
        of the controller's Ethernet XML.

    Returns
    -------
    config : GatewayConfig

    Raises
    ------
    ConfigurationError
        For an unknown key, a value that does not fit, or a linear joint: the joint string has degrees only.
    EthernetXmlError
        If the Ethernet XML does not fit the robot.
    """
    _refuse_linear_joints(robot)
    axes = tuple(axis.rsi for axis in robot.axes)
    settings = dict(settings)
    layout = None
    if "ethernet_xml" in settings:
        ethernet = read_ethernet_xml(settings.pop("ethernet_xml"), "Ethernet XML")
        check_gateway(ethernet.layout, axes, ethernet.where)
        layout = ethernet.layout
    ends = [
        sorted((axis.sign * low + axis.offset, axis.sign * high + axis.offset))
        for axis, low, high in zip(robot.axes, robot.lower, robot.upper)
    ]
    try:
        return GatewayConfig(
            robot=robot.name,
            axes=axes,
            lower=tuple(low for low, _ in ends),
            upper=tuple(high for _, high in ends),
            velocity=robot.velocity,
            acceleration=robot.acceleration,
            layout=layout,
            **settings,
        )
    except TypeError as error:
        raise ConfigurationError("gateway", settings, f"the keys of config/gateway.yaml ({error})") from error


def _refuse_linear_joints(robot: RobotModel) -> None:
    for name, linear in zip(robot.joint_names, robot.linear):
        if linear:
            expected = "joints that turn: the joint string on MQTT has no metres yet"
            raise ConfigurationError(f"joint {name}", "a linear joint", expected)
