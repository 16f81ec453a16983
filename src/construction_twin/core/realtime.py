"""Real-time scheduling, processors that stay awake, locked memory: where permitted, never required. Standard library only."""

from __future__ import annotations

import ctypes
import os
import sys

#: Linux: keep what is in memory now, without reading in what is not.
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
#: Linux: the longest time a processor may take to wake up [us], while the file is open (PM QoS, as cyclictest uses it).
_WAKE_UP_LATENCY = "/dev/cpu_dma_latency"
#: That file, while it is open.
_awake: list[int] = []


def request_realtime(priority: int) -> str:
    """Ask for SCHED_FIFO for every thread of this process, also later ones; return one sentence for the log.

    The processors are asked to stay awake as well: one that has to wake up answers late, in a virtual machine by milliseconds.
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
    return f"SCHED_FIFO {priority}, {_keep_awake()}"


def _keep_awake() -> str:
    if not _awake:
        try:
            _awake.append(os.open(_WAKE_UP_LATENCY, os.O_WRONLY))
            os.set_inheritable(_awake[0], True)
            os.write(_awake[0], (0).to_bytes(4, sys.byteorder))
        except OSError as error:
            _let_sleep()
            return f"idle processors may sleep ({_WAKE_UP_LATENCY}: {error.strerror})"
    return "processors asked to stay awake"


def _let_sleep() -> None:
    while _awake:
        os.close(_awake.pop())


def lock_memory() -> str:
    """Lock this process' present memory into RAM; return one sentence for the log."""
    if sys.platform != "linux":
        return "memory not locked: this system has no mlockall"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_ONFAULT):
        return f"memory not locked ({os.strerror(ctypes.get_errno())})"
    return "memory locked"


def release_realtime() -> None:
    """Return every thread to normal scheduling, and let the processors sleep.

    At the end of a ROS node rospy's server threads spin on their closed sockets: at a real-time priority they would block a
    processor.
    """
    _let_sleep()
    if not hasattr(os, "sched_setscheduler"):
        return
    for thread in map(int, os.listdir("/proc/self/task")):
        try:
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        except ProcessLookupError:
            continue  # it has ended meanwhile
