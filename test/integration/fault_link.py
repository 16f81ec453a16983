#!/usr/bin/env python3
"""The MQTT broker is killed and started again, or cannot be reached for 5 s, in mid-motion and at rest.

Nobody starts a node again: bridge and gateway find back by themselves, and say what happened.
"""

import sys
from pathlib import Path

import rospy
import rostest
from construction_twin.msg import Link
from interruption import Interruption
from twin_client import HOME, TwinClient, node_pid, wait

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

from impairment import Network, Profile  # noqa: E402
from processes import BrokerProcess  # noqa: E402

NODES = ("mqtt_bridge", "pca_monitor", "executor", "virtual_robot", "mock_rsi")
LOST = (Link.DISCONNECTED, Link.GATEWAY_OFFLINE)


class FaultLinkTest(Interruption):
    """Bridge and gateway reach the broker through a proxy."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("fault_link")
        cls.broker = BrokerProcess()
        cls.broker.start()
        cls.network = Network().__enter__()
        cls.proxy = cls.network.tcp(("127.0.0.1", cls.broker.port), port=rospy.get_param("~port"))
        cls.client = TwinClient()

    @classmethod
    def tearDownClass(cls):
        cls.network.__exit__()
        cls.broker.kill()

    def setUp(self):
        super().setUp()
        self.pids = {node: node_pid(node) for node in NODES}

    def tearDown(self):
        self.assertEqual({node: node_pid(node) for node in NODES}, self.pids, "a node was started again")

    def test_broker_killed_and_started_again_in_mid_motion(self):
        self.interrupt_and_recover(self.restart_broker)
        self.assert_said("silence: no command for")

    def test_broker_out_of_reach_for_5_s_in_mid_motion(self):
        self.interrupt_and_recover(self.cut)
        self.assert_said("silence: no command for")

    def test_broker_killed_and_started_again_at_rest(self):
        session = self.client.link.session
        self.restart_broker()
        # docs/architecture.md, law 5: nothing has moved, so no person has to act
        self.client.wait(lambda: self.client.link.session != session, "a session of its own accord")
        self.client.wait_until_ready()
        self.client.assert_trace_within_limits()
        self.client.go_to(HOME)

    def restart_broker(self):
        """Kill the broker, wait until the bridge says so, and start it again."""
        self.broker.kill()
        self.wait_until_lost()
        self.broker.start()

    def cut(self):
        """Let nothing pass for 5 s; the connections stay as they are."""
        self.network.apply(self.proxy, Profile(cut=5.0))
        self.wait_until_lost()

    def wait_until_lost(self):
        """Wait until the link's state says that the other side is gone."""
        wait(lambda: self.client.link.state in LOST, "the link to be lost")
        self.assertTrue(self.client.link.reason)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "fault_link", FaultLinkTest, sys.argv)
