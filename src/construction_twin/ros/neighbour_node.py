"""neighbour: watches whether the other arm stands in the way of our plans (`conflict`), while they wait and while they run."""

from __future__ import annotations

import time

import rospy

from construction_twin.errors import PayloadError, PoseUnknownError
from construction_twin.motion_errors import NeighbourUnknownError
from construction_twin.msg import Conflict as ConflictMsg
from construction_twin.plan import Plan
from construction_twin.planning.conflict import Claim, Conflict, OwnWay, braking_horizon, gives_way
from construction_twin.planning.plan_book import PlanUnknownError
from construction_twin.ros.diagnostics import OK, WARN, NodeDiagnostics
from construction_twin.ros.neighbour import ArmListener, OtherArm, neighbour_settings
from construction_twin.ros.node import run_node
from construction_twin.ros.params import robot_from_parameters
from construction_twin.ros.publisher import Publisher
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.scene.world import CollisionWorld

#: From a look to the first braking setpoint, at most [s]: one message and a few cycles of the executor, on a busy machine.
DELAY = 0.1


class NeighbourNode:
    """Two arms' topics in, verdicts on our plans out."""

    def __init__(self):
        settings = neighbour_settings()
        self._robot = robot = robot_from_parameters()
        self._settings = settings
        self._self_collision = read_self_collision(settings.self_collision, robot)
        self._state = (WARN, "nothing to watch yet", {})
        self._looks, self._longest = 0, 0.0
        self._ways: dict[str, OwnWay] = {}
        self._world: CollisionWorld | None = None
        self._row = 0
        self._said: dict[str, str] = {}
        self._diagnostics = NodeDiagnostics(robot.name, lambda: self._state)
        self._other = OtherArm(robot.name, settings, self._diagnostics.refuse, streams=True)
        self._own = ArmListener(robot, self._diagnostics.refuse, streams=True)
        self._horizon = braking_horizon(robot, self._other.robot, 1.0 / settings.rate, DELAY)
        self._publisher = Publisher("conflict", ConflictMsg, queue_size=10)
        self._timer = rospy.Timer(rospy.Duration(1.0 / settings.rate), self._on_timer)
        rospy.loginfo("watches %s; a conflict is acted upon at least %.2f s ahead", settings.name, self._horizon)

    def _on_timer(self, _event) -> None:
        began = time.monotonic()
        self._look()
        self._looks += 1
        self._longest = max(self._longest, time.monotonic() - began)

    def _look(self) -> None:
        """Judge the plan that is played and the one that waits."""
        try:
            followed, started, waiting = self._own.plans()
        except PlanUnknownError as error:
            self._report(WARN, f"our own plan is not known: {error}", {})
            return
        obstacles, problem = self._other_arm()
        verdicts = {}
        if followed is None:
            self._row = 0
        else:
            verdicts[followed.id] = self._judge(followed, obstacles, problem, Claim(started, self._robot.name))
        if waiting is not None:
            verdicts[waiting.id] = self._judge(waiting, obstacles, problem, Claim(0, self._robot.name))
        for plan_id, (conflict, time_to, sentence) in verdicts.items():
            self._publish(plan_id, conflict, time_to, sentence)
        self._forget(verdicts)
        blocked = [sentence for conflict, _, sentence in verdicts.values() if conflict]
        sentence = "; ".join(blocked) or problem or f"{self._settings.name} is in nobody's way"
        self._report(WARN if blocked or problem else OK, sentence, {"obstacles": len(obstacles)})

    def _other_arm(self) -> tuple[tuple[Obstacle, ...], str]:
        """Return what the other arm takes up; if that is not known all that it can reach, and why."""
        try:
            return self._other.occupied(), ""
        except NeighbourUnknownError as error:
            return self._other.anywhere(), str(error)

    def _judge(self, plan: Plan, obstacles: tuple, problem: str, own: Claim) -> tuple[bool, float, str]:
        """Return whether a plan must not start or go on, the time until the conflict [s], and one sentence."""
        if problem and not own.since:
            return True, 0.0, problem
        way = self._way(plan)
        if way is None:
            return True, 0.0, "our own scene, with what the arm carries, was not received"
        row = self._present_row(way) if own.since else 0
        conflict = way.conflict(obstacles, self._settings.watch_padding, row)
        if conflict is None:
            return False, -1.0, "its way is free"
        other = None if problem else self._other.claim
        blocked = gives_way(conflict, own, other, self._horizon)
        return blocked, conflict.time, problem or self._sentence(conflict, other, blocked)

    def _sentence(self, conflict: Conflict, other: Claim | None, blocked: bool) -> str:
        mine, theirs = conflict.between
        meeting = f"{mine} would come too close to {theirs} in {conflict.time:.1f} s"
        if not blocked:
            return f"{meeting}; {self._settings.name} began later and gives way"
        if other is None:
            return f"{meeting}, which stands there"
        return f"{meeting}, which follows an approved plan"

    def _present_row(self, way: OwnWay) -> int:
        """Return how far our arm has come on the plan that it follows, measured or commanded, whichever is less."""
        try:
            poses = self._own.poses(self._settings.max_pose_age)
        except (PoseUnknownError, PayloadError):
            return self._row
        rows = [way.row_of(pose, self._row) for pose in poses]
        self._row = min(self._row if row is None else row for row in rows)
        return self._row

    def _way(self, plan: Plan) -> OwnWay | None:
        scene = self._own.scene
        if scene is None:
            return None
        if self._world is None or self._world.scene.hash != scene.hash:
            self._world, self._ways = CollisionWorld(self._robot, scene, self._self_collision), {}
        if plan.id not in self._ways:
            self._ways[plan.id] = OwnWay(plan, self._world, self._settings.own_step)
        return self._ways[plan.id]

    def _publish(self, plan_id: str, conflict: bool, time_to: float, sentence: str) -> None:
        message = ConflictMsg(
            neighbour=self._settings.name, plan_id=plan_id, conflict=conflict, time=time_to, reason=sentence
        )
        message.header.stamp = rospy.Time.now()
        self._publisher.publish(message)
        if self._said.get(plan_id) != (conflict, time_to < 0.0):
            self._said[plan_id] = (conflict, time_to < 0.0)
            (rospy.logwarn if conflict else rospy.loginfo)("plan %s: %s", plan_id, sentence)

    def _forget(self, kept: dict) -> None:
        for known in (self._ways, self._said):
            for plan_id in [name for name in known if name not in kept]:
                del known[plan_id]

    def _report(self, level: int, sentence: str, values: dict) -> None:
        known = {"looks": self._looks, "longest look": f"{self._longest:.4f}", "horizon": f"{self._horizon:.2f}"}
        self._state = (level, sentence, known | values)


def main() -> None:
    """Run the node until shutdown."""
    run_node("neighbour", NeighbourNode)
