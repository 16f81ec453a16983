"""The program `console`: pipes WebSockets to the broker's TCP port, and serves a page.

Debian's mosquitto has no WebSockets. A broker that has them needs no console for the pipe. It needs `websockets`, and says so.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path

#: Not 8080: half of all programs with a page listen there.
DEFAULT_PORT = 8480


def main(argv: list[str] | None = None) -> int:
    """Serve until a signal; return the exit code."""
    arguments = _arguments(argv)
    if importlib.util.find_spec("websockets") is None:
        print("console: the Python package websockets is not installed; run setup/setup.sh console")
        return 1
    # websockets is needed from here on only
    from construction_twin.console.program import run

    return run(arguments)


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="console",
        description="Pipe WebSockets to the broker's TCP port, and serve a page. Without --certificate only on loopback.",
    )
    add = parser.add_argument
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
    # roslaunch adds __name:= and __log:= for nodes that speak ROS
    return parser.parse_args([word for word in (sys.argv[1:] if argv is None else argv) if ":=" not in word])
