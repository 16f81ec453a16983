"""neighbour: publishes on `conflict` whether our arm's plan, else its newest one, meets the other arm; obstacles of that arm."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import pydantic
import rosgraph
import rospy

from construction_twin import msg
from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError
from construction_twin.core.sentences import Sentence
from construction_twin.execution.states import ACTIVE, ExecutorState
from construction_twin.planning.limit_usage import cycle_times
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import PlanningError, SceneError
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.convert import change_from_msg, plan_from_msg
from construction_twin.ros.messages.records import with_sentences
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.params import NodeSettings, robot_from_parameters
from construction_twin.ros.transport.joint_stream import from_time
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.publisher import AnyPublisher
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.scene.collision_world import CollisionWorld, Contact
from construction_twin.scene.neighbour import Neighbour, Obstacle, key_rows, load_cell
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision


class NeighbourUnknownError(PlanningError):
    """The pose or plan of the other arm is unknown; it is never taken to be absent."""

    def __init__(self, neighbour: str, problem: str):
        super().__init__(
            Sentence(
                "where {neighbour} is, or goes, is not known: {problem}; start it, or this robot without a neighbour",
                neighbour=neighbour,
                problem=problem,
            )
        )


Refuse = Callable[[str, str], None]
#: Oldest pose of the other arm that counts [s since its reception]. The poses come 250 times a second.
OTHER_POSE_AGE = 0.5
#: A joint that is no further from a path is on it [rad] or [m]; the paddings cover that.
ON_PATH = 0.01
#: Plans kept: the one that is played, the one under review, and a few that were replaced meanwhile.
_MAX_PLANS = 8


class NeighbourSettings(NodeSettings):
    """Parameters ``neighbour/...`` of a robot that has another one, `name`, beside it; see config/neighbour.yaml. Lengths in m."""

    name: Annotated[str, pydantic.Field(min_length=1)]
    padding: Annotated[float, pydantic.Field(ge=0.01, le=10.0)]


class Claim(NamedTuple):
    """An arm's claim from a plan's approval to its end, by its first setpoint [ns] (inf before); the smaller one goes first."""

    since: float
    robot: str
    plan_id: str


def plan_rows(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return the times [s] of a plan's setpoints and its end, shape (m,), and the joint values then, shape (m, n)."""
    trajectory = plan.trajectory
    times = cycle_times(trajectory)
    times = np.append(times[times < trajectory.duration], trajectory.duration)
    return times, trajectory.sample_many(times)[0]


#: Subscribed topics of an arm, and its polled poses: without a physical arm the first one alone.
ARM_TOPICS = {"plan": msg.Plan, "execution": msg.Execution, "scene": msg.Scene}
ARM_POSES = ("twin/joint_states", "physical/joint_states")


