"""Bodies that are several objects of a scene, and their known masses.

A body is all objects whose names begin with the same part before a ``/``: ``tool/post`` and ``tool/frame``, or the convex pieces of
an element of a building.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping
from typing import TYPE_CHECKING

from construction_twin.robot.tool import read_tool
from construction_twin.scene.objects import Scene

if TYPE_CHECKING:
    from construction_twin.core.reports import TaskReport
    from construction_twin.scene.collision_bodies import RobotBodies

#: The body of a tool's objects.
TOOL = "tool"


def body_of(name: str) -> str:
    """Return the body that an object is part of."""
    return name.partition("/")[0]


def element_masses(tasks: Iterable[TaskReport]) -> dict[str, float]:
    """Return the masses that tasks say, by element [kg]."""
    return {task.element: task.mass_kg for task in tasks if math.isfinite(task.mass_kg) and task.mass_kg > 0.0}


def tool_mass(path: str) -> dict[str, float]:
    """Return the mass in a tool file [kg], {} without a file. Raises like `read_tool`."""
    return {TOOL: read_tool(path).tool.mass} if path else {}


def masses_of(
    known: Mapping[str, float], scenes: Iterable[Scene], bodies: RobotBodies, standing: Container[str] = ()
) -> dict[str, float]:
    """Return the masses of carried objects and of objects of `standing` bodies, by name [kg].

    A body's mass, `known` [kg], is split by the volumes of its objects.
    """
    # nodes that only name bodies wait for no library of shapes
    from construction_twin.extensions.physics.mass import of_object

    pieces: dict[str, dict[str, float]] = {}
    for scene in scenes:
        for item in scene.objects:
            body = body_of(item.name)
            if (item.link or body in standing) and body in known and item.name not in pieces.get(body, ()):
                pieces.setdefault(body, {})[item.name] = of_object(bodies.place(item, scene.names)).mass
    return {
        name: known[body] * volume / sum(volumes.values())
        for body, volumes in pieces.items()
        for name, volume in volumes.items()
    }
