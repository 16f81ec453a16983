"""The gateway's command line: options to a running service, and its exit code. Standard library and paho-mqtt only."""

from __future__ import annotations

import argparse
import gc
import logging
import secrets
import signal
import sys
import threading
from logging.handlers import QueueHandler, QueueListener
from pathlib import Path
from queue import SimpleQueue

from construction_twin.core.command_line import Parser
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.network import address_of, bind, is_loopback
from construction_twin.core.realtime import lock_memory, request_realtime
from construction_twin.gateway.config import GatewayConfig, load_config
from construction_twin.gateway.service import GatewayService
from construction_twin.gateway.states import Mode
from construction_twin.gateway.stop_file import StopFile
from construction_twin.gateway.trace import TraceWriter, check_trace
from construction_twin.mqtt.client import Broker, load_account
from construction_twin.mqtt.messages import Topics


def log_in_background() -> QueueListener:
    """Write the log in a background thread (docs/architecture.md, law 1)."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
    records: SimpleQueue = SimpleQueue()
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[QueueHandler(records)])
    listener = QueueListener(records, handler)
    listener.start()
    return listener


log = logging.getLogger("rsi_gateway")


def read_arguments(argv: list[str]) -> argparse.Namespace:
    """Return the options; ConfigurationError for a wrong one."""
    parser = Parser(
        prog="rsi_gateway",
        description="Bridge between MQTT joint strings and a robot controller (KUKA RSI). Needs no ROS. Not safety rated.",
    )
    parser.add_argument("--config", required=True, help="JSON file written by `rosrun construction_twin twin gateway`")
    parser.add_argument(
        "--listen",
        default="127.0.0.1:0",
        metavar="HOST:PORT",
        help="UDP address for the controller; port 0: that of its file, of RSI PORT of the Ethernet XML [%(default)s]",
    )
    parser.add_argument(
        "--ethernet-xml",
        metavar="FILE",
        help="the file that was copied to the controller: do not start when the configuration was made from another one",
    )
    parser.add_argument(
        "--commissioning",
        nargs="?",
        const="true",
        default="false",
        choices=["true", "false"],
        help="send every correction as zero; everything else runs and is reported as usual",
    )
    parser.add_argument(
        "--controller",
        metavar="HOST",
        help="read telegrams from this address only; a name is looked up once, at the start; without one --listen must be"
        " a loopback address",
    )
    parser.add_argument("--broker", default="127.0.0.1:1883", metavar="HOST:PORT", help="MQTT broker [%(default)s]")
    parser.add_argument(
        "--account",
        metavar="FILE",
        help="account file for the broker, as make_site writes it; without: anonymous, no TLS",
    )
    parser.add_argument("--prefix", default="twin", help="first level of the MQTT topics [%(default)s]")
    parser.add_argument(
        "--realtime", type=int, default=0, metavar="PRIORITY", help="SCHED_FIFO priority, 0 for none [%(default)s]"
    )
    parser.add_argument(
        "--stop-file",
        metavar="FILE",
        help="keep here that the arm is stopped until somebody resets it, also when this program is started again"
        " [ROBOT.stopped beside the configuration]",
    )
    parser.add_argument(
        "--trace",
        metavar="FILE",
        help="record what is really sent, cycle by cycle, for an hour; its room on the disk is reserved at the start",
    )
    return parser.parse_args(argv)


def _address(text: str, option: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    lowest = 0 if option == "--listen" else 1
    if not host or not (port.isascii() and port.isdigit()) or not lowest <= int(port) < 65536:
        raise ConfigurationError(option, text, "HOST:PORT")
    return host, int(port)


def _endpoints(
    arguments: argparse.Namespace, config: GatewayConfig
) -> tuple[Broker, Topics, tuple[str, int], str | None]:
    """Return broker and topics, the address for the controller, and the controller's own."""
    account = load_account(arguments.account) if arguments.account else None
    broker = Broker(*_address(arguments.broker, "--broker"), account=account)
    host, port = _address(arguments.listen, "--listen")
    controller = address_of(arguments.controller, "--controller") if arguments.controller else None
    if controller is None and not is_loopback(host):
        expected = f"the controller's address: what comes to {host} comes from a network, and only the controller may"
        raise ConfigurationError("--controller", "", expected)
    return broker, Topics(arguments.prefix, config.robot), (host, port or config.layout.port), controller


def check(arguments: argparse.Namespace, config: GatewayConfig) -> None:
    """Check the options as a start would, without side effects."""
    bind(*_endpoints(arguments, config)[2]).close()
    if arguments.trace:
        check_trace(arguments.trace)


def _run(argv: list[str]) -> int:
    try:
        arguments = read_arguments(argv)
        config = load_config(arguments.config)
        broker, topics, address, controller = _endpoints(arguments, config)
        file = arguments.ethernet_xml
        destination = config.make.form_of(file).sends_to(file, config.layout) if file else address[0]
        run, commissioning = secrets.token_hex(8), arguments.commissioning == "true"
        sock = bind(*address)
        # behind the address, which no second gateway gets
        stops = StopFile(arguments.stop_file or Path(arguments.config).with_name(f"{config.robot}.stopped"))
        service = GatewayService(config, sock, broker, topics, run, controller, commissioning, stops=stops)
        # last: it takes room on a disk, which what else may be refused must not leave taken
        trace = TraceWriter(arguments.trace, len(config.axes)) if arguments.trace else None
        if trace is not None:
            service.gateway.trace = trace.record
    except ConstructionTwinError as error:
        log.error("%s", error)
        return 2
    # before the first line is logged: the log's thread may be the one that fails
    threading.excepthook = service.on_thread_failure
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: service.stop())
    log.info(
        "configuration %s; run %s; listening on %s:%d; broker %s", config.hash[:12], run, *address, arguments.broker
    )
    log.info("telegrams are read from %s", f"{controller} only" if controller else "any sender that begins a session")
    terms = config.make.terms
    if address[1] != config.layout.port:
        log.warning(
            "%s tells the controller to send to port %d, not %d", terms.description, config.layout.port, address[1]
        )
    if destination != address[0] and address[0] != "0.0.0.0":
        log.warning("%s tells the controller to send to address %s, not %s", terms.description, destination, address[0])
    if config.layout.not_filled:
        log.info("channels that no reply fills, so they stay as they are: %s", ", ".join(config.layout.not_filled))
    if service.gateway.mode is not Mode.NORMAL:
        log.warning("%s", service.gateway.with_mode(f"mode {service.gateway.mode.value}"))
    if stops.found:
        log.warning("stopped before, and not reset (%s)", stops.found)
    log.info("%s; %s", request_realtime(arguments.realtime), lock_memory())
    # a full collection over everything imported would take longer than the controller waits
    gc.freeze()
    service.run()
    if trace is not None:
        trace.close()
    return 1 if service.failure else 0


def main(argv: list[str] | None = None) -> int:
    """Run the gateway until SIGINT or SIGTERM; return the exit code."""
    # the log's thread may keep the interpreter for 5 ms otherwise, more than a cycle
    sys.setswitchinterval(0.001)
    listener = log_in_background()
    try:
        return _run(sys.argv[1:] if argv is None else argv)
    finally:
        listener.stop()
