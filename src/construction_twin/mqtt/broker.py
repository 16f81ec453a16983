"""Starts Debian's mosquitto on loopback, after looking whether the port is free. Standard library only."""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import sys

from construction_twin.ports import port_is_free
from construction_twin.realtime import request_realtime


def main(argv: list[str] | None = None) -> None:
    """Become mosquitto; exit with one sentence when that is not possible."""
    parser = argparse.ArgumentParser(
        prog="broker", description="Run mosquitto on loopback with the project's configuration."
    )
    parser.add_argument("--config", required=True, help="mosquitto configuration file")
    parser.add_argument("--port", type=int, default=1883, help="TCP port on 127.0.0.1 [%(default)s]")
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
    os.execv(program, [program, "-c", arguments.config, "-p", str(arguments.port)])
