"""An action server on this package's own publishers and subscribers."""

from __future__ import annotations

from collections.abc import Callable

import genpy
import rospy
from actionlib import ActionServer, ServerGoalHandle
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray

from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber, caller_of

#: Messages kept for a client, and of clients, that are busy.
QUEUE = 50
#: How often the status of all goals is published [Hz], and how long that of a goal which has ended [s]: actionlib's own values.
STATUS_RATE, STATUS_KEPT = 5.0, 5.0


class GoalServer(ActionServer):
    """As `actionlib.ActionServer`, but an error in a callback ends the node, and a client that is slow or gone holds up nothing.

    rospy's subscriber would log such an error and go on; its publisher starts a thread per client that is no daemon, and complains
    about what is published while the node ends.

    Args:
        name: Of the action.
        kind: Of the action: ``...Action``.
        on_goal, on_cancel: Take the goal's handle; in rospy's threads, with the server's lock held.
        refused: See `Subscriber`.
        recalled: Returns the result of a goal that was cancelled before it came, from a sentence.
    """

    def __init__(
        self,
        name: str,
        kind: type,
        on_goal: Callable[[ServerGoalHandle], None],
        on_cancel: Callable[[ServerGoalHandle], None],
        refused: Callable[[str, str], None],
        recalled: Callable[[str], genpy.Message],
    ):
        super().__init__(name, kind, on_goal, on_cancel, auto_start=False)
        self._refused, self._recalled = refused, recalled

    def initialize(self) -> None:
        """Connect to the five topics; called by `start`."""
        self.status_pub = Publisher(f"{self.ns}/status", GoalStatusArray, queue_size=QUEUE, latch=True)
        self.result_pub = Publisher(f"{self.ns}/result", self.ActionResult, queue_size=QUEUE)
        self.feedback_pub = Publisher(f"{self.ns}/feedback", self.ActionFeedback, queue_size=QUEUE)
        self.goal_sub = self._hear("goal", self.ActionGoal, self.internal_goal_callback)
        self.cancel_sub = self._hear("cancel", GoalID, self.internal_cancel_callback)
        self.status_list_timeout = rospy.Duration(STATUS_KEPT)
        self.status_timer = rospy.Timer(rospy.Duration(1.0 / STATUS_RATE), self.publish_status_async)

    def is_connected(self, node: str) -> bool:
        """Return whether a node still hears the status of its goals.

        The status goes out all the time, so the connection of a client that ended without a word is found to be closed. That to a
        machine which was cut off stays for as long as TCP believes in it.
        """
        return any(connection.endpoint_id == node for connection in self.status_pub.impl.connections)

    def internal_cancel_callback(self, goal_id: GoalID) -> None:
        """Cancel what is there, and forget when.

        actionlib goes on to drop every goal whose stamp is not later than the cancel's: a client whose clock is an hour ahead would
        lock everybody else out for an hour, without a word. Here a cancel is about goals that are there, and nothing that comes.
        """
        # in one: a goal that comes between the two would be dropped
        with self.lock:
            super().internal_cancel_callback(goal_id)
            self.last_cancel = rospy.Time()

    def internal_goal_callback(self, goal) -> None:
        """Take a goal; one whose id is there already is refused and counted.

        actionlib drops it without a word; and where its cancel came first, the result that it sends has no error code, which is the
        code of success. The goal is then recalled with `recalled`.
        """
        with self.lock:
            there = [each for each in self.status_list if each.status.goal_id.id == goal.goal_id.id]
            if self.started and there:
                status = there[0].status
                if status.status == GoalStatus.RECALLING:
                    sentence = "cancelled before it came"
                    status.status, status.text = GoalStatus.RECALLED, sentence
                    self.publish_result(status, self._recalled(sentence))
                else:
                    sentence = "its id is that of a goal that is there; expected a new one for each goal"
                self._refused("repeated goal", f"goal {goal.goal_id.id!r} of {caller_of(goal)} dropped: {sentence}")
            super().internal_goal_callback(goal)

    def _hear(self, topic: str, kind: type, callback: Callable) -> Subscriber:
        return Subscriber(f"{self.ns}/{topic}", kind, callback, self._refused, queue_size=QUEUE, tcp_nodelay=True)
