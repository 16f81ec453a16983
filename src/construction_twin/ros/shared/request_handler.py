"""How the planner answers a request: one at a time, and every failure becomes an answer."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Sequence

import rospy

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.motion_errors import CartesianPathError
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlanRequest
from construction_twin.robot.plan import Plan
from construction_twin.ros.shared.arm_listener import OtherArm
from construction_twin.ros.shared.diagnostics import NodeDiagnostics
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.scene_change import SceneChange

#: A verdict that was given before a request, or the word that a stop voided a plan, is heard this long after its planning [s].
VERDICT_TIME = 0.1


class OccupiedSpace:
    """The space that the other arm occupies, with the distance that a plan keeps from it.

    Args:
        name: Of the other arm.
        max_pose_age: Its pose may be this old [s].
        padding: The distance [m].
    """

    def __init__(self, other: OtherArm, name: str, max_pose_age: float, padding: float):
        self._other = other
        self._name = name
        self._max_pose_age = max_pose_age
        self._padding = padding
        #: Why its whole reach counts, in one sentence, since `forget`; "" when its pose was known.
        self.unknown = ""

    def obstacles(self) -> list[Obstacle]:
        """Return the space; if the other arm's pose is not known, this is its whole reach."""
        obstacles = self._other.occupied(self._max_pose_age)
        if self._other.unknown:
            self.unknown = f"plans keep clear of the whole reach of {self._name}, because {self._other.unknown}"
            rospy.logwarn("%s", self.unknown)
        return [item.padded(self._padding) for item in obstacles]

    def forget(self) -> None:
        """Forget what was unknown while the last plan was made."""
        self.unknown = ""


class RequestHandler:
    """Makes and publishes a plan for each request, one at a time.

    Args:
        diagnostics: Counts the failures.
        scene_publishers: Returns how many nodes publish the scene now.
        scene_timeout: A request waits this long for a scene [s].
        publish: Takes the plan, and what a work plan does to the scene; publishes it and returns a sentence about it.
        publish_outcome: Takes success, request, sentence and the plan's id ("" without a plan).
        space: The other arm's, which the pipeline asks.
        demand_free: Raises `EngagedError` while the arm is inside an engaged segment that it was left in.
    """

    def __init__(
        self,
        pipeline: PlanningPipeline,
        diagnostics: NodeDiagnostics,
        scene_publishers: Callable[[], int],
        scene_timeout: float,
        publish: Callable[[Plan, Sequence[SceneChange]], str],
        publish_outcome: Callable[[bool, PlanRequest, str, str], None],
        space: OccupiedSpace | None = None,
        demand_free: Callable[[], None] = lambda: None,
    ):
        self._pipeline = pipeline
        self._diagnostics = diagnostics
        self._scene_publishers = scene_publishers
        self._scene_timeout = scene_timeout
        self._publish = publish
        self._publish_outcome = publish_outcome
        self._space = space
        self._demand_free = demand_free
        # what makes a plan the same as the one that was published last, with that one's id; whether that one was decided
        self._newest: dict[tuple[str, ...], str] = {}
        self._decided = threading.Event()
        self.repeated = 0  # requests that gave the plan that waits, and kept its place
        # one request at a time: `plan` latches one plan, and its outcome belongs to it
        self._busy = threading.Lock()

    def on_verdict(self, plan_id: str) -> None:
        """Take that a plan is not, or no longer, under review."""
        if plan_id in self._newest.values():
            self._decided.set()

    def answer(self, make_plan: Callable[[PlanRequest], Plan], asked: PlanRequest) -> Outcome:
        """Make and publish a plan; see `answer_read`."""
        return self.answer_read(lambda: make_plan, asked)

    def answer_read(
        self,
        read: Callable[[], Callable[[PlanRequest], Plan]],
        asked: PlanRequest,
        changes: Sequence[SceneChange] = (),
        back: bool = False,
    ) -> Outcome:
        """Read what a request refers to, then make and publish a plan. Every failure becomes an answer here.

        Args:
            read: Returns what makes the plan.
            changes: What a work plan does to the scene, published with it; `read` may fill it.
            back: It is the way back out of an engaged segment, the only plan for an arm that was left inside.
        """
        try:
            if not back:
                self._demand_free()
            make_plan = read()  # before taking the lock, so that no request waits while another one reads its file
            with self._busy:
                return self._make(make_plan, asked, changes)
        except ConstructionTwinError as error:
            return self._failed(error, asked, str(error))
        except (ArithmeticError, MemoryError, ValueError) as error:
            # a request that fails with an unexpected exception must get an answer, too
            rospy.logerr("%s", traceback.format_exc())
            kind = type(error).__name__
            return self._failed(error, asked, f"the request cannot be computed ({kind}: {error}); please report it")

    def _make(
        self, make_plan: Callable[[PlanRequest], Plan], asked: PlanRequest, changes: Sequence[SceneChange]
    ) -> Outcome:
        if self._space is not None:
            self._space.forget()
        self._demand_scene()
        try:
            return self._published(make_plan(asked), asked, changes)
        except ConstructionTwinError as error:
            if self._space is None or not self._space.unknown:
                raise
            # a sentence such as "the start is in collision" is understood only with the reason
            return self._failed(error, asked, f"{error}; {self._space.unknown}")

    def _demand_scene(self) -> None:
        """Wait for a scene whose publisher is connected: without it, the present surroundings of the arm are not known."""
        seen = self._pipeline.scene
        if not self._scene_publishers():
            self._pipeline.forget_scene(seen)
        self._pipeline.wait_for_scene(self._scene_timeout)

    def _published(self, plan: Plan, asked: PlanRequest, changes: Sequence[SceneChange]) -> Outcome:
        motion = plan.source, plan.hash, plan.scene
        # the node `work` waits for a new plan of its task, or of the way back
        plan_id = "" if plan.segments else self._newest.get(motion, "")
        if plan_id and not self._decided.wait(VERDICT_TIME):
            self.repeated += 1
            sentence = f"plan {plan_id} for {plan.source!r}, the same motion, is still waiting for review"
        else:
            self._decided.clear()  # before it is published: its verdict may come at once
            plan_id, self._newest = plan.id, {motion: plan.id}
            sentence = self._publish(plan, changes)
        self._publish_outcome(True, asked, sentence, plan_id)
        found = {"plan_id": plan_id, "plan_hash": plan.hash, "duration": plan.trajectory.duration}
        return Outcome(True, sentence, fields={**found, "fraction": 1.0, "retimed": plan.retimed})

    def _failed(self, error: Exception, asked: PlanRequest, sentence: str) -> Outcome:
        self._diagnostics.count(type(error).__name__, sentence)
        self._publish_outcome(False, asked, sentence, "")
        fraction = error.fraction if isinstance(error, CartesianPathError) else 0.0
        return Outcome(False, sentence, fields={"fraction": fraction})
