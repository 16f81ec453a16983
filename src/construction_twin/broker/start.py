"""The start of Debian's mosquitto: on loopback, or where a site's configuration says. Standard library only."""

from __future__ import annotations

import argparse
import os
import pwd
import re
import shutil
import socket
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
_LISTENER = re.compile(r"^\s*listener\s+(\d+)", re.MULTILINE)
_FILE = re.compile(r"^\s*(?:password_file|acl_file|cafile|certfile|keyfile)\s+(.*\S)", re.MULTILINE)


def main(argv: list[str] | None = None) -> None:
    """Replace this process with mosquitto."""
    arguments = read_arguments(argv)
    program, text = check(arguments.config, arguments.port, arguments.accounts)
    print(f"broker: {request_realtime(arguments.realtime)}", flush=True)
    os.execv(program, [program, "-c", f"/dev/fd/{_memory_file(_complete(text, arguments.port))}"])


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
    """Return mosquitto's path and its configuration; `accounts`: refuse anonymous clients."""
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
    for name in _FILE.findall(text):
        if not os.access(name, os.R_OK):
            raise ConfigurationError(path, name, "a file that this user can read; make_site writes those of a site")
    for number in listener_ports(text) or [port]:
        if not port_is_free(socket.SOCK_STREAM, number):
            raise ConfigurationError(
                "broker_port", number, "a free TCP port; broker:=false uses the broker that has it"
            )
    return program, text


def allows_anonymous(text: str) -> bool:
    """Return whether a mosquitto configuration permits clients without an account."""
    # of several lines the last one counts; without one mosquitto 2 refuses clients without an account
    permitted = [line.split()[1:] for line in text.splitlines() if line.split()[:1] == ["allow_anonymous"]]
    return bool(permitted) and permitted[-1] == ["true"]


def _complete(text: str, port: int) -> str:
    """Add to a configuration what it lacks: a listener on loopback, or the present user."""
    if not listener_ports(text):
        return f"{text}\nlistener {port} 127.0.0.1\n"
    # when root starts it, it stays root: as user mosquitto it could not read its keys
    return f"{text}\nuser {pwd.getpwuid(os.geteuid()).pw_name}\n"


def listener_ports(text: str) -> list[int]:
    """Return the TCP ports of the listeners in a mosquitto configuration."""
    return list(map(int, _LISTENER.findall(text)))


def _memory_file(text: str) -> int:
    """Return a memory file for mosquitto to inherit: ``-p`` would make it warn of local-only mode."""
    file = os.memfd_create("mosquitto.conf", 0)  # without MFD_CLOEXEC
    os.write(file, text.encode())
    return file
