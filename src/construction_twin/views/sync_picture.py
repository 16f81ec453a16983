"""What rviz shows of the monitor: the physical arm's shapes in a colour by sync state, and a text when it is not in sync.

Pure. Values are in rad and m, texts for people in deg and mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from urdf_parser_py.urdf import Box, Cylinder, Mesh, Sphere

from construction_twin.core.sentences import Quantity
from construction_twin.core.units import to_people
from construction_twin.monitor.states import SyncState
from construction_twin.robot.frames import rpy_to_quaternion
from construction_twin.robot.urdf import parse_urdf

#: Red, green, blue, alpha of the physical arm by state. It is faint while the poses agree, so that the twin is easy to see.
COLOURS = {
    SyncState.WAITING: (0.45, 0.5, 0.6, 0.35),
    SyncState.IN_SYNC: (0.1, 0.75, 0.25, 0.2),
    SyncState.HOLDING: (1.0, 0.8, 0.0, 0.6),
    SyncState.REPLANNING: (0.55, 0.25, 0.95, 0.55),
    SyncState.STALE: (0.25, 0.45, 0.95, 0.55),
    SyncState.STOPPED: (0.9, 0.05, 0.1, 0.6),
    SyncState.FAULT: (0.9, 0.05, 0.1, 0.6),
}
#: Room between the middle of the text and the length of the stretched arm, which no pose quite reaches [m].
TEXT_ROOM = 0.15
#: Longest line of the text.
LINE_LENGTH = 70


@dataclass(frozen=True)
class Shape:
    """One visual shape of a link.

    Attributes:
        link: Its pose is in this link's frame.
        kind: ``mesh``, ``box``, ``cylinder`` or ``sphere``.
        mesh: URI, for a mesh.
        scale: Length 3. Of the mesh, or the shape's extent along its axes [m].
        position: Length 3. [m]
        quaternion: Length 4. x, y, z, w
    """

    link: str
    kind: str
    mesh: str
    scale: tuple[float, float, float]
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


def visual_shapes(urdf: str) -> tuple[Shape, ...]:
    """Return a robot's visual shapes, in the order of the URDF.

    Raises:
        ConfigurationError: If the text is not a URDF.
    """
    return tuple(_shape(link.name, visual) for link in parse_urdf(urdf).links for visual in link.visuals)


def _shape(link: str, visual) -> Shape:
    geometry, origin = visual.geometry, visual.origin
    x, y, z = (0.0, 0.0, 0.0) if origin is None else map(float, origin.xyz)
    qx, qy, qz, qw = rpy_to_quaternion((0.0, 0.0, 0.0) if origin is None else [*map(math.degrees, origin.rpy)]).tolist()
    kind, mesh, scale = type(geometry).__name__.lower(), "", _extent(geometry)
    if isinstance(geometry, Mesh):
        mesh = geometry.filename
    return Shape(link, kind, mesh, scale, (x, y, z), (qx, qy, qz, qw))


def _extent(geometry: Mesh | Box | Cylinder | Sphere) -> tuple[float, float, float]:
    """Return a mesh's scale, or another shape's extent along its axes [m]."""
    if isinstance(geometry, (Mesh, Box)):
        x, y, z = (geometry.scale or (1.0, 1.0, 1.0)) if isinstance(geometry, Mesh) else geometry.size
        return float(x), float(y), float(z)
    across = 2.0 * geometry.radius
    return across, across, float(geometry.length) if isinstance(geometry, Cylinder) else across


def headline_height(shoulder: float, arm_length: float) -> float:
    """Return how high the text stands over the base [m]: above everything the arm can reach, so that it never hides it.

    Args:
        shoulder: Height of the first revolute joint [m].
        arm_length: Of all links behind it [m].
    """
    return shoulder + arm_length + TEXT_ROOM


def headline(state: SyncState, reason: str, worst: str) -> str:
    """Return the text above the arm; empty while twin and arm are in sync.

    Args:
        reason: What `hold_cause` says, or `Sync.reason` where it says nothing.
        worst: Of `worst_joint`; may be empty.
    """
    if state is SyncState.IN_SYNC:
        return ""
    return "\n".join([state.name.replace("_", " "), *_wrapped(reason), *([worst] if worst else [])])


def worst_joint(
    names: Sequence[str], errors: Sequence[float], thresholds: Sequence[float], linear: Sequence[bool]
) -> str:
    """Return which joint is closest to its threshold, and its difference; empty if nothing was measured.

    Args:
        names: Length n
        errors, thresholds: Length n. Of `Sync` [rad], [m] for prismatic joints.
        linear: Length n
    """
    rows = [
        (error / threshold, name, error, threshold, straight)
        for name, error, threshold, straight in zip(names, errors, thresholds, linear)
        if threshold > 0 and math.isfinite(error)
    ]
    if not rows:
        return ""
    _, name, error, threshold, straight = max(rows)
    unit, (allowed, _) = "m" if straight else "rad", to_people(threshold, "m" if straight else "rad")
    return f"{name} differs by {Quantity(error, unit):.3}, allowed {allowed:.3f}"


def _wrapped(text: str) -> list[str]:
    lines: list[str] = []
    for word in text.split():
        if lines and len(lines[-1]) + 1 + len(word) <= LINE_LENGTH:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines
