"""What the program `console` does with its arguments: settings, or a sentence about what is wrong; serving until a signal."""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
import socket

from construction_twin.console.given_files import broker_tls, check_rights, own_tls
from construction_twin.console.pipe import BrokerAddress
from construction_twin.console.server import SOCKET, ConsoleServer, ServerSettings
from construction_twin.console.static_files import read_folder
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.network import is_loopback
from construction_twin.core.sentences import Sentence


def settings_of(arguments: argparse.Namespace) -> ServerSettings:
    """Return the settings that the arguments mean.

    Raises:
        ConfigurationError: Naming the argument.
    """
    if bool(arguments.certificate) != bool(arguments.key):
        raise ConfigurationError("--certificate and --key", None, Sentence("expected.both_or_neither"))
    if not arguments.certificate and not is_loopback(arguments.listen):
        raise ConfigurationError("--listen", arguments.listen, Sentence("expected.loopback_certificate"))
    own = own_tls(arguments.certificate, arguments.key) if arguments.certificate else None
    to_broker = broker_tls(arguments.broker_ca) if arguments.broker_ca else None
    if arguments.rights:
        check_rights(arguments.rights)
    if to_broker is None and not is_loopback(arguments.broker_host):
        raise ConfigurationError("--broker-host", arguments.broker_host, Sentence("expected.loopback_ca"))
    return ServerSettings(
        read_folder(arguments.page) if arguments.page else {},
        arguments.private,
        BrokerAddress(arguments.broker_host, arguments.broker_port, to_broker),
        frozenset(arguments.origin),
        own,
        rights=arguments.rights,
    )


async def _serve(server: ConsoleServer, host: str, port: int, address: str) -> None:
    task = asyncio.current_task()
    assert task is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    ready = asyncio.Event()
    serving = asyncio.create_task(server.run(host, port, ready))
    opened = asyncio.create_task(ready.wait())
    try:
        await asyncio.wait((serving, opened), return_when=asyncio.FIRST_COMPLETED)
        if ready.is_set():
            print(f"console: {address}", flush=True)
        await serving
    finally:
        opened.cancel()


def run(arguments: argparse.Namespace) -> int:
    """Serve until a signal; return the exit code."""
    logging.basicConfig(level=logging.INFO, format="console: %(message)s")
    # one line per connection is ours; the library's would tell every handshake. Its errors are exceptions that nobody foresaw
    logging.getLogger("websockets").setLevel(logging.ERROR)
    try:
        server = ConsoleServer(settings_of(arguments))
    except ConstructionTwinError as error:
        print(f"console: {error}")
        return 1
    scheme = ("http" if arguments.page else "ws") + ("s" if arguments.certificate else "")
    path = "/" if arguments.page else SOCKET
    # which nothing can open: this machine's name
    host = socket.gethostname() if arguments.listen in ("", "0.0.0.0", "::") else arguments.listen
    address = f"{scheme}://{f'[{host}]' if ':' in host else host}:{arguments.port}{path}"
    try:
        asyncio.run(_serve(server, arguments.listen, arguments.port, address))
    except asyncio.CancelledError:
        return 0
    except OSError as error:
        print(
            f"console: {arguments.listen}:{arguments.port}: {error.strerror}; stop what holds it, or give another --port"
        )
        return 1
    return 0
