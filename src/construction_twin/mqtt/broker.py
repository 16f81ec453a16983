"""Starts Debian's mosquitto on loopback, after looking whether the port is free. Standard library only."""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import sys
from pathlib import Path

from construction_twin.ports import port_is_free
from construction_twin.realtime import request_realtime

#: Not MQTT's 1883: Debian's package starts a mosquitto service of its own there.
DEFAULT_PORT = 18830


def main(argv: list[str] | None = None) -> None:
    """Become mosquitto; exit with one sentence when that is not possible."""
    parser = argparse.ArgumentParser(
        prog="broker", description="Run mosquitto on loopback with the project's configuration."
    )
    parser.add_argument("--config", required=True, help="mosquitto configuration file")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="TCP port on 127.0.0.1 [%(default)s]")
    parser.add_argument(
        "--realtime", type=int, default=0, metavar="PRIORITY", help="SCHED_FIFO priority, 0 for none [%(default)s]"
    )
    # roslaunch adds __name:= and __log:= for nodes that speak ROS
    arguments = parser.parse_args([a for a in (sys.argv[1:] if argv is None else argv) if ":=" not in a])
    program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:" + os.environ.get("PATH", ""))
    if program is None:
        sys.exit("broker: mosquitto is not installed; run setup/setup.sh")
    if not port_is_free(socket.SOCK_STREAM, arguments.port):
        sys.exit(
            f"broker: TCP port {arguments.port} on 127.0.0.1 is taken, probably by another MQTT broker; stop it, give another "
            "broker_port, or use it with broker:=false"
        )
    print(f"broker: {request_realtime(arguments.realtime)}", flush=True)
    config = _with_listener(Path(arguments.config), arguments.port)
    os.execv(program, [program, "-c", config])


def _with_listener(config: Path, port: int) -> str:
    """Return the path of a file in memory: `config` and a listener on loopback.

    With ``-p`` mosquitto does the same, but warns that nobody else can connect.
    """
    file = os.memfd_create("mosquitto.conf", 0)  # without MFD_CLOEXEC: mosquitto inherits it
    os.write(file, config.read_bytes() + f"\nlistener {port} 127.0.0.1\n".encode())
    return f"/dev/fd/{file}"
