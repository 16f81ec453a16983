"""An arm on a linear axis: six revolute joints on a carriage, which one prismatic joint moves.

Positions of the carriage [m]. Who solves the arm by itself asks here for a target as the arm sees it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.robot.urdf import chain_joints, parse_urdf

#: What a robot's description has for each joint.
_PER_JOINT = ("joint_names", "lower", "upper", "velocity", "acceleration", "jerk", "home", "axes", "linear")


class Carriage:
    """The carriage of an arm, and the arm on it.

    Args:
        chain: One prismatic joint followed by six revolute ones.

    Attributes:
        arm: The six joints on the carriage, which is their base.
        rotation: Shape (3, 3). Of ``base_T_carriage``.
        origin: Shape (3,). The carriage's origin in the base, at position zero [m].
        direction: Shape (3,). In which it travels, in the base.
    """

    def __init__(self, chain: Chain):
        robot = chain.robot
        joints = chain_joints(parse_urdf(robot.urdf), robot.base_link, robot.tip_link)
        link = next(joint.child for joint in joints if joint.name == robot.joint_names[0])
        self.arm = Chain(replace(robot, base_link=link, **{name: getattr(robot, name)[1:] for name in _PER_JOINT}))
        home = np.array(robot.home)
        home[0] = 0.0
        base_T_tip, carriage_T_tip = chain.forward(home), self.arm.forward(home[1:])
        self.rotation = base_T_tip.rotation @ carriage_T_tip.rotation.T
        self.origin = base_T_tip.position - self.rotation @ carriage_T_tip.position
        self.direction = chain.jacobian(home)[:3, 0]

    def seen_from(self, pose: Pose, position: float) -> Pose:
        """Return ``carriage_T_tip`` of a target with the carriage at a position.

        Args:
            pose: ``base_T_tip``
        """
        origin = self.origin + position * self.direction
        return Pose(self.rotation.T @ (pose.position - origin), self.rotation.T @ pose.rotation)
