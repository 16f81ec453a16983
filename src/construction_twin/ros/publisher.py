"""A ROS publisher that timers and callbacks may use until the very end."""

from __future__ import annotations

import rospy


class Publisher(rospy.Publisher):
    """As `rospy.Publisher`; what is published while the node shuts down is dropped.

    rospy closes topics before it ends the threads of timers and subscribers, and before `rospy.is_shutdown` says so: without this
    every Ctrl-C would print tracebacks.
    """

    def publish(self, *args, **kwds) -> None:
        """Publish a message; ROSException unless the node is shutting down."""
        try:
            super().publish(*args, **kwds)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise
