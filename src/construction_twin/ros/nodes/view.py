"""view: becomes rviz; without a display it logs that and ends."""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path

import rosgraph
import rospy

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import write_atomically
from construction_twin.ros.shared.params import ros_home
from construction_twin.ros.shared.start_refusal import expect_no_other

#: Robot that the files in rviz/ are written for.
ROBOT = "kr120"


def rviz_config_for(text: str, robot: str, above: str = "/") -> str:
    """Return a view file's text for a robot of another name, for which `kr120` as a whole word stands, in namespace `above`."""
    return re.sub(rf"\b{ROBOT}\b", robot, re.sub(rf": /(?={ROBOT}\w*/)", f": {above}", text))


def main() -> None:
    """Replace this process with rviz, or say why not and end with 0."""
    parser = argparse.ArgumentParser(prog="view", description="Show a running system in rviz.")
    parser.add_argument("--config", required=True, help="rviz file, written for the robot kr120")
    parser.add_argument("--robot", default=ROBOT, help="namespace of the robot that is shown")
    options = parser.parse_args(rospy.myargv()[1:])
    if not os.environ.get("DISPLAY"):
        print("view: DISPLAY is not set: rviz is not started, everything else goes on without it", flush=True)
        return
    try:
        expect_no_other("view")
    except ConfigurationError as error:
        print(f"view: {error}", flush=True)
        return
    # in the namespace where this is started; view.launch has one of its own, and gives the whole name
    above, _, robot = rosgraph.names.ns_join(rospy.get_namespace(), options.robot).rpartition("/")
    path, config = Path(options.config), ros_home() / f"{robot}_{Path(options.config).name}"
    try:
        write_atomically(config, rviz_config_for(path.read_text(encoding="utf-8"), robot, f"{above}/"))
    except (OSError, UnicodeDecodeError) as error:
        sys.exit(f"view: {path} cannot be used: {error}; give another rviz_config")
    remappings = [word for word in sys.argv[1:] if ":=" in word]
    os.execvp("rviz", ["rviz", "-d", str(config), *remappings])
