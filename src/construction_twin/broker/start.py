"""Starts Debian's mosquitto, after looking whether the port is free: on loopback, or as a site's configuration says. Standard
library only.

`main` becomes mosquitto. roslaunch starts it again whenever it ends, so what can never work must be found before: `trial` starts
mosquitto as `main` does, and ends it as soon as it listens.
"""

from __future__ import annotations

import argparse
import os
import pwd
import re
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

from construction_twin.core.network import listening_ports, port_is_free
from construction_twin.core.realtime import request_realtime

#: Not MQTT's 1883: Debian's package starts a mosquitto service of its own there.
DEFAULT_PORT = 18830
#: Longest time until a mosquitto on trial listens [s]: long, because a busy machine is no reason to refuse a start.
TRIAL_TIME = 20.0
#: Longest time until it has ended by itself [s]; then it is killed.
END_TIME = 5.0
#: Pause between two looks at a mosquitto on trial [s].
_LOOK = 0.02
#: mosquitto puts the time in front of what it logs.
_LOG_TIME = re.compile(r"^\d+: ")
_NOT_INSTALLED = "mosquitto is not installed; run setup/setup.sh"


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
    program = _program()
    if program is None:
        sys.exit(f"broker: {_NOT_INSTALLED}")
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
    print(f"broker: {request_realtime(arguments.realtime)}", flush=True)
    os.execv(program, [program, "-c", f"/dev/fd/{_in_memory(_complete(text, arguments.port))}"])


def trial(path: str, port: int) -> str:
    """Start mosquitto as `main` would, and end it once it listens; return why it cannot work, empty when it can.

    Args:
        path: Of the configuration file.
        port: TCP port on 127.0.0.1, for a file without listeners.
    """
    program = _program()
    if program is None:
        return _NOT_INSTALLED
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        return str(getattr(error, "strerror", error))
    # port 0 is that of a listener on a Unix socket
    wanted = {number for number in listener_ports(text) or [port] if number}
    file = _in_memory(_complete(text, port))
    try:
        command = [program, "-c", f"/dev/fd/{file}"]
        with subprocess.Popen(command, pass_fds=[file], stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as mosquitto:
            deadline = time.monotonic() + TRIAL_TIME
            while mosquitto.poll() is None and not wanted <= listening_ports(mosquitto.pid, or_any=True):
                if time.monotonic() > deadline:
                    mosquitto.kill()
                    return f"mosquitto does not listen on {sorted(wanted)} within {TRIAL_TIME:g} s"
                time.sleep(_LOOK)
            ended = mosquitto.poll()
            mosquitto.terminate()
            try:
                words, _ = mosquitto.communicate(timeout=END_TIME)
            except subprocess.TimeoutExpired:
                # it listened, and that is what was asked
                mosquitto.kill()
                words, _ = mosquitto.communicate()
    finally:
        os.close(file)
    if ended is None:
        return ""
    lines = [_LOG_TIME.sub("", line) for line in words.decode(errors="replace").splitlines()]
    errors = [line.removeprefix("Error: ") for line in lines if line.startswith("Error")] or lines[-1:]
    return f"mosquitto ends with exit code {ended}: {'; '.join(errors) or 'its log says why'}"


def _program() -> str | None:
    return shutil.which("mosquitto", path="/usr/sbin:/usr/bin:" + os.environ.get("PATH", ""))


def _complete(text: str, port: int) -> str:
    """Return a configuration with what it lacks: without a listener of its own mosquitto binds nothing but loopback."""
    return text + (_owner() if listener_ports(text) else f"\nlistener {port} 127.0.0.1\n")


def listener_ports(text: str) -> list[int]:
    """Return the TCP ports of the listeners in a mosquitto configuration.

    Returns:
        Empty: mosquitto listens where it is told to on its command line.
    """
    return [int(port) for port in re.findall(r"^\s*listener\s+(\d+)", text, re.MULTILINE)]


def _owner() -> str:
    """Return the line by which mosquitto stays root when root starts it: as user mosquitto it could not read its keys."""
    return f"\nuser {pwd.getpwuid(os.geteuid()).pw_name}\n"


def _in_memory(text: str) -> int:
    """Return an open file in memory with a whole configuration, as a descriptor that mosquitto inherits.

    The listener is not given with ``-p``: mosquitto would warn that only local clients can connect.
    """
    file = os.memfd_create("mosquitto.conf", 0)  # without MFD_CLOEXEC
    os.write(file, text.encode())
    return file
