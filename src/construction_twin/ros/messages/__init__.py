"""Conversion between ROS messages and the library's records, in both directions, without any logic.

In: messages, or records. Out: the other of the two, or a typed error for a message that does not fit. May import the library
and ``ros.transport``.
"""
