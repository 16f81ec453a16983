"""A network that is not good: proxies that sit between two programs and delay, hold up and lose what they carry.

For tests only. asyncio in a thread of its own; every draw comes from a seed. A profile can be changed while traffic flows.
Times in s.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import random
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable

from impairment_profiles import Profile, Stall

#: Bytes of one direction of a TCP connection that wait in the proxy before it stops reading.
MOST_WAITING = 1 << 18
_CHUNK = 1 << 16
_MAX_DATAGRAM = 65535


class _Line:
    """A profile that began at some time, and the draws for it."""

    def __init__(self, clock: Callable[[], float]):
        self._chance = random.Random(1)
        self._clock = clock
        self.begin(Profile())

    def begin(self, profile: Profile) -> None:
        self.profile, self._since = profile, self._clock()

    def arrival(self, now: float) -> float:
        """Return when what is sent now arrives."""
        return self._since + self.profile.released(now - self._since + self.profile.travel(self._chance))

    def released(self, now: float) -> float:
        """Return when what is under way now goes on."""
        return self._since + self.profile.released(now - self._since)

    def stalled_since(self, now: float) -> float | None:
        """Return when the stall began that holds up what comes now; None for none."""
        begun = self.profile.stalled_since(now - self._since)
        return None if begun is None else self._since + begun

    def until_stall(self) -> float:
        """Return how long it is until the next stall begins [s]; infinite without any."""
        if not self.profile.stall:
            return math.inf
        period, into = self.profile.stall[0], self._clock() - self._since
        return period / 2 - into if into < period / 2 else period - (into - period / 2) % period

    @property
    def is_cut(self) -> bool:
        return self._clock() - self._since < self.profile.cut


class TcpProxy:
    """Carries TCP connections to `target`, in order, as its profile says.

    Attributes:
        counters: ``connections``, ``refused`` (target does not answer), ``bytes_up``, ``bytes_down``.
        stalls: Those that held something up, oldest first.
    """

    def __init__(self, target: tuple[str, int]):
        self.target = target
        self.counters: Counter[str] = Counter()
        self.address: tuple[str, int] = ()
        self.stalls: list[Stall] = []
        self._line = _Line(time.monotonic)
        self._writers: set[asyncio.StreamWriter] = set()

    async def start(self) -> None:
        """Listen; `address` says where."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.address = self._server.sockets[0].getsockname()[:2]

    def apply(self, profile: Profile) -> None:
        """Behave like this from now on."""
        self._line.begin(profile)

    def until_stall(self) -> float:
        """Return how long it is until the next stall begins [s]; infinite without any."""
        return self._line.until_stall()

    def reset(self) -> None:
        """Break every connection."""
        for writer in list(self._writers):
            sock = writer.get_extra_info("socket")
            if sock is not None:
                # with this, closing sends RST
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            writer.transport.abort()

    async def close(self) -> None:
        """Stop listening and break every connection."""
        self._server.close()
        self.reset()
        await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.counters["connections"] += 1
        self._writers.add(writer)
        try:
            far_reader, far_writer = await asyncio.open_connection(*self.target)
        except OSError:
            self.counters["refused"] += 1
            self._drop(writer)
            return
        self._writers.add(far_writer)
        for each in (writer, far_writer):
            each.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        ways = [
            asyncio.create_task(self._carry(reader, far_writer, "bytes_up")),
            asyncio.create_task(self._carry(far_reader, writer, "bytes_down")),
        ]
        # either side's end is the other's
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
        self._drop(writer)
        self._drop(far_writer)

    def _drop(self, writer: asyncio.StreamWriter) -> None:
        self._writers.discard(writer)
        writer.close()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, name: str) -> None:
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(MOST_WAITING // 256)
        taker = asyncio.create_task(self._deliver(waiting, writer, name))
        last = 0.0
        try:
            # what arrives in one piece travels in one piece
            while data := await reader.read(_CHUNK):
                now = time.monotonic()
                self._note_stall(now, name)
                last = max(last, self._line.arrival(now))
                if self._line.profile.rate:
                    last += len(data) / self._line.profile.rate
                await waiting.put((last, data))
            await waiting.put((last, b""))
            await taker
        except ConnectionError:
            return
        finally:
            taker.cancel()

    def _note_stall(self, now: float, name: str) -> None:
        begun = self._line.stalled_since(now)
        if begun is None:
            return
        if not self.stalls or begun > self.stalls[-1].end:
            self.stalls.append(Stall(begun, begun + self._line.profile.stall[1]))
        if name == "bytes_up":
            self.stalls[-1].up += 1
        else:
            self.stalls[-1].down += 1

    async def _deliver(self, waiting: asyncio.Queue, writer: asyncio.StreamWriter, name: str) -> None:
        while True:
            at, data = await waiting.get()
            # a stall that began meanwhile holds up what is under way
            while (pause := max(at, self._held_until(time.monotonic())) - time.monotonic()) > 0:
                await asyncio.sleep(pause)
            if not data:
                return
            self.counters[name] += len(data)
            writer.write(data)
            await writer.drain()

    def _held_until(self, now: float) -> float:
        return self._line.released(now)


class UdpProxy:
    """Carries datagrams to `target` and its answers back unless the line is cut. Every client gets a port of its own, as in a NAT.

    Args:
        tap: Called with each datagram of a client as it comes in, before anything happens to it.

    Attributes:
        counters: ``up``, ``down`` (datagrams carried), ``lost``.
    """

    def __init__(self, target: tuple[str, int], tap: Callable[[bytes], None] = lambda data: None):
        self.target = target
        self.counters: Counter[str] = Counter()
        self.address: tuple[str, int] = ()
        #: So many of the target's next answers are lost.
        self.answers_to_lose = 0
        self._tap = tap
        self._line = _Line(time.monotonic)
        self._outlets: dict[tuple, socket.socket] = {}

    async def start(self) -> None:
        """Listen; `address` says where."""
        self._loop = asyncio.get_running_loop()
        self._inlet = _datagram_socket(("127.0.0.1", 0))
        self.address = self._inlet.getsockname()
        self._loop.add_reader(self._inlet, self._from_client)

    def apply(self, profile: Profile) -> None:
        """Behave like this from now on."""
        self._line.begin(profile)

    async def close(self) -> None:
        """Stop listening."""
        for sock in (self._inlet, *self._outlets.values()):
            self._loop.remove_reader(sock)
            sock.close()
        self._outlets.clear()

    def _from_client(self) -> None:
        for data, client in _received(self._inlet):
            self._tap(data)
            if client not in self._outlets:
                outlet = _datagram_socket(("0.0.0.0", 0))
                outlet.connect(self.target)
                self._outlets[client] = outlet
                self._loop.add_reader(outlet, self._from_target, outlet, client)
            outlet = self._outlets[client]
            self._carry(lambda data=data, outlet=outlet: outlet.send(data), "up")

    def _from_target(self, outlet: socket.socket, client: tuple) -> None:
        for data, _ in _received(outlet):
            if self.answers_to_lose > 0:
                self.answers_to_lose -= 1
                self.counters["lost"] += 1
                continue
            self._carry(lambda data=data: self._inlet.sendto(data, client), "down")

    def _carry(self, send: Callable[[], object], way: str) -> None:
        if self._line.is_cut:
            self.counters["lost"] += 1
            return
        try:
            send()
            self.counters[way] += 1
        except OSError:
            # nobody listens there (or we are closing): a network loses such a datagram without a word
            self.counters["undeliverable"] += 1


def _datagram_socket(address: tuple[str, int]) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.bind(address)
    return sock


def _received(sock: socket.socket):
    while True:
        try:
            yield sock.recvfrom(_MAX_DATAGRAM)
        except BlockingIOError:
            return
        except ConnectionRefusedError:
            # the answer of a closed port to something sent before
            continue


def hurry() -> None:
    """Let the calling thread run before others, where permitted: a network does not wait because a processor is busy."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))


class Network:
    """A thread with an event loop for proxies; their methods are called in it.

    Use as a context: ``with Network() as network: proxy = network.tcp(("127.0.0.1", 1883))``.
    """

    def __enter__(self) -> Network:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="impairment", daemon=True)
        self._thread.start()
        self._proxies: list[TcpProxy | UdpProxy] = []
        return self

    def __exit__(self, *_) -> None:
        for proxy in self._proxies:
            self._wait(proxy.close())
        self._wait(self._end_tasks())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        self._loop.close()

    def tcp(self, target: tuple[str, int]) -> TcpProxy:
        """Return a TCP proxy that listens on loopback."""
        return self._started(TcpProxy(target))

    def udp(self, target: tuple[str, int], tap=lambda data: None) -> UdpProxy:
        """Return a UDP proxy that listens on loopback."""
        return self._started(UdpProxy(target, tap))

    def apply(self, proxy: TcpProxy | UdpProxy, profile: Profile) -> None:
        """Change a proxy's profile now."""
        self._loop.call_soon_threadsafe(proxy.apply, profile)

    def reset(self, proxy: TcpProxy) -> None:
        """Break a proxy's connections now."""
        self._loop.call_soon_threadsafe(proxy.reset)

    def _run(self) -> None:
        hurry()
        self._loop.run_forever()

    def _started(self, proxy):
        self._wait(proxy.start())
        self._proxies.append(proxy)
        return proxy

    def _wait(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(10.0)

    async def _end_tasks(self) -> None:
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(*tasks, return_exceptions=True)
