"""The gateway's time to answer the controller, from the kernel's time of arrival to the reply: idle, and with all cores busy."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from link_cell import Cell, Commander, reply_spread, shipped_config
from link_world import REALTIME, World
from machine import MachineProbe

#: Time from arming to the beginning of the measurement [s].
SETTLE = 2.0
_BUSY = "while True: pass"


def measure(seconds: float, loaded: bool, realtime: int = REALTIME) -> tuple[dict, dict]:
    """Return the spread of the reply time [us], late replies and cycles while a motion is streamed; and what goes with it.

    That is the gateway's ``state`` at the end and the ``machine``'s own pauses in the meantime (see `MachineProbe`).

    If the machine does not run the mock controller in time, the stream gets ahead of it and the gateway brakes, but goes on
    answering.

    Args:
        loaded: With one busy loop per core beside it, at normal priority.
        realtime: SCHED_FIFO priority of the 250 Hz path, 0 for none.
    """
    config, home = shipped_config()
    with tempfile.TemporaryDirectory() as folder, World(Path(folder)) as world:
        world.start_broker(realtime)
        Cell(world, config, realtime)
        commander = Commander(world.broker_port, config, home)
        commander.arm()
        commander.stream(SETTLE)
        if loaded:
            for core in range(os.cpu_count()):
                world.start(f"busy{core}", [sys.executable, "-c", _BUSY])
            commander.stream(SETTLE)
        probe = world.enter_context(MachineProbe(realtime))
        before = commander.next_status()
        probe.taken()
        commander.stream(seconds)
        machine = probe.taken()
        result = reply_spread(before, commander.next_status())
        commander.close()
        return result, {"state": commander.status["state"], "machine": machine}
