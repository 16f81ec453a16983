"""What the elements of the work's tasks weigh, and the tool, for nodes that simulate."""

from __future__ import annotations

import math

from construction_twin.extensions.physics.known_mass import TOOL
from construction_twin.msg import WorkTasks
from construction_twin.robot.tool import read_tool

#: The state of `WorkTask.msg` in which an element stands at its place.
DONE = "done"


def element_masses(message: WorkTasks) -> dict[str, float]:
    """Return the masses that the tasks say, by element [kg]."""
    tasks = [task for task in message.tasks if math.isfinite(task.mass_kg) and task.mass_kg > 0.0]
    return {task.element: task.mass_kg for task in tasks}


def placed_elements(message: WorkTasks) -> frozenset[str]:
    """Return the elements of which a task is done: those of them that are in the scene stand where they were placed."""
    return frozenset(task.element for task in message.tasks if task.state == DONE)


def tool_mass(path: str) -> dict[str, float]:
    """Return what a tool file says that the tool weighs [kg]; of no file nothing. Raises like `read_tool`."""
    return {TOOL: read_tool(path).tool.mass} if path else {}
