"""Publishers, subscribers and services below rospy's own, packed poses, and the 4 ms cycle."""
