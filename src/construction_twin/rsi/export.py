"""From robot model and link settings to the gateway's configuration.

Used by the exporter, and by the bridge, which compares hashes.
"""

from __future__ import annotations

from collections.abc import Mapping

from construction_twin.errors import ConfigurationError
from construction_twin.robot import RobotModel
from construction_twin.rsi.config import GatewayConfig


def gateway_config(robot: RobotModel, settings: Mapping) -> GatewayConfig:
    """Return the configuration of the gateway of `robot`.

    Parameters
    ----------
    robot : RobotModel
        Its joint ranges are turned into ranges of the controller's axes (sign and offset).
    settings : Mapping
        The other keys of `GatewayConfig`, SI units; see config/gateway.yaml.

    Returns
    -------
    config : GatewayConfig

    Raises
    ------
    ConfigurationError
        For an unknown key or a value that does not fit, or a robot with linear joints.
    """
    if any(robot.linear):
        raise ConfigurationError(
            "robot/joints", robot.joint_names, "turning joints only; the link cannot carry a linear one yet"
        )
    ends = [
        sorted((axis.sign * low + axis.offset, axis.sign * high + axis.offset))
        for axis, low, high in zip(robot.axes, robot.lower, robot.upper)
    ]
    try:
        return GatewayConfig(
            robot=robot.name,
            axes=tuple(axis.rsi for axis in robot.axes),
            lower=tuple(low for low, _ in ends),
            upper=tuple(high for _, high in ends),
            velocity=robot.velocity,
            acceleration=robot.acceleration,
            **settings,
        )
    except TypeError as error:
        raise ConfigurationError("gateway", dict(settings), f"the keys of config/gateway.yaml ({error})") from error
