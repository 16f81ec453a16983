"""`scene` on MQTT: what consoles get to see of a scene. SI: m. Pure; `core.records` writes it.

Meshes are named by their digests, because a console does not see this machine's files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from construction_twin.scene.objects import Scene, SceneObject


@dataclass(frozen=True)
class ObjectView:
    """One body of a scene.

    Attributes:
        size: As in `SceneObject.msg` [m]; of a mesh its scale.
        mesh: SHA-256 of the file; empty for other shapes.
        position: In `link`, or in the scene's frame [m].
        orientation: x, y, z, w.
        padding: Distance to keep from it [m], added to the scene's own.
        link: That carries it; empty: it stands in the scene's frame.
        touch: Links and objects that may touch it.
    """

    name: str
    shape: str
    size: Sequence[float]
    mesh: str
    position: Annotated[Sequence[float], Field(min_length=3, max_length=3)]
    orientation: Annotated[Sequence[float], Field(min_length=4, max_length=4)]
    padding: float
    link: str
    touch: Sequence[str]


@dataclass(frozen=True)
class SceneView:
    """A message on <prefix>/<robot>/scene: what the arm must not touch.

    Attributes:
        frame: The robot's base_link.
        padding: Distance to keep from every object [m].
    """

    hash: str
    frame: str
    padding: float
    objects: Sequence[ObjectView]


def scene_view(scene: Scene, frame: str) -> SceneView:
    """Return what is shown of a scene; `frame` is the robot's base_link."""
    return SceneView(scene.hash, frame, scene.padding, tuple(map(_object, scene.objects)))


def _object(item: SceneObject) -> ObjectView:
    return ObjectView(
        item.name, item.shape, item.size, item.mesh_digest, item.position, item.quaternion, item.padding, item.link, item.touch
    )  # fmt: skip
