"""Scene and work tasks as JSON for consoles; meshes by their digests, because a console does not see this machine's files."""

from __future__ import annotations

import json
import math

from construction_twin.msg import WorkTask, WorkTasks
from construction_twin.scene.objects import Scene, SceneObject


def scene_json(scene: Scene, frame: str) -> bytes:
    """Return the payload for `scene`; `frame` is the robot's base_link."""
    objects = [_object(item) for item in scene.objects]
    return _dumped({"hash": scene.hash, "frame": frame, "padding": scene.padding, "objects": objects})


def tasks_json(message: WorkTasks) -> bytes:
    """Return the payload for `work/tasks`."""
    document = {
        "stamp": message.header.stamp.to_sec(),
        "model": message.model,
        "model_hash": message.model_hash,
        "schedule": message.schedule,
        "engaged": bool(message.engaged),
        "next": message.next,
        "reason": message.reason,
        "tasks": [_task(task) for task in message.tasks],
        "notes": list(message.notes),
    }
    return _dumped(document)


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


def _task(task: WorkTask) -> dict:
    deviations = {
        name: value if math.isfinite(value) else None
        for name, value in (("deviation_mm", task.deviation_mm), ("deviation_deg", task.deviation_deg))
    }
    return {
        "id": task.id,
        "name": task.name,
        "element": task.element,
        "element_name": task.element_name,
        "state": task.state,
        "reason": task.reason,
        "after": list(task.after),
        "robot": task.robot,
        "plan_id": task.plan_id,
        **deviations,
        "question": task.question,
        "answers": list(task.answers),
    }


def _dumped(document: dict) -> bytes:
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
