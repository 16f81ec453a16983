"""The scene as JSON for consoles; meshes by their digests, because a console does not see this machine's files."""

from __future__ import annotations

from construction_twin.core.records import dumped
from construction_twin.scene.objects import Scene, SceneObject


def scene_json(scene: Scene, frame: str) -> bytes:
    """Return the payload for `scene`; `frame` is the robot's base_link."""
    objects = [_object(item) for item in scene.objects]
    return dumped({"hash": scene.hash, "frame": frame, "padding": scene.padding, "objects": objects})


def _object(item: SceneObject) -> dict:
    return {
        "name": item.name,
        "shape": item.shape,
        "size": list(item.size),
        "mesh": item.mesh_digest,
        "position": list(item.position),
        "orientation": list(item.quaternion),
        "padding": item.padding,
        "link": item.link,
        "touch": list(item.touch),
    }
