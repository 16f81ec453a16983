"""Poses and joints: forward kinematics, closed-form and numerical inverse kinematics, singularities.

In: a robot description, a pose or joint values. Out: joint solutions with their residuals, or a typed error that says why there
is none. May import ``core`` and ``robot``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.kinematics.axes import Axis as Axis
    from construction_twin.kinematics.axes import joint_axes as joint_axes
    from construction_twin.kinematics.batch_kinematics import BatchKinematics as BatchKinematics
    from construction_twin.kinematics.chain import Chain as Chain
    from construction_twin.kinematics.chain import Pose as Pose
    from construction_twin.kinematics.chain import to_frame as to_frame
    from construction_twin.kinematics.chain import to_pose as to_pose
    from construction_twin.kinematics.inverse import inverse_kinematics as inverse_kinematics
    from construction_twin.kinematics.rail_singularities import WristSingularity as WristSingularity
    from construction_twin.kinematics.rail_singularities import find_singularities as find_singularities
    from construction_twin.kinematics.solution import ArmKind as ArmKind
    from construction_twin.kinematics.solution import Configuration as Configuration
    from construction_twin.kinematics.solution import IkSettings as IkSettings
    from construction_twin.kinematics.solution import IkSolution as IkSolution
    from construction_twin.kinematics.solution import InverseKinematics as InverseKinematics
    from construction_twin.kinematics.solution import check_pose as check_pose
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
