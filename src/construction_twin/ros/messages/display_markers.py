"""What rviz draws of a plan, of its rehearsal and of the gate's state, as markers. No parameters, no clock; metres."""

from __future__ import annotations

import copy
import math
import textwrap
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from urdf_parser_py.urdf import Box, Cylinder, Mesh
from visualization_msgs.msg import Marker

from construction_twin.core.sentences import Quantity
from construction_twin.core.units import axis_name, to_display_unit
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.monitor.states import SyncState
from construction_twin.review.rehearsal_report import BROKEN, FAILED, PASSED, AxisLoad, RehearsalReport
from construction_twin.robot.frames import rpy_to_quaternion
from construction_twin.robot.plan import Plan
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.convert import pose_from_msg, pose_to_msg
from construction_twin.ros.messages.scene_convert import SHAPES, body_marker, tf_frame
from construction_twin.scene.objects import SceneObject, product
from construction_twin.scene.scene_change import SceneChange
from construction_twin.views.preview import WorkStates
from construction_twin.views.rehearsal_table import ESTIMATE
from construction_twin.views.texts import cut, describe

#: The physical arm by state. It is faint while the poses agree, so that the twin is easy to see.
COLOURS = {
    SyncState.WAITING: (0.45, 0.5, 0.6, 0.35),
    SyncState.IN_SYNC: (0.1, 0.75, 0.25, 0.2),
    SyncState.HOLDING: (1.0, 0.8, 0.0, 0.6),
    SyncState.REPLANNING: (0.55, 0.25, 0.95, 0.55),
    SyncState.STALE: (0.25, 0.45, 0.95, 0.55),
    SyncState.STOPPED: (0.9, 0.05, 0.1, 0.6),
    SyncState.FAULT: (0.9, 0.05, 0.1, 0.6),
}
ORANGE, DARK, DARK_RED = (1.0, 0.45, 0.0, 0.9), (0.1, 0.1, 0.15, 1.0), (0.35, 0.0, 0.0, 1.0)
#: The tool path, neighbouring segments of a work plan in two shades: free motion, and engaged.
PINKS = ((1.0, 0.25, 0.65, 1.0), (0.8, 0.05, 0.4, 1.0))
BLUES = ((0.1, 0.35, 1.0, 1.0), (0.0, 0.7, 0.95, 1.0))
#: What the ghost carries, what is carried from one segment into the next, and what stands in the end.
GRIPPED, ON_THE_WAY, PLACED = (0.2, 0.65, 0.35, 0.6), (0.1, 0.35, 1.0, 0.18), (0.1, 0.85, 0.3, 0.6)
#: Width of the tool path, diameters of the closest point and of the end of a segment, height of its name and where that stands [m].
LINE_WIDTH, POINT_SIZE, MARK_SIZE, LABEL_SIZE = 0.012, 0.06, 0.035, 0.065
LABEL_AT = (0.0, 0.0, 0.1)
#: The line of an engaged segment is so much wider: the way there and the way back often lie on each other.
WIDER = 1.7
#: Ends of segments that are closer than this share one label [m].
SAME_MARK = 0.08
#: Most bodies that are drawn of each kind: a picture, not a scene.
MOST_BODIES = 200
#: Spacing of the points of the drawn tool path [s], and the most of them.
PATH_SPACING, PATH_POINTS = 0.02, 1000
#: Height of a line of a plan's text [m], and the room between it and the arm below, whose bodies reach beyond its joints.
TEXT_SIZE, TEXT_ROOM = 0.06, 0.55
#: Height of a line of the text over the physical arm, how far in front of its axis it stands, the room above and below its middle,
#: how high that is over the stretched arm [m], and its longest line.
HEADLINE_SIZE, TEXT_FORWARD, HEADLINE_ROOM, OVER_ARM, LINE_LENGTH = 0.085, 0.4, 0.3, 0.15, 70

