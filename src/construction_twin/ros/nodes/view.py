"""view: becomes rviz where there is a display; elsewhere it says so and ends, and the rest goes on."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import rospy

from construction_twin.ros.shared.params import ros_home
from construction_twin.views.display import ROBOT, connect_display, display_problem, view_for


def main() -> None:
    """Replace this process with rviz, or say why not and end with 0."""
    parser = argparse.ArgumentParser(prog="view", description="Show a running system in rviz.")
    parser.add_argument("--config", required=True, help="rviz file, written for the robot kr120")
    parser.add_argument("--robot", default=ROBOT, help="namespace of the robot that is shown")
    options = parser.parse_args(rospy.myargv()[1:])
    problem = display_problem(os.environ.get("DISPLAY", ""), connect_display)
    if problem:
        print(f"view: {problem}", flush=True)
        return
    config = _config(Path(options.config), options.robot)
    remappings = [word for word in sys.argv[1:] if ":=" in word]
    os.execvp("rviz", ["rviz", "-d", str(config), *remappings])


def _config(path: Path, robot: str) -> Path:
    """Return the view file for a robot: the given one, or a copy with the robot's name in ROS_HOME."""
    try:
        text = path.read_text(encoding="utf-8")
        written = view_for(text, robot)
        if written == text:
            return path
        copy = ros_home() / f"{robot}_{path.name}"
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(written, encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        sys.exit(f"view: {path} cannot be used: {error}; give another rviz_config")
    return copy
