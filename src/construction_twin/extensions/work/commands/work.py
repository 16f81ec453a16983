"""The program `work`: the node, or by its first word a command that needs no ROS master."""

from __future__ import annotations

import importlib
import sys

COMMANDS = ("check", "register", "schedule")


def main() -> int:
    """Run the node until shutdown, or a command; return the exit code."""
    word = next(iter(sys.argv[1:]), "")
    if word in COMMANDS:
        # a command needs nothing of the node's
        command = importlib.import_module(f"construction_twin.extensions.work.commands.work_{word}")
        return command.main(sys.argv[2:])
    if word and ":=" not in word:
        print(f"work: found {word!r}, expected {', '.join(COMMANDS)}, or nothing: the node", file=sys.stderr)
        return 2
    from construction_twin.extensions.work.nodes.work import main as run

    run()
    return 0
