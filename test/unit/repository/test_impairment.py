"""The impairment proxies do what their profiles say: nothing more, nothing less, and the same for the same seed."""

from __future__ import annotations

import math
import random
import socket
import threading
import time
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from impairment import Network
from impairment_profiles import TCP_PROFILES, UDP_PROFILES, Profile
from processes import wait_until


@contextmanager
def tcp_pair(profile=None):
    """A connection through a proxy: near end, far end, network, proxy."""
    with socket.create_server(("127.0.0.1", 0)) as server, Network() as network:
        proxy = network.tcp(server.getsockname())
        with socket.create_connection(proxy.address, 5.0) as near, server.accept()[0] as far:
            for end in (near, far):
                end.settimeout(10.0)
            if profile is not None:
                network.apply(proxy, profile)
            yield near, far, network, proxy


def receive(sock, size):
    data = b""
    while len(data) < size:
        more = sock.recv(size - len(data))
        assert more, f"closed after {len(data)} of {size} bytes"
        data += more
    return data


class Echo:
    """Sends numbered datagrams through a proxy to a socket of its own and returns what arrived, in order."""

    def __init__(self, network, profile, seed=1):
        self.far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.far.bind(("127.0.0.1", 0))
        self.far.settimeout(1.0)
        self.near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.proxy = network.udp(self.far.getsockname(), seed)
        network.apply(self.proxy, profile)

    def carry(self, count, pause=0.0005):
        arrived = []
        reader = threading.Thread(target=self._read, args=(arrived,))
        reader.start()
        for number in range(count):
            self.near.sendto(b"%d" % number, self.proxy.address)
            time.sleep(pause)
        reader.join()
        return arrived

    def _read(self, arrived):
        try:
            while True:
                arrived.append(int(self.far.recv(100)))
        except TimeoutError:
            return

    def close(self):
        self.near.close()
        self.far.close()


def carried(profile, count, seed=1):
    with Network() as network:
        echo = Echo(network, profile, seed)
        try:
            return echo.carry(count), dict(echo.proxy.counters)
        finally:
            echo.close()


def test_without_a_profile_bytes_pass_both_ways_unchanged():
    blob = random.Random(7).randbytes(1 << 20)
    with tcp_pair() as (near, far, _, proxy):
        near.sendall(b"hello")
        assert receive(far, 5) == b"hello"
        far.sendall(b"there")
        assert receive(near, 5) == b"there"
        near.setblocking(False)
        sent, back = 0, b""
        while len(back) < len(blob):
            try:
                sent += near.send(blob[sent : sent + 65536])
            except BlockingIOError:
                pass
            back += far.recv(65536)
        assert back == blob
        assert proxy.counters["bytes_up"] == len(blob) + 5


def test_a_delay_takes_its_time_and_keeps_the_order():
    with tcp_pair(Profile(delay=0.05, jitter=0.04)) as (near, far, _, _proxy):
        sent_at, delays = {}, []
        for number in range(40):
            sent_at[number] = time.monotonic()
            near.sendall(bytes([number]))
            time.sleep(0.002)
        for number in range(40):
            assert receive(far, 1) == bytes([number])
            delays.append(time.monotonic() - sent_at[number])
        assert min(delays) >= 0.01 - 0.002
        assert max(delays) > 0.04


def test_a_cut_holds_everything_and_then_brings_it():
    with tcp_pair() as (near, far, network, proxy):
        near.sendall(b"a")
        receive(far, 1)
        begin = time.monotonic()
        network.apply(proxy, Profile(cut=0.5))
        wait_until(lambda: proxy.is_cut, what="the cut")
        near.sendall(b"b")
        far.sendall(b"c")
        assert receive(far, 1) + receive(near, 1) == b"bc"
        assert time.monotonic() - begin >= 0.5


def test_throttling_takes_bytes_over_rate():
    with tcp_pair(Profile(rate=20_000.0)) as (near, far, _, _proxy):
        begin = time.monotonic()
        near.sendall(bytes(10_000))
        receive(far, 10_000)
        assert time.monotonic() - begin >= 0.5


def test_a_reset_breaks_both_sides_and_a_new_connection_works():
    with socket.create_server(("127.0.0.1", 0)) as server, Network() as network:
        proxy = network.tcp(server.getsockname())
        with socket.create_connection(proxy.address, 5.0) as near, server.accept()[0] as far:
            near.sendall(b"a")
            receive(far, 1)
            network.reset(proxy)
            for end in (near, far):
                end.settimeout(5.0)
                with pytest.raises(ConnectionError):
                    if not end.recv(1):
                        raise ConnectionError
        with socket.create_connection(proxy.address, 5.0) as near, server.accept()[0] as far:
            near.sendall(b"b")
            assert receive(far, 1) == b"b"
        assert proxy.counters["connections"] == 2


