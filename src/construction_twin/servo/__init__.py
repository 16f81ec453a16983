"""How the arm's servos answer: their model, the file it is kept in, how it is identified, and how it is refined on line.

In: the targets that the controller took, one per cycle, and where the arm was measured. Out: where the servos should have the arm.
May import ``core``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.servo.file import read_servos as read_servos
    from construction_twin.servo.file import servo_file as servo_file
    from construction_twin.servo.identification import Drive as Drive
    from construction_twin.servo.identification import Identified as Identified
    from construction_twin.servo.identification import identify as identify
    from construction_twin.servo.model import JointServo as JointServo
    from construction_twin.servo.model import ServoModel as ServoModel
    from construction_twin.servo.model import ServoState as ServoState
    from construction_twin.servo.refine import Refinement as Refinement
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
