"""Says in one sentence which of the demo's ports is taken or is no port number; used by scripts/demo.py."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Mapping

from construction_twin.broker.start import DEFAULT_PORT
from construction_twin.core.network import port_is_free


def launch_arguments(arguments: list[str]) -> dict[str, str]:
    """Return ``name:=value`` arguments as a mapping; of several for one name the last counts, as in roslaunch."""
    return dict(argument.split(":=", 1) for argument in arguments if ":=" in argument)


def problem(given: Mapping[str, str], environment: Mapping[str, str]) -> str | None:
    """Return a sentence about the first port that cannot be used, None when all can."""
    master = environment.get("ROS_MASTER_PORT", "11311")
    ports = [("ROS_MASTER_PORT", "ROS master", socket.SOCK_STREAM, master, "set ROS_MASTER_PORT to a free one")]
    if given.get("broker", "true") == "true":
        text = given.get("broker_port", str(DEFAULT_PORT))
        advice = f'give another one: make demo ARGS="broker_port:={DEFAULT_PORT + 10}"'
        ports.append(("broker_port", "MQTT broker", socket.SOCK_STREAM, text, advice))
    if given.get("gateway", "true") == "true":
        advice = 'give another one: make demo ARGS="rsi_port:=49153"'
        ports.append(("rsi_port", "RSI gateway", socket.SOCK_DGRAM, given.get("rsi_port", "49152"), advice))
    for argument, name, kind, text, advice in ports:
        if not (text.isascii() and text.isdigit() and 1 <= int(text) <= 65535):
            return f"{argument} is '{text}'; a port is a whole number from 1 to 65535"
        if not port_is_free(kind, int(text)):
            protocol = "TCP" if kind is socket.SOCK_STREAM else "UDP"
            return f"{protocol} port {text} for the {name} is taken; end what holds it, or {advice}"
    return None


def main(arguments: list[str]) -> int:
    """Check the ports; return the exit code."""
    sentence = problem(launch_arguments(arguments), os.environ)
    if sentence:
        print(f"demo: {sentence}", file=sys.stderr)
    return 1 if sentence else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
