"""The commands; may import rospy."""
