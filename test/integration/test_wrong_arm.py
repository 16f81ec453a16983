#!/usr/bin/env python3
"""An arm whose axis A2 counts the other way is not armed; the link, `reset`, `/diagnostics` and `twin watch` name the cause."""

import subprocess
import sys

import rospy
import rostest
from construction_twin.msg import Link
from std_srvs.srv import Trigger
from twin_client import RobotTest

CAUSE = "axis A2 counts the other way (`sign` in the robot YAML)"


class WrongArmTest(RobotTest):
    """A mock arm that is not the model's."""

    def test_it_is_refused_with_the_cause(self):
        client = self.client
        client.wait(lambda: client.link and client.link.state == Link.OTHER_ARM, "an arm that is refused", 60.0)
        self.assertIn(CAUSE, client.link.reason)
        answer = rospy.ServiceProxy("reset", Trigger)()
        self.assertFalse(answer.success)
        self.assertIn(CAUSE, answer.message)
        command = ["rosrun", "construction_twin", "twin", "--robot", "kr120", "watch", "--once"]
        shown = subprocess.run(command, capture_output=True, text=True, timeout=30.0).stdout
        self.assertRegex(shown, r"tool pose +the controller's tool is 2682\.71 mm and 180\.00 deg off the model's")


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "wrong_arm", WrongArmTest, sys.argv)
