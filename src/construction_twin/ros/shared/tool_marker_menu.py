"""The menu of the marker at the tool: plan, preview, approve, reject, stop. Each action runs in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
import rospy
from interactive_markers.interactive_marker_server import InteractiveMarkerServer
from interactive_markers.menu_handler import MenuHandler
from visualization_msgs.msg import InteractiveMarkerFeedback

from construction_twin.core.errors import ConstructionTwinError, RequestRefused
from construction_twin.kinematics.chain import Pose
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.services import Outcome, pose_fields
from construction_twin.ros.shared.robot_client import OperatorClient

#: A tool that has moved less is not followed [m, and elements of the rotation].
STILL = 1e-6
#: A plan that ends within this of the goal was the plan to this goal [m, and elements of the rotation].
REACHED = 1e-3
#: How long a plan must have been shown before the menu approves or rejects it [s]: a plan that came with the click was not seen.
SHOWN = 1.0
#: The entry that is heard from every client; see `ToolMarkerMenu.on_feedback`.
STOP = "Stop"


def in_thread(title: str, action: Callable[[], None]) -> None:
    """Run an action in a thread of its own, so that a stop waits for no other action."""
    threading.Thread(target=action, name=title, daemon=True).start()


def moved(before: Pose, after: Pose, tolerance: float = STILL) -> bool:
    """Return whether two poses differ by more than a tolerance [m, and elements of the rotation]."""
    position, rotation = np.abs(after.position - before.position), np.abs(after.rotation - before.rotation)
    return bool(position.max() > tolerance or rotation.max() > tolerance)


class ToolMarkerMenu:
    """Carries out what an operator chooses, by `run(title, action)`; `home` in [rad], [m]."""

    def __init__(
        self,
        client: OperatorClient,
        under_review: Callable[[], Plan | None],
        home: Sequence[float],
        reviewer: str,
        show_text: Callable[[str], None],
        run: Callable[[str, Callable[[], None]], None] = in_thread,
    ):
        self._client = client
        self._under_review = under_review
        #: Where the marker was dragged to, as ``base_T_tool``; None: it follows the tool.
        self.goal: Pose | None = None
        self._dragging = threading.Lock()
        self._reviewer = reviewer
        self._show_text = show_text
        self._run = run
        self._planning = threading.Lock()
        # the plan that the operator sees, empty: none, and since when [s, monotonic]
        self._shown = "", 0.0
        self._actions: dict[str, Callable[[], Outcome]] = {
            "Plan": lambda: self._plan(lambda: self._pose_request("pose")),
            "Plan straight line": lambda: self._plan(lambda: self._pose_request("line")),
            "Preview": client.preview,
            "Approve": lambda: self._review("approved"),
            "Reject": lambda: self._review("rejected"),
            STOP: lambda: client.trigger("stop"),
            "Plan to home": lambda: self._plan(lambda: GoalRequest("joints", joints=tuple(home))),
            "Back to the tool": self._back,
        }
        self._menu = MenuHandler()
        # the marker server ignores a second rviz for a second after the first one's last message; a stop must not be lost, so that
        # entry does nothing here, and on_feedback hears it from every rviz
        calls = {title: lambda _, title=title: None if title == STOP else self.choose(title) for title in self._actions}
        self._entries = {title: self._menu.insert(title, callback=call) for title, call in calls.items()}

    def attach(self, server: InteractiveMarkerServer, marker: str) -> None:
        """Give a marker of a server this menu."""
        self._menu.apply(server, marker)

    def on_feedback(self, feedback: InteractiveMarkerFeedback) -> None:
        """Take what any rviz sends on the feedback topic: a stop is carried out, the rest is the marker server's."""
        if feedback.event_type == feedback.MENU_SELECT and feedback.menu_entry_id == self._entries[STOP]:
            self.choose(STOP)

    def show(self, plan_id: str) -> None:
        """Note which plan the operator sees now; empty for none."""
        if plan_id != self._shown[0]:
            self._shown = plan_id, time.monotonic()

    def reached(self, end: Pose) -> None:
        """Drop the goal if a motion has ended there; a goal that was dragged further meanwhile stays."""
        with self._dragging:
            if self.goal is not None and not moved(self.goal, end, REACHED):
                self.goal = None

    def drag(self, pose: Pose) -> None:
        """Set a new goal."""
        with self._dragging:
            self.goal = pose

    def choose(self, title: str) -> None:
        """Carry out an entry, and tell the operator how it ended."""
        self._run(title, lambda: self._carry_out(title))

    def _carry_out(self, title: str) -> None:
        self._show_text(f"{title} ...")
        try:
            sentence = self._actions[title]().message
        except ConstructionTwinError as error:
            rospy.logwarn("%s: %s", title, error)
            self._show_text(f"{title}: {error}")
            return
        except rospy.ROSInterruptException:
            return  # the node ends
        rospy.loginfo("%s: %s", title, sentence)
        self._show_text(f"{title}: {sentence}")

    def _plan(self, request: Callable[[], GoalRequest]) -> Outcome:
        if not self._planning.acquire(blocking=False):
            raise RequestRefused("a plan is being made already; wait for it")
        try:
            return self._client.plan(request())
        finally:
            self._planning.release()

    def _pose_request(self, kind: str) -> GoalRequest:
        pose = self.goal
        if pose is None:
            raise RequestRefused("the marker is at the tool; drag it to a goal first")
        return GoalRequest(kind, **pose_fields(pose))

    def _review(self, verdict: str) -> Outcome:
        plan = self._under_review()
        if plan is None:
            raise RequestRefused("no plan waits for approval; plan one first")
        shown, since = self._shown
        if shown != plan.id or time.monotonic() - since < SHOWN:
            raise RequestRefused(f"plan {plan.id[:8]} has only just come; look at it, then choose again")
        return self._client.review(ReviewRequest(plan.id, plan.hash, verdict, self._reviewer, "by the marker's menu"))

    def _back(self) -> Outcome:
        self.goal = None
        return Outcome(True, "the marker follows the tool")
