"""The line between everybody and the broker, as a program of its own: `make soak ARGS=faults` cuts it.

Lines on the standard input: ``cut 3.5`` (nothing passes for so many seconds), ``reset`` (every connection is broken). It ends
with its standard input. In the soak's own process its thread would wait for what is heard there 250 times a second.
"""

from __future__ import annotations

import sys

from impairment import Network
from impairment_profiles import Profile


def main(port: int, target: int) -> None:
    """Carry connections on `port` of loopback to `target`."""
    with Network() as network:
        proxy = network.tcp(("127.0.0.1", target), port=port)
        print("listening", flush=True)
        for line in sys.stdin:
            word, _, value = line.strip().partition(" ")
            if word == "cut":
                network.apply(proxy, Profile(cut=float(value)))
            elif word == "reset":
                network.reset(proxy)
            else:
                raise ValueError(f"{line!r}: cut SECONDS or reset expected")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
