"""Arms with mass, plans and scenes that the tests of the simulation share."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio
from plan_samples import make_plan
from scene_samples import kr120, kr120_pairs, track7, track7_pairs, ur_like_pairs

from construction_twin.extensions.physics.drive import ArmDrives, drives_of, read_drives
from construction_twin.extensions.physics.model import Load, PhysicsModel, build_model
from construction_twin.extensions.physics.rehearsal import Rehearsal
from construction_twin.review.rehearsal_report import RehearsalReport
from construction_twin.robot.description import RobotModel, load_robot, read_robot_files
from construction_twin.robot.new_robot import new_description
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import SelfCollision

ROOT = Path(__file__).parents[2]
DRIVES = ROOT / "config/kr120_drives.yaml"
#: Robots of test/data, beside those of the package.
OTHERS = ("iiwa_like", "panda_like", "ur_like")
#: A pose of the KR 120 in which it stands well away from the floor [rad].
READY = np.radians((0.0, -90.0, 90.0, 0.0, 45.0, 0.0))


#: The shipped scene.
SHIPPED = read_scene(ROOT / "config/scene.yaml")


@cache
def robot_of(name: str) -> RobotModel:
    if name in ("kr120", "kr120_track"):
        return kr120() if name == "kr120" else track7()
    if name in ("balanced_like", "endless_like"):
        urdf = (ROOT / f"test/data/{name}.urdf").read_text()
        return load_robot(urdf, new_description(urdf, name, "base_link", "tool0", 1.0))
    if name == "ur_like_gripper":
        return read_robot_files(ROOT / f"test/data/{name}.urdf.xacro", ROOT / f"test/data/{name}.yaml")
    return read_robot_files(ROOT / f"test/data/{name}.urdf", ROOT / f"test/data/{name}.yaml")


@cache
def bodies_of(name: str) -> RobotBodies:
    return RobotBodies(robot_of(name))


@cache
def pairs_of(name: str) -> SelfCollision:
    known = {"kr120": kr120_pairs, "kr120_track": track7_pairs, "ur_like": ur_like_pairs}
    if name in known:
        return known[name]()
    links = {body.owner for body in bodies_of(name).bodies}
    # which links may touch is nothing that a mass depends on
    return SelfCollision({frozenset(pair): "never" for pair in itertools.combinations(links, 2)}, "")


def drives(name: str = "kr120") -> ArmDrives:
    """Return the file's drives of the KR 120, of another arm what its URDF says."""
    return read_drives(DRIVES, kr120()) if name == "kr120" else drives_of(robot_of(name))


def model_of(
    name: str = "kr120", scene: Scene = Scene(), load: Load = Load(), of: ArmDrives | None = None
) -> PhysicsModel:
    """Return the model of an arm, of one that has no other drives with those of its URDF."""
    return build_model(bodies_of(name), scene, pairs_of(name), drives_of(robot_of(name)) if of is None else of, load)


def carrying(size: float) -> Scene:
    """Return the shipped scene with a cube of that size [m] at the flange, of 1000 kg/m^3."""
    return SHIPPED.add(SceneObject("cube", "box", (size,) * 3, (0.0, 0.0, size / 2.0 + 0.01), link=kr120().tip_link))


@cache
def model_in(scene: Scene = SHIPPED) -> PhysicsModel:
    """Return the shipped arm in a scene, with the drives of its file."""
    return model_of(scene=scene, of=drives())


def dynamics_of(name: str) -> tuple[pinocchio.Model, np.ndarray]:
    """Return Pinocchio's own model of an arm, and where each joint of the chain is in its arrays."""
    bodies = bodies_of(name)
    model = bodies.model
    model.gravity.linear = np.array((0.0, 0.0, -9.80665))
    return model, bodies.order


def between(start: Sequence[float], goal: Sequence[float], duration: float, name: str = "kr120") -> Trajectory:
    """Return a quintic motion from rest to rest."""
    ends = np.array((start, goal), dtype=float)
    return Trajectory(
        robot_of(name).joint_names, np.array((0.0, duration)), ends, np.zeros_like(ends), np.zeros_like(ends)
    )


def plan_of(trajectory: Trajectory, scene: Scene, segments: tuple[Segment, ...] = ()) -> Plan:
    """Return a plan as if checked in `scene`."""
    task = "task" if segments else ""
    plain = make_plan(trajectory, scene=scene.hash)
    return replace(plain, hash=content_hash(trajectory, task, segments), task=task, segments=segments)


def bricks(
    counts: Sequence[int] = (6, 5, 4, 3, 2),
    head: float = 0.01,
    bed: float = 0.0,
    shift: float = 0.0,
    at: tuple[float, float] = (-2.5, 0.0),
) -> tuple[SceneObject, ...]:
    """Return a wall of bricks on the floor along y, in running bond, laid as the package's sample lays them.

    Args:
        counts: Bricks in each course, from below.
        head, bed: Joints beside and below a brick [m]; below 0: the bricks are inside each other.
        shift: By so much each brick is off its place, one to this side, the next to that [m].
        at: Where the middle of the wall is [m].
    """
    length, width, height = 0.24, 0.115, 0.071
    x, y = at
    return tuple(
        SceneObject(
            f"brick{course}.{number}",
            "box",
            (width, length, height),
            (
                x + shift * (-1) ** number,
                y + (number - (count - 1) / 2) * (length + head),
                height / 2 + course * (height + bed),
            ),
        )
        for course, count in enumerate(counts)
        for number in range(count)
    )


def rehearse(trajectory: Trajectory, *scenes: Scene, name: str = "kr120", **settings: object) -> RehearsalReport:
    """Return the report of a motion: in one scene, or with equal parts in all but the last, which is there at the end."""
    known = scenes or (Scene(),)
    segments: tuple[Segment, ...] = ()
    if len(known) > 1:
        parts = list(itertools.pairwise(known))
        ends = np.linspace(0.0, trajectory.duration, len(parts) + 1)[1:].tolist()
        segments = tuple(
            Segment(f"part {number}", end, False, (), (), one.hash, other.hash)
            for number, (end, (one, other)) in enumerate(zip(ends, parts))
        )
    by_hash: Mapping[str, Scene] = {scene.hash: scene for scene in known}
    settings = {"drives": drives(name)} | settings
    rehearsal = Rehearsal(bodies_of(name), pairs_of(name), **settings)  # type: ignore[arg-type]
    return rehearsal.of_plan(plan_of(trajectory, known[0], segments), by_hash, lambda: 0.0)
