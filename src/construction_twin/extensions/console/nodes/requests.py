"""Motions from planners elsewhere, plan and IK requests: handed to the planner's own services, and answered. Nothing here moves."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import genpy
import numpy as np
import rospy
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.extensions import import_extension
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.nodes.endpoint import Connection, IncomingRequest, NewestQueue, RequestQueue
from construction_twin.extensions.console.remote_view import ClosestView
from construction_twin.link.requests import GoalRequest, IkRequest, Joints, read_goal
from construction_twin.mqtt.requests import IK, NAMELESS_TRAJECTORY, PLAN_REQUEST, TRAJECTORY
from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import quaternion_to_rotation
from construction_twin.robot.motion_errors import SceneError
from construction_twin.ros.messages.services import PLAN_SERVICES, Outcome
from construction_twin.ros.transport.persistent_service import call
from construction_twin.scene.objects import Scene
from construction_twin.srv import PlanTrajectoryResponse

if TYPE_CHECKING:
    from construction_twin.kinematics.solution import InverseKinematics
    from construction_twin.robot.plan import Clearance
    from construction_twin.scene.collision_world import CollisionWorld
    from construction_twin.views.reachability import PoseVerdict

#: Motions and plan requests that may wait while one is carried out; a person sends one at a time.
WAITING = 4
#: For so long after its answer the same bytes are the same message, sent twice by QoS 1 or by a sender that was run again [s].
REPEAT_WINDOW = 5.0
#: Accounts whose poses wait at once; each has one at most.
IK_ACCOUNTS = 16
#: Time for one pose, of an arm that is solved by search [s].
IK_BUDGET = 0.03
#: How often the closest two bodies are looked for [s].
CLOSEST_PERIOD = 0.2


@dataclass(frozen=True)
class RobotContext:
    """What these requests need to know of the robot: `twin` returns joint values [rad], [m], none while they are not known."""

    twin: Callable[[], Sequence[float]]
    has_work: Callable[[], bool] = lambda: False
    is_engaged: Callable[[], bool] = lambda: False


class PoseJudge:
    """Joint values for a pose that is dragged, and how close the arm is to something, for one thread at a time.

    What computes with the robot is imported at the first question: most starts have no console.

    Args:
        self_collision: YAML of the link pairs that are not checked; empty: nothing can be judged.
    """

    def __init__(self, robot: RobotModel, self_collision: str, scene: Callable[[], Scene | None]):
        self._robot, self._path, self._scene = robot, self_collision, scene
        self._solver: InverseKinematics | None = None
        self._world: CollisionWorld | None = None

    def judge(self, position: Sequence[float], rotation: np.ndarray, seed: Sequence[float]) -> PoseVerdict:
        """Return whether a pose of the tool can be reached, and with which joint values, nearest to a seed.

        Args:
            position: In the base_link [m].
            rotation: Shape (3, 3)
            seed: [rad], [m]; brought into the joints' ranges.

        Raises:
            ConfigurationError, SceneError: When robot or scene cannot be used, or the scene is not known yet.
        """
        from construction_twin.kinematics.chain import Chain, Pose
        from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
        from construction_twin.views.reachability import judge_pose

        world = self._present_world()
        if self._solver is None:
            settings = IkSettings(budget_s=IK_BUDGET)
            self._solver = inverse_kinematics(Chain(self._robot), settings, np.random.default_rng(0), time.monotonic)
        near = np.clip(seed, self._robot.lower, self._robot.upper)
        return judge_pose(Pose(np.array(position, dtype=float), rotation), near.tolist(), self._solver, world)

    def closest(self, q: Sequence[float]) -> Clearance | None:
        """Return the two bodies that are closest at a pose, of those whose distance some joint changes; None where nothing is
        checked or no scene known; raises as `judge`.
        """
        if not self._path or self._scene() is None:
            return None
        clearance = self._present_world().clearance(list(q), changing=True)
        return clearance if clearance.between else None

    def _present_world(self) -> CollisionWorld:
        scene = self._scene()
        if not self._path:
            raise ConfigurationError("self_collision", "", "the YAML of the link pairs that are not checked")
        if scene is None:
            raise ConfigurationError("scene", None, "a scene; see why the scene node is down")
        if self._world is None:
            from construction_twin.scene.collision_world import CollisionWorld
            from construction_twin.scene.self_collision import read_self_collision

            self._world = CollisionWorld(self._robot, scene, read_self_collision(self._path, self._robot))
        elif self._world.scene is not scene:
            self._world = self._world.with_scene(scene)
        return self._world


class ConsoleRequests:
    """What carries out motions, plan and IK requests.

    Args:
        max_trajectory_bytes: Longest motion that is read; 0: neither motions nor plan requests are taken.

    Attributes:
        queue: Where motions and plan requests wait.
        poses: Where poses wait, for a thread of their own.
    """

    def __init__(
        self,
        joints: Joints,
        services: Mapping[str, rospy.ServiceProxy],
        plan_trajectory: rospy.ServiceProxy,
        judge: PoseJudge,
        context: RobotContext,
        connection: Connection,
        max_trajectory_bytes: int,
    ):
        self._joints, self._connection = joints, connection
        self._services, self._plan_trajectory, self._judge, self._context = services, plan_trajectory, judge, context
        assert PLAN_REQUEST.pace is not None and IK.pace is not None
        self.queue = RequestQueue(WAITING, PLAN_REQUEST.pace, REPEAT_WINDOW)
        self.poses = NewestQueue(IK_ACCOUNTS, IK.pace)
        self._closest: tuple[ClosestView, float] | None = None
        self._closest_fault = ""
        connection.serve(IK, IkRequest, self._solve, self.poses)
        if max_trajectory_bytes:
            for kind in (NAMELESS_TRAJECTORY, TRAJECTORY):
                read = partial(import_extension("planners.remote_trajectory").parse_trajectory, joints=joints)
                connection.serve(replace(kind, limit=max_trajectory_bytes), read, self._check_motion, self.queue)
            connection.serve(PLAN_REQUEST, partial(read_goal, joints=joints), self._plan, self.queue)

    # -- motions

    def _check_motion(self, asked: Any, request: IncomingRequest) -> Outcome:
        """Have a motion, a `TrajectoryRequest` of the extension planners, checked and timed."""
        answer = call(
            self._plan_trajectory,
            "the planner",
            trajectory=trajectory_message(asked, self._joints),
            speed_scale=asked.speed_scale,
            acceleration_scale=asked.acceleration_scale,
            retime=True,
            source=source_of(asked.source, request.account, self._connection.proves_accounts),
        )
        outcome = Outcome.of(answer)
        return replace(outcome, fields={**outcome.fields, "notes": _timing_notes(asked, answer)})

    # -- plan requests

    def _plan(self, asked: GoalRequest, request: IncomingRequest) -> Outcome:
        kind = asked.kind
        if kind == "way_back" and self._context.has_work() and self._context.is_engaged():
            # the node `work` makes the scene right before it has the way back planned
            kind = "work_task"
        if kind == "work_task" and not self._context.has_work():
            return Outcome(
                False, Sentence("no building model is worked on here; start bringup with work_model and work_cell")
            )
        # a stop between the message and its turn voids the plan
        source = source_of("", request.account, self._connection.proves_accounts)
        fields = PLAN_SERVICES[kind].fields(asked, source=source, asked=str(request.arrived))
        return Outcome.of(call(self._services[kind], "its node", **fields))

    # -- IK requests

    def _solve(self, asked: IkRequest, _request: IncomingRequest) -> Outcome:
        seed = self._joints.in_order(asked.seed, "seed") if asked.seed else tuple(self._context.twin())
        if not seed:
            return Outcome(False, Sentence("the twin's pose is not known, and no seed was given"))
        try:
            verdict = self._judge.judge(asked.position, quaternion_to_rotation(asked.orientation), seed)
        except (ConfigurationError, SceneError) as error:
            raise PayloadError("ik", str(error)) from error
        joints = None if verdict.q is None else dict(zip(self._joints.names, map(float, verdict.q)))
        found = {"reach": verdict.reach.value, "joints": joints, "between": verdict.between}
        return Outcome(joints is not None, verdict.sentence, fields=found, counted=verdict.reach.value)

    # -- the closest two bodies

    def update_closest(self) -> None:
        """Find the two bodies that are closest at the twin's pose."""
        q = tuple(self._context.twin())
        clearance, found, problem = None, None, ""
        try:
            clearance = self._judge.closest(q) if q else None
        except (ConfigurationError, SceneError) as error:
            problem = str(error)
        if problem and problem != self._closest_fault:
            self._connection.refuse("closest", problem)
        self._closest_fault = problem
        if clearance is not None:
            found = ClosestView(clearance.distance, clearance.between, clearance.point, 0.0), time.monotonic()
        self._closest = found

    def closest(self) -> ClosestView | None:
        """Return what `update_closest` found last, with its age."""
        found = self._closest
        return None if found is None else replace(found[0], age=time.monotonic() - found[1])

    def run(self, with_closest: bool) -> None:
        """Answer poses until shutdown, and look around between them."""
        due = 0.0
        while not rospy.is_shutdown():
            self.poses.run(CLOSEST_PERIOD)
            if with_closest and time.monotonic() >= due:
                due = time.monotonic() + CLOSEST_PERIOD
                self.update_closest()


