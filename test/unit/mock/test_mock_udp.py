"""The mock controller on a real UDP socket, against a small PC that answers in a thread."""

from __future__ import annotations

import dataclasses
import socket
import subprocess
import sys
import threading
import time

import pytest
from mock_pc import running
from sentence_checks import expects, says

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.units import CYCLE_NS, radians
from construction_twin.mock.faults import Fault
from construction_twin.mock.program import (
    MockRsi,
    MockSettings,
    build_controller,
    checked_settings,
    joint_angles,
    make_forward_kinematics,
)
from construction_twin.mock.servo import RealisticServo

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
ZERO = (0.0,) * 6


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


def test_says_when_a_packet_left_not_when_somebody_asks(robot, pc):
    left = {}
    with running(robot, pc.address, observe=lambda mock: left.update({mock.controller.stamp: mock.left})):
        wait_for(lambda: len(pc.received) >= 50)
    received = {packet.controller_ms: at for at, packet, _ in pc.received}
    known = sorted(received.keys() & left.keys())
    assert len(known) >= 49
    # nobody can have reacted before
    assert all(left[ipoc] < received[ipoc] for ipoc in known)


def test_packets_can_be_doubled_dropped_and_delayed_on_purpose(robot, pc):
    with running(robot, pc.address) as mock:
        wait_for(lambda: len(pc.received) >= 20)
        mock.request(lambda: mock.faults.inject(Fault("duplicate", values=(1.0,), direction="to_pc")))
        wait_for(lambda: mock.counters["doubled"] >= 20)
        mock.request(lambda: mock.faults.end(Fault("duplicate", direction="to_pc")))
        # the second reply to a doubled packet
        wait_for(lambda: mock.counters["duplicates"] >= 5)
        mock.request(lambda: mock.faults.inject(Fault("drop", values=(0.5,), direction="to_controller", duration=0.4)))
        wait_for(lambda: mock.counters["dropped"] >= 10)
        assert mock.counters["missed"] >= 9
        wait_for(lambda: not mock.faults.active)
        mock.request(lambda: mock.faults.inject(Fault("delay", values=(0.006,), direction="to_controller")))
        # later than a cycle: each comes when the next packet is out
        wait_for(lambda: mock.counters["late_replies"] >= 20)
    ipocs = [entry[1].controller_ms for entry in pc.received]
    assert len(ipocs) > len(set(ipocs))


def test_after_an_emergency_stop_a_person_starts_rsi_again(robot, pc):
    with running(robot, pc.address, restart_after=0.05) as mock:
        wait_for(lambda: len(pc.received) >= 20)
        mock.request(lambda: mock.faults.inject(Fault("estop")))
        count = len(pc.received)
        with pytest.raises(ConfigurationError, check=expects("expected.released", "restart")):
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


def test_i_a_requested_restart_takes_another_pose(robot, pc):
    pose = radians((10, -80, 70, 5, 60, -20))
    with running(robot, pc.address) as mock:
        wait_for(lambda: len(pc.received) > 10)
        mock.request(lambda: mock.controller.restart(pose))
        wait_for(lambda: pc.received[-1][1].setpoint == pytest.approx(pose, abs=1e-8))
        assert pc.received[-1][1].measured == pytest.approx(pose, abs=1e-8)


def test_a_refused_request_is_raised_where_it_was_made(robot, pc):
    with running(robot, pc.address) as mock:
        with pytest.raises(ConfigurationError, match="A9"):
            mock.request(lambda: mock.faults.inject(Fault("stall", "A9")))


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


def test_nobody_listening_is_no_error(robot):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
        closed.bind(("127.0.0.1", 0))
        address = closed.getsockname()
    with running(robot, address, timeout=20) as mock:
        wait_for(lambda: not mock.controller.running)
    assert mock.counters["packets"] == 20


