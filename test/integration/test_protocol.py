#!/usr/bin/env python3
"""The joint string alone: nothing else travels with it, and the arm still follows, stops and returns."""

import sys

import paho.mqtt.client as paho
import rospy
import rostest
from construction_twin.msg import Feedback
from interruption import Interruption
from twin_client import case, wait

from construction_twin.mqtt.messages import Topics


class ProtocolTest(Interruption):
    """A motion and a stop on arrival times."""

    def test_commands_and_states_are_the_joint_string_alone(self):
        self.assertEqual(rospy.get_param("gateway/properties"), False)
        self.assertEqual(self.client.sync.comparison, "instant")
        self.assertEqual(rospy.wait_for_message("physical/feedback", Feedback, 5.0).command_stamp.to_nsec(), 0)
        topics = Topics(rospy.get_param("~prefix"), "kr120")
        taken = {topics.command: [], topics.state: []}
        client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        client.on_message = lambda _client, _data, message: taken[message.topic].append(message)
        client.connect(rospy.get_param("mqtt_bridge/host"), rospy.get_param("mqtt_bridge/port"))
        client.subscribe([(topic, 0) for topic in taken])
        client.loop_start()
        self.addCleanup(client.disconnect)
        wait(lambda: all(len(messages) > 50 for messages in taken.values()), "commands and states")
        client.loop_stop()
        for topic, messages in taken.items():
            with case(topic):
                self.assertEqual([getattr(m.properties, "UserProperty", []) for m in messages[:50]], [[]] * 50)
                self.assertEqual(len(messages[-1].payload.split(b",")), 6)

    def test_a_stop_holds_until_reset(self):
        self.halt_and_recover()


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "protocol", ProtocolTest, sys.argv)
