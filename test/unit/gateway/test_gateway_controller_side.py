"""The gateway's service and program with an Ethernet XML: names and port from the file, modes, the last Stop, hostile telegrams."""

from __future__ import annotations

import dataclasses
import re
import socket
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from processes import ROOT, wait_until
from rsi_mutations import mutate
from service_cell import AXES, CONFIG, START, client_of, controller_of, free_port, serving

from construction_twin.core.errors import TelegramError
from construction_twin.gateway.states import State
from construction_twin.rsi.controller_codec import SensorDecoder
from construction_twin.rsi.ethernet_xml import load_ethernet_xml
from construction_twin.rsi.gateway_codec import RobotDecoder
from construction_twin.rsi.layout import RsiLayout

PLAIN = RsiLayout.plain(AXES)
NAMED = dataclasses.replace(
    PLAIN,
    sentype="Twin",
    receive=("Stop", "AKorr.A2", "AKorr.A1"),
    holdon=(False, True, True),
    send=("ASPos", "AIPos", "Delay"),
)
READ_ONLY = dataclasses.replace(PLAIN, onlysend=True, receive=(), holdon=())


def with_layout(layout, **changes):
    return dataclasses.replace(CONFIG, layout=layout, **changes)


def exchange(controller, decoder):
    """Run a cycle and return the reply, as a controller with this layout reads it."""
    controller.ipoc += 4
    controller.send()
    reply = decoder.parse(controller.socket.recv(65535))
    assert reply.controller_ms == controller.ipoc
    return reply


def test_replies_have_the_names_and_the_sentype_of_the_file(topics):
    decoder = SensorDecoder("Twin", AXES, NAMED.receive)
    with serving(free_port(), topics, with_layout(NAMED)) as (_, address), controller_of(address) as controller:
        assert [exchange(controller, decoder) for _ in range(3)][-1].stop is False


def test_a_gateway_that_ends_tells_the_controller_once_the_arm_is_at_rest(topics):
    decoder = SensorDecoder("Twin", AXES, NAMED.receive)
    with serving(free_port(), topics, with_layout(NAMED)) as (service, address), controller_of(address) as controller:
        for _ in range(3):
            exchange(controller, decoder)
        service.stop()
        wait_until(lambda: exchange(controller, decoder).stop, what="Stop 1")


def test_read_only_publishes_states_and_answers_nothing(broker, topics):
    with serving(broker, topics, with_layout(READ_ONLY)) as (service, address), controller_of(address) as controller:
        with client_of(broker, topics) as client:
            client.wait_for_status(state="no_controller", mode="read_only")
            controller.socket.settimeout(0.05)
            for _ in range(5):
                controller.cycle()
            assert controller.replies == [None] * 5
            client.wait_for_status(state="read_only")
            assert client.on(topics.state)
            answer = client.arm(service.gateway.config)
            assert not answer["ok"] and "ONLYSEND TRUE" in answer["reason"]


def test_commissioning_is_in_the_status(broker, topics):
    with serving(broker, topics, commissioning=True) as (_, address), controller_of(address) as controller:
        with client_of(broker, topics) as client:
            for _ in range(3):
                controller.cycle()
            client.wait_for_status(state="ready", mode="commissioning")
            assert "commissioning" in client.status()["reason"]
            assert client.arm()["reason"].startswith("armed; commissioning")


def test_every_hostile_telegram_is_counted_and_none_disturbs_the_session(topics):
    with serving(free_port(), topics) as (service, address), controller_of(address) as controller:
        controller.cycle()
        counters, decoder = service.gateway.counters, RobotDecoder(AXES)
        sent = 0
        for seed in range(1500):
            data = mutate(controller.telegram(), seed)
            if len(data) > 60_000 or is_telegram(decoder, data):
                continue  # what can be read is no garbage: a controller's own telegram, changed
            controller.send(data)
            sent += 1
            if sent % 25 == 0 or len(data) > 4000:
                # a reply proves that everything before it was read: the socket's buffer is not for us to overflow
                controller.cycle()
        controller.cycle()
        refused = sum(count for name, count in counters.items() if name.startswith("telegram_refused_"))
        assert sent > 500 and refused == sent
        assert set(controller.replies) == {(0.0, 0.0)}
        assert (counters["rsi_sessions"], controller.measured) == (1, START)