#: The arm and the text of a rehearsal by how it ended. One that broke off has no arm to show.
GHOSTS = {PASSED: (0.0, 0.55, 0.7, 0.4), FAILED: (0.9, 0.1, 0.1, 0.45)}
HEADLINES = {PASSED: "REHEARSAL PASSED", FAILED: "REHEARSAL FAILED", BROKEN: "THE REHEARSAL BROKE OFF"}
TEXTS = {PASSED: (0.0, 0.3, 0.15, 1.0), FAILED: (0.6, 0.0, 0.05, 1.0), BROKEN: (0.6, 0.0, 0.05, 1.0)}
#: Of its columns, from the fraction of the limit on that stands before each; of what stands around one; of a contact.
COLUMNS = ((1.0, (0.85, 0.08, 0.1, 1.0)), (0.8, (0.95, 0.6, 0.05, 1.0)), (0.0, (0.15, 0.62, 0.28, 1.0)))
LIMIT, CONTACT = (0.3, 0.32, 0.38, 0.22), (1.0, 0.0, 0.35, 0.95)
#: Of the length of the stretched arm: height of a column at its limit, its width, from one to the next, and how far behind the base
#: and to its right the last of them stands, where rviz shows the arm from in front. The last: most height of one, of its limit.
HEIGHT, WIDTH, SPACING, BEHIND, BESIDE, TALLEST = 0.36, 0.045, 0.15, 0.3, 0.1, 1.4
#: Height of a line of its texts, their room above what they belong to, diameter of a contact [m]; most reasons that are said.
REHEARSAL_TEXT, REHEARSAL_ROOM, CONTACT_SIZE, MOST_REASONS = 0.075, 0.07, 0.09, 3


# -- the physical arm in the colour of the gate's state


def visual_markers(urdf: str) -> list[Marker]:
    """Return a robot's visual shapes, in the order of the URDF: each with its link, without prefix, as its frame."""
    visuals = [(link.name, visual) for link in parse_urdf(urdf).links for visual in link.visuals]
    return [_visual(number, *each) for number, each in enumerate(visuals)]


def _visual(number: int, link: str, visual) -> Marker:
    geometry, origin = visual.geometry, visual.origin
    marker = _marker(link, number, SHAPES[type(geometry).__name__.lower()], DARK, 1.0, "physical")
    if isinstance(geometry, Mesh):
        marker.mesh_resource, extent = geometry.filename, geometry.scale or (1.0, 1.0, 1.0)
    elif isinstance(geometry, Box):
        extent = geometry.size
    else:
        across = 2.0 * geometry.radius
        extent = (across, across, geometry.length if isinstance(geometry, Cylinder) else across)
    marker.scale = Vector3(*map(float, extent))
    if origin is not None:
        turned = rpy_to_quaternion([*map(math.degrees, origin.rpy)]).tolist()
        marker.pose = PoseMsg(Point(*map(float, origin.xyz)), Quaternion(*turned))
    return marker


def arm_markers(shapes: Iterable[Marker], state: SyncState, tf_prefix: str) -> list[Marker]:
    """Return the physical arm in the colour of a state."""
    markers = copy.deepcopy([*shapes])
    for marker in markers:
        marker.header.frame_id = tf_frame(tf_prefix, marker.header.frame_id)
        marker.color, marker.frame_locked = ColorRGBA(*COLOURS[state]), True
    return markers


def headline_height(chain: Chain) -> float:
    """Return how high the text over the physical arm stands [m]: above all that it can reach, so that it never hides it."""
    return float(chain.shoulder[2]) + chain.arm_length + OVER_ARM


def headline_marker(state: SyncState, reason: str, worst: str, frame: str, height: float) -> Marker:
    """Return the text over the physical arm, in its base's frame, or its removal while twin and arm are in sync."""
    marker = _text("", frame, 0, (TEXT_FORWARD, 0.0, height), DARK_RED, "why", HEADLINE_SIZE)
    marker.action, marker.frame_locked = Marker.DELETE, True
    if state is not SyncState.IN_SYNC:
        lines = textwrap.wrap(reason, LINE_LENGTH, break_long_words=False, break_on_hyphens=False)
        marker.action = Marker.ADD
        marker.text = "\n".join(filter(None, [state.name.replace("_", " "), *lines, worst]))
    return marker


def worst_joint(
    names: Sequence[str], errors: Sequence[float], thresholds: Sequence[float], linear: Sequence[bool]
) -> str:
    """Return which joint is closest to its threshold, and its difference, both of `Sync`; empty if nothing was measured."""
    rows = [
        (error / threshold, name, error, threshold, "m" if straight else "rad")
        for name, error, threshold, straight in zip(names, errors, thresholds, linear)
        if threshold > 0 and math.isfinite(error)
    ]
    if not rows:
        return ""
    _, name, error, threshold, unit = max(rows)
    return f"{name} differs by {Quantity(error, unit):.3}, allowed {to_display_unit(threshold, unit)[0]:.3f}"


# -- a plan


