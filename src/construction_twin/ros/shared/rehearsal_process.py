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
from construction_twin.physics.known_mass import masses_of
from construction_twin.physics.mass import payload_of
from construction_twin.physics.report import RehearsalReport
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.robot.tool import read_tool, tool_hash
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.work.worker import serve_parent

if TYPE_CHECKING:
    from construction_twin.physics.rehearsal import Rehearsal

#: What the process is started with.
PROGRAM = (sys.executable, "-m", "construction_twin.ros.shared.rehearsal_process")


@dataclass(frozen=True, eq=False)
class Question:
    """A plan to rehearse.

    Attributes:
        scenes: By hash: that of the plan, and those of its segments.
        masses: Of bodies that the arm carries, and of those that stand there and can be tipped over, see `physics.known_mass` [kg].
        inputs: Hash of what else decides the result.
        standing: Which of these stand there.
        unweighed: Elements that stand there, too, and of which nobody says the mass.
    """

    plan: Plan
    scenes: Mapping[str, Scene]
    masses: Mapping[str, float]
    inputs: str
    standing: tuple[str, ...] = ()
    unweighed: tuple[str, ...] = ()


#: Of this process, made by `_prepare`.
_prepared: list[Rehearsal] = []


def prepared(
    robot: RobotModel, self_collision: str, drives: str, tool: str = "", payload: tuple[float, ...] = ()
) -> Rehearsal:
    """Return what rehearses the plans of an arm.

    Args:
        self_collision: YAML of the link pairs that are not checked.
        drives: YAML of the arm's drives; empty: what its URDF says.
        tool: Tool file; empty: no tool.
        payload: At the flange, see `payload_of`.
    """
    from construction_twin.physics.grip import SuctionGrip
    from construction_twin.physics.rehearsal import Rehearsal

    read = read_drives(drives, robot) if drives else drives_of(robot)
    grip = None
    if tool and (at_tip := read_tool(tool).tool).cups is not None:
        grip = SuctionGrip.of(at_tip.cups, at_tip.tool0_T_tcp)
    pairs = read_self_collision(self_collision, robot)
    flange = payload_of(payload, "payload")
    return Rehearsal(RobotBodies(robot), pairs, read, flange=flange, grip=grip, tool=tool_hash(tool))


def answer(rehearsal: Rehearsal, question: Question) -> RehearsalReport:
    """Return what a rehearsal finds."""
    masses = masses_of(question.masses, question.scenes.values(), rehearsal.bodies, question.standing)
    found = replace(rehearsal, masses=masses, unweighed=question.unweighed, inputs=question.inputs)
    return found.of_plan(question.plan, question.scenes, time.perf_counter)


def _prepare(robot: RobotModel, self_collision: str, drives: str, tool: str, payload: tuple[float, ...] = ()) -> None:
    _prepared[:] = [prepared(robot, self_collision, drives, tool, payload)]


def _rehearse(question: Question) -> RehearsalReport:
    return answer(_prepared[0], question)


if __name__ == "__main__":
    # Ctrl-C reaches the whole group: the node ends this process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve_parent({"prepare": _prepare, "rehearse": _rehearse})
