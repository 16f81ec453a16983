"""Scene and work tasks as JSON for consoles; meshes by their digests, because a console does not see this machine's files."""

from __future__ import annotations

import math

from construction_twin.core.records import dumped
from construction_twin.msg import WorkTask, WorkTasks
from construction_twin.scene.objects import Scene, SceneObject


def scene_json(scene: Scene, frame: str) -> bytes:
    """Return the payload for `scene`; `frame` is the robot's base_link."""
    objects = [_object(item) for item in scene.objects]
    return dumped({"hash": scene.hash, "frame": frame, "padding": scene.padding, "objects": objects})


def tasks_json(message: WorkTasks) -> bytes:
    """Return the payload for `work/tasks`."""
    document = {
        "stamp": message.header.stamp.to_sec(),
        "model": message.model,
        "model_hash": message.model_hash,
        "schedule": message.schedule,
        "engaged": bool(message.engaged),
        "reading": bool(message.reading),
        "next": message.next,
        "reason": message.reason,
        "tasks": [_task(task) for task in message.tasks],
        "notes": list(message.notes),
    }
    return dumped(document)


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
    numbers = {
        name: value if math.isfinite(value := getattr(task, name)) else None
        for name in ("deviation_mm", "deviation_deg", "mass_kg", "scheduled_duration", "tolerance_mm", "tolerance_deg")
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
        **numbers,
        "question": task.question,
        "answers": list(task.answers),
        "grip": task.grip,
        "scheduled_start": task.scheduled_start,
        "begun": task.begun.to_sec() if task.begun else None,
        "settled": task.settled.to_sec() if task.settled else None,
    }
