"""neighbour: watches whether the other arm blocks the path of our plans (`conflict`), while they wait and while they run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rosgraph
import rospy

from construction_twin.coordination.conflict import braking_horizon
from construction_twin.coordination.path_judge import Judgement, Others, PathJudge, PlanUnknownError
from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError
from construction_twin.core.motion_errors import NeighbourUnknownError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.conflict_verdicts import VERDICT_TIMEOUT
from construction_twin.msg import Conflict as ConflictMsg
from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.arm_listener import (
    ARM_POSES,
    ARM_TOPICS,
    OTHER_POSE_AGE,
    OWN_STEP,
    ArmListener,
    NeighbourSettings,
    OtherArm,
    await_robot,
    listen_to_other_arm,
)
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, Report
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.ports import Interface, Ports, Publication
from construction_twin.ros.transport.publisher import Sink

#: From the moment when a verdict counts no longer to the first braking setpoint, and from a pose to its reception, at most
#: [s]: a few cycles of the executor and the transport of a message, on a busy machine.
DELAY = 0.1
#: Checks per second. The executor takes a verdict for 0.5 s: below 5 Hz one that is left out would stop the arm.
RATE = 10.0


@dataclass(frozen=True)
class LoggedVerdict:
    """What stands in the log of a plan.

    Attributes:
        clear: No conflict was found.
    """

    blocked: bool
    clear: bool


class NeighbourNode:
    """Two arms' topics in, verdicts on our plans out; `start` gives it parameters and topics.

    Args:
        horizon: How far ahead a conflict is acted upon [s].
    """

    def __init__(
        self,
        settings: NeighbourSettings,
        own: ArmListener,
        other: OtherArm,
        judge: PathJudge,
        horizon: float,
        conflict: Sink,
    ):
        self._settings = settings
        self._own = own
        self._other = other
        self._judge = judge
        self._horizon = horizon
        self._publisher = conflict
        self._state = Report(WARN, "nothing to watch yet")
        self._checks, self._longest = 0, 0.0
        self._failure = ""
        self._logged: dict[str, LoggedVerdict] = {}

    def run(self) -> None:
        """Check again and again, in the main thread: an unexpected exception ends the process, which is then started anew."""
        rate = rospy.Rate(RATE)
        while not rospy.is_shutdown():
            began = time.monotonic()
            self.check()
            self._checks += 1
            self._longest = max(self._longest, time.monotonic() - began)
            rate.sleep()

    def check(self) -> None:
        """Judge the plan that is played and say so, then the one that waits."""
        # a verdict has the age of its poses
        stamp = rospy.Time.now()
        try:
            plans = self._own.plans()
        except PlanUnknownError as error:
            self._note(WARN, Sentence("reason.neighbour.own_plan_unknown", problem=error.sentence), {})
            return
        followed, waiting = plans.followed, plans.waiting
        others = self._others()
        scene = self._own.scene
        verdicts: dict[str, Judgement] = {}
        if followed is not None:
            verdict = self._verdict(
                others, lambda known: self._judge.followed(followed, scene, known, plans.started, self._poses())
            )
            verdicts[followed.id] = verdict
            self._publish(followed.id, verdict, stamp)
        if waiting is not None:
            verdict = self._verdict(others, lambda known: self._judge.waiting(waiting, scene, known))
            verdicts[waiting.id] = verdict
            # a plan that has begun meanwhile is judged next time: what may not start yet need not stop
            if not (verdict.blocked and self._has_begun(waiting.id)):
                self._publish(waiting.id, verdict, stamp)
        self._forget(verdicts)
        self._sum_up(verdicts, others)

    def _has_begun(self, plan_id: str) -> bool:
        try:
            followed = self._own.plans().followed
        except PlanUnknownError:
            return False
        return followed is not None and followed.id == plan_id

    def _others(self) -> Others | None:
        """Return the other arm; None when its space is unknown."""
        self._failure = ""
        try:
            obstacles = self._other.occupied(horizon=self._horizon)
        except NeighbourUnknownError as error:
            self._failure = str(error)
            return None
        return Others(obstacles, self._other.claim, self._other.unknown, self._other.complete)

    def _verdict(self, others: Others | None, judge: Callable[[Others], Judgement]) -> Judgement:
        """Judge a plan; one that cannot be judged must not start, or not go on."""
        if others is not None:
            try:
                return judge(others)
            except ConstructionTwinError as error:
                self._failure = Sentence(
                    "reason.neighbour.not_compared", neighbour=self._settings.name, problem=error.sentence
                )
        return Judgement(True, 0.0, self._failure)

    def _poses(self) -> tuple[np.ndarray, ...]:
        try:
            return self._own.poses(OTHER_POSE_AGE)
        except (PoseUnknownError, PayloadError):
            return ()

    def _publish(self, plan_id: str, verdict: Judgement, stamp: rospy.Time) -> None:
        message = ConflictMsg(
            neighbour=self._settings.name,
            plan_id=plan_id,
            conflict=verdict.blocked,
            time=verdict.time,
            reason=verdict.sentence,
        )
        message.header.stamp = stamp
        self._publisher.publish(message)
        logged = LoggedVerdict(verdict.blocked, verdict.time < 0.0)
        if self._logged.get(plan_id) != logged:
            self._logged[plan_id] = logged
            (rospy.logwarn if verdict.blocked else rospy.loginfo)("plan %s: %s", plan_id, verdict.sentence)

    def _forget(self, kept: dict) -> None:
        self._judge.forget(kept)
        self._logged = {plan_id: logged for plan_id, logged in self._logged.items() if plan_id in kept}

    def _sum_up(self, verdicts: dict[str, Judgement], others: Others | None) -> None:
        if self._failure or others is None:
            self._note(ERROR, self._failure, {"obstacles": 0})
            return
        blocked = "; ".join(verdict.sentence for verdict in verdicts.values() if verdict.blocked)
        sentence = (
            blocked or others.unknown or Sentence("reason.neighbour.blocks_nothing", neighbour=self._settings.name)
        )
        self._note(WARN if blocked or others.unknown else OK, sentence, {"obstacles": len(others.obstacles)})

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        return self._state

    def _note(self, level: int, sentence: str, values: dict) -> None:
        known = {"checks": self._checks, "longest check": f"{self._longest:.4f}", "horizon": f"{self._horizon:.2f}"}
        self._state = Report(level, sentence, known | values)


def start(settings: NeighbourSettings, robot: RobotModel, ports: Ports) -> NeighbourNode:
    """Return the watch with its parameters and topics."""
    refuse = ports.diagnostics.refuse
    await_robot(settings.name)
    other = listen_to_other_arm(robot.name, settings, refuse, streams=True)
    own = ArmListener(robot, rosgraph.names.namespace(rospy.get_namespace()), refuse, streams=True)
    timeout = VERDICT_TIMEOUT / NANOSECONDS
    horizon = braking_horizon(robot, other.robot, OTHER_POSE_AGE, timeout, DELAY)
    judge = PathJudge(robot, settings.name, settings.watch_padding, OWN_STEP, horizon)
    rospy.loginfo("watches %s; a conflict is acted upon at least %.2f s ahead", settings.name, horizon)
    return NeighbourNode(settings, own, other, judge, horizon, ports.publishers["conflict"])


INTERFACE = Interface(
    report=NeighbourNode.report,
    publishes=(Publication("conflict", ConflictMsg, queue_size=10),),
    listeners=(*ARM_TOPICS, *ARM_POSES),
)
NODE = NodeShell("neighbour", NeighbourSettings, start, INTERFACE)


def main() -> None:
    """Run the node until shutdown."""
    NODE.run()
