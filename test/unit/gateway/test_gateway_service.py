"""The gateway between a real broker and a real UDP socket, without ROS."""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import math
import socket
import threading
import time

import pytest
from processes import wait_until
from service_cell import (
    CODEC,
    CONFIG,
    PATIENT,
    RUN,
    START,
    assert_still,
    cell,
    client_of,
    controller_of,
    motion,
    serving,
    stream,
)

from construction_twin.gateway.states import State
from construction_twin.link.gateway_status import parse_answer, parse_status
from construction_twin.link.supervisor import LinkSupervisor
from construction_twin.mqtt.fast_client import received_pairs
from construction_twin.mqtt.messages import Control, arm_value, read_state_properties

pytestmark = pytest.mark.realtime


def test_an_armed_gateway_carries_out_the_stream_and_reports_states(broker, topics):
    with cell(broker, topics, config=PATIENT) as (service, controller, client):
        answer = client.arm(PATIENT)
        assert (answer["ok"], answer["verb"], answer["session"]) == (True, "arm", "s1")
        assert client.status()["state"] == "armed"
        stream(client, controller, (motion(k) for k in range(200)))
        last = CODEC.quantise(motion(199))
        stream(client, controller, [last] * 30)
        wait_until(
            lambda: controller.measured == pytest.approx(last, abs=math.radians(1e-6)), what="the end of the motion"
        )
        assert_still(controller)
        assert service.gateway.counters["commands_lost"] == 0
        states = [
            message
            for message in client.on(topics.state)
            if read_state_properties(received_pairs(message)).command_stamp
        ]
        assert CODEC.decode(states[-1].payload) == pytest.approx(last, abs=math.radians(0.0006))
        properties = [read_state_properties(received_pairs(message)) for message in states]
        assert all(later.seq > earlier.seq for earlier, later in itertools.pairwise(properties))
        assert 10**18 < properties[-1].command_stamp <= client.stamp


def test_the_state_after_a_verb_is_told_before_its_answer(broker, topics):
    with cell(broker, topics) as (service, controller, client):
        client.arm()
        order = [message.topic for message in client.messages if message.topic in (topics.status, topics.control_ack)]
        payloads = [json.loads(message.payload) for message in client.on(topics.status)]
        before = order[: order.index(topics.control_ack)]
        assert payloads[len(before) - 1]["state"] == "armed"


@pytest.mark.parametrize("name", ["command", "control"])
def test_messages_retained_before_the_gateway_came_are_refused(broker, topics, name):
    topic = getattr(topics, name)
    with client_of(broker, topics) as client:
        payload = Control("old", "s1", "stop").to_json() if name == "control" else CODEC.encode(START)
        client.paho.publish(topic, payload, qos=1, retain=True).wait_for_publish(5.0)
        with serving(broker, topics):
            client.wait_for_counter("refused_retained", 1)
            assert client.status()["last_refusal"].startswith(f"retained: a message on {name} with the retain flag")
        assert not client.on(topics.control_ack)


def test_a_retained_message_is_refused_when_it_comes_live_too(broker, topics):
    with cell(broker, topics) as (service, controller, client):
        arm = Control("live", "s1", "arm", arm_value(CONFIG.hash, RUN))
        client.paho.publish(topics.control, arm.to_json(), qos=1, retain=True)
        client.wait_for_counter("refused_retained", 1)
        assert client.status()["last_refusal"].startswith("retained: a message on control")
        assert service.gateway.status()["state"] == "ready"
        client.paho.publish(topics.control, b"", qos=1, retain=True)


def test_when_the_broker_dies_the_arm_brakes_replies_go_on_and_the_gateway_comes_back(broker_process, topics):
    with cell(broker_process.port, topics) as (service, controller, client):
        client.arm()
        stream(client, controller, (motion(k) for k in range(100)))
        broker_process.kill()
        wait_until(lambda: service.gateway.status()["state"] == "holding", what="holding")
        assert_still(controller)
        client.messages.clear()
        broker_process.start()
        client.wait_for_status(state="holding")
        assert controller.missed == 0
        assert client.control("reset")["ok"]


class Proxy:
    """Carries bytes between clients and a broker, and none while `passes` is cleared: a line that is cut, and comes back."""

    def __init__(self, port):
        self.passes = threading.Event()
        self.passes.set()
        self._broker, self._listener = port, socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            near, far = self._listener.accept()[0], socket.create_connection(("127.0.0.1", self._broker))
            for ends in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=ends, daemon=True).start()

    def _carry(self, source, sink):
        sink.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self.passes.wait()
                sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)
        source.close()


def test_a_connection_that_is_silent_for_a_second_while_the_arm_rests_is_followed_again_by_itself(broker, topics):
    """Law 5: the link has returned within `start_tolerance`."""
    proxy, ids = Proxy(broker), itertools.count(1)
    supervisor = LinkSupervisor(CONFIG, lambda: f"s{next(ids)}")
    readers = {
        topics.state: lambda payload, now: supervisor.inputs.on_pose(CODEC.decode(payload), now),
        topics.status: lambda payload, now: supervisor.inputs.on_status(parse_status(payload), now),
        topics.control_ack: lambda payload, now: supervisor.on_answer(parse_answer(payload), now),
    }
    with serving(proxy.port, topics) as (service, address), controller_of(address) as controller:
        with client_of(broker, topics) as client:
            controller.start()
            supervisor.inputs.on_connection(True)
            read = 0

            def run_until(condition, what):
                def turn():
                    nonlocal read
                    now = time.monotonic_ns()
                    for message in client.messages[read:]:
                        read += 1
                        if message.topic in readers:
                            readers[message.topic](message.payload, now)
                    if control := supervisor.poll(now):
                        client.paho.publish(topics.control, control.to_json(), qos=1)
                    client.session, client.stamp = supervisor.on_command(START, now), time.time_ns()
                    if client.session:
                        client.command(START)
                    return condition()

                wait_until(turn, what=what)

            state = service.gateway
            run_until(lambda: state.state is State.FOLLOWING, "a stream that is followed")
            before, cut, stops = supervisor.session, time.monotonic(), state.counters["stops_silence"]
            proxy.passes.clear()
            run_until(lambda: time.monotonic() > cut + 1.0, "the end of the cut")
            assert state.state is State.HOLDING and state.counters["stops_silence"] > stops
            proxy.passes.set()
            run_until(lambda: state.state is State.FOLLOWING and supervisor.session != before, "another session")
            assert not state.fault and supervisor.halts == supervisor.requests == 0 and controller.measured == START


def test_a_broker_that_ends_together_with_the_gateway_is_no_error(broker_process, topics, caplog):
    caplog.set_level(logging.INFO, "rsi_gateway")
    with cell(broker_process.port, topics) as (service, controller, client):
        client.arm()
        stream(client, controller, (motion(k) for k in range(100)))
        # it brakes first, and finds meanwhile that the broker is gone
        service.stop()
        broker_process.kill()
    assert [record.message for record in caplog.records if record.levelno >= logging.WARNING] == []
