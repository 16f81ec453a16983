"""Requests for plans, answered one at a time: every failure is an answer, and a motion that waits for review keeps its place."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.planning.ik_branch import CartesianPathError
from construction_twin.planning.planner import PlanRequest
from construction_twin.robot.plan import Plan
from construction_twin.scene.scene_change import SceneChange

#: How long after its planning a verdict from before the request, or a stop, may still arrive [s].
VERDICT_TIME = 0.1


@dataclass(frozen=True)
class Answer:
    """The outcome of a request, with the field names of the services' answers.

    `fraction` of the path that can be followed; `failure`: the error's class, "" for a plan; `trace` of an unforeseen one.
    """

    success: bool
    message: str
    plan_id: str = ""
    plan_hash: str = ""
    duration: float = 0.0
    fraction: float = 1.0
    retimed: str = ""
    failure: str = ""
    trace: str = ""


class PlanRequests:
    """Makes and publishes a plan for each request.

    `begin` is called before each, and raises where nothing is known to plan in. `publish` takes a plan (None: published before),
    what it does to the scene, its request and the answer.
    """

    def __init__(
        self,
        begin: Callable[[], None],
        publish: Callable[[Plan | None, Sequence[SceneChange], PlanRequest, Answer], None],
    ):
        self._begin, self._publish = begin, publish
        # what makes a plan the same as the one that was published last, with that one's id; whether that one was decided
        self._newest: dict[tuple[str, ...], str] = {}
        self._decided = threading.Event()
        self.repeated = 0  # requests that gave the plan that waits, and kept its place
        # one request at a time: `plan` latches one plan, and its outcome belongs to it
        self._busy = threading.Lock()

    def on_verdict(self, plan_id: str) -> None:
        """Record that a plan is decided."""
        if plan_id in self._newest.values():
            self._decided.set()

    def answer(
        self,
        asked: PlanRequest,
        read: Callable[[], Callable[[], Plan]],
        changes: Sequence[SceneChange] = (),
    ) -> Answer:
        """Read what a request refers to, then make and publish a plan, with its changes of the scene, which `read` may fill in."""
        try:
            plan_motion = read()  # before taking the lock, so that no request waits while another one reads its file
            with self._busy:
                self._begin()
                return self._published(plan_motion(), asked, changes)
        except ConstructionTwinError as error:
            return _failed(error, str(error))
        except (ArithmeticError, MemoryError, ValueError) as error:
            # a request that fails with an unexpected exception must get an answer, too
            sentence = f"the request cannot be computed ({type(error).__name__}: {error}); please report it"
            return _failed(error, sentence, traceback.format_exc())

    def _published(self, plan: Plan, asked: PlanRequest, changes: Sequence[SceneChange]) -> Answer:
        motion = plan.source, plan.hash, plan.scene
        # the node `work` waits for a new plan of its task, or of the way back
        plan_id = "" if plan.segments else self._newest.get(motion, "")
        new_plan: Plan | None = None
        if plan_id and not self._decided.wait(VERDICT_TIME):
            self.repeated += 1
            sentence = f"plan {plan_id} for {plan.source!r}, the same motion, is still waiting for review"
        else:
            self._decided.clear()  # before it is published: its verdict may come at once
            new_plan, plan_id, self._newest = plan, plan.id, {motion: plan.id}
            sentence = _sentence(plan)
        answer = Answer(True, sentence, plan_id, plan.hash, plan.trajectory.duration, retimed=plan.retimed)
        self._publish(new_plan, changes, asked, answer)
        return answer


def _failed(error: Exception, sentence: str, trace: str = "") -> Answer:
    fraction = error.fraction if isinstance(error, CartesianPathError) else 0.0
    return Answer(False, sentence, fraction=fraction, failure=type(error).__name__, trace=trace)


def _sentence(plan: Plan) -> str:
    trajectory, clearance = plan.trajectory, plan.report.clearance
    close = f"closest {clearance.distance:.3f} m at {clearance.time:.2f} s ({' to '.join(clearance.between)})"
    return (
        f"plan {plan.id} for {plan.source!r}: {trajectory.duration:.3f} s, {len(trajectory.times)} waypoints, made by "
        f"{plan.planner} in {plan.planning_time:.3f} s; {close if clearance.between else 'nothing to touch'}; "
        "waiting for review"
    )
