"""The singular wrist of an arm of the OPW kind: axes 4 and 6 in line, so that a pose determines only the sum of joints 4 and 6."""

from __future__ import annotations

import math

import numpy as np

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.opw import OpwModel
from construction_twin.kinematics.ranges import TURN
from construction_twin.robot.description import JointValues

#: A joint that is out of range by less is at the end of its range but for rounding [rad].
_ROUNDING = 1e-7


class SingularWrist:
    """Chooses joints 4 and 6 where axes 4 and 6 are in line."""

    def __init__(self, chain: Chain, model: OpwModel):
        self._chain = chain
        self._model = model
        self._lower, self._upper = np.array(chain.robot.lower)[[3, 5]], np.array(chain.robot.upper)[[3, 5]]
        self._tip_R_flange = model.flange_T_tip[:3, :3].T

    def families(self, branch: np.ndarray, pose: Pose, seed: JointValues) -> list[np.ndarray]:
        """Return solutions with axes 4 and 6 in line, one for each choice of whole turns, the nearest to the seed first.

        Args:
            branch: Shape (6,). [rad]. Used are joints 1 to 3, and whether joint 5 is closer to parallel or to opposed axes 4 and 6.
            pose: Target ``base_T_tip``.
            seed: Length 6. [rad]

        Returns:
            Each of shape (6,). With joints 4 and 6 within their ranges except for rounding, whole turns included; joints 1 to 3
            unchanged.
        """
        signs, offsets = self._model.signs, self._model.offsets
        theta = np.asarray(signs) * branch - offsets
        opposed = math.cos(theta[4]) < 0.0
        q = branch.copy()
        q[4] = signs[4] * ((math.copysign(math.pi, theta[4]) if opposed else 0.0) + offsets[4])
        # the sense in which joints 4 and 6 contribute to the missing angle
        fraction = np.array([signs[3], -signs[5] if opposed else signs[5]], dtype=float)
        missing = self._missing_turn(q, pose, seed, opposed)
        start = np.array([seed[3], seed[5]])
        lower, upper = self._lower - start, self._upper - start
        turns = math.ceil(float((upper - lower).sum()) / TURN) + 1
        found = []
        for total in (missing + TURN * turn for turn in range(-turns, turns + 1)):
            # joint 4 takes t and joint 6 takes total - t; both must stay in range
            ends = np.sort(
                [
                    [lower[0] * fraction[0], upper[0] * fraction[0]],
                    [total - lower[1] * fraction[1], total - upper[1] * fraction[1]],
                ]
            )
            low, high = float(ends[:, 0].max()), float(ends[:, 1].min())
            if low <= high + _ROUNDING:
                t = min(max(0.5 * total, low), high)
                solution = q.copy()
                solution[[3, 5]] = start + fraction * (t, total - t)
                found.append(solution)
        return sorted(found, key=lambda solution: math.dist(solution, seed))

    def _missing_turn(self, q: np.ndarray, pose: Pose, seed: JointValues, opposed: bool) -> float:
        """Return the angle about axis 6 from the tip to the target, with joints 4 and 6 at the seed [rad]."""
        held = q.copy()
        held[[3, 5]] = seed[3], seed[5]
        reached = self._chain.forward(held).rotation @ self._tip_R_flange
        target = pose.rotation @ self._tip_R_flange
        turned = reached.T @ target
        angle = math.atan2(turned[1, 0], turned[0, 0])
        # the angle counts about axis 4, and opposed axes have the opposite sense
        return -angle if opposed else angle
