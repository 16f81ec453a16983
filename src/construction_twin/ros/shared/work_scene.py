"""How the work node changes the collision scene: as the plan says, as the ledger says, and for an arm that was left engaged.

The ledger comes first: the scene changes only after what is known of the task is on the disk.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from construction_twin.core.reports import ExecutionReport
from construction_twin.core.sentences import Sentence
from construction_twin.ros.messages.scene_convert import object_to_msg
from construction_twin.ros.shared.work_follower import WorkFollower
from construction_twin.ros.shared.work_listener import WorkListener
from construction_twin.scene.scene_change import SceneChange
from construction_twin.srv import EditSceneRequest
from construction_twin.work import engaged_scene
from construction_twin.work.built import change
from construction_twin.work.task_board import TaskBoard
from construction_twin.work.task_states import UNDER_WAY

#: Calls a service with a request; returns why there is no answer, and the answer.
Call = Callable[[Any], tuple[str, Any]]
#: How long a changed scene may take from the scene node to this one [s].
SCENE_TIME = 2.0


class WorkScene:
    """Has the scene changed by the scene node. To be called without the lock: the scene node is waited for.

    Args:
        lock: Of the board.
        edit_scene: The scene node's service, see `Call`.
        refuse: Counts what could not be done; takes reason and sentence.

    Attributes:
        blocked: Why the scene of an engaged arm cannot be made right; empty: it can, or no arm is engaged.
    """

    def __init__(
        self,
        board: TaskBoard,
        lock: threading.RLock,
        heard: WorkListener,
        follower: WorkFollower,
        edit_scene: Call,
        refuse: Callable[[str, str], None],
    ):
        self._board, self._lock, self._heard, self._follower = board, lock, heard, follower
        self._edit_scene, self._refuse = edit_scene, refuse
        self.blocked = ""
        #: Of what that was said.
        self._blocked_in: tuple | None = None

    def change_as_planned(self, report: ExecutionReport | None) -> None:
        """Change the scene as planned, when a report, which has been followed, says that the executor waits for it."""
        board, known, scene = self._board, self._heard.plan, self._heard.scene
        if report is None or known is None or scene is None:
            return
        plan = known.message
        if not report.wants_scene or report.plan_id != plan.id or not 0 <= report.segment < len(plan.segments):
            return
        segment = plan.segments[report.segment]
        task = board.book.busy
        if not task or board.book.tasks[task].plan != plan.id or scene.hash == segment.scene_after:
            return
        self._edit(EditSceneRequest(segment.scene, segment.put, segment.remove, segment.scene_after))

    def tidy(self) -> None:
        """Make the scene what the ledger says: tool, stock, placed elements."""
        scene = self._heard.scene
        if scene is None:
            return
        with self._lock:
            wanted, alone = self._board.wanted_scene()
        wrong = change(scene, wanted, alone)
        if wrong != SceneChange():
            self._change(scene.hash, wrong)

    def make_for_way_back(self) -> str:
        """Make the scene one in which an engaged arm can go back; return why not, empty when it is.

        What the ledger has to say of the stop is on the disk before.
        """
        left, board = self._heard.left, self._board
        if left is None:
            return Sentence("work.back.unsaid")
        with self._lock:
            scene = self._heard.scene
            if scene is None:
                return Sentence("work.scene_unknown")
            if scene.hash in left.scenes:
                self.unblock()
                return ""
            if self._heard.playing:
                return Sentence("work.back.playing")
            self._follower.follow(self._heard.execution)
            self._follower.settle_if_lost()
            memory = board.book.tasks.get(left.task)
            if memory is not None and memory.plan == left.plan_id and memory.state in UNDER_WAY:
                return Sentence("work.back.unwritten", task=board.title(left.task))
            known = self._heard.work_plan(left.plan_id)
            segments, changes = (known.segments, known.changes) if known is not None else ((), ())
            about = (left.plan_id, left.scenes, scene.hash, bool(segments), memory.state if memory else None)
            if about == self._blocked_in:
                return self.blocked
            element = board.element_of(left.task) if memory is not None else ""
            forms = board.forms(left.task) if memory is not None else ()
            found = engaged_scene.due(left, scene, segments, changes, self._heard.scenes(), element, forms)
        if found.change is None:
            self.blocked, self._blocked_in = found.sentence, about
            self._refuse("engagement", found.sentence)
            return found.sentence
        # tried again as long as the scene node refuses
        self.blocked, self._blocked_in = self._change(scene.hash, found.change, found.after), None
        return self.blocked

    def unblock(self) -> None:
        """Forget why the scene of an engaged arm could not be made right."""
        self.blocked, self._blocked_in = "", None

    def _change(self, before: str, wanted: SceneChange, after: str = "") -> str:
        return self._edit(EditSceneRequest(before, list(map(object_to_msg, wanted.put)), list(wanted.remove), after))

    def _edit(self, request: EditSceneRequest) -> str:
        """Have the scene changed; return why not, empty when it was and the change has arrived here."""
        problem, answer = self._edit_scene(request)
        if answer is None or not answer.success:
            sentence = problem or answer.message
            self._refuse("edit_scene", sentence)
            return sentence
        heard = self._heard
        if not heard.wait_for(lambda: heard.scene is not None and heard.scene.hash == answer.hash, SCENE_TIME):
            return Sentence("work.scene_unpublished")
        return ""
