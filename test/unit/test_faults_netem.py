"""The profiles through the kernel's netem, between two network namespaces; skipped, with the reason, where there is no netem."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest
from fault_cell import FaultCell
from impairment_profiles import TCP_PROFILES, UDP_PROFILES, Profile
from netem import CELL_PC, ROS_PC, Namespaces, netem_arguments, why_no_namespaces, why_no_netem

PROFILES = {"delay_20_10": TCP_PROFILES["delay_20_10"]} | UDP_PROFILES
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


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_through_netem(namespaces, name):
    reason = why_no_netem()
    if reason:
        pytest.skip(f"no netem: {reason}")
    profile = PROFILES[name]
    namespaces.apply(profile)
    arrived = carried(namespaces)
    assert 500 * (1 - profile.loss) - 30 <= len(set(arrived)) <= 500
    assert bool(profile.loss) == (len(set(arrived)) < 500)
    assert bool(profile.duplication) == (len(arrived) > len(set(arrived)))
    assert bool(profile.reordering or profile.jitter > 0.002) == (sorted(arrived) != arrived)


@pytest.mark.parametrize("name", [None, "delay_20_10", "loss_1", "loss_5", "reordering", "duplication"])
def test_a_motion_between_the_namespaces(namespaces, tmp_path, name):
    if name is not None:
        reason = why_no_netem()
        if reason:
            pytest.skip(f"no netem: {reason}")
    with namespaces.entered(), FaultCell(tmp_path, spaces=namespaces) as cell:
        if name is not None:
            namespaces.apply(PROFILES[name])
        cell.move()
        cell.finish()
        cell.wait_until_following()
        cell.assert_within_limits()
        cell.assert_nobody_restarted()
        assert cell.counter("stops_refused") == 0, cell.describe()


@pytest.mark.parametrize(
    "profile, words",
    [
        (Profile(delay=0.02, jitter=0.01), "delay 20ms 10ms"),
        (Profile(loss=0.05), "loss 5%"),
        (Profile(duplication=0.05), "duplicate 5%"),
        (Profile(reordering=0.02), "delay 6ms reorder 2%"),
        (Profile(delay=0.02, jitter=0.01, loss=0.01), "delay 20ms 10ms loss 1%"),
    ],
)
def test_profiles_as_netem_knows_them(profile, words):
    assert " ".join(netem_arguments(profile)) == f"limit 10000 {words}"


@pytest.mark.parametrize("name", ["stall_50ms_1s", "cut_1s", "throttled"])
def test_what_is_no_steady_state_is_refused(name):
    with pytest.raises(ValueError, match="netem has no"):
        netem_arguments(TCP_PROFILES[name])