def source_of(says: str, sender: str, proven: bool) -> str:
    """Return who asked, for the reviewer, with what the sender `says` of itself.

    Args:
        proven: The broker knows accounts, and by a site's rules only this one writes on that topic.
    """
    if not sender:
        known = "MQTT, sender not known"
    else:
        known = f"MQTT account {sender}" if proven else f"MQTT, on the topic of {sender}"
    return f"{known}, which says it is {says!r}" if says else known


def trajectory_message(asked: Any, joints: Joints) -> JointTrajectory:
    """Return the motion as `plan_trajectory` takes it; its header has no stamp, because a foreign clock proves nothing."""
    points = [
        JointTrajectoryPoint(
            positions=point.positions,
            velocities=point.velocities,
            accelerations=point.accelerations,
            time_from_start=genpy.Duration(*divmod(point.time_ns, NANOSECONDS)),
        )
        for point in asked.points
    ]
    return JointTrajectory(joint_names=list(joints.names), points=points)


def _timing_notes(asked: Any, answer: PlanTrajectoryResponse) -> list[str]:
    """Return that the times were replaced, and why, where they were."""
    if not answer.retimed:
        return []
    requested = (asked.points[-1].time_ns - asked.points[0].time_ns) / NANOSECONDS
    return [f"timed anew: {answer.duration:.3f} s instead of {requested:.3f} s, because {answer.retimed}"]
