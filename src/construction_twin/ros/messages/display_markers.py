"""What rviz draws of a plan, its rehearsal and the gate's state: pictures of `views` as markers. No parameters, no clock."""

from __future__ import annotations

from collections.abc import Iterable

from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from construction_twin.kinematics.chain import Pose
from construction_twin.monitor.states import SyncState
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.ros.messages.scene_convert import SHAPES, body_marker, tf_frame
from construction_twin.scene.objects import SceneObject
from construction_twin.views.preview import TEXT_SIZE, PlanPicture
from construction_twin.views.rehearsal_picture import (
    CONTACT,
    CONTACT_SIZE,
    LIMIT,
    TEXT_ROOM,
    RehearsalPicture,
    TorqueColumn,
)
from construction_twin.views.rehearsal_picture import TEXT_SIZE as REHEARSAL_TEXT
from construction_twin.views.sync_picture import COLOURS, Shape
from construction_twin.views.work_picture import WorkPath

PINK = ColorRGBA(1.0, 0.25, 0.65, 1.0)
ORANGE = ColorRGBA(1.0, 0.45, 0.0, 0.9)
DARK, DARK_RED = ColorRGBA(0.1, 0.1, 0.15, 1.0), ColorRGBA(0.35, 0.0, 0.0, 1.0)
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
#: Height of a line of the text over the physical arm, and how far in front of its axis it stands [m].
HEADLINE_SIZE, TEXT_FORWARD = 0.085, 0.4


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


def grip_markers(items: Iterable[SceneObject], tf_prefix: str) -> list[Marker]:
    """Return what the ghost carries, in its links' frames."""
    return [
        _body(item, tf_frame(tf_prefix, item.link), GRIPPED, "plan_grip", number) for number, item in enumerate(items)
    ]


def rehearsal_markers(drawing: RehearsalPicture, frame: str) -> list[Marker]:
    """Return a rehearsal's markers in the frame of its points: arm, columns of torques, contacts, text."""
    markers = []
    for number, (shape, pose) in enumerate(drawing.ghost):
        place = PoseMsg(Point(*pose.position), Quaternion(*rotation_to_quaternion(pose.rotation)))
        markers.append(_shape(shape, place, frame, ColorRGBA(*drawing.ghost_colour), number, "rehearsal_arm"))
    for number, (item, pose) in enumerate(drawing.carried):
        markers.append(_body(item, frame, drawing.ghost_colour, "rehearsal_carried", number, pose))
    for number, column in enumerate(drawing.columns):
        markers += _column(column, frame, number)
    for number, (point, said) in enumerate(drawing.contacts):
        place = _marker(frame, number, Marker.SPHERE, ColorRGBA(*CONTACT), CONTACT_SIZE, "rehearsal_contacts")
        place.pose.position = Point(*point)
        markers += [place, _text(said, frame, number, point, ColorRGBA(*CONTACT), "rehearsal_contact_names")]
    return [*markers, _text(drawing.text, frame, 0, drawing.text_at, ColorRGBA(*drawing.text_colour), "rehearsal")]


def _shape(shape: Shape, pose: PoseMsg, frame: str, colour: ColorRGBA, number: int, namespace: str) -> Marker:
    marker = _marker(frame, number, SHAPES[shape.kind], colour, 1.0, namespace)
    marker.mesh_resource, marker.pose, marker.scale = shape.mesh, pose, Vector3(*shape.scale)
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


def all_gone(namespace: str) -> Marker:
    """Return the removal of all markers of a topic."""
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


def arm_markers(shapes: tuple[Shape, ...], state: SyncState, tf_prefix: str) -> list[Marker]:
    """Return the physical arm in the colour of a state: one marker per shape, in its link's frame."""
    markers = []
    for number, shape in enumerate(shapes):
        place = PoseMsg(Point(*shape.position), Quaternion(*shape.quaternion))
        frame = tf_frame(tf_prefix, shape.link)
        markers.append(_shape(shape, place, frame, ColorRGBA(*COLOURS[state]), number, "physical"))
        markers[-1].frame_locked = True
    return markers


def text_marker(text: str, frame: str, height: float) -> Marker:
    """Return the text over the physical arm, in its base's frame, or its removal when there is none."""
    marker = _marker(frame, 0, Marker.TEXT_VIEW_FACING, DARK_RED, HEADLINE_SIZE, "why")
    marker.action, marker.frame_locked = Marker.ADD if text else Marker.DELETE, True
    marker.text, marker.pose.position = text, Point(TEXT_FORWARD, 0.0, height)
    return marker
