"""The program `work`: the node, or by its first word a command that needs no ROS master."""

from __future__ import annotations

import importlib
import sys

COMMANDS = ("check", "register", "schedule")


def main() -> int:
    """Run the node until shutdown, or a command; return the exit code."""
    if sys.argv[1:2] and sys.argv[1] in COMMANDS:
        # a command needs nothing of the node's
        command = importlib.import_module(f"construction_twin.extensions.work.commands.work_{sys.argv[1]}")
        return command.main(sys.argv[2:])
    from construction_twin.extensions.work.nodes.work import main as run

    run()
    return 0
