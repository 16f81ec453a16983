"""view: becomes rviz where there is a display; elsewhere it says so and ends, and the rest goes on."""

from __future__ import annotations

import argparse
import os
import re
import socket
import sys
from collections.abc import Callable
from pathlib import Path

import rosgraph
import rospy

from construction_twin.core.errors import ConfigurationError
from construction_twin.ros.shared.params import ros_home
from construction_twin.ros.shared.start_refusal import expect_no_other

#: Robot that the files in rviz/ are written for.
ROBOT = "kr120"
#: First TCP port of X11 displays, and how long a display may take to answer [s].
_X11_PORT, _TIMEOUT = 6000, 3.0


def display_problem(display: str, connect: Callable[[str, int], None]) -> str:
    """Return in one sentence why no window can be shown; empty when one can.

    Args:
        display: Environment variable DISPLAY.
        connect: ``connect(host, number)`` reaches display `number`; host "" is this machine. Raises OSError when it cannot.
    """
    if not display:
        return "there is no display (DISPLAY is not set): rviz is not started, everything else goes on without it"
    found = re.fullmatch(r"(?:unix)?([^:]*):(\d+)(?:\.\d+)?", display)
    if found is None:
        return (
            f"DISPLAY is {display!r}, expected HOST:NUMBER or :NUMBER: rviz is not started, everything "
            "else goes on without it"
        )
    try:
        connect(found[1], int(found[2]))
    except OSError as error:
        return (
            f"the display {display} does not answer ({error}): rviz is not started, everything else goes on without it"
        )
    return ""


def connect_display(host: str, number: int) -> None:
    """Open a connection to an X11 display and close it again.

    Raises:
        OSError: If nothing answers.
    """
    if host:
        socket.create_connection((host, _X11_PORT + number), _TIMEOUT).close()
        return
    address = f"/tmp/.X11-unix/X{number}"
    # servers listen on the file, on Linux's abstract name, or both
    for name in (address, f"\0{address}"):
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(_TIMEOUT)
            try:
                link.connect(name)
                return
            except OSError as error:
                problem = error
    raise problem


def view_for(text: str, robot: str, above: str = "/") -> str:
    """Return a view file's text for a robot of another name: `kr120` as a whole word becomes its name.

    Args:
        above: Namespace that the robots are in: topics and parameters of `kr120`, `kr120_1` and so on begin with it.
    """
    return re.sub(rf"\b{ROBOT}\b", robot, re.sub(rf": /(?={ROBOT}\w*/)", f": {above}", text))


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
    try:
        expect_no_other("view")
    except ConfigurationError as error:
        print(f"view: {error}", flush=True)
        return
    # in the namespace where this is started; view.launch has one of its own, and gives the whole name
    above, _, robot = rosgraph.names.ns_join(rospy.get_namespace(), options.robot).rpartition("/")
    config = _config(Path(options.config), robot, f"{above}/")
    remappings = [word for word in sys.argv[1:] if ":=" in word]
    os.execvp("rviz", ["rviz", "-d", str(config), *remappings])


def _config(path: Path, robot: str, above: str) -> Path:
    """Return the view file for a robot: the given one, or a copy with the robot's name in ROS_HOME."""
    try:
        text = path.read_text(encoding="utf-8")
        written = view_for(text, robot, above)
        if written == text:
            return path
        copy = ros_home() / f"{robot}_{path.name}"
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(written, encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        sys.exit(f"view: {path} cannot be used: {error}; give another rviz_config")
    return copy
