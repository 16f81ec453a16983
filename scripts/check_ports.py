"""Says in one sentence which port that the demo needs is taken: `python scripts/check_ports.py [launch arguments]`."""

from __future__ import annotations

import os
import socket
import sys

from construction_twin.ports import port_is_free


def main(arguments: list[str]) -> int:
    """Check the ports; return the exit code."""
    given = dict(argument.split(":=", 1) for argument in arguments if ":=" in argument)
    ports = [
        (
            "ROS master",
            socket.SOCK_STREAM,
            int(os.environ.get("ROS_MASTER_PORT", "11311")),
            "set ROS_MASTER_PORT to a free one",
        )
    ]
    if given.get("broker", "true") == "true":
        port = int(given.get("broker_port", "1883"))
        ports.append(("MQTT broker", socket.SOCK_STREAM, port, 'give another one: make demo ARGS="broker_port:=1884"'))
    if given.get("gateway", "true") == "true":
        port = int(given.get("rsi_port", "49152"))
        ports.append(("RSI gateway", socket.SOCK_DGRAM, port, 'give another one: make demo ARGS="rsi_port:=49153"'))
    for name, kind, port, advice in ports:
        if not port_is_free(kind, port):
            protocol = "TCP" if kind is socket.SOCK_STREAM else "UDP"
            print(
                f"demo: {protocol} port {port} for the {name} is taken; end what holds it, or {advice}", file=sys.stderr
            )
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
