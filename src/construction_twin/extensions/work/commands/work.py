"""The program `work`: the node, or with the word `check` the command that needs no ROS master."""

from __future__ import annotations

import sys


def main() -> int:
    """Run the node until shutdown, or check a model; return the exit code."""
    if sys.argv[1:2] == ["check"]:
        # a check needs nothing of the node's
        from construction_twin.extensions.work.commands.work_check import main as check

        return check(sys.argv[2:])
    from construction_twin.extensions.work.nodes.work import main as run

    run()
    return 0