class ArmListener:
    """Listens to an arm's own topics in namespace `above`, ``/`` or ``/cell/``."""

    def __init__(self, robot: RobotModel, above: str, refused: Refuse):
        self.robot = robot
        # None before the first
        self.newest: Plan | None = None
        self.scene: Scene | None = None
        self._space = f"{above}{robot.name}"
        self._refused = refused
        self._lock = threading.Lock()
        self._plans: dict[str, tuple[Plan, tuple[SceneObject, ...]]] = {}
        self._execution: msg.Execution | None = None
        handlers = (self._on_plan, self._on_execution, self._on_scene)
        for (topic, kind), callback in zip(ARM_TOPICS.items(), handlers):
            Subscriber(f"{self._space}/{topic}", kind, callback, refused, queue_size=10)

    def claim(self) -> Claim | None:
        """Return the claim of the plan under way, if any; NeighbourUnknownError while that is unknown."""
        last = self._execution
        if last is None:
            raise NeighbourUnknownError(self.robot.name, Sentence("its executor has said nothing yet"))
        if ExecutorState(last.state) not in ACTIVE:
            return None
        return Claim(from_time(last.plan_start) or math.inf, self.robot.name, last.plan_id)

    def plan(self, plan_id: str) -> Plan:
        """Return a plan; NeighbourUnknownError if it is not known."""
        with self._lock:
            if plan_id in self._plans:
                return self._plans[plan_id][0]
        raise NeighbourUnknownError(
            self.robot.name, Sentence("it follows plan {plan}, which came before this node was started", plan=plan_id)
        )

    def carrying(self, plan: Plan, scene: Scene) -> Scene:
        """Return a scene in which the arm carries all loads of a plan at once."""
        with self._lock:
            _, carried = self._plans.get(plan.id, (plan, ()))
        objects = {item.name: item for item in (*scene.objects, *carried)}
        return Scene(tuple(objects.values()), scene.padding)

    def _on_plan(self, message: msg.Plan) -> None:
        try:
            plan = plan_from_msg(message)
            put = (item for segment in message.segments for item in change_from_msg(segment).put)
            carried = tuple(item for item in put if item.link)
        except ConstructionTwinError as error:
            self._refused("plan", f"{self._space}/plan: {error}")
            return
        with self._lock:
            self._plans[plan.id], self.newest = (plan, carried), plan
            playing = "" if self._execution is None else self._execution.plan_id
            for plan_id in [*self._plans][:-_MAX_PLANS]:
                if plan_id != playing:
                    del self._plans[plan_id]

    def _on_execution(self, message: msg.Execution) -> None:
        if message.state not in ExecutorState._value2member_map_:
            self._refused("execution", f"{self._space}/execution: state {message.state}")
            return
        self._execution = message

    def _on_scene(self, message: msg.Scene) -> None:
        try:
            self.scene = scene_from_msg(message)
        except ConstructionTwinError as error:
            self.scene = None
            self._refused("scene", f"{self._space}/scene: {error}")


@dataclass(frozen=True)
class OccupiedSpace:
    """The space that the other arm occupies: along the whole path of the plan that it follows, else where it is (`claim` None)."""

    claim: Claim | None
    obstacles: tuple[Obstacle, ...]


class OtherArm:
    """The other arm as obstacles in the world of ours, by its commanded and measured poses. For one thread."""

    def __init__(self, listener: ArmListener, poses: tuple[LatestPose, ...], arm: Neighbour):
        self._listener = listener
        self._poses = poses
        self._arm = arm
        self._shape = arm
        self._rows, self._path = np.empty(0), tuple[Obstacle, ...]()
        self._known: tuple[Scene, str] | None = None

    def occupied(self) -> OccupiedSpace:
        """Return the space that it occupies, the same object while that is the same; NeighbourUnknownError if not known."""
        name, scene, claim = self._arm.name, self._listener.scene, self._listener.claim()
        if scene is None:
            raise NeighbourUnknownError(name, Sentence("its scene, with what it carries, was not received"))
        known = scene, "" if claim is None else claim.plan_id
        if self._known != known:
            plan = None if claim is None else self._listener.plan(claim.plan_id)
            carried = scene if plan is None else self._listener.carrying(plan, scene)
            try:
                self._shape = self._arm.carrying(carried.objects)
            except SceneError as error:
                problem = Sentence("what it carries cannot be used: {problem}", problem=str(error))
                raise NeighbourUnknownError(name, problem) from error
            self._rows = np.empty(0) if plan is None else plan_rows(plan)[1]
            self._path = () if plan is None else self._shape.space_along(self._rows)
            self._known = known
        try:
            ends = [stream.pose(OTHER_POSE_AGE) for stream in self._poses]
        except (PoseUnknownError, PayloadError) as error:
            raise NeighbourUnknownError(name, str(error)) from error
        if claim is None:
            return OccupiedSpace(None, self._shape.space_between(ends[0], ends[-1]))
        away = max(float(np.abs(self._rows - end).max(axis=1).min()) for end in ends)
        if away > ON_PATH:
            beside = Sentence("a joint is {away:.3f} beside the path of plan {plan}", away=away, plan=claim.plan_id)
            raise NeighbourUnknownError(name, beside)
        return OccupiedSpace(claim, self._path)

    def claim(self) -> Claim | None:
        """Return its claim; raises like `ArmListener.claim`."""
        return self._listener.claim()


