"""The gateway's UDP socket: real telegrams on loopback, with and without a broker, and no ROS."""

from __future__ import annotations

import errno
import socket
import threading

import pytest
from mock_cell import SWING, gateway_config, mock_at, swing
from processes import free_port, wait_until
from service_cell import (
    START,
    client_of,
    controller_of,
    serving,
    stream,
)

from construction_twin.core.network import bind
from construction_twin.core.units import CYCLE
from construction_twin.gateway.states import State
from construction_twin.mock.faults import Fault
from construction_twin.mqtt.fast_client import FastClient
from construction_twin.mqtt.joint_string import JointStringCodec

pytestmark = pytest.mark.realtime


def test_every_telegram_is_answered_without_any_broker(topics):
    with serving(free_port(), topics) as (service, address), controller_of(address) as controller:
        for _ in range(300):
            controller.cycle()
        assert controller.replies == [(0.0, 0.0)] * 300
        assert service.gateway.counters["telegrams"] == 300
        # the last one is counted behind its reply
        wait_until(lambda: sum(service.controller.reply_time.counts) == 300)
    # generous, for a busy machine: half of them far quicker than a cycle
    assert service.controller.reply_time.percentile(0.5) < 2000


def test_a_broker_that_accepts_and_then_says_nothing_delays_no_reply(topics):
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        with serving(deaf.getsockname()[1], topics) as (service, address), controller_of(address) as controller:
            connection, _ = deaf.accept()
            with connection:
                for _ in range(200):
                    controller.cycle()
            assert controller.missed == 0
        assert service.controller.reply_time.percentile(0.5) < 2000


@pytest.mark.parametrize("lost", [1, 5])
@pytest.mark.parametrize("fault", ["drop", "duplicate"])
def test_whatever_replies_are_lost_or_doubled_what_the_controller_takes_is_inside_the_limits(
    broker, topics, fault, lost
):
    """Law 5, over real UDP, in motion: one reply, or five in a row."""
    config, sock = gateway_config(timeout=4.0), bind("127.0.0.1", 0)
    counter = {"drop": "dropped", "duplicate": "duplicates"}[fault]

    def commands(mock):
        for k in range(SWING + 100):
            # again where a busy machine's reply came beside it
            if SWING // 2 <= k < SWING and k % 20 == 0 and not mock.counters[counter]:
                struck = Fault(fault, values=(1.0,), direction="to_controller", duration=(lost + 1) * CYCLE)
                mock.request(lambda: mock.faults.inject(struck))
            yield swing(k)

    with (
        mock_at(sock.getsockname(), timeout=1000) as (mock, cycles),
        serving(broker, topics, config=config, sock=sock) as (service, _),
        client_of(broker, topics) as client,
    ):
        client.codec = JointStringCodec.of_config(config)
        client.wait_for_status(state="ready")
        assert client.arm(config)["ok"]
        stream(client, cycles, commands(mock))
        goal = swing(SWING)[0]
        wait_until(lambda: abs(mock.controller.measured[0] - goal) < 1e-6, what="the arm at its goal")
        assert service.gateway.state is State.FOLLOWING and not service.gateway.fault, "nobody needs to reset anything"
        counters = service.gateway.counters
    if fault == "drop":
        assert mock.counters["dropped"] >= 1 and max(cycle.missed for cycle in cycles.replies) >= lost
        assert counters["standstills"] >= 1 and counters["delay_irregular"] == counters["stops_replies"] == 0
    else:
        assert mock.counters["duplicates"] >= 1
    # the strings' rounding, and the same again of the replies
    allowance = [2 * each for each in config.limits.allowances(config.decimals, CYCLE)]
    for axis, (velocity, acceleration) in enumerate(zip(config.velocity, config.acceleration)):
        taken = [cycle.correction[axis] for cycle in cycles.replies]
        before = 0.0
        for place, (last, cycle) in zip(taken, zip([0.0, *taken], cycles.replies)):
            # HOLDON stops the arm dead where no reply was taken; what comes next begins at rest
            step = place - last
            assert abs(step) <= (velocity + allowance[axis] * CYCLE / 2) * CYCLE * (1 + 1e-6)
            assert cycle.missed or abs(step - before) <= (acceleration + allowance[axis]) * CYCLE**2 * (1 + 1e-6)
            before = step


class WindowsSocket:
    """A UDP socket as Windows has it: without recvmsg."""

    def __init__(self, sock):
        self._sock = sock
        self.fileno, self.recvfrom, self.sendto = sock.fileno, sock.recvfrom, sock.sendto
        self.getsockname, self.close = sock.getsockname, sock.close


def test_a_reply_leaves_before_anything_is_read_or_said_on_mqtt(broker, topics, monkeypatch):
    sock, order, busy, go_on = WindowsSocket(bind("127.0.0.1", 0)), [], threading.Event(), threading.Event()
    reply, say = sock.sendto, FastClient.send_stream
    sock.sendto = lambda *given: order.append("reply") or reply(*given)
    with serving(broker, topics, sock=sock) as (service, address), controller_of(address) as controller:
        with client_of(broker, topics) as client:
            controller.cycle()
            client.wait_for_status(state="ready")

            def say_late(*given):
                order.append("state")
                busy.set()
                go_on.wait(10.0)
                say(*given)

            monkeypatch.setattr(FastClient, "send_stream", say_late)
            service.gateway.on_command = lambda *_: order.append("command")
            controller.cycle()
            assert busy.wait(10.0)
            # now a command and a telegram wait
            client.command(START)
            wait_until(lambda: client.on(topics.command))
            controller.ipoc += 4
            controller.send()
            go_on.set()
            wait_until(lambda: "command" in order)
            assert order[-5:] == ["reply", "state", "reply", "state", "command"]


def test_a_reply_that_the_system_does_not_send_is_counted(topics):
    def refuse(*_):
        raise OSError(errno.EPERM, "a firewall")

    sock = WindowsSocket(bind("127.0.0.1", 0))
    sock.sendto = refuse
    with serving(free_port(), topics, sock=sock) as (service, address), controller_of(address) as controller:
        controller.send()
        wait_until(lambda: service.gateway.counters[f"udp_send_{errno.EPERM}"] == 1)
        assert service.failure == ""
