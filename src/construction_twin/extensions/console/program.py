"""The program `console`: serves the page, and pipes WebSockets to the broker's TCP port.

Debian's mosquitto has no WebSockets. A broker that has them needs no console for the pipe. It needs `aiohttp`, and says so.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import signal
import socket
import ssl
from pathlib import Path
from typing import TYPE_CHECKING

from construction_twin.core.command_line import Parser
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.extensions import check_extras
from construction_twin.core.network import is_loopback, port_is_free
from construction_twin.core.share import share_file

if TYPE_CHECKING:
    from construction_twin.extensions.console.server import ServerSettings

#: Not 8080: half of all programs with a page listen there.
DEFAULT_PORT = 8480


def main(argv: list[str] | None = None) -> int:
    """Serve until a signal; return the exit code. ConfigurationError where it cannot be served."""
    arguments, settings = check(argv)
    logging.basicConfig(level=logging.INFO, format="console: %(message)s")
    try:
        asyncio.run(_serve(settings, arguments))
    except asyncio.CancelledError:
        return 0
    return 0


def check(argv: list[str] | None) -> tuple[argparse.Namespace, ServerSettings]:
    """Return the options and what they mean; ConfigurationError where nothing can be served with them."""
    arguments = _arguments(argv)
    check_extras("console")
    settings = settings_of(arguments)
    if not port_is_free(socket.SOCK_STREAM, arguments.port, arguments.listen):
        where, expected = (
            f"{arguments.listen}:{arguments.port}",
            "an address of this machine, and a free port, as --port 8490",
        )
        raise ConfigurationError("--listen and --port", where, expected)
    return arguments, settings


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(
        prog="console",
        description="Pipe WebSockets to the broker's TCP port, and serve a page. Without --certificate only on loopback.",
    )
    add = parser.add_argument
    add(
        "--config", type=Path, help="YAML of listen, port and page, as config/console.yaml; the options count before it"
    )
    add("--page", type=Path, help="folder of the page; without it there is none, only the pipe")
    add("--private", type=Path, help="folder of files for who is logged in: robot, scene, building model")
    add("--rights", type=Path, help="who has which right, for who is logged in: rights.json, which make_site writes")
    add("--listen", default="127.0.0.1", metavar="ADDRESS", help="address on which it listens [%(default)s]")
    add("--port", type=int, default=DEFAULT_PORT, help="TCP port [%(default)s]")
    add("--certificate", type=Path, help="certificate (PEM); needs --key")
    add("--key", type=Path, help="its key (PEM)")
    add("--origin", action="append", default=[], help="a further origin whose pages may connect; may be repeated")
    add("--broker-host", default="127.0.0.1", help="the broker's address [%(default)s]")
    add("--broker-port", type=int, default=18830, help="the broker's TCP port [%(default)s]")
    add("--broker-ca", type=Path, help="certificate of who signed the broker's; with it the broker's connection is TLS")
    arguments = parser.options(argv)
    if arguments.config:
        parser.set_defaults(**_configuration(arguments.config))
        arguments = parser.options(argv)
    return arguments


def _configuration(path: Path) -> dict[str, object]:
    """Return the content of a file like config/console.yaml."""
    # the pipe alone needs no YAML
    from construction_twin.robot.urdf import read_yaml

    content = read_yaml(path)
    expected = 'an address, a whole number and a folder, or "": the keys of config/console.yaml'
    kinds = {"listen": str, "port": int, "page": str}
    if not isinstance(content, dict) or {name: type(value) for name, value in content.items()} != kinds:
        raise ConfigurationError(str(path), content, expected)
    return content | {"page": share_file(content["page"]) if content["page"] else None}


def settings_of(arguments: argparse.Namespace) -> ServerSettings:
    """Return the settings that the arguments mean; ConfigurationError names the argument."""
    # aiohttp is needed from here on only
    from construction_twin.extensions.console.pipe import BrokerAddress
    from construction_twin.extensions.console.server import ServerSettings

    if bool(arguments.certificate) != bool(arguments.key):
        raise ConfigurationError("--certificate and --key", None, "both or neither")
    if not arguments.certificate and not is_loopback(arguments.listen):
        raise ConfigurationError(
            "--listen", arguments.listen, "loopback, or --certificate: passwords cross the network"
        )
    own = _own_tls(arguments.certificate, arguments.key) if arguments.certificate else None
    to_broker = _broker_tls(arguments.broker_ca) if arguments.broker_ca else None
    if arguments.rights:
        _check_rights(arguments.rights)
    if to_broker is None and not is_loopback(arguments.broker_host):
        raise ConfigurationError("--broker-host", arguments.broker_host, "loopback, or --broker-ca, for passwords")
    if arguments.page and not arguments.page.is_dir():
        raise ConfigurationError("--page", str(arguments.page), "a folder")
    return ServerSettings(
        arguments.page,
        arguments.private,
        BrokerAddress(arguments.broker_host, arguments.broker_port, to_broker),
        arguments.rights,
        frozenset(arguments.origin),
        own,
    )


def _own_tls(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return the TLS of the console itself; ConfigurationError unless the files are PEM and fit each other."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        # a key with a passphrase is refused: there is no terminal to type it
        context.load_cert_chain(certificate, key, password="")
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError("--certificate and --key", str(error), "readable files in PEM") from error
    return context


def _broker_tls(ca: Path) -> ssl.SSLContext:
    """Return what the broker's certificate is checked by; ConfigurationError when the file is no PEM."""
    try:
        return ssl.create_default_context(cafile=str(ca))
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError("--broker-ca", str(error), "readable files in PEM") from error


def _check_rights(path: Path) -> None:
    """Check that a file is a list of rights."""
    expected = "rights.json as make_site writes it: console/rights.json of the site"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigurationError("--rights", f"{path}: {error}", expected) from error
    if not isinstance(document, dict) or not isinstance(document.get("robots"), dict):
        raise ConfigurationError("--rights", str(path), expected)


async def _serve(settings: ServerSettings, arguments: argparse.Namespace) -> None:
    from construction_twin.extensions.console.server import SOCKET, ConsoleServer

    task = asyncio.current_task()
    assert task is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    await ConsoleServer(settings).run(
        arguments.listen, arguments.port, lambda: print(f"console: {_address(arguments, SOCKET)}", flush=True)
    )


def _address(arguments: argparse.Namespace, socket_path: str) -> str:
    """Return where the page, or the pipe, is reached."""
    scheme = ("http" if arguments.page else "ws") + ("s" if arguments.certificate else "")
    # in place of what nothing can open: this machine's name
    host = socket.gethostname() if arguments.listen in ("", "0.0.0.0", "::") else arguments.listen
    path = "/" if arguments.page else socket_path
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{arguments.port}{path}"
