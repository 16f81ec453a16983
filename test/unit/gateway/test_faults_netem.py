"""The profiles through the kernel's netem, between two network namespaces; skipped, with the reason, where there is no netem.

The cell's namespace holds gateway and mock controller, the other one broker and commander: the profiles act on MQTT. Loss,
reordering and duplication of datagrams between controller and gateway are made by the impairment proxy (test_faults_rsi).
"""

from __future__ import annotations

import itertools
import socket
import subprocess
import sys
from contextlib import nullcontext

import pytest
from fault_cell import FaultCell
from impairment_profiles import TCP_PROFILES, UDP_PROFILES, Profile
from netem import CELL_PC, ROS_PC, Namespaces, netem_arguments, outages, why_no_namespaces, why_no_netem
from processes import wait_until

STEADY = {"delay_20_10": TCP_PROFILES["delay_20_10"]} | UDP_PROFILES
#: Sends numbered datagrams to the ROS PC at 250 Hz, from inside the cell's namespace.
_SENDER = """
import socket, sys, time
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for number in range(int(sys.argv[3])):
    sock.sendto(b"%d" % number, (sys.argv[1], int(sys.argv[2])))
    time.sleep(0.004)
"""
#: Prints what arrives, in order, until nothing has for a second.
_RECEIVER = """
import socket, sys
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.bind((sys.argv[1], int(sys.argv[2])))
print("ready", flush=True)
sock.settimeout(30.0)
try:
    while True:
        print(int(sock.recv(100)))
        sock.settimeout(1.0)
except TimeoutError:
    pass
"""


@pytest.fixture(scope="module")
def namespaces():
    reason = why_no_namespaces()
    if reason:
        pytest.skip(reason)
    with Namespaces() as spaces:
        yield spaces


def carried(spaces, count=500, port=20000):
    """Return the numbers that arrived on the ROS PC, in order."""
    command = (*spaces.prefix(spaces.ros), sys.executable, "-c", _RECEIVER, ROS_PC, str(port))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as receiver:
        assert receiver.stdout.readline() == "ready\n"
        spaces.inside(spaces.cell, sys.executable, "-c", _SENDER, ROS_PC, str(port), str(count))
        return [int(line) for line in receiver.stdout]


def test_the_two_namespaces_reach_each_other_and_nobody_else_does(namespaces):
    assert carried(namespaces, 20) == list(range(20))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outside, pytest.raises(OSError):
        outside.bind((CELL_PC, 0))


@pytest.mark.parametrize("name", STEADY)
def test_a_profile_through_netem(namespaces, name):
    reason = why_no_netem()
    if reason:
        pytest.skip(f"no netem: {reason}")
    profile = STEADY[name]
    with namespaces.shaped(profile):
        arrived = carried(namespaces)
    assert 500 * (1 - profile.loss) - 30 <= len(set(arrived)) <= 500
    assert bool(profile.loss) == (len(set(arrived)) < 500)
    assert bool(profile.duplication) == (len(arrived) > len(set(arrived)))
    assert bool(profile.reordering or profile.jitter > 0.002) == (sorted(arrived) != arrived)


@pytest.mark.parametrize("name", [None, *TCP_PROFILES, *UDP_PROFILES])
def test_a_motion_between_the_namespaces(namespaces, tmp_path, name):
    if name is not None:
        reason = why_no_netem()
        if reason:
            pytest.skip(f"no netem: {reason}")
    with namespaces.entered(), FaultCell(tmp_path, spaces=namespaces) as cell:
        profile = (TCP_PROFILES | UDP_PROFILES).get(name)
        with namespaces.shaped(profile) if profile else nullcontext():
            cell.move()
            cell.finish()
            cell.wait_until_following()
        cell.assert_within_limits()
        cell.assert_nobody_restarted()
        assert cell.counters()["stops_refused"] == 0, cell.describe()


@pytest.mark.parametrize(
    "profile, words",
    [
        (Profile(delay=0.02, jitter=0.01), "delay 20ms 10ms"),
        (Profile(loss=0.05), "loss 5%"),
        (Profile(duplication=0.05), "duplicate 5%"),
        (Profile(reordering=0.02), "delay 6ms reorder 2%"),
        (Profile(delay=0.02, jitter=0.01, loss=0.01), "delay 20ms 10ms loss 1%"),
        (Profile(rate=80_000.0), "rate 160000bps"),
        (Profile(reordering=0.02, loss=0.01), "delay 6ms loss 1% reorder 2%"),
    ],
)
def test_profiles_as_netem_knows_them(profile, words):
    assert " ".join(netem_arguments(profile)) == f"limit 10000 {words}"


@pytest.mark.parametrize("name", [*TCP_PROFILES, *UDP_PROFILES])
def test_tc_understands_every_profile(namespaces, name):
    try:
        with namespaces.shaped((TCP_PROFILES | UDP_PROFILES)[name]):
            pass
    except subprocess.CalledProcessError as error:
        # the kernel may refuse, which has netem or not; what tc itself does not understand it explains
        assert "What is" not in error.stderr and "Usage" not in error.stderr


@pytest.mark.parametrize(
    "name, expected",
    [
        ("delay_20_10", []),
        ("cut_1s", [(0.0, 1.0)]),
        ("stall_50ms_1s", [(0.5, 0.55), (1.5, 1.55), (2.5, 2.55)]),
        ("stall_200ms_5s", [(2.5, 2.7), (7.5, 7.7), (12.5, 12.7)]),
    ],
)
def test_outages_are_those_of_the_proxy(name, expected):
    profile = TCP_PROFILES[name]
    found = list(itertools.islice(outages(profile), 3))
    assert found == [pytest.approx(times) for times in expected]
    for begin, end in found:
        assert profile.released(begin + 1e-6) == pytest.approx(end)


def test_the_line_goes_dark_for_each_outage_and_is_restored(monkeypatch):
    said: list[str] = []
    spaces = Namespaces()
    monkeypatch.setattr(spaces, "inside", lambda space, *command: said.append(" ".join(command[7:])))
    monkeypatch.setattr("netem.subprocess.run", lambda command, **_: said.append(" ".join(command[4:])))
    with spaces.shaped(Profile(stall=(0.04, 0.02), delay=0.02)):
        wait_until(lambda: said.count("loss 100%") >= 4, 20.0, "two outages")
    plain, clear = "limit 10000 delay 20ms 0ms", "tc qdisc delete dev line root"
    # both ends of the line, one after the other
    assert said[:8] == [plain, plain, *["loss 100%"] * 2, plain, plain, *["loss 100%"] * 2]
    assert said[-2:] == [clear, clear]
