"""A mock robot controller, a KR C4 by default: a client of the gateway with its own clock, servo model, limits, faults on demand.

In: replies, the file that describes them, faults. Out: telegrams and the true joint positions. May import ``core``,
``controller``, ``robot``, ``kinematics``, ``physics`` and ``scene``; the last two only with the servo `physics`.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.mock.config import MockConfig as MockConfig
    from construction_twin.mock.controller import MockController as MockController
    from construction_twin.mock.faults import Fault as Fault
    from construction_twin.mock.faults import FaultBoard as FaultBoard
    from construction_twin.mock.faults import FaultKind as FaultKind
    from construction_twin.mock.gripper import Gripper as Gripper
    from construction_twin.mock.network import MockRsi as MockRsi
    from construction_twin.mock.network import Result as Result
    from construction_twin.mock.physics_servo import PhysicsServo as PhysicsServo
    from construction_twin.mock.program import MockSettings as MockSettings
    from construction_twin.mock.program import axis_angles as axis_angles
    from construction_twin.mock.program import build_controller as build_controller
    from construction_twin.mock.program import build_servo as build_servo
    from construction_twin.mock.program import joint_angles as joint_angles
    from construction_twin.mock.program import make_forward_kinematics as make_forward_kinematics
    from construction_twin.mock.servo import IdealServo as IdealServo
    from construction_twin.mock.servo import RealisticServo as RealisticServo
    from construction_twin.mock.servo import Servo as Servo
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
