"""Conversions between ROS messages and the library's values. No parameters, no clock."""