@pytest.mark.parametrize(
    "change, why",
    [
        ((b'A2="-', b'A9="-'), "attribute: AIPos has no A2"),
        ((b'A1="5', b'A1="inf5'), "number: AIPos A1 is 'inf5"),
        ((b"</Rob>", b""), "xml: telegram is not well-formed"),
        ((b"<IPOC>", b"<IPOC>x"), "ipoc: IPOC is 'x"),
        ((b"<Rob", b"<!-- --><Rob"), "markup: telegram holds a declaration"),
    ],
)
def test_while_no_telegram_can_be_read_the_reason_says_why_and_how_many(broker, topics, change, why):
    with serving(broker, topics) as (_, address), controller_of(address) as controller:
        with client_of(broker, topics) as client:
            client.wait_for_status(state="no_controller", reason="no telegram yet")
            for _ in range(30):
                controller.send(controller.telegram().replace(*change))
            client.wait_for_counter(f"telegram_refused_{why.partition(':')[0]}", 30)

            def said():
                # counted once a second: the last ones are told with the next datagram that cannot be read
                words = r"no telegram yet; datagrams refused: \d+, the last one for (.*)"
                found = re.match(words, client.status()["reason"])
                return found and found[1]

            controller.send(controller.telegram().replace(*change))
            assert wait_until(said, what="the reason").startswith(why)
            assert client.status()["state"] == "no_controller"
            controller.cycle()
            client.wait_for_status(state="ready")


def test_telegrams_as_a_python_sender_writes_them_make_a_session(broker, topics):
    with serving(broker, topics) as (service, address), controller_of(address) as controller:
        for k in range(20):
            controller.ipoc += 4
            root = ElementTree.fromstring(controller.telegram())
            for element in root.findall("AIPos") + root.findall("ASPos"):
                for name, value in element.attrib.items():
                    element.set(name, f"{float(value):.12e}" if k % 2 else repr(float(value)))
            controller.send(ElementTree.tostring(root, encoding="utf8"))
            assert controller.receive() == (0.0, 0.0)
        counters = service.gateway.counters
        assert (counters["telegrams"], counters["rsi_sessions"]) == (20, 1)
        assert not [name for name in counters if name.startswith("telegram_refused_")]
        assert service.gateway.state is State.READY


def is_telegram(decoder, data) -> bool:
    try:
        decoder.parse(data)
    except TelegramError:
        return False
    return True


def test_telegrams_from_any_but_the_configured_address_are_not_even_parsed(topics):
    with (
        serving(free_port(), topics, controller="127.0.0.1") as (service, address),
        controller_of(address) as controller,
    ):
        controller.cycle()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.2", 0))
            for data in (controller.telegram(), b"garbage", b""):
                stranger.sendto(data, address)
            wait_until(lambda: service.gateway.counters["telegram_refused_address"] == 3)
        controller.cycle()
        assert controller.replies == [(0.0, 0.0)] * 2
        refused = [name for name in service.gateway.counters if name.startswith("telegram_refused_")]
        assert refused == ["telegram_refused_address"]


# -- the program -------------------------------------------------------------------------------------------------------


def run(tmp_path, config, *arguments):
    path = tmp_path / "arm.json"
    path.write_text(config.to_json())
    command = [sys.executable, "-m", "construction_twin.gateway", "--config", str(path), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0)


@pytest.fixture
def ethernet_file(tmp_path):
    """The shipped file, cut down to the two axes of these tests; returns its path and a function to change it."""
    text = (ROOT / "krl" / "ethernet" / "ctwin_ethernet.xml").read_text()
    lines = [line for line in text.splitlines() if not any(f'"AK.A{i}"' in line for i in (3, 4, 5, 6))]
    path = tmp_path / "eth.xml"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(
    "change, said",
    [
        (("ImFree", "KROSHU"), ("sentype", "'KROSHU'", "ImFree as in the configuration", "export it again")),
        (("49152", "49153"), ("port", "49153", "49152 as in the configuration")),
        (('HOLDON="1"', 'HOLDON="0"'), ("holdon", "(False, True, True) as in the configuration")),
        (("DEF_ASPos", "DEF_MACur"), ("send", "'ASPos'")),
    ],
)
def test_a_file_on_the_controller_that_differs_from_the_configuration_is_found_at_the_desk(
    tmp_path, ethernet_file, change, said
):
    config = with_layout(load_ethernet_xml(ethernet_file).layout)
    ethernet_file.write_text(ethernet_file.read_text().replace(*change))
    result = run(tmp_path, config, "--ethernet-xml", str(ethernet_file))
    assert result.returncode == 2
    assert len(result.stderr.strip().splitlines()) == 1 and "Traceback" not in result.stderr
    for words in ("eth.xml", *said):
        assert words in result.stderr


def test_the_port_is_the_files_unless_another_one_is_given(tmp_path, ethernet_file):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        layout = dataclasses.replace(load_ethernet_xml(ethernet_file).layout, port=port)
        result = run(tmp_path, with_layout(layout))
    assert f"cannot listen for RSI on UDP 127.0.0.1:{port}" in result.stderr
