"""The load of a suction tool while the arm moves, against its cups' capacity.

The plate with the cups is rigid. What the workpiece is pulled and pushed by (its weight, its acceleration, what it touches) is
spread over the cups so that the plate is in balance with the least squares of their forces. A cup is four points on its lip, so
that one row of cups resists a moment, too. At each point pull and shear are one load, ``pull + shear / friction``, as makers of
cups calculate it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import coal
import mujoco
import numpy as np
import pinocchio

from construction_twin.extensions.physics.model import GRAVITY, PhysicsModel
from construction_twin.review.rehearsal_report import GripLoad
from construction_twin.robot.frames import rpy_to_quaternion
from construction_twin.robot.tool import Cups, FilePose
from construction_twin.scene.collision_bodies import Body

#: Friction of a cup's lip on what it holds [1], where unknown: dry board, stone and metal.
FRICTION = 0.5
#: A cup holds where this far below its plane [m] a ball of this radius [m] is inside of the workpiece.
_DEPTH, _BALL = 0.003, 0.002
#: Points of a cup, for one of radius 1: their pull together is that of the lip all around.
_LIP = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]) / math.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class SuctionGrip:
    """Cups that hold something.

    Attributes:
        tip_T_tcp: Plane of the cups in the robot's tip link; z points to what is held.
        cups: Shape (k, 2). Middle of each that holds, in that plane [m].
        holds: What one holds, safety factor included [N].
    """

    tip_T_tcp: pinocchio.SE3
    cups: np.ndarray
    radius: float
    holds: float

    @staticmethod
    def of(cups: Cups, tip_T_tcp: FilePose) -> SuctionGrip:
        """Return the grip of all cups of a tool."""
        pose = np.array((*tip_T_tcp.xyz, *rpy_to_quaternion(tip_T_tcp.rpy_deg)), dtype=float)
        at = np.array(cups.at, dtype=float)
        return SuctionGrip(pinocchio.XYZQUATToSE3(pose), at, cups.radius, cups.holds * GRAVITY)

    def on(self, pieces: Sequence[Body]) -> SuctionGrip:
        """Return the cups that lie on a workpiece, with its `pieces` placed in the frame of the tip link."""
        ball = coal.Sphere(_BALL)
        request = coal.CollisionRequest()
        placed = [
            (piece.geometry, coal.Transform3s(piece.placement.rotation, piece.placement.translation))
            for piece in pieces
        ]
        lying = []
        for x, y in self.cups:
            at = coal.Transform3s(np.eye(3), self.tip_T_tcp.act(np.array([x, y, _DEPTH])))
            lying.append(any(coal.collide(ball, at, *piece, request, coal.CollisionResult()) for piece in placed))
        return replace(self, cups=self.cups[np.array(lying, dtype=bool)])

    def usages(self, forces: np.ndarray, moments: np.ndarray) -> np.ndarray:
        """Return the fraction of what the cup that is loaded most holds, shape (N,).

        `forces`, `moments`: Shape (N, 3). What the cups must exert on the workpiece, about origin and axes of the plane [N], [N m].
        """
        points = (self.cups[:, None] + self.radius * _LIP).reshape(-1, 2)
        x, y = points.T
        ones, zeros = np.ones_like(x), np.zeros_like(x)
        # pulls towards the tool, along -z
        pulls = np.column_stack((forces[:, 2], moments[:, :2])) @ np.linalg.pinv(np.stack((-ones, -y, x))).T
        across = np.block([[ones, zeros], [zeros, ones], [-y, x]])
        shears = np.column_stack((forces[:, :2], moments[:, 2])) @ np.linalg.pinv(across).T
        shears = np.hypot(shears[:, : len(x)], shears[:, len(x) :])
        loads = np.maximum(pulls, 0.0) + shears / FRICTION
        return loads.max(axis=1) / (self.holds / len(_LIP))


class GripLoadRecorder:
    """Records what cups must exert on a workpiece, cycle by cycle; `pieces`: names of its objects, `joint`: above the tip."""

    def __init__(
        self,
        grip: SuctionGrip,
        name: str,
        physics: PhysicsModel,
        pieces: Sequence[str],
        joint: str,
        joint_T_tip: pinocchio.SE3,
    ):
        self._name = name
        self._grip, self._model = grip, physics.model
        self._pieces = [physics.model.body(name).id for name in pieces]
        self._holder = physics.model.body(f"joint\n{joint}").id
        self._root = physics.model.body_rootid[self._holder]
        self._joint_T_tcp = joint_T_tip * grip.tip_T_tcp
        self._times: list[float] = []
        self._forces: list[np.ndarray] = []
        self._moments: list[np.ndarray] = []

    def record_step(self, time: float, data: mujoco.MjData) -> None:
        """Record the last step, at `time` of the plan [s]: its accelerations, and the forces on the workpiece."""
        mujoco.mj_rnePostConstraint(self._model, data)
        moment, force = data.cfrc_int[self._pieces].sum(axis=0).reshape(2, 3)
        rotation = data.xmat[self._holder].reshape(3, 3)
        place = data.xpos[self._holder] + rotation @ self._joint_T_tcp.translation
        axes = rotation @ self._joint_T_tcp.rotation
        # MuJoCo's moments are about the centre of mass of all that hangs together
        moment = moment + np.cross(data.subtree_com[self._root] - place, force)
        self._times.append(time)
        self._forces.append(force @ axes)
        self._moments.append(moment @ axes)

    def worst(self) -> GripLoad:
        """Return the largest load of a cup over all cycles."""
        usages = self._grip.usages(np.array(self._forces), np.array(self._moments))
        number = int(np.argmax(usages))
        return GripLoad(self._name, len(self._grip.cups), self._times[number], float(usages[number]))
