"""Bodies that are several objects of a scene, and the masses that somebody has said of them.

A body is all objects whose names begin with the same part before a ``/``: ``tool/post`` and ``tool/frame``, or the convex pieces of
an element of a building.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pinocchio

from construction_twin.physics.mass import of_shape
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject

#: The body of a tool's objects.
TOOL = "tool"
#: Pieces whose numbers in one another's frames differ by less than this lie as before: rounding [1], [m].
_SAME = 1e-4


def body_of(name: str) -> str:
    """Return the body that an object is part of."""
    return name.partition("/")[0]


def rigid_bodies(scenes: Iterable[Scene]) -> dict[str, str]:
    """Return the body that each object is a piece of while a plan goes through `scenes`, by the object's name.

    Pieces are one body if they are together in all scenes: all there, standing or on the same link, and to one another as before.
    Objects of like names of which one goes alone are each a body of its own, which has its full name.
    """
    found: dict[str, str] = {}
    first: dict[str, Sequence[SceneObject]] = {}
    apart: set[str] = set()
    for scene in scenes:
        pieces: dict[str, list[SceneObject]] = {}
        for item in sorted(scene.objects, key=lambda each: each.name):
            body = found[item.name] = body_of(item.name)
            pieces.setdefault(body, []).append(item)
        for body, items in pieces.items():
            if not _is_rigid(first.setdefault(body, items), items):
                apart.add(body)
    return {name: name if body in apart else body for name, body in found.items()}


def _is_rigid(before: Sequence[SceneObject], now: Sequence[SceneObject]) -> bool:
    """Return whether pieces, sorted by name, can be one body that was carried from one place to another."""
    if [item.name for item in before] != [item.name for item in now] or len({item.link for item in now}) > 1:
        return False
    places, others = ([_placement(item) for item in items] for items in (before, now))
    return all(
        np.abs(places[0].actInv(place).homogeneous - others[0].actInv(other).homogeneous).max() < _SAME
        for place, other in zip(places[1:], others[1:])
    )


def _placement(item: SceneObject) -> pinocchio.SE3:
    return pinocchio.XYZQUATToSE3(np.array((*item.position, *item.quaternion)))


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
                pieces.setdefault(body, {})[item.name] = of_shape(bodies.place(item, scene.names).geometry).mass
    return {
        name: known[body] * volume / sum(volumes.values())
        for body, volumes in pieces.items()
        for name, volume in volumes.items()
    }
