"""The command line of `twin`, read before anything is loaded that does what it says: help and a refused option wait for no ROS."""

from __future__ import annotations

import os
import re
import sys

from construction_twin.views.arguments import check, parser


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return an exit code of `views.arguments.Exit`."""
    if arguments is None:
        arguments = [word for word in sys.argv[1:] if ":=" not in word]  # as rospy.myargv, which loads rospy
    # or argparse takes "-30,5" for an option, and says nothing of its comma
    arguments = [f" {word}" if re.match(r"-\.?\d.*,", word) else word for word in arguments]
    command_line = parser(os.environ.get("ROS_NAMESPACE", "").strip("/") or "kr120")
    options = command_line.parse_args(arguments)
    problem = check(options)
    if problem:
        command_line.error(problem)
    from construction_twin.ros.commands.twin import run

    return run(options)
