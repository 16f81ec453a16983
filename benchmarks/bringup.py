"""The whole system on ports of its own, for benchmarks that measure at its topics."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from link_world import free_port

#: Longest wait until twin and arm are in sync [s].
START = 90.0


@contextmanager
def bringup(*arguments: str) -> Iterator[int]:
    """Run bringup with the mock arm and these launch arguments; give the broker's port. Nodes of this process find its master."""
    with tempfile.TemporaryDirectory() as folder:
        port = free_port()
        os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_HOME": folder}
        broker = free_port()
        ports = [f"broker_port:={broker}", f"rsi_port:={free_port(socket.SOCK_DGRAM)}"]
        with open(Path(folder) / "launch.log", "w") as log:
            run = subprocess.Popen(
                ["roslaunch", "-p", str(port), "construction_twin", "bringup.launch", *ports, *arguments],
                stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
            try:
                yield broker
            finally:
                run.send_signal(signal.SIGINT)  # lets it end its nodes
                run.wait(60)