def test_a_target_that_is_away_is_a_connection_that_ends():
    with Network() as network:
        with socket.create_server(("127.0.0.1", 0)) as server:
            address = server.getsockname()
        proxy = network.tcp(address)
        with socket.create_connection(proxy.address, 5.0) as near:
            assert near.recv(1) == b""
        assert proxy.counters["refused"] == 1


def test_tcp_refuses_what_tcp_cannot_do():
    with Network() as network:
        proxy = network.tcp(("127.0.0.1", 1))
        for profile in UDP_PROFILES.values():
            assert profile.for_tcp or pytest.raises(ValueError, proxy.apply, profile)
    assert all(profile.for_tcp for profile in TCP_PROFILES.values())


def test_datagrams_pass_in_order_and_answers_find_their_client():
    with Network() as network:
        echo = Echo(network, Profile())
        other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            assert echo.carry(50) == list(range(50))
            for near in (echo.near, other):
                near.settimeout(5.0)
                near.sendto(b"ask", echo.proxy.address)
                data, source = echo.far.recvfrom(100)
                echo.far.sendto(b"answer to %d" % source[1], source)
                assert near.recv(100) == b"answer to %d" % source[1]
        finally:
            other.close()
            echo.close()


@pytest.mark.parametrize("fraction", [0.01, 0.05, 1.0])
def test_losses_are_the_share_and_the_same_for_the_same_seed(fraction):
    arrived, counters = carried(Profile(loss=fraction), 600)
    assert counters["lost"] == 600 - len(arrived)
    assert counters["lost"] == pytest.approx(600 * fraction, abs=12)
    assert carried(Profile(loss=fraction), 600)[0] == arrived
    if fraction < 1.0:
        assert carried(Profile(loss=fraction), 600, seed=2)[0] != arrived


def test_duplicates_come_twice_and_nothing_is_missing():
    arrived, counters = carried(Profile(duplication=0.1), 300)
    assert sorted(set(arrived)) == list(range(300))
    assert len(arrived) == 300 + counters["duplicated"] and counters["duplicated"] > 10


def test_what_is_held_back_arrives_behind_others_and_nothing_is_missing():
    arrived, counters = carried(Profile(reordering=0.1), 200)
    assert sorted(arrived) == list(range(200)) and arrived != sorted(arrived)
    assert counters["held_back"] > 5


def test_a_cut_loses_datagrams():
    arrived, counters = carried(Profile(cut=30.0), 20)
    assert arrived == [] and counters["lost"] == 20


@given(
    st.floats(0.0, 20.0),
    st.tuples(st.floats(0.1, 5.0), st.floats(0.001, 0.1)),
    st.floats(0.0, 2.0),
)
def test_nothing_arrives_before_its_time_nor_in_a_stall_or_a_cut(at, stall, cut):
    profile = Profile(stall=stall, cut=cut)
    released = profile.released(at)
    assert released >= max(at, cut) - 1e-9
    assert released <= max(at + stall[1], cut) + 1e-9
    if released > cut and released >= stall[0] / 2:
        into = (released - stall[0] / 2) % stall[0]
        assert into >= stall[1] - 1e-6 or into < 1e-6


@pytest.mark.parametrize(
    "at, begun",
    [(0.0, None), (2.499, None), (2.5, 2.5), (2.6, 2.5), (2.701, None), (7.4, None), (7.5, 7.5), (12.69, 12.5)],
)
def test_a_stall_knows_when_it_began(at, begun):
    profile = TCP_PROFILES["stall_200ms_5s"]
    assert profile.stalled_since(at) == (begun if begun is None else pytest.approx(begun))
    assert Profile(cut=1.0).stalled_since(at) is None


def test_a_proxy_records_the_stalls_that_held_something_up_and_no_others():
    with tcp_pair() as (near, far, network, proxy):
        assert proxy.until_stall() == math.inf
        near.sendall(b"before")
        assert receive(far, 6) == b"before"
        network.apply(proxy, Profile(stall=(0.6, 0.3)))
        # the first and the second; in the third nothing is sent
        for begun in range(1, 3):
            wait_until(lambda: 0.45 < proxy.until_stall() <= 0.6, what="the beginning of the next stall")
            sent = time.monotonic()
            near.sendall(b"up")
            assert receive(far, 2) == b"up"
            far.sendall(b"down!")
            assert receive(near, 5) == b"down!"
            stall = proxy.stalls[-1]
            assert len(proxy.stalls) == begun and stall.begin <= sent and time.monotonic() >= stall.end
            assert stall.end - stall.begin == pytest.approx(0.3)
            assert stall.up == 1
        wait_until(lambda: time.monotonic() > proxy.stalls[-1].end + 0.6, what="the third stall's end")
        assert len(proxy.stalls) == 2
