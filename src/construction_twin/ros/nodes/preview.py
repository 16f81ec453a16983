"""preview: shows the plan under review (`plan_markers`) and its rehearsal (`rehearsal_markers`) in rviz, and plays the plan with a
ghost (`preview/joint_states`).
"""

from __future__ import annotations

import threading
import time
from bisect import bisect_left

import pydantic
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError
from construction_twin.core.motion_errors import SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.msg import Execution, Plan, Rehearsal, Review
from construction_twin.msg import Scene as SceneMsg
from construction_twin.physics.report import RehearsalReport, is_whole
from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.plan import Plan as MadePlan
from construction_twin.ros.messages.convert import change_from_msg, plan_from_msg
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import SHAPES, body_marker, scene_from_msg, tf_frame
from construction_twin.ros.shared.diagnostics import OK, Report
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.ports import (
    Every,
    Interface,
    NewestPose,
    Ports,
    PosePublication,
    Publication,
    Served,
    Subscription,
)
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange
from construction_twin.srv import PreviewPlan, PreviewPlanRequest
from construction_twin.views.preview import TEXT_SIZE, PlanPicture, Preview, WorkContext, picture
from construction_twin.views.rehearsal_picture import (
    CONTACT,
    CONTACT_SIZE,
    LIMIT,
    TEXT_ROOM,
    RehearsalPicture,
    TorqueColumn,
    rehearsal_picture,
)
from construction_twin.views.rehearsal_picture import TEXT_SIZE as REHEARSAL_TEXT
from construction_twin.views.shown_poses import ShownPoses
from construction_twin.views.sync_picture import Shape, headline_height, visual_shapes
from construction_twin.views.work_picture import MOST_BODIES, WorkPath, WorkStates, work_states

#: How long a preview waits for the plan that was made just before [s].
PLAN_TIMEOUT = 1.0
#: The twin's pose counts as known this long after its last message [s].
TWIN_TIMEOUT = 0.5
PINK = ColorRGBA(1.0, 0.25, 0.65, 1.0)
ORANGE = ColorRGBA(1.0, 0.45, 0.0, 0.9)
DARK = ColorRGBA(0.1, 0.1, 0.15, 1.0)
#: The tool path of a work plan, neighbouring segments in two shades: free motion, and engaged.
PINKS = (PINK, ColorRGBA(0.8, 0.05, 0.4, 1.0))
BLUES = (ColorRGBA(0.1, 0.35, 1.0, 1.0), ColorRGBA(0.0, 0.7, 0.95, 1.0))
#: What the ghost carries, what is carried from one segment into the next, and what stands in the end.
GRIPPED, ON_THE_WAY, PLACED = (0.2, 0.65, 0.35, 0.6), (0.1, 0.35, 1.0, 0.18), (0.1, 0.85, 0.3, 0.6)
#: Width of the tool path, diameters of the closest point and of the end of a segment, height of its name and where that stands [m].
LINE_WIDTH, POINT_SIZE, MARK_SIZE, LABEL_SIZE = 0.012, 0.06, 0.035, 0.065
LABEL_AT = (0.0, 0.0, 0.1)
#: The line of an engaged segment is so much wider: the way there and the way back often lie on each other.
WIDER = 1.7
#: Between two poses of the ghost [s].
FRAME_PERIOD = 0.04
#: Rehearsals that are remembered: of the plan under review, and of those that come before it is offered.
REHEARSALS_KEPT = 4