def await_robot(name: str) -> None:
    """Wait until the robot beside the node's own is launched; rospy.ROSInterruptException when ROS ends before."""
    space = f"{rosgraph.names.namespace(rospy.get_namespace())}{name}"
    needed = (f"{space}/robot_description", f"{space}/executor/arm")
    if not all(map(rospy.has_param, needed)):
        rospy.logwarn("waiting for %s, the other robot of the cell, which is not launched", space)
    while not all(map(rospy.has_param, needed)):
        rospy.sleep(0.5)


def listen_to_other_arm(own: str, settings: NeighbourSettings, refused: Refuse) -> OtherArm:
    """Return the other arm of the cell, listening to its topics; `own` is the name of our robot there."""
    above = rosgraph.names.namespace(rospy.get_namespace())
    space = f"{above}{settings.name}"
    robot = robot_from_parameters(f"{space}/")
    arm = Neighbour(settings.name, robot, load_cell(rospy.get_param("cell", None)).root_T_root(own, settings.name))
    topics = ARM_POSES[:1] if rospy.get_param(f"{space}/executor/arm", "") == "none" else ARM_POSES
    poses = tuple(LatestPose(f"{space}/{topic}", robot.joint_names, refused) for topic in topics)
    return OtherArm(ArmListener(robot, above, refused), poses, arm)


def neighbour_obstacles(robot: RobotModel, refuse: Refuse) -> Callable[[], list[Obstacle]] | None:
    """Return what makes obstacles of the cell's other arm, once it is launched; None for a robot alone."""
    values = rospy.get_param("neighbour", None)
    if values is None:
        return None
    settings = NeighbourSettings.read(values, rospy.resolve_name("neighbour"))
    await_robot(settings.name)
    other = listen_to_other_arm(robot.name, settings, refuse)
    return lambda: [item.padded(settings.padding) for item in other.occupied().obstacles]


#: Checks per second. The executor takes a verdict for 0.5 s.
RATE = 10.0


def first_meeting(
    world: CollisionWorld, plan: Plan, obstacles: Iterable[Obstacle], padding: float
) -> tuple[float, Contact] | None:
    """Return when a plan first comes too close to the other arm [s] and what does, None if nothing does.

    Poses are checked between which no point moves further than the padding, and half of that is kept besides a quarter: a plan
    made with the whole padding is free. `world`: of our arm with all that it will carry.
    """
    combined = world.with_neighbour((item.padded(0.75 * padding) for item in obstacles), alone=True)
    times, qs = plan_rows(plan)
    rows = key_rows(np.append(0.0, np.cumsum(np.abs(np.diff(qs, axis=0)) @ combined.levers)), padding)
    index = combined.all_free(qs[rows])
    if index is None:
        return None
    contact = combined.contact(qs[rows[index]])
    assert contact is not None, "all_free and contact disagree"
    return float(times[rows[index]]), contact


