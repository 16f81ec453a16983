#!/usr/bin/env python3
"""Mirror mode with the whole system: the twin follows the arm's own program, nothing is commanded, and neither jumps."""

import sys

import numpy as np
import rospy
import rostest
from construction_twin.msg import Link, Sync
from std_srvs.srv import SetBool
from twin_client import LEFT, RobotTest, Stream

from construction_twin.core.units import radians

#: Where the arm goes by itself [deg].
JOGGED = (10.0, -85.0, 85.0, 5.0, 85.0, -10.0)


class MirrorTest(RobotTest):
    """One robot: command, mirror, command, halt."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.mirror = rospy.ServiceProxy("mirror", SetBool)

    def test_the_arm_leads_and_then_follows_again(self):
        client = self.client
        client.wait_until_ready()
        with Stream("twin/joint_states") as twin, Stream("physical/joint_states") as physical:
            session = client.link.session
            # on a busy machine the pose may just be older than what counts as known
            client.wait(lambda: self.mirror(True).success, "mirror mode to be entered")
            client.wait(lambda: client.link.state == Link.MIRROR, "the link to mirror")
            client.wait(lambda: client.link.gateway_state == "ready", "the gateway's session to end")
            client.wait(lambda: client.sync.state == Sync.WAITING, "the gate to wait")
            self.assertNotEqual(client.link.session, session)
            commands = client.link.commands_sent
            entered = len(twin.messages)
            client.inject("jog", value=radians(JOGGED), duration=3.0)
            client.wait(lambda: physical.moved(3.0), "the arm to move by itself")
            refused = self.mirror(False)
            self.assertFalse(refused.success)
            self.assertIn("still changing", refused.message)
            client.assert_at(JOGGED, physical)
            client.wait(lambda: np.abs(twin.positions(-1)[0] - radians(JOGGED)).max() < 2e-5, "the twin to arrive")
            client.assert_no_jump(twin, entered)
            self.assertEqual(client.link.commands_sent, commands)
            self.assertEqual(client.sync.state, Sync.WAITING)

            client.wait(lambda: self.mirror(False).success, "mirror mode to be left")
            client.wait_until_ready()
            client.assert_no_jump(twin)
            plan = client.start(LEFT, duration=3.0)
            client.wait_for_outcome(plan.plan_id, "finished")
            client.assert_at(LEFT, twin, physical)
            self.assertFalse([name for name in client.gateway_counters() if name.startswith("stops_")])
        client.assert_trace_within_limits()
        self.panic_button()

    def panic_button(self):
        """One call stops executor and gateway; a person goes on."""
        client = self.client
        with Stream("physical/joint_states") as physical:
            plan = client.start(JOGGED, duration=4.0)
            client.wait(lambda: physical.moved(3.0), "the arm to move")
            answer = client.call("halt")
            self.assertTrue(answer.success, answer.message)
            client.wait(lambda: client.link.state == Link.NEEDS_RESET, "the link to need a reset")
            client.wait_for_outcome(plan.plan_id, "dropped")
            client.wait(physical.at_rest, "the arm to rest")
            client.wait(lambda: client.gateway_counters().get("stop_took_s"), "the gateway's report of the stop")
        report = client.gateway_counters()
        stated, moved = (np.array(report[f"stop_{name}_deg"].split(), float) for name in ("distance", "moved"))
        self.assertEqual(report["stop_cause"], "stop")
        self.assertEqual((stated.shape, moved.shape), ((6,), (6,)))
        self.assertTrue((moved <= stated + 1e-6).all(), report)
        self.assertGreater(stated.max(), 0.0)
        self.assertFalse(self.mirror(False).success)
        answer = client.call("reset")
        self.assertTrue(answer.success, answer.message)
        client.wait_until_ready()


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "mirror", MirrorTest, sys.argv)
