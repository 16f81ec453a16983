"""The server of an interactive marker, which takes the clicks of rviz from the rviz that made them.

rviz puts the name of its node in front of the id that each of its messages carries. A message that another node sends under that id
was recorded, and is played: by it a plan could be approved that nobody has seen.
"""

from __future__ import annotations

from collections.abc import Callable

import rospy
from interactive_markers.interactive_marker_server import InteractiveMarkerServer
from visualization_msgs.msg import InteractiveMarkerFeedback

from construction_twin.ros.transport.subscriber import PUBLISHER, caller_of


class MarkerServer(InteractiveMarkerServer):
    """As `InteractiveMarkerServer`, but deaf to what is played.

    Args:
        topic: Namespace of the marker's topics.
        refused: Called as ``refused(reason, sentence)`` for a message that its sender did not make.
    """

    def __init__(self, topic: str, refused: Callable[[str, str], None]):
        self._refused = refused
        super().__init__(topic)

    def keepAlive(self, msg: object) -> None:  # noqa: N802 (the name of its base class)
        """Tell clients that it is here; at shutdown its topic may be closed already."""
        try:
            super().keepAlive(msg)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise

    def processFeedback(self, feedback: InteractiveMarkerFeedback) -> None:  # noqa: N802 (the name of its base class)
        """Take what a client sent, if it is the client's own."""
        caller = caller_of(feedback)
        if caller and feedback.client_id.startswith(f"{caller}/"):
            super().processFeedback(feedback)
            return
        sender = caller or "a node without a name"
        self._refused(
            PUBLISHER, f"click of {feedback.client_id!r} on the marker, sent by {sender}: it is no rviz's own"
        )
