#!/usr/bin/env python3
"""Read-only controller: nothing leaves the PC, the twin still follows the jogged arm in mirror mode, and commanding is refused."""

import sys
import unittest

import numpy as np
import rospy
import rostest
from construction_twin.msg import Link
from std_srvs.srv import SetBool
from twin_client import Stream, TwinClient

from construction_twin.core.units import radians

#: Where the arm is jogged to [deg].
JOGGED = (-12.0, -80.0, 85.0, 10.0, 80.0, 15.0)


class MirrorReadOnlyTest(unittest.TestCase):
    """A person jogs the arm; the PC only listens."""

    def test_the_twin_follows_and_nothing_is_answered(self):
        rospy.init_node("test_mirror_read_only")
        client = TwinClient()
        mirror = rospy.ServiceProxy("mirror", SetBool)
        client.wait(lambda: client.link and client.link.gateway_state == "read_only", "the read-only gateway", 60.0)
        client.wait(lambda: client.link.state == Link.NO_CONTROLLER, "the link to tell that nothing can be commanded")
        self.assertIn("read-only", client.link.reason)
        # asked for and refused, not left undone
        self.assertFalse(client.call("reset").success)

        client.wait(lambda: mirror(True).success, "mirror mode to be entered")
        client.wait(lambda: client.link.state == Link.MIRROR, "the link to mirror")
        with Stream("twin/joint_states") as twin, Stream("physical/joint_states") as physical:
            client.inject("jog", value=radians(JOGGED), duration=3.0)
            client.assert_at(JOGGED, physical)
            client.wait(lambda: np.abs(twin.positions(-1)[0] - radians(JOGGED)).max() < 2e-5, "the twin to arrive")
            client.assert_no_jump(twin)
        sent = client.link.commands_sent

        answers = []

        def left() -> bool:
            answers.append(mirror(False))
            return answers[-1].success

        client.wait(left, "mirror mode to be left")
        self.assertIn("read-only", answers[-1].message)
        client.wait(lambda: client.link.state == Link.NO_CONTROLLER, "the link after mirror mode")
        counters = client.gateway_counters()
        self.assertGreater(int(counters["telegrams_unanswered"]), 500)
        self.assertNotIn("telegrams", counters)
        self.assertEqual(client.mock_counter("replies"), 0)
        self.assertEqual(client.link.commands_sent, sent)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "mirror_read_only", MirrorReadOnlyTest, sys.argv)
