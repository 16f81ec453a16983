"""The program `work`: the node, or with the word `check` or `register` a command that needs no ROS master."""

from __future__ import annotations

import sys


def main() -> int:
    """Run the node until shutdown, or a command; return the exit code."""
    # a command needs nothing of the node's
    if sys.argv[1:2] == ["check"]:
        from construction_twin.extensions.work.commands.work_check import main as check

        return check(sys.argv[2:])
    if sys.argv[1:2] == ["register"]:
        from construction_twin.extensions.work.commands.work_register import main as register

        return register(sys.argv[2:])
    from construction_twin.extensions.work.nodes.work import main as run

    run()
    return 0
