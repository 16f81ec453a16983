"""Functions of the worker process that builds models and rehearses plans: the node outlives it.

``python -m`` with this module's name is the process; `core.worker` carries questions and answers.
"""

from __future__ import annotations

import hashlib
import json
import signal
import sys
import time
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from construction_twin.core.realtime import release_realtime
from construction_twin.core.worker import serve_parent
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.known_mass import body_of, masses_of
from construction_twin.extensions.physics.mass import payload_of
from construction_twin.review.rehearsal_report import RehearsalReport
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.robot.tool import read_tool, tool_hash
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_change import SceneChange
from construction_twin.scene.self_collision import read_self_collision

if TYPE_CHECKING:
    from construction_twin.extensions.physics.model import PhysicsModel
    from construction_twin.extensions.physics.rehearsal import Rehearsal

#: What the process is started with.
PROGRAM = (sys.executable, "-m", "construction_twin.extensions.physics.process")


@dataclass(frozen=True, eq=False)
class RehearsalRequest:
    """A plan to rehearse.

    Attributes:
        scenes: By hash: that of the plan, and those of its segments.
        masses: Of bodies that the arm carries, and of those that stand there and can be tipped over [kg].
        inputs: Hash of what else decides the result.
        standing: Which of these stand there.
        unweighed: Elements that stand there and whose mass is unknown.
    """

    plan: Plan
    scenes: Mapping[str, Scene]
    masses: Mapping[str, float]
    inputs: str
    standing: tuple[str, ...] = ()
    unweighed: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        plan: Plan,
        scene: Scene | None,
        changes: Sequence[SceneChange],
        known: Mapping[str, float],
        placed: Set[str],
        constant: str,
    ) -> RehearsalRequest:
        """Return the request of a plan; raises SceneError if a change does not lead to the scene that its segment names.

        Args:
            scene: That it begins in; None: unknown.
            known: Masses of bodies [kg].
            placed: Elements that stand where their tasks placed them.
            constant: Hash of all other inputs of the result.
        """
        there = () if scene is None else scene.objects
        objects = (*there, *(item for change in changes for item in change.put))
        carried = {body_of(item.name) for item in objects if item.link}
        stands = {body_of(item.name) for item in there} & placed - carried
        masses = {body: mass for body, mass in sorted(known.items()) if body in carried | stands}
        standing, unweighed = tuple(sorted(stands & masses.keys())), tuple(sorted(stands - masses.keys()))
        scenes = {} if scene is None else {scene.hash: scene}
        for segment, change in zip(plan.segments, changes):
            if scene is not None:
                scene = change.apply_checked(scene, segment.scene, segment.scene_after)
                scenes[scene.hash] = scene
        return cls(plan, scenes, masses, digest(constant, masses, standing, unweighed), standing, unweighed)


def digest(*parts: object) -> str:
    """Return the SHA-256 of values that JSON can write."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def file_digest(path: str) -> str:
    """Return the SHA-256 of a file; "" for an empty path."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else ""


@lru_cache(maxsize=1)
def load_rehearsal(
    robot: RobotModel, self_collision: str, drives: str, tool: str = "", payload: tuple[float, ...] = ()
) -> Rehearsal:
    """Return the `Rehearsal` of an arm; `drives` and `tool` may be empty, `payload` as in `payload_of`."""
    from construction_twin.extensions.physics.grip import SuctionGrip
    from construction_twin.extensions.physics.rehearsal import Rehearsal

    grip = None
    if tool and (at_tip := read_tool(tool).tool).cups is not None:
        grip = SuctionGrip.of(at_tip.cups, at_tip.tool0_T_tcp)
    pairs = read_self_collision(self_collision, robot)
    flange = payload_of(payload, "payload")
    read = read_drives(drives, robot)
    return Rehearsal(RobotBodies(robot), pairs, read, flange=flange, grip=grip, tool=tool_hash(tool))


def build(arm: Mapping, scene: Scene, masses: Mapping[str, float]) -> PhysicsModel:
    """Return the model of an arm, the arguments of `load_rehearsal`, in a scene; masses of bodies that it carries [kg]."""
    from construction_twin.extensions.physics.model import Load, build_model

    of = load_rehearsal(**arm)
    load = Load(masses_of(masses, (scene,), of.bodies), flange=of.flange)
    return build_model(of.bodies, scene, of.self_collision, of.drives, load)


def rehearse(arm: Mapping, request: RehearsalRequest) -> RehearsalReport:
    """Return what the rehearsal of a plan by an arm, the arguments of `load_rehearsal`, finds."""
    rehearsal = load_rehearsal(**arm)
    masses = masses_of(request.masses, request.scenes.values(), rehearsal.bodies, request.standing)
    found = replace(rehearsal, masses=masses, unweighed=request.unweighed, inputs=request.inputs)
    return found.of_plan(request.plan, request.scenes, time.perf_counter)


if __name__ == "__main__":
    # Ctrl-C reaches the whole group: the node ends this process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    release_realtime()
    serve_parent({"build": build, "rehearse": rehearse})