class NeighbourNode:
    """ROS around `first_meeting`: two arms' topics in, verdicts on a plan of ours out."""

    def __init__(
        self, own: ArmListener, other: OtherArm, world: CollisionWorld, padding: float, conflict: AnyPublisher
    ):
        self._own = own
        self._other = other
        self._world = world
        self._padding = padding
        self._publisher = conflict
        self._state = Diagnosis(WARN, "no plan yet")
        self._checked: tuple[Plan, Scene, tuple[Obstacle, ...]] | None = None
        self._met: tuple[float, Contact] | None = None
        self._logged: tuple[str, str] | None = None

    def run(self) -> None:
        """Check again and again, in the main thread: an unexpected exception ends the process, which is then started anew."""
        rate = rospy.Rate(RATE)
        while not rospy.is_shutdown():
            self.check()
            rate.sleep()

    def check(self) -> None:
        """Publish the verdict on the plan that is played, else on our newest."""
        try:
            own = self._own.claim()
            plan = self._own.newest if own is None else self._own.plan(own.plan_id)
        except NeighbourUnknownError as error:
            # whether it is played is not known: without a word nothing starts, and nothing stops
            self._state = Diagnosis(WARN, str(error))
            return
        if plan is None:
            return
        try:
            problem = self._obstacle(plan, own)
        except ConstructionTwinError as error:
            problem = str(error)
        self._publish(plan, problem)
        sentence = problem or "its path is free"
        self._state = Diagnosis(WARN if problem else OK, sentence)
        if self._logged != (plan.id, problem):
            self._logged = plan.id, problem
            (rospy.logwarn if problem else rospy.loginfo)("plan %s: %s", plan.id, sentence)

    def _publish(self, plan: Plan, problem: str) -> None:
        message = msg.Conflict(plan_id=plan.id, conflict=bool(problem), reason=problem)
        self._publisher.publish(with_sentences(message, problem))

    def _obstacle(self, plan: Plan, own: Claim | None) -> str:
        """Return the conflict of a plan with the other arm's earlier plan, or its present place; "" for none."""
        scene, plays = self._own.scene, own is not None and own.plan_id == plan.id
        try:
            occupied = self._other.occupied()
        except NeighbourUnknownError:
            if plays:
                return ""
            raise
        if own is not None and plays and occupied.claim is not None and own < occupied.claim:
            return ""
        if scene is None:
            return "" if plays else Sentence("our own scene, with what the arm carries, was not received")
        inputs = plan, scene, occupied.obstacles
        if self._checked is None or any(one is not other for one, other in zip(inputs, self._checked)):
            if occupied.claim is not None and not plays:
                # this takes about a second, in which no earlier word may start it
                self._publish(
                    plan, Sentence("its path is being compared with a plan of the other arm; approve it after that")
                )
            world = self._world.with_scene(self._own.carrying(plan, scene))
            self._met, self._checked = first_meeting(world, plan, occupied.obstacles, self._padding), inputs
            if self._other.claim() != occupied.claim:
                # one of its plans was approved, or ended, during the comparison
                return self._obstacle(plan, self._own.claim())
        if self._met is None:
            return ""
        seconds, contact = self._met
        mine, theirs = contact.between
        too_close = Sentence(
            "{mine} would come too close to {theirs} in {seconds:.1f} s", mine=mine, theirs=theirs, seconds=seconds
        )
        return Sentence(
            "{contact}, which stands there" if occupied.claim is None else "{contact}, which follows an approved plan",
            contact=too_close,
        )

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        return self._state


def start(settings: NeighbourSettings, robot: RobotModel, node_io: shell.NodeIO) -> NeighbourNode:
    """Return the watch with its parameters and topics."""
    refuse = node_io.diagnostics.refuse
    await_robot(settings.name)
    other = listen_to_other_arm(robot.name, settings, refuse)
    own = ArmListener(robot, rosgraph.names.namespace(rospy.get_namespace()), refuse)
    world = CollisionWorld(robot, Scene(()), SelfCollision({}, ""))
    return NeighbourNode(own, other, world, settings.padding, node_io.publishers["conflict"])


INTERFACE = shell.Interface(
    diagnose=NeighbourNode.diagnose,
    publishes=(shell.Publication("conflict", msg.Conflict, queue_size=10),),
    listeners=(*ARM_TOPICS, *ARM_POSES),
)
NODE = shell.NodeShell("neighbour", NeighbourSettings, start, INTERFACE)
main = NODE.run
