"""RIst: read where the Ethernet XML declares it, as the simulators of other drivers write it, into the gateway's status."""

from __future__ import annotations

import dataclasses
import math

import pytest
from gateway_cell import CONFIG, RUN, START

from construction_twin.controller.telegram import Telegram
from construction_twin.gateway.gateway import Gateway
from construction_twin.rsi.controller_codec import RobotEncoder
from construction_twin.rsi.gateway_codec import read_tool_pose

POSE = (1.35, -0.02, 1.569, math.pi, -0.3, 3.0)
#: As of kuka_rsi_simulator: its attribute's name, blanks, apostrophes.
FOREIGN = (
    b"<Rob TYPE='KUKA'>\n <RIst  X='1350.0' Y = '-20.0' Z='1569.0' A='180.0' B='-17.188734' C='1.71887339e2' />"
    b"<RSol X='0.0' Y='0.0' Z='0.0' A='0.0' B='0.0' C='0.0'/><IPOC>1000</IPOC></Rob>"
)


def test_it_is_read_in_m_and_rad_whatever_stands_around_it():
    assert read_tool_pose(FOREIGN) == pytest.approx(POSE, abs=1e-7)
    ours = RobotEncoder(("A1",), 6).encode(1000, (0.0,), (0.0,), POSE, (0.0,) * 6, 0)
    assert read_tool_pose(ours) == pytest.approx(POSE, abs=1e-8)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        FOREIGN.replace(b"RIst", b"RIs"),
        FOREIGN.replace(b"Z='1569.0'", b""),
        FOREIGN.replace(b"1569.0", b"nan"),
        FOREIGN.replace(b"1569.0", b"0x1"),
        FOREIGN.replace(b"<RSol", b"<RIst"),
    ],
)
def test_where_it_is_not_clear_there_is_none(data):
    assert read_tool_pose(data) is None


def status_after(send) -> dict:
    config = dataclasses.replace(CONFIG, layout=dataclasses.replace(CONFIG.layout, send=send))
    gateway = Gateway(config, RUN)
    gateway.controller.datagram = RobotEncoder(CONFIG.axes, 6, send).encode(1000, START, START, POSE, (0.0,) * 6, 0)
    assert gateway.on_telegram(Telegram(1000, START, START, 0), "controller", 0) is not None
    return gateway.status()


def test_the_status_has_it_beside_the_axes_of_the_same_telegram():
    found = status_after(("RIst", "AIPos", "ASPos", "Delay"))["tool_pose"]
    assert found["axes"] == pytest.approx(START) and found["position"] == pytest.approx(POSE[:3])
    assert found["abc"] == pytest.approx(POSE[3:])


def test_a_layout_without_it_sends_none():
    assert "tool_pose" not in status_after(("AIPos", "ASPos", "Delay"))