def plan_markers(
    plan: Plan,
    chain: Chain,
    frame: str,
    headline: float,
    changes: Sequence[SceneChange] = (),
    states: WorkStates | None = None,
) -> list[Marker]:
    """Return a plan's markers in the base's frame: tool path, closest point, and a text clear of what moves and of the headline.

    `states`: of a work plan, whose segments are drawn then, with what is carried and placed.
    """
    trajectory, clearance = plan.trajectory, plan.report.clearance
    points = min(max(math.ceil(trajectory.duration / PATH_SPACING) + 1, 2), PATH_POINTS)
    poses = trajectory.sample_many(np.linspace(0.0, trajectory.duration, points))[0]
    arms = np.array([chain.skeleton(q) for q in poses])
    if states is None:
        markers = [_line(arms[:, -1], frame, 0, PINKS[0], LINE_WIDTH, "plan")]
    else:
        markers = _work_markers(plan, states, chain, frame)
    x, y, top = arms.reshape(-1, 3)[np.argmax(arms[:, :, 2])].tolist()
    text = describe(plan, changes, states.problem if states is not None else "")
    half = (text.count("\n") + 1) * TEXT_SIZE / 2
    middle = top + TEXT_ROOM + half
    if middle + half >= headline - HEADLINE_ROOM:
        middle = max(middle, headline + HEADLINE_ROOM + half)
    markers.append(_text(text, frame, 1, (x, y, middle), DARK, "plan", TEXT_SIZE))
    if math.isfinite(clearance.distance):
        markers.append(_sphere(clearance.point, frame, 2, ORANGE, POINT_SIZE, "plan"))
    return markers


def _work_markers(plan: Plan, states: WorkStates, chain: Chain, frame: str) -> list[Marker]:
    """Return the tool path of each segment, where it ends and its name, what is carried into the next one, and what is placed."""
    trajectory, markers, poses, begin = plan.trajectory, [], [], 0.0
    spacing = max(PATH_SPACING, trajectory.duration / PATH_POINTS)
    for number, segment in enumerate(plan.segments):
        times = np.linspace(begin, segment.end, max(2, round((segment.end - begin) / spacing) + 1))
        tips = [chain.forward(q) for q in trajectory.sample_many(times)[0]]
        colours, width = (BLUES, WIDER * LINE_WIDTH) if segment.engaged else (PINKS, LINE_WIDTH)
        path = np.array([pose.position for pose in tips])
        markers.append(_line(path, frame, number, colours[number % 2], width, "plan_path"))
        poses.append(tips[-1])
        begin = segment.end
    places: list[tuple[np.ndarray, list[str]]] = []
    for number, (segment, pose) in enumerate(zip(plan.segments, poses), 1):
        near = (names for place, names in places if np.linalg.norm(place - pose.position) < SAME_MARK)
        names = next(near, None)
        if names is None:
            places.append((pose.position, names := []))
        names.append(f"{number} {cut(segment.name)}")
    for number, (place, names) in enumerate(places):
        markers.append(_sphere(place, frame, number, DARK, MARK_SIZE, "plan_marks"))
        markers.append(_text(", ".join(names), frame, number, place + LABEL_AT, DARK, "plan_names", LABEL_SIZE))
    on_the_way = [
        (item, product(pose, item.pose))
        for number, pose in enumerate(poses[:-1])
        for item in states.loads(number)
        if item.link == chain.robot.tip_link and item in states.loads(number + 1)
    ]
    for number, (item, pose) in enumerate(on_the_way[:MOST_BODIES]):
        markers.append(_body(item, frame, ON_THE_WAY, "plan_on_the_way", number, pose))
    for number, item in enumerate(states.placed[:MOST_BODIES]):
        markers.append(_body(item, frame, PLACED, "plan_placed", number))
    return markers


def grip_markers(items: Sequence[SceneObject], tf_prefix: str) -> list[Marker]:
    """Return what the ghost carries, in its links' frames."""
    return [
        _body(item, tf_frame(tf_prefix, item.link), GRIPPED, "plan_grip", number)
        for number, item in enumerate(items[:MOST_BODIES])
    ]


# -- its rehearsal


def rehearsal_markers(
    report: RehearsalReport,
    shapes: Sequence[Marker],
    link_pose: Callable[[Sequence[float], str], Pose],
    arm_length: float,
    carried: Sequence[SceneObject],
    frame: str,
) -> list[Marker]:
    """Return the arm at the worst moment, a column per axis with its largest torque, where bodies touched, and how it ended.

    Torques stand in columns, which show their height from every side. `carried`: what the arm carries then, each in its link.
    """
    markers = _ghost(report, shapes, link_pose, carried[:MOST_BODIES], frame) if report.worst_pose else []
    top, aside = HEIGHT * arm_length, 0.0
    for number, axis in enumerate(report.axes):
        y = -(BESIDE + (len(report.axes) - 1 - number) * SPACING) * arm_length
        column = _column(axis, (-BEHIND * arm_length, y), arm_length, frame, number)
        top = max(top, column[-1].pose.position.z - REHEARSAL_ROOM)
        aside += y / len(report.axes)
        markers += column
    for number, one in enumerate(report.contacts):
        text = f"{one.first} and {one.second}: {one.time:.2f} s, {one.force:.0f} N"
        markers.append(_sphere(one.point, frame, number, CONTACT, CONTACT_SIZE, "rehearsal_contacts"))
        markers.append(_above(one.point, text, frame, number, CONTACT, "rehearsal_contact_names"))
    lines = [HEADLINES[report.state]]
    lines += [textwrap.shorten(reason, LINE_LENGTH, placeholder="...") for reason in report.reasons[:MOST_REASONS]]
    if len(report.reasons) > MOST_REASONS:
        lines.append(f"and {len(report.reasons) - MOST_REASONS} reasons more")
    if report.worst_pose:
        lines.append(f"ghost: the largest share of a torque, after {report.worst_time:.2f} s")
    place = (-BEHIND * arm_length, aside, top + (3 + len(lines) / 2) * REHEARSAL_TEXT + REHEARSAL_ROOM)
    return [*markers, _above(place, "\n".join(lines), frame, 0, TEXTS[report.state], "rehearsal")]


