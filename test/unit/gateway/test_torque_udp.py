"""Torques over real UDP and a real broker: the mock arm with mass, the gateway as a program, and who hears `torque`."""

from __future__ import annotations

import dataclasses

import pytest
from mock_pc import running
from processes import ROOT, wait_until
from service_cell import client_of, serving

from construction_twin.core.axis_quantities import CURRENT, TORQUE
from construction_twin.mock.motor_current import TORQUE_PER_PERCENT
from construction_twin.mqtt.messages import read_report
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.shared.gateway_config import gateway_config

XML = (ROOT / "config/torque_ethernet.xml").read_text()
PLAIN = (ROOT / "krl/ethernet/ctwin_ethernet.xml").read_text()
ARM = {"servo": "physics", "drives": str(ROOT / "config/kr120_drives.yaml"), "payload": [60.0, 0.0, 0.0, 0.2]}


@pytest.fixture
def robot():
    return read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")


def config_of(robot, xml):
    # patient, because this machine may be busy
    return dataclasses.replace(gateway_config(robot, {"ethernet_xml": xml, "timeout": 2000}), silence=8.0, max_age=20.0)


def test_torques_are_told_with_the_states_and_show_a_lost_load(broker, topics, robot):
    with serving(broker, topics, config_of(robot, XML)) as (_, address), client_of(broker, topics) as client:

        def newest(quantity=TORQUE):
            heard = client.on(topics.told(quantity))
            return read_report(quantity, heard[-1].payload, 6) if heard else None

        with running(robot, address, ethernet_xml=XML, timeout=2000, **ARM) as mock:
            first = wait_until(newest, what="torques")
            # gravity of arm and load, held at rest; nothing is commanded
            assert first.values == pytest.approx(mock.controller.servo.torque, abs=0.1) and first.command_stamp == 0
            assert abs(first.values[1]) > 1000.0
            # the mock's currents are its torques, divided by its own invented constants
            currents = wait_until(lambda: newest(CURRENT), what="currents").values
            wanted = [torque / each for torque, each in zip(first.values, TORQUE_PER_PERCENT.values())]
            assert currents == pytest.approx(wanted, abs=0.01) and abs(currents[1]) > 9.0
            mock.request(lambda: mock.controller.servo.carry(False))
            wait_until(lambda: abs(newest().values[2] - first.values[2]) > 300.0, what="the lost load")
            counters = client.status()["counters"]
            assert "torque_channels_unreadable" not in counters and "current_channels_unreadable" not in counters


def test_a_controller_that_lacks_a_declared_channel_is_answered_and_counted(broker, topics, robot):
    with serving(broker, topics, config_of(robot, XML)) as (_, address), client_of(broker, topics) as client:
        with running(robot, address, ethernet_xml=PLAIN, timeout=2000):
            wait_until(lambda: len(client.on(topics.state)) > 20, what="states")
            wait_until(lambda: client.status()["counters"].get("torque_channels_unreadable", 0) > 20, what="its count")
            assert client.status()["counters"]["current_channels_unreadable"] > 20
        assert not client.on(topics.told(TORQUE)) and not client.on(topics.told(CURRENT))
