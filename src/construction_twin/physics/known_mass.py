"""Masses that somebody has said, of bodies that are several objects of a scene.

A body is all objects whose names begin with the same part before a ``/``: ``tool/post`` and ``tool/frame``, or the convex pieces of
an element of a building.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from construction_twin.physics.mass import of_object
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene

#: The body of a tool's objects.
TOOL = "tool"


def body_of(name: str) -> str:
    """Return the body that an object is part of."""
    return name.partition("/")[0]


def masses_of(known: Mapping[str, float], scenes: Iterable[Scene], bodies: RobotBodies) -> dict[str, float]:
    """Return the mass of each object that the arm carries in one of the scenes, by name [kg].

    A body's mass is divided as its objects' volumes are. Objects of which nobody says it are left out.

    Args:
        known: Of bodies [kg].
    """
    pieces: dict[str, dict[str, float]] = {}
    for scene in scenes:
        for item in scene.objects:
            body = body_of(item.name)
            if item.link and body in known and item.name not in pieces.get(body, ()):
                pieces.setdefault(body, {})[item.name] = of_object(bodies.place(item, scene.names)).mass
    return {
        name: known[body] * volume / sum(volumes.values())
        for body, volumes in pieces.items()
        for name, volume in volumes.items()
    }
