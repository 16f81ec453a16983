"""Keeps the terminal view of `views.dashboard` up to date."""

from __future__ import annotations

import time

import rospy
from rich.console import Console
from rich.live import Live

from construction_twin.core.errors import SilenceError
from construction_twin.core.sentences import Sentence
from construction_twin.ros.shared.robot_listener import RobotListener
from construction_twin.views.dashboard import render

#: Time over which a single picture counts the rates [s].
COUNTING = 1.0


def watch(listener: RobotListener, rate: float, once: bool, timeout: float) -> None:
    """Show a robot until the process is interrupted, or once.

    Args:
        rate: Pictures per second.
        once: Print one picture and return.
        timeout: How long to wait for a first report [s].

    Raises:
        SilenceError: If no robot reports.
    """
    if not listener.wait(lambda: listener.newest("sync") or listener.newest("link"), timeout):
        nothing = Sentence("view.silent.nothing", seconds=timeout)
        raise SilenceError("sync and link", nothing, Sentence("view.to_do.give_robot"))
    console = Console(highlight=False)
    listener.snapshot()  # begins to count
    if once:
        time.sleep(COUNTING)
        console.print(render(listener.snapshot()))
        return
    with Live(console=console, auto_refresh=False, screen=console.is_terminal) as live:
        while not rospy.is_shutdown():
            time.sleep(1.0 / rate)
            live.update(render(listener.snapshot()), refresh=True)
