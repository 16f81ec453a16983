"""Starts Debian's mosquitto, after looking whether the port is free: on loopback, or as a site's configuration says. Standard
library only.

`main` becomes mosquitto. roslaunch starts it again whenever it ends, so what can never work must be found before: `trial` starts
mosquitto with the same configuration on other ports, where no client finds it, and ends it as soon as it has begun.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pwd
import re
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

from construction_twin.core.command_line import Parser
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.network import port_is_free
from construction_twin.core.realtime import request_realtime

#: Not MQTT's 1883: Debian's package starts a mosquitto service of its own there.
DEFAULT_PORT = 18830
#: What a real arm is commanded by.
ACCOUNTS = (
    "accounts, with arm:=real: this broker lets in everybody; give `accounts` of a site (make_site), or "
    "anonymous_broker_is_meant:=true"
)
#: Longest time until a mosquitto on trial listens [s]: long, because a busy machine is no reason to refuse a start.
TRIAL_TIME = 20.0
#: Pause between two looks at a mosquitto on trial [s].
_POLL = 0.02
#: mosquitto puts the time in front of what it logs.
_LOG_TIME = re.compile(r"^\d+: ")
_LISTENER = re.compile(r"^(\s*listener\s+)(\d+)", re.MULTILINE)


def main(argv: list[str] | None = None) -> None:
    """Become mosquitto; ConfigurationError where that is not possible."""
    arguments = read_arguments(argv)
    program, text = check(arguments.config, arguments.port, arguments.accounts)
    print(f"broker: {request_realtime(arguments.realtime)}", flush=True)
    os.execv(program, [program, "-c", f"/dev/fd/{_in_memory(_complete(text, arguments.port))}"])


def read_arguments(argv: list[str] | None) -> argparse.Namespace:
    """Return the options; ConfigurationError for a wrong one."""
    parser = Parser(
        prog="broker", description="Run mosquitto: on loopback, or where its configuration's listeners say."
    )
    add = parser.add_argument
    add("--config", required=True, help="mosquitto configuration file")
    add(
        "--port",
        type=int,
        default=DEFAULT_PORT,
        help="TCP port on 127.0.0.1, for a file without listeners [%(default)s]",
    )
    add("--realtime", type=int, default=0, metavar="PRIORITY", help="SCHED_FIFO priority, 0 for none [%(default)s]")
    add("--accounts", action="store_true", help="refuse a configuration that lets in clients without an account")
    return parser.options(argv)


def check(path: str, port: int, accounts: bool = False) -> tuple[str, str]:
    """Return mosquitto's path and the text of its configuration; ConfigurationError where it could not start, or not stay.

    `accounts`: a configuration that lets in clients without an account is refused.
    """
    program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:" + os.environ.get("PATH", ""))
    if program is None:
        raise ConfigurationError("mosquitto", None, "it to be installed; run setup/setup.sh")
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", error)
        raise ConfigurationError("mosquitto.conf", path, f"a file that can be read: {why}") from error
    if accounts and allows_anonymous(text):
        raise ConfigurationError("mosquitto.conf", path, ACCOUNTS)
    for number in listener_ports(text) or [port]:
        if not port_is_free(socket.SOCK_STREAM, number):
            raise ConfigurationError(
                "broker_port", number, "a free TCP port; broker:=false uses the broker that has it"
            )
    if cause := trial(program, text):
        raise ConfigurationError("mosquitto.conf", path, f"one that mosquitto can start with: {cause}")
    return program, text


def allows_anonymous(text: str) -> bool:
    """Return whether a mosquitto configuration permits clients without an account."""
    # of several lines the last one counts; without one mosquitto 2 refuses clients without an account
    permitted = [line.split()[1:] for line in text.splitlines() if line.split()[:1] == ["allow_anonymous"]]
    return bool(permitted) and permitted[-1] == ["true"]


def trial(program: str, text: str) -> str:
    """Start mosquitto on free ports, and end it once it has begun; return why it cannot work, empty when it can."""

    def on_free_port(listener: re.Match[str]) -> str:
        # port 0 is that of a listener on a Unix socket
        if not int(listener[2]):
            return listener[0]
        with socket.create_server(("127.0.0.1", 0)) as free:
            return f"{listener[1]}{free.getsockname()[1]}"

    file = _in_memory(_LISTENER.sub(on_free_port, _complete(text, DEFAULT_PORT)))
    try:
        command = [program, "-c", f"/dev/fd/{file}"]
        with subprocess.Popen(command, pass_fds=[file], stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as mosquitto:
            deadline = time.monotonic() + TRIAL_TIME
            while mosquitto.poll() is None and not _has_begun(mosquitto.pid):
                if time.monotonic() > deadline:
                    mosquitto.kill()
                    return f"mosquitto does not listen within {TRIAL_TIME:g} s"
                time.sleep(_POLL)
            ended = mosquitto.poll()
            # a killed one writes no persistent state
            mosquitto.kill()
            words, _ = mosquitto.communicate()
    finally:
        os.close(file)
    if ended is None:
        return ""
    lines = [_LOG_TIME.sub("", line) for line in words.decode(errors="replace").splitlines()]
    errors = [line.removeprefix("Error: ") for line in lines if line.startswith("Error")] or lines[-1:]
    return f"mosquitto ends with exit code {ended}: {'; '.join(errors) or 'its log says why'}"


def _has_begun(pid: int) -> bool:
    """Return whether mosquitto catches SIGTERM: it does so once every listener stands, with its certificate and access rules."""
    with contextlib.suppress(OSError):  # it has ended
        caught = re.search(r"^SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
        return caught is not None and bool(int(caught[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


def _complete(text: str, port: int) -> str:
    """Return a configuration with what it lacks: without a listener of its own mosquitto binds nothing but loopback."""
    if not listener_ports(text):
        return f"{text}\nlistener {port} 127.0.0.1\n"
    # when root starts it, it stays root: as user mosquitto it could not read its keys
    return f"{text}\nuser {pwd.getpwuid(os.geteuid()).pw_name}\n"


def listener_ports(text: str) -> list[int]:
    """Return the TCP ports of the listeners in a mosquitto configuration."""
    return [int(port) for _, port in _LISTENER.findall(text)]


def _in_memory(text: str) -> int:
    """Return a file in memory that mosquitto inherits; with ``-p`` it would warn that only local clients can connect."""
    file = os.memfd_create("mosquitto.conf", 0)  # without MFD_CLOEXEC
    os.write(file, text.encode())
    return file