class Settings(pydantic.BaseModel):
    """Private parameters, given in launch/twin.launch: what stands before the ghost's links in tf."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    tf_prefix: str


class PreviewNode:
    """ROS around a Preview."""

    def __init__(self, settings: Settings, robot: RobotModel, ports: Ports):
        self._robot = robot
        self._chain = Chain(self._robot)
        self._tf_prefix = settings.tf_prefix
        self._preview = Preview()
        self._scene: Scene | None = None
        self._changes: dict[str, tuple[SceneChange, ...]] = {}
        self._states: WorkStates | None = None
        self._gripped: tuple[SceneObject, ...] = ()
        self._still: list[Marker] = []
        self._rehearsals: dict[str, RehearsalReport] = {}
        #: Made when the first rehearsal comes: where there is none, nobody pays for them.
        self._bodies: RobotBodies | None = None
        self._shapes: tuple[Shape, ...] = ()
        self._rehearsal_drawn: tuple[str, str, bool] | None = None
        self._news = threading.Condition()
        self._frame = ""
        self._drawn: str | None = None
        self._diagnostics = ports.diagnostics
        self._ghost, self._markers = ports.publishers["preview/joint_states"], ports.publishers["plan_markers"]
        self._rehearsal = ports.publishers["rehearsal_markers"]
        self._twin = ports.poses["twin/joint_states"]
        self._shown: ShownPoses[tuple[int, tuple[float, ...]]] = ShownPoses()

    # -- subscriptions

    def on_plan(self, message: Plan) -> None:
        """Show a plan."""
        try:
            plan = plan_from_msg(message)
            changes = tuple(map(change_from_msg, message.segments))
        except ConstructionTwinError as error:
            self._diagnostics.refuse("plan", str(error))
            return
        with self._news:
            self._frame = message.header.frame_id
            self._changes = {plan.id: changes}
            self._preview.on_plan(plan)
            self._draw()
            self._news.notify_all()

    def on_scene(self, message: SceneMsg) -> None:
        """Take the scene in which a work plan may begin."""
        try:
            scene = scene_from_msg(message)
        except SceneError as error:
            self._diagnostics.refuse("scene", str(error))
            return
        with self._news:
            self._scene = scene
            plan = self._preview.under_review
            # after a start of this node the plan may come before the scene that it begins in
            if plan is not None and plan.scene == scene.hash:
                if plan.segments:
                    self._drawn = None
                self._draw()

    def on_rehearsal(self, message: Rehearsal) -> None:
        """Show what the rehearsal of the plan under review has found."""
        report = from_msg(RehearsalReport, message)
        if not is_whole(report) or len(report.worst_pose) not in (0, len(self._robot.joint_names)):
            self._diagnostics.refuse("rehearsal", Sentence("reason.refused.rehearsal", plan=repr(report.plan_id)))
            return
        with self._news:
            # it may come before its plan
            self._rehearsals.pop(report.plan_id, None)
            self._rehearsals[report.plan_id] = report
            while len(self._rehearsals) > REHEARSALS_KEPT:
                del self._rehearsals[next(iter(self._rehearsals))]
            self._draw_rehearsal()

    def on_review(self, message: Review) -> None:
        """Take a verdict."""
        with self._news:
            self._preview.on_verdict(message.plan_id, message.approved)
            self._draw()

    def on_execution(self, message: Execution) -> None:
        """Take away what was played."""
        if not message.plan_id:
            return
        with self._news:
            self._preview.on_verdict(message.plan_id, True)
            if message.outcome:
                self._preview.on_ending(message.plan_id)
            self._draw()

    # -- the ghost

    def on_preview(self, request: PreviewPlanRequest) -> str:
        """Play the plan under review with the ghost."""
        with self._news:
            if request.speed > 0.0:
                self._news.wait_for(lambda: self._preview.under_review is not None, PLAN_TIMEOUT)
            return self._preview.play(request.speed, request.loop, time.monotonic())

    def move_ghost(self) -> None:
        """Publish where the ghost is now."""
        try:
            twin = self._twin.pose(TWIN_TIMEOUT)
        except PoseUnknownError:
            twin = None  # before the first pose there is nothing to hide in; afterwards the ghost stays where it is
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            twin = None
        with self._news:
            if twin is not None:
                self._preview.on_twin(twin)
            now = time.monotonic()
            pose = self._preview.pose(now)
            self._grip(now)
        if pose is not None:
            shown = self._shown.take(now, (), pose, (now_ns(), pose))
            if shown is not None:
                self._ghost.publish(*shown)

    # -- the markers

    def _draw(self) -> None:
        """Publish the markers of another plan than the one drawn, or their removal."""
        self._draw_plan()
        self._draw_rehearsal()

    def _draw_plan(self) -> None:
        plan = self._preview.plan
        name = None if plan is None else plan.id
        if name == self._drawn:
            return
        self._drawn = name
        self._still, self._states = [_all_gone("plan")], None
        self._gripped = ()
        if plan is not None:
            chain = self._chain
            headline = headline_height(float(chain.shoulder[2]), chain.arm_length)
            told = None
            if plan.segments:
                changes = self._changes.get(plan.id, ())
                self._states = work_states(plan, changes, self._scene)
                told = WorkContext(changes, self._states, chain.forward, self._robot.tip_link)
            self._still += plan_markers(picture(plan, chain.skeleton, headline, told), self._frame)
        self._publish()
        self._grip(time.monotonic())

    def _draw_rehearsal(self) -> None:
        """Publish the markers of the rehearsal of the plan under review, or their removal."""
        plan = self._preview.under_review
        report = None if plan is None else self._rehearsals.get(plan.id)
        if plan is None or report is None or (report.plan_hash, report.scene) != (plan.hash, plan.scene):
            if self._rehearsal_drawn is not None:
                self._rehearsal_drawn = None
                self._rehearsal.publish(MarkerArray(markers=[_all_gone("rehearsal")]))
            return
        carried = self._carried(plan, report.worst_time)
        drawn = report.plan_id, report.hash, bool(carried)
        if drawn == self._rehearsal_drawn:
            return
        self._rehearsal_drawn = drawn
        if self._bodies is None:
            self._bodies, self._shapes = RobotBodies(self._robot), visual_shapes(self._robot.urdf)
        drawing = rehearsal_picture(
            report, self._shapes, self._bodies.link_pose, self._chain.arm_length, carried[:MOST_BODIES]
        )
        self._rehearsal.publish(MarkerArray(markers=[_all_gone("rehearsal"), *rehearsal_markers(drawing, self._frame)]))

    def _carried(self, plan: MadePlan, at: float) -> tuple[SceneObject, ...]:
        """Return what the arm carries at a time of a plan [s], where the scene that it begins in is known."""
        if self._states is not None:
            ends = [segment.end for segment in plan.segments]
            return self._states.carried[min(bisect_left(ends, at), len(ends) - 1)]
        if self._scene is None or self._scene.hash != plan.scene:
            return ()
        return tuple(item for item in self._scene.objects if item.link)

    def _grip(self, now: float) -> None:
        """Let the ghost carry what the arm will carry where the ghost is; the twin shows what is carried during execution."""
        gripped: tuple[SceneObject, ...] = ()
        if self._states is not None and self._preview.under_review is not None:
            number = self._preview.segment(now)
            gripped = self._states.carried[-1 if number is None else number][:MOST_BODIES]
        if gripped != self._gripped:
            self._gripped = gripped
            self._publish()

    def _publish(self) -> None:
        """Publish all that is drawn: who listens later hears the last message only."""
        grip = [
            _body(item, tf_frame(self._tf_prefix, item.link), GRIPPED, "plan_grip", number)
            for number, item in enumerate(self._gripped)
        ]
        self._markers.publish(MarkerArray(markers=[*self._still, *grip]))

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        plan = self._preview.plan
        return Report(OK, "no plan to show" if plan is None else f"shows plan {plan.id}")


def plan_markers(drawing: PlanPicture, frame: str) -> list[Marker]:
    """Return a plan's markers in the frame of its points: tool path, closest point, text; of a work plan segments and bodies."""
    path = _marker(frame, 0, Marker.LINE_STRIP, PINK, LINE_WIDTH)
    path.points = [Point(*point) for point in drawing.path.tolist()]
    text = _marker(frame, 1, Marker.TEXT_VIEW_FACING, DARK, TEXT_SIZE)
    text.text, text.pose.position = drawing.text, Point(*drawing.text_at)
    markers = [path, text] if drawing.work is None else [*work_markers(drawing.work, frame), text]
    if drawing.closest is not None:
        closest = _marker(frame, 2, Marker.SPHERE, ORANGE, POINT_SIZE)
        closest.pose.position = Point(*drawing.closest)
        markers.append(closest)
    return markers