def test_late_packets_are_all_sent_and_only_a_long_stall_gives_up_grid_points(robot):
    mock = MockRsi(build_controller(MockSettings(gateway_host="127.0.0.1", gateway_port=9), robot), ("127.0.0.1", 9))
    for late_ms, grid_points in ((0, 1), (1.9, 1), (2.1, 1), (100, 1), (101, 26)):
        assert mock.next_due(0, round(late_ms * 1e6)) == grid_points * CYCLE_NS
    assert (mock.overruns, mock.skipped) == (3, 25)


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


def test_an_unknown_gateway_host_is_a_transport_error(robot):
    controller = build_controller(MockSettings(gateway_host="a", gateway_port=9), robot)
    with pytest.raises(ConstructionTwinError, check=says("view.no_host", host="'no-such-host.invalid'", port=9)):
        MockRsi(controller, ("no-such-host.invalid", 9))


def test_forward_kinematics_holds_the_facts_sheets_vector(robot):
    position, abc = make_forward_kinematics(robot)(radians((30, -80, 100, 20, 60, -45)))
    assert [1e3 * value for value in position] == pytest.approx((1281.521, -813.421, 1225.799), abs=1e-3)
    assert tuple(abc) == pytest.approx(radians((114.8444, 19.2695, -172.4208)), abs=2e-6)


def test_axes_are_the_joints_turned_and_shifted(robot):
    first = dataclasses.replace(robot.axes[0], sign=-1, offset=0.1)
    lower, upper = (-1.0, *robot.lower[1:]), (2.0, *robot.upper[1:])
    turned = dataclasses.replace(robot, axes=(first, *robot.axes[1:]), lower=lower, upper=upper)
    config = build_controller(MockSettings(gateway_host="a", gateway_port=9), turned).config
    assert (config.lower[0], config.upper[0]) == pytest.approx((-1.9, 1.1))
    assert joint_angles(turned, config.start_pose) == pytest.approx(robot.home)


def test_settings_choose_servo_and_start_pose(robot):
    settings = MockSettings(
        gateway_host="a",
        gateway_port=9,
        servo="realistic",
        start_pose_deg=[0, -90, 90, 0, 45, 0],
    )
    controller = build_controller(settings, robot)
    assert isinstance(controller.servo, RealisticServo)
    assert controller.start_pose == radians((0, -90, 90, 0, 45, 0))


@pytest.mark.parametrize(
    "options", [{"gateway": "127.0.0.1"}, {"gateway": "a:70000"}, {"gateway": "a:1", "timeout": 0}]
)
def test_settings_without_meaning_are_refused(options):
    with pytest.raises(ConfigurationError):
        checked_settings(dict(options))


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


def test_the_command_line_explains_itself_and_its_mistakes():
    command = [sys.executable, "-m", "construction_twin.mock"]
    assert "--restart-after" in subprocess.run([*command, "--help"], capture_output=True, text=True, check=True).stdout
    wrong = subprocess.run([*command, "--robot-config", "missing.yaml"], capture_output=True, text=True)
    assert wrong.returncode == 2
    assert "missing.yaml" in wrong.stderr and "Traceback" not in wrong.stderr


def test_strangers_that_send_more_than_is_read_at_a_time_keep_no_reply_from_being_read(robot, pc):
    """75 to 150 datagrams a cycle: if 64 were read at its end, replies would wait behind more and more of them."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger, running(robot, pc.address) as mock:
        wait_for(lambda: mock.counters["replies"] >= 10)
        port, before = pc.received[-1][2][1], mock.counters
        for _ in range(100):
            seen = len(pc.received)
            for _ in range(150):
                stranger.sendto(b"?", ("127.0.0.1", port))
            wait_for(lambda seen=seen: len(pc.received) > seen)
        after = mock.counters
    assert after["foreign"] - before["foreign"] > 100 * 64
    # one or the other may be late on a busy machine
    assert after["replies"] - before["replies"] > 0.8 * (after["packets"] - before["packets"])
