"""Tool I/O over real UDP and a real broker: gateway as a program, the mock controller in its own loop, a sender on MQTT."""

from __future__ import annotations

import dataclasses
import threading

import pytest
import yaml
from mock_pc import running
from processes import ROOT, wait_until
from service_cell import client_of, serving

from construction_twin.core.units import CYCLE_NS
from construction_twin.mqtt.fast_client import UserProperties
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, arm_value
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.shared.gateway_config import gateway_config

TOOL = yaml.safe_load((ROOT / "config/tools/vacuum_frame.yaml").read_text())
XML = (ROOT / "krl/ethernet/ctwin_tool_ethernet.xml").read_text()


class Sender(threading.Thread):
    """Repeats one pose every 4 ms."""

    def __init__(self, client, codec, pose):
        super().__init__(daemon=True)
        self._client, self._payload = client, codec.encode(pose)
        self._ended = threading.Event()
        self.stamp, self.seq = 10**18, 0

    def run(self):
        while not self._ended.wait(0.004):
            self.seq += 1
            self.stamp += CYCLE_NS
            beside = UserProperties(CommandProperties("s1", self.seq, self.stamp).pairs())
            self._client.paho.publish(self._client.topics.command, self._payload, properties=beside)

    def close(self):
        self._ended.set()
        self.join(5.0)


@pytest.fixture
def robot():
    return read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")


def test_grip_hold_over_a_restart_of_rsi_and_release(broker, topics, robot):
    # patient, because this machine may be busy
    config = dataclasses.replace(
        gateway_config(robot, {"ethernet_xml": XML, "tool": TOOL, "timeout": 2000}),
        playout_delay=0.1,
        silence=8.0,
        max_age=20.0,
    )
    codec = JointStringCodec.of(robot, config.decimals)
    with (
        serving(broker, topics, config) as (_, address),
        client_of(broker, topics) as client,
    ):
        settings = {"ethernet_xml": XML, "tool": TOOL, "timeout": 2000}
        with running(robot, address, **settings) as mock:

            def tool():
                return client.status().get("tool", {})

            def switch(id, value, sender):
                # the playout trails by what this machine needs: as far ahead as any of it
                content = {"id": id, "output": "vacuum", "value": value, "stamp": sender.stamp + 100 * CYCLE_NS}
                answer = client.control("switch", content)
                assert (answer["verb"], answer["ok"], answer["reason"]) == ("switch", True, "armed")
                wait_until(lambda: {s["id"]: s["state"] for s in tool()["switches"]}.get(id) == "fired", what=id)
                wait_until(lambda: tool()["inputs"] == {"vacuum_reached": value}, what=f"inputs after {id}")

            client.wait_for_status(state="ready")
            assert tool()["known"] and tool()["outputs"] == {"vacuum": False}
            assert client.arm(config)["ok"]
            sender = Sender(client, codec, robot.home)
            sender.start()
            try:
                client.wait_for_status(state="following")
                switch("grip", True, sender)
            finally:
                sender.close()
            assert mock.controller.tool.holds
            # RSI ends and begins anew: what is held stays held, and is read back
            mock.request(mock.controller.restart)
            wait_until(lambda: client.status()["counters"]["rsi_sessions"] == 2, what="another session")
            client.wait_for_status(state="ready")
            assert tool()["known"] and tool()["outputs"] == {"vacuum": True} and mock.controller.tool.holds
            assert client.control("arm", arm_value(config.hash, "run1"), "s2")["ok"]
            answer = client.control("switch", {"id": "late", "output": "vacuum", "value": False, "stamp": 5}, "s2")
            assert not answer["ok"] and "no stream is followed" in answer["reason"]
            assert mock.controller.tool.holds
