"""The ROS side: nodes, commands, and what they share; the only folder of the core that knows rospy."""
