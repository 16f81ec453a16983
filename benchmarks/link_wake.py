"""The time this machine needs to hand a message on: a chain of processes that only receive and send on bare sockets.

A command that goes from ROS over the bridge and the broker to its peer and back is received six times, by six processes' wake-ups.
What six bare wake-ups take is what no bridge on this machine can go below, in whatever language it is written.

``python benchmarks/link_wake.py`` prints the JSON that `link.py` reads.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import socket
import time
from pathlib import Path

from link_world import REALTIME, end_in_order

from construction_twin.core.realtime import request_realtime

#: Receptions of a round trip: bridge, broker, peer, broker, bridge, ROS.
HOPS = 6
#: As long as a command with its properties [bytes].
MESSAGE = bytes(200)
RATE = 250.0


def connection() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a TCP connection on loopback that sends at once."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
    for end in (near, far):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return near, far


def hand_on(source: socket.socket, target: socket.socket, realtime: int) -> None:
    """Send what comes from `source` to `target` until it is closed."""
    request_realtime(realtime)
    while data := source.recv(len(MESSAGE)):
        target.send(data)


def measure(hops: int, seconds: float, realtime: int) -> list[int]:
    """Return the times from the first process of the chain to its end, which is the first again [ns]."""
    links = [connection() for _ in range(hops)]
    context = multiprocessing.get_context("fork")
    chain = [
        context.Process(target=hand_on, args=(links[index][1], links[index + 1][0], realtime), daemon=True)
        for index in range(hops - 1)
    ]
    for process in chain:
        process.start()
    first, last = links[0][0], links[-1][1]
    request_realtime(realtime)
    times, due = [], time.monotonic_ns()
    for _ in range(round(seconds * RATE)):
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
        sent = time.monotonic_ns()
        first.send(MESSAGE)
        last.recv(len(MESSAGE))
        times.append(time.monotonic_ns() - sent)
        due += round(1e9 / RATE)
    for process in chain:
        process.terminate()
        process.join()
    return times


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--realtime", type=int, default=REALTIME)
    parser.add_argument("--output", type=Path, required=True)
    options = parser.parse_args()
    end_in_order()
    options.output.write_text(json.dumps({"hops": HOPS, "latencies": measure(HOPS, options.seconds, options.realtime)}))


if __name__ == "__main__":
    main()
