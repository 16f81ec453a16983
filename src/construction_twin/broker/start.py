"""Starts Debian's mosquitto, after looking whether the port is free: on loopback, or as a site's configuration says. Standard
library only.
"""

from __future__ import annotations

import argparse
import os
import pwd
import re
import shutil
import socket
import sys
from pathlib import Path

from construction_twin.core.network import port_is_free
from construction_twin.core.realtime import request_realtime

#: Not MQTT's 1883: Debian's package starts a mosquitto service of its own there.
DEFAULT_PORT = 18830


def main(argv: list[str] | None = None) -> None:
    """Become mosquitto; exit with one sentence when that is not possible."""
    parser = argparse.ArgumentParser(
        prog="broker",
        description="Run mosquitto: on loopback, or where the listeners of the configuration file say.",
    )
    parser.add_argument("--config", required=True, help="mosquitto configuration file")
    parser.add_argument(
        "--port",
        type=int,
        default=DEFAULT_PORT,
        help="TCP port on 127.0.0.1; not used when the file has listeners of its own [%(default)s]",
    )
    parser.add_argument(
        "--realtime", type=int, default=0, metavar="PRIORITY", help="SCHED_FIFO priority, 0 for none [%(default)s]"
    )
    # roslaunch adds __name:= and __log:= for nodes that speak ROS
    arguments = parser.parse_args([a for a in (sys.argv[1:] if argv is None else argv) if ":=" not in a])
    program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:" + os.environ.get("PATH", ""))
    if program is None:
        sys.exit("broker: mosquitto is not installed; run setup/setup.sh")
    try:
        text = Path(arguments.config).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        sys.exit(f"broker: {arguments.config}: {getattr(error, 'strerror', error)}")
    listeners = listener_ports(text)
    for port in listeners or [arguments.port]:
        if not port_is_free(socket.SOCK_STREAM, port):
            sys.exit(
                f"broker: TCP port {port} on 127.0.0.1 is taken, probably by another MQTT broker; stop it, give another "
                "broker_port, or use it with broker:=false"
            )
    # without a listener of its own mosquitto binds nothing but loopback, whatever the file allows
    text += _owner() if listeners else f"\nlistener {arguments.port} 127.0.0.1\n"
    print(f"broker: {request_realtime(arguments.realtime)}", flush=True)
    os.execv(program, [program, "-c", _in_memory(text)])


def listener_ports(text: str) -> list[int]:
    """Return the TCP ports of the listeners in a mosquitto configuration.

    Parameters
    ----------
    text : str
        Of the file.

    Returns
    -------
    ports : list of int
        Empty: mosquitto listens where it is told to on its command line.
    """
    return [int(port) for port in re.findall(r"^\s*listener\s+(\d+)", text, re.MULTILINE)]


def _owner() -> str:
    """Return the line by which mosquitto stays root when root starts it: as user mosquitto it could not read its keys."""
    return f"\nuser {pwd.getpwuid(os.geteuid()).pw_name}\n"


def _in_memory(text: str) -> str:
    """Return the path of a file in memory with a whole configuration.

    The listener is not given with ``-p``: mosquitto would warn that only local clients can connect.
    """
    file = os.memfd_create("mosquitto.conf", 0)  # without MFD_CLOEXEC: mosquitto inherits it
    os.write(file, text.encode())
    return f"/dev/fd/{file}"
