"""Publishers and subscribers of the 250 Hz path, packed poses, and the 4 ms cycle.

In: joint positions and stamps. Out: the same over ROS, with the caller id of the publisher checked. May import ``core`` and
rospy; no other part of ``ros``.
"""
