"""Building models of boxes, made without IFC."""

from __future__ import annotations

import numpy as np

from construction_twin.extensions.work.building import Body, BuildingModel, Element
from construction_twin.kinematics.chain import Pose

_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5)),
        *((0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)),
        *((0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
)


def box(low, high) -> Body:
    """A box between two corners [m], outward normals."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return Body(low + _CORNERS * (high - low), _FACES)


def element(identifier: str, *bodies: Body, at=(0.0, 0.0, 0.0), rotation=None, name: str = "") -> Element:
    """An IfcMember of bodies."""
    pose = Pose(np.asarray(at, dtype=float), np.eye(3) if rotation is None else np.asarray(rotation, dtype=float))
    return Element(identifier, "IfcMember", name or identifier, "", "", "", pose, bodies, {}, None)


def building(*elements: Element, tasks=(), sequences=()) -> BuildingModel:
    """A model of elements."""
    return BuildingModel(
        "m.ifc",
        "",
        "project",
        {one.id: one for one in elements},
        {task.id: task for task in tasks},
        tuple(sequences),
    )
