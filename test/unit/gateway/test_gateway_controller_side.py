"""The gateway's service and program with an Ethernet XML: names and port from the file, modes, the last Stop, hostile telegrams."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import pytest
from processes import ROOT, free_port, wait_until
from service_cell import AXES, CONFIG, controller_of, serving

from construction_twin.rsi.controller_codec import SensorDecoder
from construction_twin.rsi.ethernet_xml import load_ethernet_xml
from construction_twin.rsi.layout import RsiLayout

PLAIN = RsiLayout.plain(AXES)
NAMED = dataclasses.replace(
    PLAIN,
    sentype="Twin",
    receive=("Stop", "AKorr.A2", "AKorr.A1"),
    holdon=(False, True, True),
    send=("ASPos", "AIPos", "Delay"),
)


def with_layout(layout, **changes):
    return dataclasses.replace(CONFIG, layout=layout, **changes)


def exchange(controller, decoder):
    """Run a cycle and return the reply, as a controller with this layout reads it."""
    controller.ipoc += 4
    controller.send()
    reply = decoder.parse(controller.socket.recv(65535))
    assert reply.controller_ms == controller.ipoc
    return reply


def test_a_gateway_that_ends_tells_the_controller_once_the_arm_is_at_rest(topics):
    decoder = SensorDecoder("Twin", AXES, NAMED.receive)
    with serving(free_port(), topics, with_layout(NAMED)) as (service, address), controller_of(address) as controller:
        for _ in range(3):
            exchange(controller, decoder)
        service.stop()
        wait_until(lambda: exchange(controller, decoder).stop, what="Stop 1")


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
