"""Real-time scheduling where the system permits it; never required. Standard library only."""

from __future__ import annotations

import os


def request_realtime(priority: int) -> str:
    """Ask for SCHED_FIFO at `priority` for every thread of this process; threads and programs started later inherit it.

    Parameters
    ----------
    priority : int
        1 to 99; 0 asks for nothing.

    Returns
    -------
    outcome : str
        One sentence for the log.
    """
    if priority == 0:
        return "normal scheduling"
    if not hasattr(os, "sched_setscheduler"):
        return f"SCHED_FIFO {priority} was asked for, but this system has none; normal scheduling"
    try:
        for thread in map(int, os.listdir("/proc/self/task")):
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return f"SCHED_FIFO {priority} not permitted ({error.strerror}); normal scheduling"
    return f"SCHED_FIFO {priority}"


def release_realtime() -> None:
    """Return every thread of this process to normal scheduling.

    For the end of a ROS node: rospy's server threads spin on their closed sockets until the interpreter is gone, and at a real-time
    priority they would keep the processors to themselves.
    """
    if not hasattr(os, "sched_setscheduler"):
        return
    for thread in map(int, os.listdir("/proc/self/task")):
        try:
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        except ProcessLookupError:
            continue  # it has ended meanwhile
