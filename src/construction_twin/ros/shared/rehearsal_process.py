"""Rehearses plans in a process of its own, behind everything else on the machine: what a simulation does there, the node outlives.

``python -m`` with this module's name is the process; `work.worker` carries questions and answers. Knows no ROS.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from construction_twin.physics.drive import drives_of, read_drives
from construction_twin.physics.mass import of_shape, payload_of
from construction_twin.physics.report import RehearsalReport
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.work.worker import serve_parent

if TYPE_CHECKING:
    from construction_twin.physics.rehearsal import Rehearsal

#: What the process is started with.
PROGRAM = (sys.executable, "-m", "construction_twin.ros.shared.rehearsal_process")


@dataclass(frozen=True)
class Body:
    """Several objects that are one body of a known mass.

    Attributes:
        names: Of the objects.
        mass: Of all of them together [kg].
    """

    names: tuple[str, ...]
    mass: float


@dataclass(frozen=True, eq=False)
class Question:
    """A plan to rehearse.

    Attributes:
        scenes: By hash: that of the plan, and those of its segments.
        bodies: Whose mass somebody says; objects that none of the scenes has are left out.
        tool: Hash of what else decides the result.
    """

    plan: Plan
    scenes: Mapping[str, Scene]
    bodies: tuple[Body, ...]
    tool: str


#: Of this process, made by `_prepare`.
_prepared: list[Rehearsal] = []


def prepared(robot: RobotModel, self_collision: str, drives: str, payload: tuple[float, ...] = ()) -> Rehearsal:
    """Return what rehearses the plans of an arm.

    Args:
        self_collision: YAML of the link pairs that are not checked.
        drives: YAML of the arm's drives; empty: what its URDF says.
        payload: At the flange, see `payload_of`.
    """
    from construction_twin.physics.rehearsal import Rehearsal

    read = read_drives(drives, robot) if drives else drives_of(robot)
    flange = payload_of(payload, "payload")
    return Rehearsal(RobotBodies(robot), read_self_collision(self_collision, robot), read, flange=flange)


def shares(bodies: tuple[Body, ...], scenes: Mapping[str, Scene], robot: RobotBodies) -> dict[str, float]:
    """Return the mass of each object of the bodies, by name: of what a body weighs as much as of its volume [kg]."""
    objects = {item.name: (item, scene) for scene in scenes.values() for item in scene.objects}
    found: dict[str, float] = {}
    for body in bodies:
        parts = {
            name: of_shape(robot.place(objects[name][0], objects[name][1].names).geometry).mass
            for name in body.names
            if name in objects
        }
        found |= {name: body.mass * part / sum(parts.values()) for name, part in parts.items()}
    return found


def answer(rehearsal: Rehearsal, question: Question) -> RehearsalReport:
    """Return what a rehearsal finds."""
    masses = shares(question.bodies, question.scenes, rehearsal.bodies)
    return replace(rehearsal, masses=masses, tool=question.tool).of_plan(
        question.plan, question.scenes, time.perf_counter
    )


def _prepare(robot: RobotModel, self_collision: str, drives: str, payload: tuple[float, ...] = ()) -> None:
    _prepared[:] = [prepared(robot, self_collision, drives, payload)]


def _rehearse(question: Question) -> RehearsalReport:
    return answer(_prepared[0], question)


if __name__ == "__main__":
    # Ctrl-C reaches the whole group: the node ends this process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve_parent({"prepare": _prepare, "rehearse": _rehearse})