def work_markers(work: WorkPath, frame: str) -> list[Marker]:
    """Return a work plan's markers: the tool path of each segment, where it ends and its name, and what is carried and placed."""
    markers = []
    for number, (points, engaged) in enumerate(zip(work.parts, work.engaged)):
        colour, width = (BLUES[number % 2], WIDER * LINE_WIDTH) if engaged else (PINKS[number % 2], LINE_WIDTH)
        part = _marker(frame, number, Marker.LINE_STRIP, colour, width, "plan_path")
        part.points = [Point(*point) for point in points.tolist()]
        markers.append(part)
    for number, (label, point) in enumerate(work.marks):
        mark = _marker(frame, number, Marker.SPHERE, DARK, MARK_SIZE, "plan_marks")
        mark.pose.position = Point(*point.tolist())
        name = _marker(frame, number, Marker.TEXT_VIEW_FACING, DARK, LABEL_SIZE, "plan_names")
        name.text, name.pose.position = label, Point(*(point + LABEL_AT).tolist())
        markers += [mark, name]
    for number, (item, pose) in enumerate(work.on_the_way):
        markers.append(_body(item, frame, ON_THE_WAY, "plan_on_the_way", number, pose))
    for number, item in enumerate(work.placed):
        markers.append(_body(item, frame, PLACED, "plan_placed", number))
    return markers