def _ghost(report: RehearsalReport, shapes, link_pose, carried: Sequence[SceneObject], frame: str) -> list[Marker]:
    colour = GHOSTS.get(report.state, GHOSTS[FAILED])
    names = {*(each.header.frame_id for each in shapes), *(each.link for each in carried)}
    links = {link: link_pose(report.worst_pose, link) for link in names}
    markers = copy.deepcopy([*shapes])
    for marker in markers:
        marker.pose = pose_to_msg(product(links[marker.header.frame_id], pose_from_msg(marker.pose)))
        marker.header.frame_id, marker.ns, marker.color = frame, "rehearsal_arm", ColorRGBA(*colour)
    for number, item in enumerate(carried):
        markers.append(_body(item, frame, colour, "rehearsal_carried", number, product(links[item.link], item.pose)))
    return markers


def _column(axis: AxisLoad, foot: tuple[float, float], arm_length: float, frame: str, number: int) -> list[Marker]:
    """Return an axis' column inside of its limit, and its text; of an axis with an unknown limit the text alone."""
    name, full, width = axis_name(axis.joint), HEIGHT * arm_length, WIDTH * arm_length
    if not axis.limit:
        return [_above((*foot, 0.0), f"{name} {axis.peak:.0f} Nm", frame, number, DARK, "rehearsal_axes")]
    colour = next(each for least, each in COLUMNS if axis.usage > least or not least)
    markers, height = [], full * min(axis.usage, TALLEST)
    for tall, wide, shade, kind in (
        (height, 0.7 * width, colour, "rehearsal_torques"),
        (full, width, LIMIT, "rehearsal_limits"),
    ):
        if tall > 0.0:
            bar = _marker(frame, number, Marker.CUBE, shade, wide, kind)
            bar.scale.z, bar.pose.position = tall, Point(*foot, tall / 2)
            markers.append(bar)
    text = f"{name} {axis.usage * 100:.0f} %{ESTIMATE if axis.estimated else ''}"
    return [*markers, _above((*foot, max(height, full)), text, frame, number, DARK, "rehearsal_axes")]


# -- single markers


def _above(below: Iterable[float], text: str, frame: str, number: int, colour, namespace: str) -> Marker:
    x, y, z = below
    return _text(text, frame, number, (x, y, z + REHEARSAL_ROOM), colour, namespace, REHEARSAL_TEXT)


def _text(text: str, frame: str, number: int, at: Iterable[float], colour, namespace: str, size: float) -> Marker:
    marker = _marker(frame, number, Marker.TEXT_VIEW_FACING, colour, size, namespace)
    marker.text, marker.pose.position = text, Point(*map(float, at))
    return marker


def _sphere(at: Iterable[float], frame: str, number: int, colour, size: float, namespace: str) -> Marker:
    marker = _marker(frame, number, Marker.SPHERE, colour, size, namespace)
    marker.pose.position = Point(*map(float, at))
    return marker


def _line(points: np.ndarray, frame: str, number: int, colour, width: float, namespace: str) -> Marker:
    marker = _marker(frame, number, Marker.LINE_STRIP, colour, width, namespace)
    marker.points = [Point(*point) for point in points.tolist()]
    return marker


def _body(
    item: SceneObject, frame: str, colour: tuple[float, ...], namespace: str, number: int, pose: Pose | None = None
) -> Marker:
    marker = body_marker(item, frame, colour, pose)
    marker.ns, marker.id = namespace, number
    return marker


def _marker(frame: str, number: int, kind: int, colour: Iterable[float], size: float, namespace: str) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=ColorRGBA(*colour))
    # stamp 0: with the newest transform, as the plan is valid at any time
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = size
    return marker
