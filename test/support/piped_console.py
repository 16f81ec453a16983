"""The console in this process, with real sockets, and mosquitto with accounts behind it."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from mqtt_packets import packet, text
from websockets.asyncio.client import connect as websocket
from websockets.exceptions import ConnectionClosed

from construction_twin.console.server import ConsoleServer, ServerSettings

MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
CONNACK_OK = b"\x20\x02\0\0"
PING, PONG = b"\xc0\0", b"\xd0\0"


@contextlib.contextmanager
def started(command: list, port: int) -> Iterator[subprocess.Popen]:
    """Start a program; wait until its port is open."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        end = time.monotonic() + 10
        while time.monotonic() < end and process.poll() is None:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
                break
            time.sleep(0.02)
        assert process.poll() is None
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=10)


@contextlib.contextmanager
def broker_with(folder: Path, port: int, *accounts: str) -> Iterator[None]:
    """Mosquitto with accounts whose password is `secret`."""
    passwords, configuration = folder / "passwords", folder / "mosquitto.conf"
    passwords.write_text("".join(f"{account}:secret\n" for account in accounts))
    passwords.chmod(0o600)
    subprocess.run(["mosquitto_passwd", "-U", passwords], check=True)
    configuration.write_text(
        f"listener {port} 127.0.0.1\nallow_anonymous false\npassword_file {passwords}\nuser root\n"
    )
    with started([MOSQUITTO, "-c", configuration], port):
        yield


@contextlib.asynccontextmanager
async def serving(served: ServerSettings, port: int) -> AsyncIterator[ConsoleServer]:
    """Serve on loopback until the block ends."""
    ready, server = asyncio.Event(), ConsoleServer(served)
    task = asyncio.create_task(server.run("127.0.0.1", port, ready))
    await asyncio.wait_for(ready.wait(), 10)
    try:
        yield server
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def browser_at(port: int, address: str = "127.0.0.1", **more):
    """Return a WebSocket as a page's, from an address of this machine."""
    values = {"origin": f"http://127.0.0.1:{port}", "subprotocols": ["mqtt"], "compression": None} | more
    return websocket(f"ws://127.0.0.1:{port}/mqtt", local_addr=(address, 0), **values)


def login(user: str = "ada", password: str = "secret") -> bytes:
    return packet(
        1, text("MQTT") + b"\x04\xc2\0\x0a" + text(f"test-{time.monotonic_ns()}") + text(user) + text(password)
    )


async def closed(client) -> tuple[int, str]:
    """Wait until the server has closed; return code and reason."""
    with pytest.raises(ConnectionClosed) as caught:
        while True:
            await asyncio.wait_for(client.recv(), 10)
    return caught.value.rcvd.code, caught.value.rcvd.reason
