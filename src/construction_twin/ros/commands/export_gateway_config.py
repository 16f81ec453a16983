"""`export_gateway_config`: the gateway's configuration, from the parameter server into a file for another machine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import rospy

from construction_twin.core.errors import ConstructionTwinError, spoken
from construction_twin.core.files import check_writable
from construction_twin.ros.shared.gateway_config import config_from_parameters
from construction_twin.ros.shared.master import await_master


def main() -> None:
    """Write the configuration file for a gateway on another machine."""
    parser = argparse.ArgumentParser(
        prog="export_gateway_config",
        description="Write the configuration of rsi_gateway for the cell PC, from the parameters of a running bringup.",
    )
    parser.add_argument("output", help="file to write, e.g. kr120_gateway.json; - for the terminal")
    parser.add_argument("--namespace", default="kr120", help="namespace of the robot [%(default)s]")
    arguments = parser.parse_args(rospy.myargv(sys.argv)[1:])
    try:
        if arguments.output != "-":
            check_writable(Path(arguments.output).parent)
        await_master()
        rospy.init_node("export_gateway_config", anonymous=True, disable_signals=True)
        config = config_from_parameters(f"/{arguments.namespace.strip('/')}/")
        if arguments.output == "-":
            print(config.to_json(), end="")
            return
        Path(arguments.output).write_text(config.to_json(), encoding="utf-8")
    except (ConstructionTwinError, OSError) as error:
        sys.exit(f"export_gateway_config: {spoken(error)}")
    layout, make = config.layout, config.make
    print(
        f"{arguments.output}: configuration {config.hash[:12]} of {config.robot}, {config.decimals} decimals; "
        f"{make.words.protocol} on UDP port {layout.port}, {layout.summary}"
        + (f"; tool {config.tool.name}, {', '.join(make.tool_channels(layout))}" if config.tool else "; no tool")
        + (f"; not filled, so they stay as they are: {', '.join(layout.not_filled)}" if layout.not_filled else "")
    )
