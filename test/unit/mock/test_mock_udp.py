"""The mock controller on a real UDP socket, against a small PC that answers in a thread."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time

import pytest
from mock_cell import running

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import CYCLE_NS, radians
from construction_twin.mock.faults import Fault

pytestmark = pytest.mark.realtime


def wait_for(condition, timeout=3.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "condition not met in time"
        time.sleep(0.005)


def test_a_one_second_has_250_packets_on_an_absolute_grid(robot, pc):
    with running(robot, pc.address) as mock:
        wait_for(lambda: len(pc.received) >= 251)
        counters = mock.counters
    times = [entry[0] for entry in pc.received[:251]]
    ipocs = [entry[1].controller_ms for entry in pc.received[:251]]
    assert {b - a for a, b in zip(ipocs, ipocs[1:])} == {4}
    # a busy machine makes packets late, which must not move the grid
    late = [time - k * CYCLE_NS for k, time in enumerate(times)]
    assert counters["skipped"] == 0
    assert min(late[125:]) - min(late[:125]) == pytest.approx(0.0, abs=CYCLE_NS / 2)
    assert counters["foreign"] == counters["send_errors"] == 0


def test_after_an_emergency_stop_a_person_starts_rsi_again(robot, pc):
    with running(robot, pc.address, restart_after=0.05) as mock:
        wait_for(lambda: len(pc.received) >= 20)
        mock.request(lambda: mock.faults.inject(Fault("estop")))
        count = len(pc.received)
        with pytest.raises(ConfigurationError, match="restart.*a released one: inject `estop` with `on` false"):
            mock.request(mock.controller.restart)
        mock.request(lambda: mock.faults.end(Fault("estop")))
        time.sleep(0.3)  # longer than `restart_after`
        assert mock.controller.session == 1 and len(pc.received) <= count + 2
        mock.request(mock.controller.restart)
        wait_for(lambda: len(pc.received) >= count + 20)
        assert mock.controller.session == 2


def test_the_clock_does_not_wait_for_replies_and_stops_after_the_timeout(robot, pc):
    pc.answering = False
    with running(robot, pc.address, timeout=25) as mock:
        wait_for(lambda: not mock.controller.running)
        time.sleep(0.02)
        assert len(pc.received) == 25
        assert [packet.missed for _, packet, _ in pc.received] == list(range(25))
        assert mock.controller.flag and mock.controller.reason.startswith("timeout")


def test_every_session_has_a_port_of_its_own_and_starts_by_itself_when_told(robot, pc):
    pc.answering = False
    with running(robot, pc.address, restart_after=0.02, timeout=5) as mock:
        wait_for(lambda: mock.controller.session == 3)
    ports = {source[1] for _, _, source in pc.received}
    assert len(ports) >= 2
    ipocs = [packet.controller_ms for _, packet, _ in pc.received]
    assert max(b - a for a, b in zip(ipocs, ipocs[1:])) > 400


def test_a_session_that_nobody_answers_is_tried_again_soon_and_one_that_was_answered_after_its_time(robot, pc):
    pc.answering = False
    with running(robot, pc.address, restart_after=3600.0, timeout=5) as mock:
        wait_for(lambda: mock.controller.session == 3)
        pc.answering = True
        wait_for(lambda: mock.controller.counters["replies"] > 20)
        answered = mock.controller.session
        pc.answering = False
        wait_for(lambda: not mock.controller.running)
        time.sleep(0.3)  # longer than the other would take
        assert mock.controller.session == answered


def test_datagrams_from_elsewhere_are_counted_and_ignored(robot, pc):
    with running(robot, pc.address) as mock:
        wait_for(lambda: pc.received)
        port = pc.received[0][2][1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for _ in range(20):
                stranger.sendto(b"garbage", ("127.0.0.1", port))
        wait_for(lambda: mock.foreign == 20)
        pc.socket.sendto(b"garbage", ("127.0.0.1", port))
        wait_for(lambda: mock.counters["malformed"] == 1)
        assert mock.controller.running


def test_after_a_stall_the_grid_is_met_again_without_a_burst(robot, pc):
    stalled = threading.Event()

    def stall(mock):
        if mock.counters["packets"] == 20 and not stalled.is_set():
            stalled.set()
            time.sleep(0.04)

    def late() -> list[int]:
        return [entry[0] - k * CYCLE_NS for k, entry in enumerate(list(pc.received))]

    with running(robot, pc.address, observe=stall) as mock:
        wait_for(lambda: len(pc.received) >= 50)
        # it catches up at twice the pace at most, on a busy machine more slowly
        wait_for(lambda: min(late()[-10:]) - min(late()[:20]) < CYCLE_NS / 2, 20.0)
    ipocs = [packet.controller_ms for _, packet, _ in pc.received]
    assert {b - a for a, b in zip(ipocs, ipocs[1:])} == {4}
    assert mock.overruns >= 9 and mock.skipped == 0
    assert max(late()) - min(late()) >= 30e6


def test_the_command_line_runs_without_ros_and_ends_on_sigterm(robot, pc):
    options = ["--gateway", "{}:{}".format(*pc.address), "--start=10,-90,90,0,45,0"]
    command = [sys.executable, "-m", "construction_twin.mock", *options]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        wait_for(lambda: len(pc.received) > 25, timeout=15.0)
    finally:
        process.terminate()
        _, said = process.communicate(timeout=10)
    assert process.returncode == 0
    assert pc.received[-1][1].setpoint == pytest.approx(radians((10, -90, 90, 0, 45, 0)))
    assert "RSI session 1 started" in said and "'packets'" in said
