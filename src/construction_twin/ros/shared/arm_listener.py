"""The other arm, from its own topics: the space that it occupies now and on the path that it follows. For planner and watch."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pydantic
import rosgraph
import rospy

from construction_twin.coordination.conflict import Claim
from construction_twin.coordination.path_judge import PlanBook, PlanUnknownError
from construction_twin.coordination.path_sweep import PathSweep, PlanPosition
from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError
from construction_twin.core.motion_errors import NeighbourUnknownError, SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.msg import Execution, Plan, Review, Scene
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan as PlanValue
from construction_twin.ros.messages.convert import plan_from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.params import NodeSettings, robot_from_parameters, settings_of
from construction_twin.ros.transport.joint_stream import from_time
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.scene.cell import load_cell
from construction_twin.scene.neighbour import Neighbour, Obstacle
from construction_twin.scene.objects import Scene as SceneValue

Refuse = Callable[[str, str], None]
_Length = Annotated[float, pydantic.Field(ge=0.01, le=1.0)]
_Distance = Annotated[float, pydantic.Field(ge=0.0, le=10.0)]
#: Largest distance that any point of our arm moves between two poses that the watch checks [m]; half of it is added.
OWN_STEP = 0.1
#: Oldest pose of either arm that counts [s since its reception]. Added to how far ahead a conflict must be seen. The poses come 250
#: times a second; twin and executor wait for each other as long.
OTHER_POSE_AGE = 0.5


class NeighbourSettings(NodeSettings):
    """Parameters ``neighbour/...`` of a robot that has another one beside it, explained in config/neighbour.yaml.

    The node `neighbour` owns them, and its ``realtime_priority`` is among them; the planner reads them, too.

    Attributes:
        name: Of the other robot: its namespace. Given in launch/twin.launch.
        padding, watch_padding, step: [m]
    """

    name: Annotated[str, pydantic.Field(min_length=1)]
    padding: _Distance
    watch_padding: _Distance
    step: _Length

    @pydantic.model_validator(mode="after")
    def _plans_may_start(self) -> NeighbourSettings:
        if self.watch_padding + OWN_STEP / 2.0 > self.padding:
            raise ValueError(Sentence("expected.watch_padding"))
        return self


def neighbour_settings(namespace: str = "") -> NeighbourSettings | None:
    """Return the settings of the robot in a namespace (``/kr120/``), by default the node's own; None for a robot alone.

    Raises:
        ConfigurationError: With the parameter's name, its value and what was expected.
    """
    name = f"{namespace}neighbour"
    values = rospy.get_param(name, None)
    if values is None:
        return None
    return settings_of(NeighbourSettings, values, rospy.resolve_name(name))


@dataclass(frozen=True)
class ArmPlans:
    """An arm's plans.

    Attributes:
        followed: The approved plan that it follows.
        started: Stamp of the first setpoint of that plan [ns]; 0: it has not begun.
        waiting: The plan that waits for review.
    """

    followed: PlanValue | None
    started: int
    waiting: PlanValue | None


#: What is heard of an arm, and the poses that are asked for: without a physical arm the first one alone.
ARM_TOPICS = {"plan": Plan, "execution": Execution, "review": Review, "scene": Scene}
ARM_POSES = ("twin/joint_states", "physical/joint_states")


class ArmListener:
    """Listens to an arm's own topics.

    Args:
        robot: Its name is its namespace.
        above: What that is in: ``/``, or ``/cell/``.
        refused: Called as ``refused(reason, sentence)`` for a message that is not used.
        streams: True: subscribe to the poses permanently. False: only during `poses`, which makes it about 50 ms slower and costs
            nothing otherwise.
    """

    def __init__(self, robot: RobotModel, above: str, refused: Refuse, streams: bool):
        self.robot = robot
        self._space = f"{above}{robot.name}"
        self._refused = refused
        self._lock = threading.Lock()
        self._book = PlanBook()
        self._scene: SceneValue | None = None
        self._alone = rospy.get_param(f"{self._space}/executor/arm", "") == "none"
        self._streams = self._open() if streams else None
        handlers = (self._on_plan, self._on_execution, self._on_review, self._on_scene)
        for (topic, kind), callback in zip(ARM_TOPICS.items(), handlers):
            Subscriber(f"{self._space}/{topic}", kind, callback, refused, queue_size=10)

    @property
    def scene(self) -> SceneValue | None:
        """Its scene; None before the first."""
        return self._scene

    def plans(self) -> ArmPlans:
        """Return the arm's plans; raises like `PlanBook.followed`."""
        with self._lock:
            return ArmPlans(self._book.followed(), self._book.started, self._book.waiting())

    def poses(self, oldest: float, patience: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return the commanded and the measured pose; the same twice for a robot without a physical arm.

        Raises:
            PoseUnknownError, PayloadError: As of `LatestPose.pose`.
        """
        with self._open_streams() as streams:
            twin, *physical = (np.array(stream.pose(oldest, patience)) for stream in streams)
        return twin, physical[0] if physical else twin

    @contextmanager
    def _open_streams(self) -> Iterator[list[LatestPose]]:
        if self._streams is not None:
            yield self._streams
            return
        streams = self._open()
        try:
            yield streams
        finally:
            for stream in streams:
                stream.close()

    def _open(self) -> list[LatestPose]:
        topics = ARM_POSES[:1] if self._alone else ARM_POSES
        return [LatestPose(f"{self._space}/{topic}", self.robot.joint_names, self._refused) for topic in topics]

    def _on_plan(self, message: Plan) -> None:
        try:
            plan = plan_from_msg(message)
        except ConstructionTwinError as error:
            self._refused("plan", f"{self._space}/plan: {error}")
            return
        with self._lock:
            self._book.on_plan(plan)

    def _on_execution(self, message: Execution) -> None:
        with self._lock:
            try:
                self._book.on_execution(message.state, message.plan_id, from_time(message.plan_start))
            except ValueError as error:
                self._refused("execution", f"{self._space}/execution: {error}")

    def _on_review(self, message: Review) -> None:
        with self._lock:
            self._book.on_verdict(message.plan_id, message.approved)

    def _on_scene(self, message: Scene) -> None:
        try:
            self._scene = scene_from_msg(message)
        except ConstructionTwinError as error:
            self._scene = None
            self._refused("scene", f"{self._space}/scene: {error}")


class OtherArm:
    """The other arm as obstacles in the world of ours.

    Not for use from several threads at once.

    Args:
        arm: The other robot without what it carries.
        max_pose_age: Older poses are not used [s].

    Attributes:
        complete: See `occupied`.
    """

    def __init__(self, listener: ArmListener, arm: Neighbour, max_pose_age: float):
        self.robot = listener.robot
        self._listener = listener
        self._max_pose_age = max_pose_age
        self._bare = arm
        self._carried_by = ""
        self._shape = arm
        self._sweeps: dict[str, PathSweep] = {}
        self._at = PlanPosition("", 0)
        self.claim: Claim | None = None
        self.unknown = ""
        self.complete = True

    def occupied(self, patience: float = 0.0, horizon: float = np.inf) -> tuple[Obstacle, ...]:
        """Return the space that the arm occupies: at its present pose, and on the rest of the path that it follows.

        Sets `claim`; `unknown`, the reason why the arm's whole reach is returned (its pose or its plan is not known), or empty; and
        `complete`, whether the result contains the path to its end.

        Args:
            patience: How long to wait for the poses [s].
            horizon: How far ahead the path must be included [s]. The rest is added in chunks by later calls.

        Raises:
            NeighbourUnknownError: If its load is not known, because its reach is then unknown, too.
        """
        name = self._bare.name
        self.claim, self.unknown, self.complete = None, "", True
        try:
            twin, physical = self._listener.poses(self._max_pose_age, patience)
            plans = self._listener.plans()
        except (PoseUnknownError, PayloadError, PlanUnknownError) as error:
            # after waiting for the poses, because its scene may have arrived meanwhile
            self._take_carried()
            self.unknown = str(NeighbourUnknownError(name, str(error)))
            return self._shape.anywhere()
        self._take_carried()
        followed = plans.followed
        self.claim = None if followed is None else Claim(plans.started, name)
        self._prepare(followed, plans.waiting if horizon < np.inf else None)
        if followed is None:
            return self._shape.between(physical, twin)
        sweep = self._sweeps[followed.id]
        known = self._at.row if self._at.plan_id == followed.id else 0
        rows = [sweep.row_of(twin, known), sweep.row_of(physical, known)]
        sweep.grow(sweep.row_after(max(known if row is None else row for row in rows), horizon))
        self.complete = sweep.complete
        self._at = PlanPosition(followed.id, min(known if row is None else row for row in rows))
        # an arm off the path (after a fault, or moved by hand) is somewhere between the two poses
        off = () if None not in rows else self._shape.between(physical, twin)
        return sweep.rest(self._at.row) + off

    def _take_carried(self) -> None:
        name, scene = self._bare.name, self._listener.scene
        if scene is None:
            raise NeighbourUnknownError(name, Sentence("motion.neighbour.no_scene"))
        if scene.hash != self._carried_by:
            try:
                self._shape = self._bare.carrying(scene.objects)
            except SceneError as error:
                raise NeighbourUnknownError(name, Sentence("motion.neighbour.load", problem=error.sentence)) from error
            self._carried_by, self._sweeps = scene.hash, {}

    def _prepare(self, *plans: PlanValue | None) -> None:
        """Compute one more chunk of the first incomplete plan; forget all plans except the given ones."""
        wanted = [plan for plan in plans if plan is not None]
        self._sweeps = {
            plan.id: self._sweeps.get(plan.id) or PathSweep(self._shape, plan.trajectory) for plan in wanted
        }
        for sweep in self._sweeps.values():
            if not sweep.complete:
                sweep.grow()
                return


def await_robot(name: str) -> None:
    """Wait until the robot beside the node's own is launched; rospy.ROSInterruptException when ROS ends before."""
    space = f"{rosgraph.names.namespace(rospy.get_namespace())}{name}"
    needed = (f"{space}/robot_description", f"{space}/executor/arm")
    if not all(map(rospy.has_param, needed)):
        rospy.logwarn("%s", Sentence("startup.other_robot", space=space))
    while not all(map(rospy.has_param, needed)):
        rospy.sleep(0.5)


def listen_to_other_arm(
    own: str, settings: NeighbourSettings, refused: Refuse, streams: bool, namespace: str = ""
) -> OtherArm:
    """Return the other arm of the cell, listening to its topics.

    Args:
        own: Name of our robot in the cell.
        refused: As in `ArmListener`.
        streams: As in `ArmListener`.
        namespace: Of our robot, ``/kr120/``; the node's own by default.

    Raises:
        ConfigurationError: If the other robot's description is missing, or the cell does not hold both.
    """
    above = rosgraph.names.namespace(namespace or rospy.get_namespace())
    robot = robot_from_parameters(f"{above}{settings.name}/")
    cell = load_cell(rospy.get_param(f"{namespace}cell", None))
    arm = Neighbour(settings.name, robot, cell.root_T_root(own, settings.name), settings.step)
    return OtherArm(ArmListener(robot, above, refused, streams), arm, OTHER_POSE_AGE)