def rehearsal_markers(drawing: RehearsalPicture, frame: str) -> list[Marker]:
    """Return a rehearsal's markers in the frame of its points: arm, columns of torques, contacts, text."""
    markers = [
        _shape(shape, pose, frame, ColorRGBA(*drawing.ghost_colour), number)
        for number, (shape, pose) in enumerate(drawing.ghost)
    ]
    for number, (item, pose) in enumerate(drawing.carried):
        markers.append(_body(item, frame, drawing.ghost_colour, "rehearsal_carried", number, pose))
    for number, column in enumerate(drawing.columns):
        markers += _column(column, frame, number)
    for number, (point, said) in enumerate(drawing.contacts):
        place = _marker(frame, number, Marker.SPHERE, ColorRGBA(*CONTACT), CONTACT_SIZE, "rehearsal_contacts")
        place.pose.position = Point(*point)
        markers += [place, _text(said, frame, number, point, ColorRGBA(*CONTACT), "rehearsal_contact_names")]
    return [*markers, _text(drawing.text, frame, 0, drawing.text_at, ColorRGBA(*drawing.text_colour), "rehearsal")]


def _shape(shape: Shape, pose: Pose, frame: str, colour: ColorRGBA, number: int) -> Marker:
    marker = _marker(frame, number, SHAPES[shape.kind], colour, 1.0, "rehearsal_arm")
    marker.mesh_resource, marker.scale = shape.mesh, Vector3(*shape.scale)
    quaternion = rotation_to_quaternion(pose.rotation).tolist()
    marker.pose = PoseMsg(Point(*pose.position.tolist()), Quaternion(*quaternion))
    return marker


def _column(column: TorqueColumn, frame: str, number: int) -> list[Marker]:
    markers = []
    x, y, z = column.foot
    # the column inside of its limit
    for height, width, colour, kind in (
        (column.height, 0.7 * column.width, column.colour, "rehearsal_torques"),
        (column.limit, column.width, LIMIT, "rehearsal_limits"),
    ):
        if height > 0.0:
            bar = _marker(frame, number, Marker.CUBE, ColorRGBA(*colour), width, kind)
            bar.scale.z, bar.pose.position = height, Point(x, y, z + height / 2)
            markers.append(bar)
    top = (x, y, z + max(column.height, column.limit))
    return [*markers, _text(column.text, frame, number, top, DARK, "rehearsal_axes")]


def _text(said: str, frame: str, number: int, below, colour: ColorRGBA, namespace: str) -> Marker:
    text = _marker(frame, number, Marker.TEXT_VIEW_FACING, colour, REHEARSAL_TEXT, namespace)
    x, y, z = below
    text.text, text.pose.position = said, Point(x, y, z + TEXT_ROOM)
    return text


def _all_gone(namespace: str) -> Marker:
    return Marker(ns=namespace, action=Marker.DELETEALL)


def _body(
    item: SceneObject, frame: str, colour: tuple[float, ...], namespace: str, number: int, pose: Pose | None = None
) -> Marker:
    marker = body_marker(item, frame, colour, pose)
    marker.ns, marker.id = namespace, number
    return marker


def _marker(frame: str, number: int, kind: int, color: ColorRGBA, size: float, namespace: str = "plan") -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=color)
    # stamp 0: with the newest transform, as the plan is valid at any time
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = size
    return marker


INTERFACE = Interface(
    report=PreviewNode.report,
    publishes=(
        PosePublication("preview/joint_states"),
        Publication("plan_markers", MarkerArray, queue_size=2, latch=True),
        Publication("rehearsal_markers", MarkerArray, queue_size=2, latch=True),
    ),
    reads=(NewestPose("twin/joint_states"),),
    hears=(
        Subscription("scene", SceneMsg, PreviewNode.on_scene, queue_size=1),
        Subscription("review", Review, PreviewNode.on_review, queue_size=5),
        Subscription("execution", Execution, PreviewNode.on_execution, queue_size=10),
        Subscription("plan", Plan, PreviewNode.on_plan, queue_size=2),
        Subscription("rehearsal", Rehearsal, PreviewNode.on_rehearsal, queue_size=2),
    ),
    serves=(Served("preview_plan", PreviewPlan, PreviewNode.on_preview),),
    every=(Every(lambda _settings: FRAME_PERIOD, lambda node, _ports: node.move_ghost()),),
)
NODE = NodeShell("preview", Settings, PreviewNode, INTERFACE)


def main() -> None:
    """Run the node."""
    NODE.run()
