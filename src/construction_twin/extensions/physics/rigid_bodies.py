"""Which objects of a scene move as one while a plan goes through its scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pinocchio

from construction_twin.extensions.physics.known_mass import body_of
from construction_twin.scene.objects import Scene, SceneObject

#: Pieces whose numbers in one another's frames differ by less than this lie as before: rounding [1], [m].
_SAME = 1e-4


def rigid_bodies(scenes: Iterable[Scene]) -> dict[str, str]:
    """Return the body that each object is a piece of while a plan goes through `scenes`, by the object's name.

    Pieces are one body if they are together in all scenes: all of them there, standing or on the same link, and lying to one
    another as before. Objects of like names of which one goes alone are each a body of its own, which has its full name.
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
