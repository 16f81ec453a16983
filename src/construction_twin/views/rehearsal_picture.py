"""What rviz shows of a rehearsal: the arm at the worst moment, a column per axis with its largest torque, and where bodies touched.

Pure; joint values in rad (m for a prismatic joint), points in the robot's base_link [m]. Torques stand in columns and not in lying
bars, because rviz has no body that always faces whoever looks: a column shows its height from every side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.core.units import axis_name
from construction_twin.kinematics.chain import Pose
from construction_twin.review.rehearsal_report import (
    BROKEN,
    FAILED,
    PASSED,
    AxisLoad,
    RehearsalReport,
    RehearsedContact,
)
from construction_twin.robot.frames import quaternion_to_rotation
from construction_twin.scene.objects import SceneObject, product
from construction_twin.views.sync_picture import Shape

#: Behind a number that is an estimate.
ESTIMATE = "~"
#: Colours r, g, b, a of the arm by how the rehearsal ended. A rehearsal that broke off has no arm to show.
GHOSTS = {PASSED: (0.0, 0.55, 0.7, 0.4), FAILED: (0.9, 0.1, 0.1, 0.45)}
#: Of the columns, from the fraction of the limit on that stands before each; and of one without a limit.
COLUMNS = ((1.0, (0.85, 0.08, 0.1, 1.0)), (0.8, (0.95, 0.6, 0.05, 1.0)), (0.0, (0.15, 0.62, 0.28, 1.0)))
UNKNOWN_LIMIT = (0.5, 0.52, 0.56, 1.0)
#: Of what stands around a column up to the limit, and of a contact.
LIMIT, CONTACT = (0.3, 0.32, 0.38, 0.22), (1.0, 0.0, 0.35, 0.95)
#: What is said first, and the texts' colour, by how the rehearsal ended.
HEADLINES = {PASSED: "REHEARSAL PASSED", FAILED: "REHEARSAL FAILED", BROKEN: "THE REHEARSAL BROKE OFF"}
TEXTS = {PASSED: (0.0, 0.3, 0.15, 1.0), FAILED: (0.6, 0.0, 0.05, 1.0), BROKEN: (0.6, 0.0, 0.05, 1.0)}
#: Of the length of the stretched arm: height of a column at its limit, its width, from one to the next, and how far behind the base
#: and to its right the last of them stands, where rviz shows the arm from in front.
HEIGHT, WIDTH, SPACING, BEHIND, BESIDE = 0.36, 0.045, 0.15, 0.3, 0.1
#: A column is not drawn higher than this times its limit; its text says the fraction.
TALLEST = 1.4
#: Height of a line of the texts, their room above what they belong to, diameter of a contact [m].
TEXT_SIZE, TEXT_ROOM, CONTACT_SIZE = 0.075, 0.07, 0.09
#: Most reasons and contacts that are written out, and the longest line.
MOST_LINES, LINE_LENGTH = 3, 70


@dataclass(frozen=True)
class TorqueColumn:
    """One axis.

    Attributes:
        foot: Length 3. Middle of the column on the ground [m].
        width, height: [m]; height 0: the axis needs nothing.
        limit: Height at the limit [m]; 0: nobody says what it is.
        colour: r, g, b, a
        text: E.g. ``A2 87 %``; without a limit the torque.
    """

    foot: tuple[float, float, float]
    width: float
    height: float
    limit: float
    colour: tuple[float, float, float, float]
    text: str


@dataclass(frozen=True, eq=False)
class RehearsalPicture:
    """What is drawn of a rehearsal.

    Attributes:
        ghost: The arm's shapes, each with where it stands in the base_link.
        ghost_colour: r, g, b, a
        carried: What the arm carries then, with where it is.
        contacts: Shape (3,) each. Where two bodies first touched, and which, when, how hard.
        text: How it ended, and why.
        text_at: Length 3. Its middle.
        text_colour: r, g, b, a
    """

    ghost: tuple[tuple[Shape, Pose], ...]
    ghost_colour: tuple[float, float, float, float]
    carried: tuple[tuple[SceneObject, Pose], ...]
    columns: tuple[TorqueColumn, ...]
    contacts: tuple[tuple[tuple[float, float, float], str], ...]
    text: str
    text_at: tuple[float, float, float]
    text_colour: tuple[float, float, float, float]


def rehearsal_picture(
    report: RehearsalReport,
    shapes: Sequence[Shape],
    link_pose: Callable[[Sequence[float], str], Pose],
    arm_length: float,
    carried: Sequence[SceneObject] = (),
) -> RehearsalPicture:
    """Return what is to be drawn of a rehearsal.

    Args:
        shapes: What is drawn of each link.
        link_pose: Returns a link's pose in the base_link, for joint values of shape (n,).
        arm_length: Of the stretched arm [m]: what the columns are measured by.
        carried: What the arm carries at `worst_time`, each in its link.

    Raises:
        SceneError: If a shape or an object names a link that the robot does not have.
    """
    pose = report.worst_pose
    ghost: list[tuple[Shape, Pose]] = []
    held: list[tuple[SceneObject, Pose]] = []
    if pose:
        links = {
            link: link_pose(pose, link) for link in {*(one.link for one in shapes), *(one.link for one in carried)}
        }
        ghost = [(one, product(links[one.link], _origin(one))) for one in shapes]
        held = [(one, product(links[one.link], one.pose)) for one in carried]
    columns = tuple(_column(axis, number, len(report.axes), arm_length) for number, axis in enumerate(report.axes))
    lines = _lines(report)
    aside = float(np.mean([one.foot[1] for one in columns])) if columns else 0.0
    top = max((max(one.height, one.limit) for one in columns), default=HEIGHT * arm_length)
    middle = top + 3 * TEXT_SIZE + TEXT_ROOM + len(lines) * TEXT_SIZE / 2
    return RehearsalPicture(
        tuple(ghost), GHOSTS.get(report.state, GHOSTS[FAILED]), tuple(held), columns,
        tuple((one.point, _contact(one)) for one in report.contacts),
        "\n".join(lines), (-BEHIND * arm_length, aside, middle), TEXTS[report.state],
    )  # fmt: skip


def _origin(shape: Shape) -> Pose:
    return Pose(np.array(shape.position), quaternion_to_rotation(shape.quaternion))


def _column(axis: AxisLoad, number: int, count: int, arm_length: float) -> TorqueColumn:
    full = HEIGHT * arm_length
    y = -(BESIDE + (count - 1 - number) * SPACING) * arm_length
    name, mark = axis_name(axis.joint), ESTIMATE if axis.estimated else ""
    if axis.limit:
        colour = next(each for least, each in COLUMNS if axis.usage > least or not least)
        text, height = f"{name} {axis.usage:.0%}{mark}".replace("%", " %"), full * min(axis.usage, TALLEST)
    else:
        colour, height = UNKNOWN_LIMIT, 0.0
        text = f"{name} {axis.peak:.0f} Nm"
    return TorqueColumn(
        (-BEHIND * arm_length, y, 0.0), WIDTH * arm_length, height, full if axis.limit else 0.0, colour, text
    )


def _lines(report: RehearsalReport) -> list[str]:
    lines = [HEADLINES[report.state], *map(_cut, report.reasons[:MOST_LINES])]
    if len(report.reasons) > MOST_LINES:
        lines.append(f"and {len(report.reasons) - MOST_LINES} reasons more")
    if report.worst_pose:
        lines.append(f"ghost: the largest share of a torque, after {report.worst_time:.2f} s")
    return lines


def _cut(line: str) -> str:
    return line if len(line) <= LINE_LENGTH else f"{line[: LINE_LENGTH - 3]}..."


def _contact(one: RehearsedContact) -> str:
    return f"{one.first} and {one.second}: {one.time:.2f} s, {one.force:.0f} N"
