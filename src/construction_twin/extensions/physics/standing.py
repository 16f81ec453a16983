"""What can be tipped over and stands around before a plan begins: how it lies at rest, and what would move anyway. SI.

The planner's scene has every element where it was planned to be: without the mortar between two bricks, or a hair inside its
neighbour. So the simulation first lets everything come to rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.arm import Servo, SimulatedArm
from construction_twin.extensions.physics.judgement import SETTLING, STAYS, STAYS_TURNED
from construction_twin.extensions.physics.model import PhysicsModel
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import RobotModel
from construction_twin.scene.objects import SceneObject

#: What sinks by more than this stands on nothing that the scene has, such as mortar [m]: in the simulation the wall would be lower
#: than the plan has it.
SINKS = 0.001
#: A body slower than this lies still [m/s], [rad/s].
STILL = 0.01
#: So many bodies can be tipped over, those nearest to the tool's path: what lies awake takes time.
MOST = 40
#: For so long bodies that are inside each other part, without getting any speed from it [s].
_PARTING = 0.1
#: What stands without the restless may be restless itself: it is looked at anew so often. What is left then is fixed, too.
_ROUNDS = 4
#: Poses along a plan from which distances are measured.
_POSES = 64


@dataclass(frozen=True, eq=False)
class RestingBodies:
    """How bodies stand before a plan begins.

    Attributes:
        places: By body: where it lies at rest, shape (7,): x, y, z [m], and the quaternion w, x, y, z.
        restless: Bodies that move without the plan, and how far [m].
    """

    places: Mapping[str, np.ndarray] = field(default_factory=dict)
    restless: Mapping[str, float] = field(default_factory=dict)


def displacement(before: np.ndarray, now: np.ndarray) -> tuple[float, float, float]:
    """Return how far a body has moved [m], turned [rad] and sunk [m] between two places, each of shape (7,)."""
    turned = 2.0 * math.acos(min(1.0, abs(float(before[3:] @ now[3:]))))
    return float(np.linalg.norm(now[:3] - before[:3])), turned, float(before[2] - now[2])


def come_to_rest(
    build: Callable[[Mapping[str, str]], PhysicsModel], pieces: Mapping[str, str], pose: np.ndarray, servo: Servo
) -> RestingBodies | None:
    """Let bodies come to rest around an arm that stands still; None: the simulation came apart.

    Args:
        build: Returns the model in which some objects are loose, see `Load.loose`.
        pieces: Body of each object that can be moved, by name.
    """
    restless: dict[str, float] = {}
    for number in range(_ROUNDS + 1):
        left = {name: body for name, body in pieces.items() if body not in restless}
        if not left:
            break
        arm = SimulatedArm(build(left), pose, servo)
        before = {body: arm.loose_state(body)[0] for body in arm.physics.loose}
        _settle(arm, pose)
        if not np.isfinite(arm.data.qpos).all():
            return None
        after = {body: arm.loose_state(body) for body in before}
        moved = {body: displacement(before[body], place) for body, (place, _) in after.items()}
        found = {
            body: way
            for body, (way, turned, sunk) in moved.items()
            if sunk > SINKS or way > STAYS or turned > STAYS_TURNED or np.abs(after[body][1]).max() > STILL
        }
        if not found:
            return RestingBodies({body: place for body, (place, _) in after.items()}, restless)
        restless |= found if number < _ROUNDS else {body: way for body, (way, _, _) in moved.items()}
    return RestingBodies({}, restless)


def _settle(arm: SimulatedArm, pose: np.ndarray) -> None:
    """Let everything loose part from what it is inside of, and then lie until it sleeps, for `SETTLING` at most."""
    data = arm.data
    speeds = np.concatenate([arm.speeds_of(body) for body in arm.physics.loose])
    for _ in range(round(_PARTING / CYCLE)):
        for _step in arm.steps(pose):
            # two bricks that are planned a millimetre into each other part; they do not jump
            data.qvel[speeds] = 0.0
    arm.physics.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    for _ in range(round(SETTLING / CYCLE)):
        arm.cycle(pose)
        # what sleeps has no speed at all
        if not data.qvel[speeds].any():
            return


def nearest_bodies(
    objects: Iterable[SceneObject], bodies: Mapping[str, str], robot: RobotModel, poses: np.ndarray
) -> list[str]:
    """Return the bodies of objects, those first that the tool comes nearest to along `poses`, shape (m, n); then by name."""
    rows = poses[np.unique(np.linspace(0, len(poses) - 1, _POSES).round().astype(int))]
    chain = Chain(robot)
    path = np.array([chain.forward(row).position for row in rows])
    found: dict[str, float] = {}
    for item in objects:
        away = float(np.linalg.norm(path - np.array(item.position), axis=1).min())
        body = bodies[item.name]
        found[body] = min(away, found.get(body, math.inf))
    return sorted(found, key=lambda body: (found[body], body))
