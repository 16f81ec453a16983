"""The command line of a program that a launch file starts. Standard library only."""

from __future__ import annotations

import argparse
import sys
from typing import NoReturn

from construction_twin.core.errors import ConfigurationError


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that raises ConfigurationError in place of exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Raise argparse's message as ConfigurationError."""
        raise ConfigurationError(f"the options of {self.prog}", message, f"those of {self.prog} --help")

    def options(self, argv: list[str] | None) -> argparse.Namespace:
        """Return the options; None: those of this process."""
        # roslaunch adds __name:= and __log:= for nodes that speak ROS
        return self.parse_args([word for word in (sys.argv[1:] if argv is None else argv) if ":=" not in word])
